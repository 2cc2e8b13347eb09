"""A track's state is a value: steps are pure; a tracker can be copied and pickled at any state."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from handsight.errors import InvalidInput
from handsight.observation import check_observation
from handsight.tracking import Tracker

EVERY = 17


def numbers(tracker):
    """Returns the answer's numbers as one array."""
    estimate = tracker.estimate
    pose = (
        np.zeros(52)
        if estimate is None
        else np.r_[estimate.T_palm_object.ravel(), estimate.information.ravel()]
    )
    return np.r_[pose, tracker.sigma, tracker.corrections, tracker.late]


def said(tracker):
    return tracker.state, tracker.reason, tracker.fingertips.fingers, tracker.unweighed


def same(one, other):
    np.testing.assert_array_equal(numbers(one), numbers(other))
    assert said(one) == said(other)


FASTER = 0.1
"""Factor on stamps, so that an update solves one problem, and many states are in the middle of a correction."""


def fast(grasp):
    return [replace(each, stamp=FASTER * each.stamp) for each in grasp.observations]


@pytest.fixture(params=["can", "box"])
def grasp(request):
    return request.getfixturevalue(request.param)


def test_a_step_is_pure(grasp):
    """A state answers the same however often it is asked and whatever was asked in between, as its pickle does."""
    tracker, observations = Tracker(grasp.rig, grasp.model), fast(grasp)
    step = tracker.follower.step
    for k, observation in enumerate(observations[:-2]):
        if k % EVERY == 0:
            state, (clean, other) = tracker.track_state, map(check_observation, observations[k : k + 2])
            stored = pickle.dumps(state)
            first, _ = step(state, clean)
            step(step(state, other)[0], check_observation(observations[k + 2]))
            for again in (state, pickle.loads(stored)):
                second, _ = step(again, clean)
                assert (second.monitor.label, second.monitor.reason) == (
                    first.monitor.label,
                    first.monitor.reason,
                )
                assert (second.belief.smoother is None) == (first.belief.smoother is None)
                if first.estimate is not None and first.belief.smoother is not None:
                    assert second.estimate.answer.tobytes() == first.estimate.answer.tobytes()
                    for field in ("T_palm_object", "covariance"):
                        here, there = (getattr(each.belief.smoother.now, field) for each in (second, first))
                        np.testing.assert_array_equal(here, there)
        tracker.update(observation)


def test_a_tracker_goes_on_from_a_copy_or_a_pickle_as_if_it_had_not_stopped(grasp):
    tracker, observations = Tracker(grasp.rig, grasp.model), fast(grasp)
    others = []
    for k, observation in enumerate(observations):
        if k % (2 * EVERY) == 0:
            others += [copy.copy(tracker), pickle.loads(pickle.dumps(tracker))]
        for each in (tracker, *others):
            each.update(observation)
    assert len(others) >= 6
    for other in others:
        same(tracker, other)


def test_copies_diverge(can):
    tracker = Tracker(can.rig, can.model)
    for observation in can.observations[:60]:
        tracker.update(observation)
    known, twin = numbers(tracker), copy.copy(tracker)
    for observation in can.observations[60:]:
        twin.update(observation)
    np.testing.assert_array_equal(numbers(tracker), known)
    assert (numbers(twin) != known).any()


def test_an_error_midway_leaves_the_tracker_as_it_was(can, monkeypatch):
    tracker = Tracker(can.rig, can.model)
    for observation in can.observations[:50]:
        tracker.update(observation)
    state, known = tracker.track_state, numbers(tracker)
    with monkeypatch.context() as patch:
        patch.setattr("handsight.tracking.search.corrected", lambda *_, **__: 1 / 0)
        patch.setattr("handsight.tracking.search.refined", lambda *_, **__: 1 / 0)
        failed = False
        for observation in can.observations[50:]:
            state, known = tracker.track_state, numbers(tracker)
            try:
                tracker.update(observation)
            except ZeroDivisionError:
                failed = True
                break
    assert failed
    assert tracker.track_state is state
    np.testing.assert_array_equal(numbers(tracker), known)


@pytest.mark.parametrize("epoch", [1e9, 1.7e9])
def test_a_recording_is_answered_alike_whenever_it_was_made(grasp, epoch):
    """To the rounding of its stamps."""
    trackers = [Tracker(grasp.rig, grasp.model) for _ in range(2)]
    for observation in fast(grasp):
        now = replace(observation, stamp=epoch + observation.stamp)
        for tracker, each in zip(trackers, (observation, now), strict=True):
            tracker.update(each)
        assert trackers[0].corrections == trackers[1].corrections
        assert trackers[0].state == trackers[1].state
    poses = [tracker.estimate.T_palm_object for tracker in trackers]
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-5)


def test_an_observation_that_cannot_be_fused_is_refused_and_changes_nothing(can, monkeypatch):
    """A singular covariance, say: it is InvalidInput, which a replay counts."""
    tracker = Tracker(can.rig, can.model)
    for observation in can.observations[:10]:
        tracker.update(observation)
    state = tracker.track_state

    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(type(state.belief), "predicted", singular)
    with pytest.raises(InvalidInput):
        tracker.update(can.observations[10])
    assert tracker.track_state is state
    assert tracker.refused == 1
