"""Distance fields: the grids they are sampled on, their values and derivatives, and how far they are off."""
