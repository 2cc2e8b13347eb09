"""What contacts compute: eq. 7 of the paper, taxels, and both in the palm's frame."""
