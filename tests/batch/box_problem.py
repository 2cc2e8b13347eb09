"""A problem with a known answer, as JSON has it: a box in five fingers, at the palm's origin."""

import json

BOX = {
    "object": {"box": [0.06, 0.09, 0.14]},
    "contacts": [
        {"point": [0.030, 0.010, 0.030], "normal": [1, 0, 0], "sigma_point": 0.001, "sigma_normal_deg": 5},
        {"point": [0.030, -0.020, -0.040], "normal": [2, 0, 0]},
        {"point": [-0.010, 0.045, 0.020], "normal": [0, 1, 0]},
        {"point": [0.015, 0.045, -0.030], "normal": [0, 1, 0]},
        {"point": [0.010, 0.020, 0.070], "normal": [0, 0, 1]},
    ],
    "vision": {
        "position": [0.02, -0.01, 0.015],
        "quaternion_xyzw": [0.025, 0.01, -0.02, 1.0],
        "sigma_position": 0.03,
        "sigma_rotation_deg": 15,
    },
}
KEYS = [
    "position",
    "quaternion_xyzw",
    "maximum",
    "covariance",
    "information",
    "converged",
    "iterations",
    "seconds",
    "residuals",
    "unobservable",
    "consistent",
    "outliers",
    "conflicts",
    "hypotheses",
]


def changed(path, value):
    """The box problem with one field, named like `contacts[0].point`, replaced (or removed by `...`)."""
    problem = json.loads(json.dumps(BOX))
    *way, last = path.replace("]", "").replace("[", ".").split(".")
    at = problem
    for step in way:
        at = at[int(step)] if isinstance(at, list) else at[step]
    if value is ...:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value
    return problem
