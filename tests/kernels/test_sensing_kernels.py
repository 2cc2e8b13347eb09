"""Contact sensing's kernels against plain NumPy."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from contact.contact_cases import PAPER_TIP, any_tip, touches
from handsight import se3
from handsight.checks import MAX_LOAD
from handsight.contact import (
    Contact,
    Ellipsoid,
    NoContact,
    Reason,
    Sphere,
    contact_from_wrench,
    contacts_from_wrenches,
)
from oracles import sensing as oracle

SIGMAS = np.array([0.01, 0.02, 0.03, 5e-5, 1e-4, 2e-4])
OPTIONS = {"sigma_force": SIGMAS[:3], "sigma_torque": SIGMAS[3:]}
TIP = Ellipsoid(PAPER_TIP, cap=-0.002, max_friction=1.2)
FIELDS = ("points", "normals", "forces", "forces_normal", "torques")


def tips(rng):
    """Every shape, with and without each option."""
    T = se3.random(rng, spread=0.02)
    return [
        any_tip(rng),
        any_tip(rng, cap=0.001, max_friction=0.5, T_surface_sensor=T),
        Ellipsoid((1e-5, 0.2, 1e-3), min_force=1e-9),
        Sphere(0.009, max_friction=0.8, min_force=3.7),
        Sphere(0.011, cap=-0.003, T_surface_sensor=T),
    ]


def any_wrenches(rng, tip, n):
    """Pushes, pulls and what is neither, on and off the tip, of all sizes a hand knows."""
    truth = touches(rng, Ellipsoid(tip.semi_axes), n // 2)
    turn = np.where(rng.random(n // 2) < 0.3, -1.0, 1.0)[:, None]
    size = 10 ** rng.uniform(-2, 2, (n - n // 2, 1))
    loose = size * rng.normal(size=(n - n // 2, 3))
    twist = size * max(tip.semi_axes) * 10 ** rng.uniform(-3, 1) * rng.normal(size=(n - n // 2, 3))
    return np.concatenate([turn * truth.forces, loose]), np.concatenate([turn * truth.torques, twist])


def assert_alike(batch, plain, tolerance=1e-9):
    """Reasons alike; each number to `tolerance` of the size of what it is a part of."""
    np.testing.assert_array_equal(batch.reasons, plain.reasons)
    np.testing.assert_array_equal(batch.rows, plain.rows)
    assert (batch.reasons.dtype, batch.rows.dtype) == (np.int8, np.intp)
    size = np.abs(plain.forces).max(axis=1, initial=0.0)
    axes = batch.fingertip.semi_axes
    sizes = {"points": axes, "normals": 1.0, "forces": size[:, None], "forces_normal": size}
    # A torque is as uncertain as the wrench's largest part of it.
    sizes["torques"] = size * axes.max() + np.abs(plain.torques)
    for name in FIELDS:
        assert np.isfinite(getattr(batch, name)).all()
        error = np.abs(getattr(batch, name) / sizes[name] - getattr(plain, name) / sizes[name])
        assert error.max(initial=0.0) < tolerance, name


@pytest.mark.parametrize("seed", range(8))
def test_contacts_are_those_of_plain_numpy(seed):
    rng = np.random.default_rng(seed)
    for tip in tips(rng):
        F, M = any_wrenches(rng, tip, 1000)
        plain = oracle.sense(F, M, tip, SIGMAS)
        assert_alike(contacts_from_wrenches(F, M, tip), plain)


def test_one_wrench_has_the_answer_it_has_among_many_to_the_bit():
    rng = np.random.default_rng(1)
    for tip in tips(rng):
        F, M = any_wrenches(rng, tip, 131)
        batch = contacts_from_wrenches(F, M, tip, **OPTIONS)
        for force, torque, one_of_many in zip(F, M, batch, strict=True):
            one = contact_from_wrench(force, torque, tip, **OPTIONS)
            if isinstance(one_of_many, NoContact):
                assert one == one_of_many
                continue
            for name in Contact.__slots__:
                np.testing.assert_array_equal(getattr(one, name), getattr(one_of_many, name))


def test_a_grazing_wrench_is_off_the_cap_where_plain_numpy_says_so():
    ball = Sphere(0.01, min_force=1e-3)
    past = 10.0 ** np.arange(-16, 0)
    offset = 0.01 * np.concatenate([1 - past, [1.0], 1 + past])
    F = np.tile([0.0, 0, -1], (len(offset), 1))
    M = np.cross(np.column_stack([offset, 0 * offset, 0 * offset]), F)
    # 1 - x is x only to rounding: there the last places decide, by the root of which the point moves.
    decided = np.abs(offset / 0.01 - 1) > 1e-11
    batch, plain = contacts_from_wrenches(F, M, ball), oracle.sense(F, M, ball, SIGMAS)
    np.testing.assert_array_equal(batch.reasons[decided], plain.reasons[decided])
    assert (batch.reasons[offset > 0.01 * (1 + 1e-11)] == Reason.OFF_CAP).all()
    near = contacts_from_wrenches(F[decided], M[decided], ball)
    assert_alike(near, oracle.sense(F[decided], M[decided], ball, SIGMAS))


SIZES = st.floats(-MAX_LOAD, MAX_LOAD, allow_subnormal=True)
SPECIAL = st.sampled_from(
    [0.0, -0.0, 1.0, 1e-300, 5e-324, 1e-160, MAX_LOAD, 100001.0, 1e300, np.nan, np.inf, -np.inf]
)
WRENCHES = hnp.arrays(np.float64, (5, 6), elements=SIZES | SPECIAL)


@given(WRENCHES, st.integers(0, 4))
@example(np.full((5, 6), -1.7976931348623157e308), 0)
@example(
    np.array(
        [[0, 0, -1e-200, 1e5, 1e5, 1e5], [1e5, 0, -1e5, 0, 0, 0], [1e-300] * 6, [0] * 6, [100001.0] * 6]
    ),
    2,
)
@settings(max_examples=300)
def test_the_reason_is_that_of_plain_numpy_whatever_comes(wrenches, which):
    tip = tips(np.random.default_rng(3))[which]
    F, M = wrenches[:, :3], wrenches[:, 3:]
    batch = contacts_from_wrenches(F, M, tip, **OPTIONS)
    plain = oracle.sense(F, M, tip, SIGMAS)
    np.testing.assert_array_equal(batch.reasons, plain.reasons)
    largest = np.abs(plain.forces).max(axis=1, initial=0.0)[:, None]
    for ours, theirs in (
        (batch.points / tip.semi_axes, plain.points / tip.semi_axes),
        (batch.forces / largest, plain.forces / largest),
        (batch.forces_normal / largest[:, 0], plain.forces_normal / largest[:, 0]),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    assert np.isfinite(batch.torques).all()
    assert np.isfinite(batch.covariances).all()


def test_what_comes_in_is_neither_changed_nor_kept():
    truth = touches(np.random.default_rng(6), TIP, 40)
    F, M = truth.forces.copy(), truth.torques.copy()
    batch = contacts_from_wrenches(F, M, TIP)
    np.testing.assert_array_equal(F, truth.forces)
    np.testing.assert_array_equal(M, truth.torques)
    assert not any(np.shares_memory(getattr(batch, name), F) for name in FIELDS)
    batch.sigmas[:] = 1.0  # of this batch alone
    assert contacts_from_wrenches(F, M, TIP).sigmas[0] == 0.01
