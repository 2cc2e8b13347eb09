"""What images compute: votes, refinement, scores, outlines."""
