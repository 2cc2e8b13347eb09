"""No update waits for a long search: a correction runs a step at a time, and counts at its own stamp once it ends."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from handsight.correction.problem import finished
from handsight.tracking import Tracker, runner
from handsight.tracking.follower import Follower
from handsight.tracking.runner import steps_in


@pytest.fixture
def one_step(monkeypatch):
    """Of a recording with 50 observations a second an update runs one step, as of one with 500 by default."""
    monkeypatch.setattr(runner, "STEP_EVERY", 0.02)


def off(grasp, estimate):
    """How far the object's middle is from where it is [m]."""
    middle = np.append(grasp.model.center_object, 1.0)
    return np.linalg.norm((estimate.T_palm_object - grasp.T_palm_object) @ middle)


def test_an_update_runs_a_step_for_the_time_of_each_and_never_none():
    assert [steps_in(seconds) for seconds in (0.0, 0.001, 0.002, 0.02, 0.1)] == [1, 1, 1, 10, 50]
    assert steps_in(np.inf) == steps_in(10.0)


@pytest.mark.parametrize("name", ["can", "box"])
def test_a_correction_goes_on_by_a_step_an_update_and_its_answer_is_that_of_its_own_stamp(
    name, request, one_step
):
    grasp = request.getfixturevalue(name)
    tracker, at_once = Tracker(grasp.rig, grasp.model), Tracker(grasp.rig, grasp.model)
    before, longest = None, 0
    for observation in grasp.observations:
        tracker.update(observation)
        now, last = tracker.track_state.progress, tracker.track_state.correction
        if before is not None and now is not None and now.started is before.started:
            assert now.steps == before.steps + 1
        elif before is not None and last is not None:  # it has ended
            assert last.stamp == before.started.stamp < observation.stamp
            expected = finished(at_once.follower._correct(before.started)).correction
            assert last.estimate.answer.tobytes() == expected.estimate.answer.tobytes()
        before, longest = now, max(longest, 0 if now is None else now.steps)
    assert longest > 3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "STEP_EVERY", 1e-5)
        for observation in grasp.observations:
            at_once.update(observation)
            assert at_once.track_state.progress is None
    assert off(grasp, tracker.estimate) < off(grasp, at_once.estimate) + 1e-3, tracker.reason


def test_what_goes_on_is_lost_with_the_object_and_survives_a_copy(box, one_step):
    tracker = Tracker(box.rig, box.model)
    for observation in box.observations:
        tracker.update(observation)
        progress = tracker.track_state.progress
        if progress is not None and progress.steps == 3:
            break
    copies = copy.deepcopy(tracker), pickle.loads(pickle.dumps(tracker))
    steps = [each.track_state.progress.steps for each in copies]
    for k in range(1, 25):
        free = replace(observation, stamp=observation.stamp + 0.01 * k, wrenches={})
        answers = [each.update(free) for each in (tracker, *copies)]
        assert len({answer.answer.tobytes() for answer in answers}) == 1
    assert steps == [3, 3]
    assert tracker.track_state.progress is None
    assert tracker.track_state.correction is None


def test_an_error_in_a_later_step_is_said_with_its_evidence_and_the_tracker_goes_on(can, one_step):
    """Once: the next correction, of later observations, ends without it, and the answer is the old one until then."""
    tracker = Tracker(can.rig, can.model)
    judged, failed, before, reasons = Follower._judged, [], None, list[str]()

    def raising(self, state, *given):
        if state.corrections == 3 and not failed:
            failed.append((state.stamp, state.fingertips.fingers))
            raise np.linalg.LinAlgError("singular")
        return (yield from judged(self, state, *given))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Follower, "_judged", raising)
        for observation in can.observations:
            answer = tracker.update(observation)
            state = tracker.track_state
            if state.failure is not None:
                reasons.append(tracker.reason)
                assert tracker.state != "tracking"
                assert np.array_equal(answer.T_palm_object, before.T_palm_object)
            before = answer
    (stamp, fingers), named = failed[0], ", ".join(f"finger {name}" for name in failed[0][1])
    assert fingers
    assert len(set(reasons)) == 1
    assert reasons[0].startswith(f"the correction by {named}, vision")
    assert reasons[0].endswith(f"at {stamp:.3f} s failed: singular")
    assert tracker.refused == 0
    assert tracker.corrections > 3
    assert tracker.state == "tracking", tracker.reason
