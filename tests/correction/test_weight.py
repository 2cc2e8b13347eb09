"""The object's weight as evidence of its pose: what it tells, and what is told of a weight that cannot be its."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import WeightEvidence, solve
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, descents_at
from handsight.errors import InvalidInput, InvalidObject
from handsight.objects import Symmetries
from handsight.objects.symmetry import kept_center
from testbed.refusals import refused
from testbed.scenes import box, can

T_TRUE = se3.compose(se3.rotation_exp(np.array([0.2, -0.1, 0.3])), np.array([0.01, -0.08, 0.09]))
SIDE = np.array([[0.03, 0.01, 0.02], [0.03, -0.02, -0.03], [-0.03, 0.0, 0.0]])
"""On two faces of the box: a slide along both is open, and about their normal."""


def gripped(points=SIDE, normals=((1, 0, 0), (1, 0, 0), (-1, 0, 0))):
    R = T_TRUE[:3, :3]
    return hs.Contacts(
        se3.apply(T_TRUE, points), np.array(normals, float) @ R.T, sigma_point=5e-4, sigma_normal=0.03
    )


def vision(error=(0.0, 0.015, -0.012, 0.0, 0.0, 0.0)):
    off = np.concatenate([T_TRUE[:3, :3] @ error[:3], T_TRUE[:3, :3] @ error[3:]])
    return hs.PosePrior(se3.moved(T_TRUE, off), np.diag([0.02**2] * 3 + [0.02**2] * 3))


def weighed(center=(0.0, 0.0, 0.0), wrong=(0.0, 0.0, 0.0), sigma=1e-3):
    place = se3.apply(T_TRUE, np.array([center]) + np.array([wrong]))[0]
    return WeightEvidence(np.array(center), place, sigma**2 * np.eye(3))


@pytest.mark.parametrize("center", [(0, 0, 0), (0.01, -0.02, 0.03)])
def test_the_weight_measures_a_slide_that_contacts_leave_open(center):
    model = box().with_symmetries(Symmetries())
    without = hs.correct_pose(model, gripped(), vision=vision())
    found = hs.correct_pose(model, gripped(), vision=vision(), weight=weighed(center))
    assert np.linalg.norm(without.T_palm_object[:3, 3] - T_TRUE[:3, 3]) > 0.008
    assert np.linalg.norm(found.T_palm_object[:3, 3] - T_TRUE[:3, 3]) < 1.5e-3
    assert found.weight_fits is True
    assert without.weight_fits is None
    assert len(found.unobservable) < len(without.unobservable)


def test_weight_is_information_of_its_rows():
    """At a fixed pose touch's information rises by Jᵀ Σ⁻¹ J, and χ² by the squared residuals."""
    contacts, center = gripped(), np.array([0.01, -0.02, 0.03])
    weight = weighed(center, (3e-4, 0, -5e-4))
    given = Problem(box(), contacts, vision(), NO_OUTSIDE)
    everyone = np.ones((1, 3), dtype=bool)
    with_weight, without = (
        solve.summaries(problem, descents_at(T_TRUE[None]), everyone, first_order=True)[0]
        for problem in (replace(given, weight=weight), given)
    )
    J = np.hstack([np.eye(3), -se3.skew(T_TRUE[:3, :3] @ center)]) / 1e-3
    np.testing.assert_allclose(
        with_weight["information"] - without["information"], J.T @ J, rtol=1e-6, atol=1e-3
    )
    assert with_weight["chi2"] - without["chi2"] == pytest.approx(0.3**2 + 0.5**2)
    assert with_weight["rows"] - without["rows"] == 3
    assert given.freedom(everyone) + 3 == replace(given, weight=weight).freedom(everyone)


@pytest.mark.parametrize("wrong", [(0.02, 0, 0), (-0.014, 0.014, 0)])
def test_a_wrong_centre_of_mass_is_left_out(wrong):
    model = box().with_symmetries(Symmetries())
    found = hs.correct_pose(model, gripped(), vision=vision(), weight=weighed(wrong=wrong))
    without = hs.correct_pose(model, gripped(), vision=vision())
    assert found.weight_fits is False
    np.testing.assert_array_equal(found.T_palm_object, without.T_palm_object)


def test_without_vision_the_weight_determines_the_slide():
    corners = np.vstack([SIDE, [[0.0, 0.045, 0.01]]])
    contacts = gripped(corners, [*np.eye(3)[[0, 0]], -np.eye(3)[0], np.eye(3)[1]])
    found = hs.correct_pose(box(), contacts, weight=weighed())
    near = min(np.linalg.norm(h.T_palm_object[:3, 3] - T_TRUE[:3, 3]) for h in found.hypotheses)
    assert near < 3e-3
    assert found.weight_fits is True


def test_a_centre_of_mass_off_the_axis_is_refused_for_a_symmetric_object():
    with refused(InvalidInput, "weight.center_object"):
        hs.correct_pose(can(), gripped(), vision=vision(), weight=weighed((0.01, 0, 0)))
    with refused(InvalidInput, "center_of_mass"):
        can().with_weight(center_of_mass=(0.01, 0, 0))
    np.testing.assert_allclose(can().with_weight(center_of_mass=(1e-4, 0, 0)).center_of_mass, 0, atol=1e-12)
    np.testing.assert_allclose(kept_center(can().symmetries, np.array([0.0, 0, 0.02])), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"center_object": [0, 0]}, "weight.center_object"),
        ({"center_palm": [np.nan, 0, 0]}, "weight.center_palm"),
        ({"covariance": np.zeros((3, 3))}, "weight.covariance"),
        ({"covariance": np.diag([1.0, -1, 1]) * 1e-6}, "weight.covariance"),
    ],
)
def test_a_wrong_weight_is_refused(change, field):
    given = {"center_object": np.zeros(3), "center_palm": np.zeros(3), "covariance": 1e-6 * np.eye(3)}
    with refused(InvalidInput, field):
        WeightEvidence(**{**given, **change})


def test_a_model_has_the_centroid_of_its_volume():
    import trimesh

    shape = trimesh.creation.cone(radius=0.03, height=0.1)
    cone = hs.ObjectModel.from_mesh(shape.vertices, shape.faces)
    np.testing.assert_allclose(cone.volume_centroid, shape.center_mass, atol=1e-5)
    np.testing.assert_allclose(box().volume_centroid, 0, atol=1e-12)
    cloud = hs.ObjectModel.from_points(*box().sample(500))
    with refused(InvalidObject, "object"):
        getattr(replace(cloud, closed=False), "volume_centroid")  # noqa: B009 - it raises
