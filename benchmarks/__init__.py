"""handsight against its peers: time, success and accuracy side by side. Run with `python -m benchmarks`."""

import os
from pathlib import Path

# Threads of one peer that wait for more work by spinning would slow the next one, on the same cores.
for name, value in (("OMP_WAIT_POLICY", "PASSIVE"), ("GOMP_SPINCOUNT", "0"), ("KMP_BLOCKTIME", "0")):
    os.environ.setdefault(name, value)

ROOT = Path(__file__).parents[1]
