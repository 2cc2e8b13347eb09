"""Where what is in the flat arrays that kernels take. All SI, doubles unless said otherwise.

`model`: one object. `singles`: its float32 part, the grids' nodes and the table that phase 1 scans. `contacts`:
CONTACT numbers for each contact. `prior`: vision's pose and covariance. `sight`: the same as evidence about an
object so symmetric. `hand`: sigma of the outside points, then these, 3 numbers each. `out`: an answer.
"""

# A field, FIELD numbers. An exact one has its half sizes (box), radius and half height (cylinder) or radius
# (sphere) in place of the origin.
KIND, ORIGIN, CELL, INVERSE_CELL, SHAPE, LEAST, NODES = 0, 1, 4, 5, 6, 9, 10
FIELD = 12
GRID, BOX, CYLINDER, SPHERE = 0, 1, 2, 3

# The model.
COARSE, FINE = 0, FIELD
RADIUS = 2 * FIELD
CENTER = RADIUS + 1
SAMPLE_VARIANCE = CENTER + 3  # of a sample's plane [m²] and of its normal per axis [rad²]
BAND = SAMPLE_VARIANCE + 2
WEIGHT_TANGENTIAL = BAND + 1
MATCH_WEIGHT = WEIGHT_TANGENTIAL + 1  # what a unit of normal is worth in phase 1, squared [m²]
LEAST_ROUGH = MATCH_WEIGHT + 1  # variances of distance and normal
SHARP = LEAST_ROUGH + 2  # squared curvature of an edge
BLUR = SHARP + 1  # variances of the coarse field's distance and normal
SYMMETRY = BLUR + 2
AXIS_COUNT = SYMMETRY + 1
PIVOT = AXIS_COUNT + 1
AXES = PIVOT + 3  # three directions
ROTATION_COUNT = AXES + 9
ROTATIONS = ROTATION_COUNT + 1  # where in `model` they begin, 12 numbers each
SAMPLES = ROTATIONS + 1  # where in `model`: point and normal, 6 numbers each
SCAN = SAMPLES + 1  # where in `singles`: 7 rows
SCAN_COUNT = SCAN + 1  # their length
ROUGH_CELL = SCAN_COUNT + 1  # one over it; 0: no roughness
ROUGH_ORIGIN = ROUGH_CELL + 1
ROUGH_SHAPE = ROUGH_ORIGIN + 3
ROUGH = ROUGH_SHAPE + 3  # where in `model`
BOUNDS = ROUGH + 1  # least and greatest corner of a box around all of the object
MODEL = BOUNDS + 6
# What of the symmetries the kernels know: none, finitely many, an axis through the origin (and finitely many).
NONE, DISCRETE, AXIS, OTHER = 0, 1, 2, 3

# A contact. Its mean variances and whether its point's covariance is that of a ball, and apart from the normal's,
# are filled in by the kernel.
POINT, NORMAL, HAS_NORMAL, VARIANCE, BALL, COVARIANCE = 0, 3, 6, 7, 9, 10
CONTACT = 46

# A prior: rotation row by row, position, covariance of (δp, δθ).
PRIOR_ROTATION, PRIOR_POSITION, PRIOR_COVARIANCE = 0, 9, 12
PRIOR = 48

# Sight as evidence.
HAS_AXIS, PIVOT_OBJECT, AXIS_OBJECT, PIVOT_PALM, ROTATION, INFORMATION = 1, 2, 5, 8, 11, 20
SIGHT = 56
BLIND, VISION, HELD = 0, 1, 2

# Normal equations, 7 rows of 8: Hessian, gradient in row and column 6, cost where these meet.
GRADIENT, COST = 48, 54
EQUATIONS = 56

# The hand's points begin after their sigma.
HAND = 1

# An answer: pose, cost of the descent, steps, whether it converged, χ², minus two log of the density, whether all is
# known, the number of open directions, the largest gain of leaving out a contact, the prior's width, how many of the
# contacts have a normal; then matrices, distances and angles.
DESCENT_COST, STEPS, CONVERGED, CHI2, POSTERIOR_COST = 12, 13, 14, 15, 16
COMPLETE, OPEN_COUNT, GAIN, WIDTH, NORMALS = 17, 18, 19, 20, 21
TRANSFORM_OUT, INFORMATION_OUT, COVARIANCE_OUT, OPEN_OUT, RESIDUALS = 22, 38, 74, 110, 146
