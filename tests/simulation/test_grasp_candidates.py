"""Where an object could be held: laws of the geometry, and of the balance of forces against a linear program."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog

from handsight import se3
from handsight.simulation.shadow_grasps import GRASP, body_of, forces, grasp_candidates, rests


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


def test_a_smooth_body_is_the_hull_of_its_points_within_a_hundredth_of_its_size():
    for _, vertices in list(shapes())[:4]:
        body, hull = body_of(vertices), trimesh.convex.convex_hull(vertices)
        assert (vertices @ body.normals.T - body.offsets).max() < 0.01 * np.ptp(vertices, axis=0).max()
        np.testing.assert_allclose(body.mass, hull.center_mass, atol=5e-4)
        assert body.areas.sum() == pytest.approx(hull.area, rel=0.02)


def test_a_body_rests_on_sides_that_carry_its_weight(body):
    found = rests(body)
    np.testing.assert_array_equal(found[0], np.eye(3))
    for R in found[1:]:
        at = body.turned(R)
        assert at.vertices[:, 2].min() == pytest.approx(0, abs=1e-12)
        # Independent of the faces: no mixture of its lowest points that balances is farther than 2 mm aside.
        low = at.vertices[at.vertices[:, 2] < 5e-4]
        sides = [(s, i) for i in (0, 1) for s in (1, -1)]
        off = linprog(
            np.r_[np.zeros(len(low)), 1.0],
            A_eq=np.r_[np.ones(len(low)), 0][None],
            b_eq=[1],
            A_ub=np.array([np.r_[s * low[:, i], -1.0] for s, i in sides]),
            b_ub=[s * at.mass[i] for s, i in sides],
        )
        assert off.fun < 0.002


def test_holds_are_on_the_surface_from_opposite_sides_above_the_table(body):
    found = grasp_candidates(body)
    assert found
    assert [h.merit for h in found] == sorted((h.merit for h in found), reverse=True)
    for hold in found[::7]:
        at = hold.body
        np.testing.assert_allclose(
            (body.vertices - body.middle) @ hold.R_world_object.T + at.middle, at.vertices, atol=1e-12
        )
        for finger, point in hold.points.items():
            assert (at.normals @ point - at.offsets).max() == pytest.approx(0, abs=1e-9)
            sense = -1 if finger == "th" else 1
            assert sense * hold.normals[finger][0] > 0.7
            assert point[2] > GRASP.tip_radius - 0.0021
        width = np.mean([p[0] for f, p in hold.points.items() if f != "th"]) - hold.points["th"][0]
        assert 0 < width <= GRASP.max_width


def random_contacts(rng):
    n = rng.integers(2, 6)
    normals = rng.normal(size=(n, 3))
    if rng.random() < 0.7:  # roughly opposed, else few are balanced
        normals = 0.4 * normals + np.outer(np.r_[-1, np.ones(n - 1)], [1.0, 0, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return 0.03 * normals + 0.01 * rng.normal(size=(n, 3)), normals


def balance_by_linear_program(points, normals, most):
    """How much can be pressed in all without a wrench, each finger at most `most` [N]: cones as pyramids, another code."""
    columns, owner = [], []
    for k, (point, normal) in enumerate(zip(points, normals, strict=True)):
        a = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        a /= np.linalg.norm(a)
        b = np.cross(normal, a)
        for turn in 2 * np.pi * np.arange(32) / 32:
            force = -normal + GRASP.friction * (np.cos(turn) * a + np.sin(turn) * b)
            columns.append(
                np.concatenate([force, np.cross(point - points.mean(axis=0), force) / GRASP.lever])
            )
            owner.append(k)
    each = (np.arange(len(points))[:, None] == np.array(owner)).astype(float)
    done = linprog(-np.ones(len(owner)), A_eq=np.array(columns).T, b_eq=np.zeros(6), A_ub=each, b_ub=most)
    return -done.fun


def test_forces_are_within_friction_and_balanced_exactly_where_a_linear_program_says_that_they_can_be():
    rng, seen = np.random.default_rng(1), {True: 0, False: 0}
    for _ in range(80):
        points, normals = random_contacts(rng)
        wished = np.r_[6.0, np.full(len(points) - 1, 6.0 / (len(points) - 1))]
        found, left = forces(points, normals, wished)
        pressed = -(found * normals).sum(axis=1)
        aside = np.linalg.norm(found + pressed[:, None] * normals, axis=1)
        assert (aside <= GRASP.friction * pressed + 1e-9).all()
        wrench = np.r_[
            found.sum(axis=0), np.cross((points - points.mean(axis=0)) / GRASP.lever, found).sum(axis=0)
        ]
        assert left == pytest.approx(np.linalg.norm(wrench), abs=1e-9)
        possible = balance_by_linear_program(points, normals, wished)
        if possible < 1e-6:
            # Whatever is pressed there leaves a wrench.
            assert left > 1e-4 * pressed.sum()
            assert pressed.sum() < wished.sum()
            seen[False] += 1
        elif balance_by_linear_program(points, normals, 0.5 * wished) > 0.99 * 0.5 * wished.sum():
            # All that is wished can be had, with a pyramid of many edges: eight have nearly as much.
            assert left < 0.15
            seen[True] += 1
    assert min(seen.values()) > 8
    assert GRASP.cone_edges == 8
