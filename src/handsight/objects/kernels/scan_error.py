"""How the errors of a scanned surface count."""

CHI2_95 = 3.84
"""Factor on the variance of a slope or a curvature, the 95 % quantile of χ² with one degree of freedom: a grasp meets
few bumps at once, and their mean would not be enough."""
