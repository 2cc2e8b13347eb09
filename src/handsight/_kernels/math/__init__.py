"""Linear algebra of small matrices, kinematic chains and symmetry groups."""
