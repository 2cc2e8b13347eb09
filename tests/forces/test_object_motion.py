"""The motion of a sliding object follows from its loads: tangential forces are along the velocities."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from handsight import se3
from handsight.contact import Contacts
from handsight.forces import FRICTION, slip_twist

SEEDS = st.integers(0, 2**32 - 1)


def slid(points, normals, twist, origin, rng, mu=0.7):
    """Loads (n, 5) of contacts whose object moves by a twist about the origin: each on its cone, along the velocity."""
    velocity = twist[:3] + np.cross(twist[3:], points - origin)
    velocity -= np.sum(velocity * normals, axis=1, keepdims=True) * normals
    turn = FRICTION.torsion * normals @ twist[3:]
    speed = np.sqrt((velocity**2).sum(axis=1) + turn**2)
    normal = rng.uniform(0.5, 3, len(points))
    along = np.column_stack([velocity, turn]) * (mu * normal / speed)[:, None]
    return np.column_stack([along[:, :3], normal, FRICTION.torsion * along[:, 3]]), speed


def touched(rng, n=3):
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.uniform(-0.04, 0.04, (n, 3)), normals


@settings(deadline=None, max_examples=50)
@given(SEEDS)
def test_a_slide_along_two_faces_is_recovered_exactly(seed):
    """All speeds are the same: the twist is the true one, for a metre of slip."""
    rng = np.random.default_rng(seed)
    R = se3.random(rng)[:3, :3]
    points, normals = rng.uniform(-0.04, 0.04, (3, 3)), np.array([R[2], R[2], -R[2]])
    direction = R[:2].T @ rng.normal(size=2)
    direction /= np.linalg.norm(direction)
    loads, _ = slid(points, normals, np.r_[direction, 0, 0, 0], np.zeros(3), rng)
    found = slip_twist(Contacts(points, normals), loads, np.zeros(3))
    velocities = found[:3] + np.cross(found[3:], points)
    np.testing.assert_allclose(velocities, [direction] * 3, atol=1e-6)


@settings(deadline=None, max_examples=50)
@given(SEEDS)
def test_the_fitted_twist_never_goes_against_the_motion(seed):
    """Any contacts, any motion along them: the fit never goes against it, nor depends on where its origin is."""
    rng = np.random.default_rng(seed)
    points, normals = touched(rng, 4)
    twist, origin = np.r_[rng.normal(size=3), 20 * rng.normal(size=3)], 0.1 * rng.normal(size=3)
    loads, speeds = slid(points, normals, twist, origin, rng)
    assume(speeds.min() > 0.2 * speeds.max())
    contacts = Contacts(points, normals)
    found, about_zero = (slip_twist(contacts, loads, at) for at in (origin, np.zeros(3)))
    assume(found is not None)
    moves, true = (each[:3] + np.cross(each[3:], points - origin) for each in (found, twist))
    turns, truly = (FRICTION.torsion * normals @ each[3:] for each in (found, twist))
    said = np.sum(moves * loads[:, :3], axis=1) + turns * loads[:, 4] / FRICTION.torsion
    assert said.sum() > 0
    flat = true - np.sum(true * normals, axis=1, keepdims=True) * normals
    assert np.sum(moves * flat) + turns @ truly > 0
    shifted = about_zero[:3] + np.cross(about_zero[3:], origin)
    np.testing.assert_allclose(
        np.r_[shifted, about_zero[3:]], found, rtol=0.15, atol=0.15 * np.abs(found[:3]).max()
    )


def test_contradictory_loads_give_no_twist():
    points, normals = np.array([[0.03, 0, 0], [-0.03, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    for loads in (np.zeros((2, 5)), np.full((2, 5), np.nan), np.array([[0, 0, 0, 2.0, 0]] * 2)):
        assert slip_twist(Contacts(points, normals), loads, np.zeros(3)) is None
    same = np.array([[0.03, 0, 0]] * 2)
    against = np.array([[0, 1.0, 0, 1.0, 0], [0, -1.0, 0, 1.0, 0]])
    assert slip_twist(Contacts(same, normals[[0, 0]]), against, np.zeros(3)) is None
