import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from contact.contact_cases import PAPER_TIP, any_tip, touches
from handsight import se3
from handsight.contact import (
    Contact,
    Ellipsoid,
    NoContact,
    Reason,
    Sphere,
    contact_from_wrench,
    contacts_from_wrenches,
    unambiguous_cap,
)
from handsight.errors import InvalidInput
from testbed.refusals import refused

TIP = Ellipsoid(PAPER_TIP)


def errors(batch, truth):
    """Largest error of location, normal, force, normal force and local torque."""
    return {
        "location": np.abs(batch.points - truth.points).max(),
        "normal": np.abs(batch.normals - truth.normals).max(),
        "force": np.abs(batch.forces - truth.forces).max(),
        "force_normal": np.abs(batch.forces_normal - truth.forces_normal).max(),
        "torque": np.abs(batch.torques - truth.twists).max(),
    }


@pytest.mark.parametrize("twist", [2e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0])
def test_a_hundred_thousand_contacts_are_recovered_to_1e_9(twist):
    rng = np.random.default_rng(1)
    for _ in range(200):
        tip = any_tip(rng, max_friction=1.0)
        truth = touches(rng, tip, 500, twist=twist)
        batch = contacts_from_wrenches(truth.forces, truth.torques, tip)
        assert (batch.reasons == Reason.CONTACT).all()
        assert max(errors(batch, truth).values()) < 1e-9


