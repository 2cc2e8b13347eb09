"""Contacts whose covariance is of the whole residual: nothing of the model is added to it."""

import numpy as np
import pytest
from scipy.stats import chi2

import handsight as hs
from handsight import se3
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.objects import Symmetries
from oracles import correction as oracle
from oracles import fields

SIGMA_POINT, SIGMA_NORMAL = 1e-3, 0.03
PRIOR = np.repeat([5e-3, 0.1], 3)


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def rod():
    """A cylinder whose normal turns by 0.05 where a point slides by 1 mm; its spin is not declared."""
    return hs.ObjectModel.cylinder(0.02, 0.1, symmetries=Symmetries())


def grasp(model, seed, of_residual):
    """Contacts whose residuals at the truth have the given sigmas, vision, and the truth."""
    rng = np.random.default_rng(seed)
    T = se3.random(rng, spread=0.1)
    turn, height = rng.uniform(0, 2 * np.pi, 5), rng.uniform(-0.04, 0.04, 5)
    side = np.column_stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), height])
    points = np.vstack([side, [0.005, 0.005, 0.05]])
    points = points + SIGMA_POINT * rng.normal(size=points.shape)
    normals = model.evaluate(points).gradient
    # What is felt is off the model's normal at the measured point: all of the residual.
    aside = SIGMA_NORMAL * rng.normal(size=normals.shape)
    normals = (se3.rotation_exp(np.cross(normals, aside)) @ normals[..., None])[..., 0]
    palm = se3.apply(T, points), normals @ T[:3, :3].T
    contacts = hs.Contacts(*palm, SIGMA_POINT, SIGMA_NORMAL, of_residual=of_residual)
    return contacts, hs.PosePrior(se3.moved(T, PRIOR * rng.normal(size=6)), np.diag(PRIOR**2)), T


def squares(model, of_residual, count=250):
    """(count,) squared errors of answers in their own covariances."""
    found = []
    for seed in range(count):
        contacts, vision, T = grasp(model, seed, of_residual)
        answer = hs.correct_pose(model, contacts, vision=vision)
        turn = se3.rotation_log(T[:3, :3] @ answer.T_palm_object[:3, :3].T)
        error = np.r_[T[:3, 3] - answer.T_palm_object[:3, 3], turn]
        found.append(error @ np.linalg.solve(answer.covariance, error))
    return np.array(found)


@pytest.mark.slow
def test_regions_are_right_for_sigmas_of_the_residual_and_too_wide_where_the_model_is_added_to_them():
    model = rod()
    whole, added = squares(model, True), squares(model, False)
    half, most = chi2.ppf([0.5, 0.95], 6)
    # Three deviations of a count of 250.
    assert (whole < most).mean() == pytest.approx(0.95, abs=0.042)
    assert (whole < half).mean() == pytest.approx(0.5, abs=0.095)
    assert (added < most).mean() > 0.985
    assert added.mean() < 0.9 * whole.mean()


