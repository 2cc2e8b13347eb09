"""The ground that kernels of all rooms stand on: how they are compiled, records, small vectors and matrices."""
