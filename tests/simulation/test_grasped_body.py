"""An object to be grasped: how it rests on a table."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog

from handsight import se3
from handsight.simulation.grasped_body import body_of, rests, standing


def shapes():
    rng = np.random.default_rng(0)
    yield "box", trimesh.creation.box((0.05, 0.09, 0.17)).vertices
    yield (
        "flat",
        trimesh.creation.box((0.13, 0.12, 0.035)).vertices @ se3.rotation_exp(np.array([0, 0, 0.6])).T,
    )
    yield "rod", trimesh.creation.cylinder(0.01, 0.12, sections=40).vertices
    yield "ball", trimesh.creation.icosphere(3, 0.04).vertices
    for k in range(3):
        yield f"random {k}", rng.normal(size=(60, 3)) * [0.02, 0.03, 0.04] + rng.normal(size=3)


@pytest.fixture(scope="module", params=list(shapes()), ids=lambda case: case[0])
def body(request):
    return body_of(np.asarray(request.param[1], dtype=np.float64))


def test_a_body_rests_on_sides_that_carry_its_weight(body):
    found = rests(body)
    np.testing.assert_array_equal(found[0], np.eye(3))
    for R in found[1:]:
        at = standing(body, R)
        assert at.vertices[:, 2].min() == pytest.approx(0, abs=1e-12)
        # Independent of the faces: no mixture of its lowest points that balances is farther than 2 mm aside.
        low = at.vertices[at.vertices[:, 2] < 5e-4]
        sides = [(s, i) for i in (0, 1) for s in (1, -1)]
        off = linprog(
            np.r_[np.zeros(len(low)), 1.0],
            A_eq=np.r_[np.ones(len(low)), 0][None],
            b_eq=[1],
            A_ub=np.array([np.r_[s * low[:, i], -1.0] for s, i in sides]),
            b_ub=[s * at.center_mass[i] for s, i in sides],
        )
        assert off.fun < 0.002