def test_the_residuals_covariance_is_the_one_given(rng):
    model = rod()
    contacts, vision, T = grasp(model, 3, True)
    S = oracle.covariance(Problem(model, contacts, vision, NO_OUTSIDE), T)
    places = se3.apply(se3.inverse(T), contacts.points_palm)
    gradient = fields.evaluate(model.fine, places).gradient
    np.testing.assert_allclose(S[:, 0, 0], SIGMA_POINT**2 * (gradient**2).sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(S[:, 0, 1:], 0, atol=1e-18)
    # Tangents as given; along the normal their mean.
    np.testing.assert_allclose(S[:, 1:, 1:], np.tile(SIGMA_NORMAL**2 * np.eye(3), (6, 1, 1)), atol=1e-12)
    # χ² is that of the residuals in it.
    answer = hs.correct_pose(model, contacts, vision=vision)
    given = Problem(model, contacts, vision, NO_OUTSIDE)
    r = oracle.residuals(given, answer.T_palm_object)
    slope = oracle.jacobian(
        lambda T: oracle.residuals(given, T), answer.T_palm_object, answer.T_palm_object[:3, 3]
    )
    assert np.abs(slope.T @ r).max() / np.linalg.norm(slope, axis=0).max() < 0.5


@pytest.mark.parametrize("method", ["select", "moved", "from a list"])
def test_each_contact_keeps_its_flag_of_residual(method, rng):
    points, normals = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    flags = [True, False, False, True]
    contacts = hs.Contacts(points, normals, of_residual=flags)
    other, expected = {
        "select": (contacts.select([3, 1]), [True, False]),
        "moved": (contacts.moved(se3.random(rng)), flags),
        "from a list": (hs.Contacts(points, normals, of_residual=np.array(flags)), flags),
    }[method]
    np.testing.assert_array_equal(other.of_residual, expected)
    np.testing.assert_array_equal(other.record["of_residual"], expected)
    assert not hs.Contacts(points).of_residual.any()
    assert not hs.Contacts.trusted(points, normals, np.tile(np.eye(6), (4, 1, 1))).record["of_residual"].any()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1, "of_residual: expected true or false, or 2 of these, got 1"),
        ("yes", "of_residual: expected true or false"),
        ([True], "of_residual: expected true or false, or 2 of these"),
        (None, "of_residual: expected true or false"),
    ],
)
def test_a_flag_is_a_truth_value(value, message):
    with pytest.raises(hs.HandsightError, match=message):
        hs.Contacts(np.eye(3)[:2], of_residual=value)


def test_a_singular_covariance_of_a_residual_is_refused():
    flat = np.diag([1e-6, 1e-6, 0.0, 1e-2, 1e-2, 1e-2])
    contacts = {"points_palm": np.eye(3)[:1], "normals_palm": np.eye(3)[:1], "covariance": flat[None]}
    assert len(hs.Contacts(**contacts)) == 1
    with pytest.raises(
        hs.HandsightError, match=r"covariance\[0\]: expected a residual's, uncertain in every"
    ):
        hs.Contacts(**contacts, of_residual=True)
    # Along the normal nothing is known of a direction, and without one nothing of the normal.
    tangent = np.diag([1e-6, 1e-6, 1e-6, 0.0, 1e-2, 1e-2])
    hs.Contacts(np.eye(3)[:1], np.eye(3)[:1], covariance=tangent[None], of_residual=True)
    hs.Contacts(np.eye(3)[:1], covariance=np.diag([1e-6] * 3 + [0.0] * 3)[None], of_residual=True)


def test_a_json_problem_has_the_flag_beside_its_contacts():
    import json
    from pathlib import Path

    from handsight.batch.problems import Reader, answer_text

    problem = {
        "object": {"cylinder": {"radius": 0.02, "height": 0.1}},
        "contacts": [
            {"point": [0.02, 0, 0], "normal": [1, 0, 0], "sigma_normal_deg": 3},
            {"point": [-0.02, 0, 0.01], "normal": [-1, 0, 0]},
        ],
        "vision": {
            "position": [0.003, 0, 0], "quaternion_xyzw": [0, 0, 0, 1], "sigma_position": 0.01,
            "sigma_rotation_deg": 10,
        },
    }  # fmt: skip
    reader = Reader(Path())
    covariances = {}
    for flag in (False, True):
        line = json.dumps(problem | {"contacts_of_residual": flag}).encode()
        assert (reader.read(line).contacts.of_residual == flag).all()
        covariances[flag] = np.array(json.loads(answer_text(reader, line))["information"])
    # Along y the can's side turns the normal: more is known where no bend is added to its noise.
    assert covariances[True][1, 1] > 1.05 * covariances[False][1, 1]
    wrong = answer_text(reader, json.dumps(problem | {"contacts_of_residual": 1}).encode())
    assert json.loads(wrong) == {"error": "contacts_of_residual: expected true or false, got 1"}
    exact = problem | {"contacts_of_residual": True}
    exact["contacts"] = [{"point": [0, 0, 0.05], "covariance": np.diag([1e-6, 1e-6, 0, 0, 0, 0]).tolist()}]
    message = json.loads(answer_text(reader, json.dumps(exact).encode()))["error"]
    assert message.startswith("contacts: covariance[0]: expected a residual's")