def iterated(force, torque, semi_axes):
    """Every solution of eq. 7, as (point, local torque about the inward normal), found by iteration."""
    a = np.asarray(semi_axes)
    F, M = force / np.linalg.norm(force), torque / np.linalg.norm(force) / a.max()

    def residuals(x):
        p = a / a.max() * x[:3]
        return np.append(np.cross(p, F) + x[3] * p / (a / a.max()) ** 2 - M, x[:3] @ x[:3] - 1)

    found = []
    for start in [*itertools.product((-0.6, 0.6), (-0.6, 0.6), (-0.6, 0.6), (-0.3, 0.3))]:
        solution = least_squares(residuals, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(solution.fun).max() < 1e-11:
            p, k = a * solution.x[:3], solution.x[3]
            length = np.linalg.norm(solution.x[:3] / (a / a.max()))
            found.append((p, -k * length * np.linalg.norm(force) * a.max()))
    return found


def test_the_closed_form_agrees_with_an_iterative_solution_of_eq_7():
    rng = np.random.default_rng(2)
    for _ in range(12):
        tip = any_tip(rng)
        truth = touches(rng, tip, 1)
        contact = contact_from_wrench(truth.forces[0], truth.torques[0], tip)
        pushes = [
            (p, twist)
            for p, twist in iterated(truth.forces[0], truth.torques[0], tip.semi_axes)
            if truth.forces[0] @ (p / tip.semi_axes**2) < 0
        ]
        assert pushes
        for p, twist in pushes:  # there is one push only, from wherever the iteration starts
            np.testing.assert_allclose(contact.point, p, atol=1e-9)
            np.testing.assert_allclose(contact.torque, twist, atol=1e-9)


def test_the_object_pushes_along_the_normal_against_the_tip_s_outward_normal():
    contact = contact_from_wrench([0.1, 0.0, -2.0], [0.0, 0.012 * 0.1, -3e-4], TIP)
    np.testing.assert_allclose(contact.point, [0, 0, 0.012], atol=1e-12)
    np.testing.assert_allclose(contact.normal, [0, 0, -1], atol=1e-12)
    assert contact.force_normal == pytest.approx(2.0)
    # The object twists the tip by -3e-4 about z: +3e-4 about the normal, which is -z.
    assert contact.torque == pytest.approx(3e-4)
    np.testing.assert_allclose(contact.force_tangential, [0.1, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(contact.force, [0.1, 0.0, -2.0])


def test_a_contact_explains_its_wrench_wherever_one_is_found():
    rng = np.random.default_rng(3)
    F, M = rng.normal(size=(5000, 3)), 0.02 * rng.normal(size=(5000, 3))
    batch = contacts_from_wrenches(F, M, TIP)
    assert len(batch.rows) > 4500
    explained = np.cross(batch.points, batch.forces) + batch.torques[:, None] * batch.normals
    np.testing.assert_allclose(explained, M[batch.rows], atol=1e-12)
    np.testing.assert_allclose(((batch.points / PAPER_TIP) ** 2).sum(axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose((batch.forces * batch.normals).sum(axis=1), batch.forces_normal, atol=1e-12)
    assert (batch.forces_normal > 0).all()


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_no_pull_passes_for_a_push_above_the_unambiguous_cap(friction):
    rng = np.random.default_rng(4)
    for _ in range(50):
        shape = 0.006 * 4 ** rng.uniform(0, 1, 3)
        cap = unambiguous_cap(Ellipsoid(shape, max_friction=friction))
        tip = Ellipsoid(shape, cap=cap, max_friction=friction, min_force=1e-3)
        truth = touches(rng, tip, 400, friction=friction)
        assert (contacts_from_wrenches(truth.forces, truth.torques, tip).reasons == Reason.CONTACT).all()
        pulled = contacts_from_wrenches(-truth.forces, -truth.torques, tip).reasons
        assert np.isin(pulled, (Reason.OFF_CAP, Reason.BEYOND_FRICTION)).all()


def test_below_the_unambiguous_cap_some_pull_is_a_push_from_the_other_side():
    cap = 0.9 * unambiguous_cap(Ellipsoid(PAPER_TIP, max_friction=0.5))
    tip = Ellipsoid(PAPER_TIP, cap=cap, max_friction=0.5, min_force=1e-3)
    truth = touches(np.random.default_rng(5), tip, 20_000, friction=0.5)
    pulled = contacts_from_wrenches(-truth.forces, -truth.torques, tip)
    assert 0 < len(pulled.rows) < 2000
    # And they are told apart by nothing: the push explains the wrench exactly, in the cap, within friction.
    explained = np.cross(pulled.points, pulled.forces) + pulled.torques[:, None] * pulled.normals
    np.testing.assert_allclose(explained, -truth.torques[pulled.rows], atol=1e-12)


@pytest.mark.parametrize(
    ("force", "torque", "reason"),
    [
        ([0, 0, 0], [0, 0, 0], "free"),
        ([0, 0, 0], [1, 0, 0], "free"),
        ([0, 0, -0.0999], [0, 0, 0], "free"),
        ([0, 0, 1], [0, 0, 0], "off_cap"),
        ([1, 0, 0], [0, 0, 0], "off_cap"),
        ([0.6, 0, -1], [0, 0.6 * 0.012, 0], "beyond_friction"),
        ([0, 0, -1], [0.5, 0, 0], "off_cap"),
    ],
)
def test_what_is_no_contact_says_why_and_is_false(force, torque, reason):
    answer = contact_from_wrench(force, torque, Ellipsoid(PAPER_TIP, cap=0.002, max_friction=0.5))
    assert answer == NoContact(reason)
    assert not answer


def test_the_friction_limit_is_where_it_says():
    for ratio, kind in ((0.499, Contact), (0.501, NoContact)):
        answer = contact_from_wrench(
            [ratio, 0, -1], [0, 0.012 * ratio, 0], Ellipsoid(PAPER_TIP, max_friction=0.5)
        )
        assert isinstance(answer, kind)


def test_the_sensor_s_frame_changes_nothing_but_the_frame_of_the_wrench():
    rng = np.random.default_rng(9)
    truth = touches(rng, TIP, 200)
    T = se3.random(rng, spread=0.02)
    forces_sensor = truth.forces @ T[:3, :3]
    torques_sensor = (truth.torques - np.cross(T[:3, 3], truth.forces)) @ T[:3, :3]
    sensed = contacts_from_wrenches(forces_sensor, torques_sensor, Ellipsoid(PAPER_TIP, T_surface_sensor=T))
    assert max(errors(sensed, truth).values()) < 1e-12
    turned = T.copy()
    turned[:3, 3] = 0
    torques_turned = truth.torques @ T[:3, :3]
    sensed = contacts_from_wrenches(
        forces_sensor, torques_turned, Ellipsoid(PAPER_TIP, T_surface_sensor=turned)
    )
    plain = contacts_from_wrenches(truth.forces, truth.torques, TIP)
    # Noise alike on all axes does not know how the sensor is turned.
    np.testing.assert_allclose(sensed.covariances, plain.covariances, rtol=1e-9, atol=1e-18)


def readings(truth, T):
    return truth.forces @ T[:3, :3], (truth.torques - np.cross(T[:3, 3], truth.forces)) @ T[:3, :3]


def test_the_covariance_is_the_derivative_s_by_central_differences():
    rng = np.random.default_rng(10)
    sigmas = np.array([0.01, 0.02, 0.03, 5e-5, 1e-4, 2e-4])
    for k in range(24):
        T = se3.random(rng, spread=0.02)
        tip = Sphere(0.009, T_surface_sensor=T) if k % 6 == 0 else any_tip(rng, T_surface_sensor=T)
        (force,), (torque,) = readings(touches(rng, tip, 1), T)
        steps = np.concatenate([np.eye(6), -np.eye(6)]) * 1e-4 * sigmas
        moved = contacts_from_wrenches(force + steps[:, :3], torque + steps[:, 3:], tip)
        sensed = np.hstack([moved.points, moved.normals])
        jacobian = (sensed[:6] - sensed[6:]).T / 2e-4  # per sigma
        contact = contact_from_wrench(force, torque, tip, sigma_force=sigmas[:3], sigma_torque=sigmas[3:])
        expected = jacobian @ jacobian.T
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(contact.covariance / scale, expected / scale, atol=1e-5)
        np.testing.assert_array_equal(contact.covariance, contact.covariance.T)
        values = np.linalg.eigvalsh(contact.covariance)
        assert values[0] > -1e-12 * values[-1]
        assert np.linalg.matrix_rank(contact.covariance / scale, tol=1e-9) == 2


@pytest.mark.parametrize(
    ("tip", "most_mm"),
    [(Ellipsoid(PAPER_TIP), 0.130), (Ellipsoid(PAPER_TIP, cap=-0.002), 0.130), (Sphere(0.008), 0.120)],
)
def test_location_at_one_newton_is_as_good_as_the_sensor_s_noise_allows(tip, most_mm):
    """1 N along the normal, 10 mN and 0.05 mN m per axis. Six readings fix six unknowns: no slack."""
    rng = np.random.default_rng(12)
    truth = touches(rng, tip, 20_000, friction=0.5)
    size = truth.forces_normal[:, None]
    F = truth.forces / size + 0.01 * rng.normal(size=(len(size), 3))
    M = truth.torques / size + 5e-5 * rng.normal(size=(len(size), 3))
    batch = contacts_from_wrenches(F, M, tip)
    assert len(batch.rows) > 0.98 * len(F)
    errors_mm = 1e3 * np.linalg.norm(batch.points - truth.points[batch.rows], axis=1)
    assert errors_mm.mean() < most_mm
    # And the answer knows: two tangent axes, each as uncertain as the covariance says.
    sigma_mm = 1e3 * np.sqrt(np.trace(batch.covariances[:, :3, :3], axis1=1, axis2=2))
    assert np.sqrt((errors_mm**2).mean()) == pytest.approx(np.sqrt((sigma_mm**2).mean()), rel=0.03)


def test_a_row_that_is_not_finite_is_invalid_and_the_others_are_answered():
    F, M = np.tile([0.0, 0, -1], (4, 1)), np.zeros((4, 3))
    F[1, 0], M[2, 2] = np.nan, np.inf
    F[3] = 0
    batch = contacts_from_wrenches(F, M, TIP)
    assert batch.reasons.tolist() == [Reason.CONTACT, Reason.INVALID, Reason.INVALID, Reason.FREE]
    assert batch.rows.tolist() == [0]
    assert isinstance(batch[0], Contact)
    assert batch[1] == batch[2] == NoContact("invalid")
    assert batch[-1] == NoContact("free")
    with pytest.raises(IndexError):
        batch[4]


def test_moving_a_contact_there_and_back_changes_nothing():
    rng = np.random.default_rng(15)
    truth = touches(rng, TIP, 1)
    contact = contact_from_wrench(truth.forces[0], truth.torques[0], TIP)
    T = se3.random(rng)
    moved_contact = contact.moved(T)
    np.testing.assert_allclose(moved_contact.point, T[:3, :3] @ contact.point + T[:3, 3])
    np.testing.assert_allclose(moved_contact.normal @ moved_contact.force, moved_contact.force_normal)
    np.testing.assert_allclose(
        moved_contact.covariance[:3, 3:], T[:3, :3] @ contact.covariance[:3, 3:] @ T[:3, :3].T
    )
    np.testing.assert_array_equal(moved_contact.covariance, moved_contact.covariance.T)
    back = moved_contact.moved(se3.inverse(T))
    np.testing.assert_allclose(back.point, contact.point, atol=1e-14)
    np.testing.assert_allclose(back.covariance, contact.covariance, atol=1e-16)
    assert back.torque == contact.torque


@pytest.mark.parametrize(
    ("arguments", "options", "field"),
    [
        (([np.nan, 0, 0], [0, 0, 0], TIP), {}, "force"),
        (([0, 0, 1], [0, 0], TIP), {}, "torque"),
        (([0, 0, 1], [0, 0, 0], "sphere"), {}, "fingertip"),
        (([0, 0, 1], [0, 0, 0], TIP), {"sigma_force": 0}, "sigma_force"),
        (([0, 0, 1], [0, 0, 0], TIP), {"sigma_torque": [1, 2, -1]}, "sigma_torque"),
    ],
)
def test_a_wrong_input_is_refused_by_name(arguments, options, field):
    with refused(InvalidInput, field):
        contact_from_wrench(*arguments, **options)


@pytest.mark.parametrize(
    ("forces", "torques", "field"),
    [
        ([0, 0, 1], [[0, 0, 0]], "forces"),
        ([[0, 0, 1]], [[0, 0], [1]], "torques"),
        ([["a", 0, 1]], [[0, 0, 0]], "forces"),
        ([[0, 0, 1]], [[0, 0, 0]] * 2, "torques"),
    ],
)
def test_a_wrong_batch_is_refused_by_name(forces, torques, field):
    with refused(InvalidInput, field):
        contacts_from_wrenches(forces, torques, TIP)
