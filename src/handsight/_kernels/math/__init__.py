"""Small linear algebra, kinematic chains and symmetry groups for kernels."""
