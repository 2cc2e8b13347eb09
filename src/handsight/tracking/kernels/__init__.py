"""What the smoother computes."""
