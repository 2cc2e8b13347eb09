"""What slip computes."""
