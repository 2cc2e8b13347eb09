"""Laws of the table as evidence: it says how an object rests, and is withdrawn where touch contradicts it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight import se3
from handsight.correction import PoseEstimate
from handsight.objects.resting import resting_poses
from handsight.rig import Table
from handsight.tracking import Tracker
from handsight.tracking.hypotheses import Alternatives, ambiguity
from handsight.tracking.smoother import PoseAndBias
from handsight.tracking.table import MISPLACED, TableEvidence, on_table, supports_of

BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])


def known(T_palm_object, covariance):
    return PoseAndBias(np.stack([T_palm_object, np.eye(4)]), covariance)


@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0, np.pi / 2, 0]), np.array([np.pi, 0, 0])])
def test_a_table_fixes_height_and_tilt_of_whatever_side_is_down(turn):
    side = [0.03, 0.045, 0.07][np.abs(se3.rotation_exp(turn)[2]).argmax()]
    T_world_palm = se3.compose(se3.rotation_exp(np.array([0.3, -0.7, 1.0])), np.array([0.1, 0.0, 0.6]))
    T_world_true = se3.compose(se3.rotation_exp(turn), np.array([0.2, 0.1, 0.4 + side]))
    off = np.array([0.03, -0.02, 0.04, 0.05, -0.04, 0.2])
    T = se3.inverse(T_world_palm) @ se3.moved(T_world_true, off)
    prior = known(T, np.diag([0.05**2] * 3 + [0.15**2] * 3 + [1.0] * 6))
    after = on_table(prior, BOX, Table(height=0.4), T_world_palm)
    delta = se3.difference(T_world_palm @ after.T_palm_object, T_world_true)
    np.testing.assert_allclose(delta[[2, 3, 4]], 0, atol=4e-3)
    np.testing.assert_allclose(delta[:2], off[:2], atol=2e-3)


def test_an_object_in_the_air_is_not_put_on_the_table():
    T = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.5]))
    prior = known(T, np.diag([0.02**2] * 3 + [0.1**2] * 3 + [1.0] * 6))
    assert on_table(prior, BOX, Table(height=0.0), np.eye(4)) is None


def evidence_of(state, table, T_world_palm):
    return TableEvidence.of(BOX, table, supports_of(resting_poses(BOX)), state, T_world_palm, 0.0)


def test_an_object_that_leans_is_not_put_upright():
    """A box tilted by 30° in the hand, known to 2°, rests on no side; at 3° it does."""
    for tilt, rests in ((30.0, False), (3.0, True)):
        T = se3.compose(se3.rotation_exp(np.array([np.deg2rad(tilt), 0, 0])), np.array([0.0, 0.0, 0.075]))
        state = known(T, np.diag([0.02**2] * 3 + [np.deg2rad(2.0) ** 2] * 3 + [1.0] * 6))
        assert (on_table(state, BOX, Table(height=0.0), np.eye(4)) is not None) == rests


def test_an_object_rests_on_its_sides_however_its_frame_is_turned():
    """A box whose file has it turned by 27°, as a banana's is: no axis of the frame is upright at rest."""
    R = se3.rotation_exp(np.deg2rad([27.0, 0, 0]))
    corners = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.045, 0.045) for z in (-0.07, 0.07)])
    mesh = trimesh.convex.convex_hull(corners @ R.T)
    model = hs.ObjectModel.from_mesh(mesh.vertices, mesh.faces)
    T_true = se3.compose(R.T, np.array([0.1, 0.0, 0.07]))
    prior = known(
        se3.moved(T_true, np.array([0.02, 0, 0.03, 0.05, -0.06, 0])),
        np.diag([0.05**2] * 3 + [0.1**2] * 3 + [1.0] * 6),
    )
    after = on_table(prior, model, Table(height=0.0), np.eye(4))
    assert np.abs(se3.difference(after.T_palm_object, T_true)[2:5]).max() < 2e-3


def test_probabilities_of_supports_are_shares_and_follow_what_vision_says():
    """A table that vision, known to 2 mm, has 20 mm lower than told is misplaced; one that it has there is not."""
    told = {}
    for off in (0.0, 0.02):
        T = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.07 - off]))
        state = known(T, np.diag([0.002**2] * 3 + [np.deg2rad(2.0) ** 2] * 3 + [1.0] * 6))
        evidence = evidence_of(state, Table(height=0.0), np.eye(4))
        assert evidence.probabilities.sum() == pytest.approx(1)
        assert evidence.supports[-1].pose is None
        told[off] = evidence.supports[evidence.best].factors
    assert told == {0.0: (1.0, 1.0), 0.02: MISPLACED}


