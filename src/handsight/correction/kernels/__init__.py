"""What a correction computes: evidence, search and posterior."""