def gaussian(T, covariance, weight=1.0):
    estimate = PoseEstimate.from_gaussian(T, covariance, np.empty((0, 6)))
    estimate.answer["weight"] = weight
    return estimate


def test_distant_explanations_stay_hypotheses_and_the_answer_says_how_far_they_are_apart():
    covariance, T = np.diag([0.002**2] * 3 + [0.02**2] * 3), np.eye(4)
    far = se3.moved(T, np.array([0.04, 0, 0, 0, 0, 0]))
    likely, rare = gaussian(T, covariance), gaussian(far, covariance)
    for share, said in ((0.2, "two poses explain the touch: 40 mm, 0° apart"), (0.02, "")):
        both = Alternatives.of(BOX, [(1 - share, likely), (share, rare)]).added(BOX, likely)
        np.testing.assert_allclose(both.T_palm_object, T, atol=1e-12)
        np.testing.assert_allclose(both.covariance, covariance, rtol=1e-6)
        assert [hypothesis.weight for hypothesis in both.hypotheses] == pytest.approx([1 - share, share])
        assert ambiguity(BOX, both, "touch") == said


def tracked(grasp, rig):
    tracker = Tracker(rig, grasp.model)
    for observation in grasp.observations:
        tracker.update(observation)
    return tracker


def moved_table(rig, off):
    return replace(rig, table=replace(rig.table, height=rig.table.height + off))


def height_error(grasp, tracker):
    """Returns the estimate's error along the vertical [m], and its standard deviation [m]."""
    up = tracker.T_world_palm[2, :3]
    T = grasp.model.nearest(grasp.T_palm_object, tracker.estimate.T_palm_object)
    covariance = tracker.estimate.bounded_covariance[:3, :3]
    return up @ (tracker.estimate.T_palm_object - T)[:3, 3], float(np.sqrt(up @ covariance @ up))


def test_a_table_that_is_elsewhere_does_not_exclude_the_truth(box):
    """The table is believed 15 mm, five sigmas, too high. Nothing else measures the height of a box that fingers hold
    at its sides: the answer is where it was told, but its covariance has the table that is elsewhere in it."""
    error, sigma = height_error(box, tracked(box, moved_table(box.rig, 0.015)))
    assert abs(error) < 3.0 * sigma


def test_a_table_makes_the_height_known(box):
    off, with_table = height_error(box, tracked(box, box.rig))
    _, without = height_error(box, tracked(box, replace(box.rig, table=None)))
    assert abs(off) < 3 * with_table
    assert with_table < 0.6 * without


def test_the_tracker_tells_where_the_table_must_be(box):
    table = tracked(box, box.rig).table
    assert abs(table.height - box.rig.table.height) < 3 * table.sigma_height
    assert table.probability > 0.5
    assert not table.reason
    assert tracked(box, replace(box.rig, table=None)).table is None


def test_a_table_far_from_the_object_is_doubted_and_said(box):
    """30 cm off, six sigmas of vision's constant error: the object cannot stand there."""
    right = tracked(box, replace(box.rig, table=None))
    tracker = tracked(box, moved_table(box.rig, -0.3))
    assert tracker.table is None or tracker.table.reason
    shift = se3.difference(right.estimate.T_palm_object, tracker.estimate.T_palm_object)[:3]
    assert np.linalg.norm(shift) < 0.01


def test_a_table_is_not_counted_again_at_the_next_grasp(box):
    """The fingers let go three times and grasp again where they were. The table, believed 15 mm too high, says the same
    each time, so that four grasps must not make the height so certain that the truth is excluded."""
    rig = moved_table(box.rig, 0.015)
    tracker = tracked(box, rig)
    open_hand, stamp = box.observations[0], tracker.stamp
    for held in [box.held[-20:]] * 3:
        for k, observation in enumerate([open_hand] * 20 + held):
            stamp += 0.02
            observation = replace(observation, stamp=stamp, T_world_palm=tracker.T_world_palm, vision=None)
            if k < 20:
                observation = replace(observation, joint_positions=held[0].joint_positions)
            tracker.update(observation)
            assert k != 19 or not tracker.fingertips.fingers
    error, sigma = height_error(box, tracker)
    assert len(tracker.fingertips.fingers) > 1
    assert abs(error) < 3 * sigma
