"""No update waits for a long search: each solves a few problems, and a correction counts at its own stamp once it ends."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from handsight.tracking import Tracker, follower
from handsight.tracking.search import solves_in

FASTER = 0.1


def fast(grasp):
    """A recording of 50 observations a second as one of 500, of which an update solves one problem."""
    return [replace(each, stamp=FASTER * each.stamp) for each in grasp.observations]


def off(grasp, estimate):
    """How far the object's middle is from where it is [m]."""
    middle = np.append(grasp.model.center_object, 1.0)
    return np.linalg.norm((estimate.T_palm_object - grasp.T_palm_object) @ middle)


def test_an_update_solves_a_problem_for_the_time_of_each_and_never_none():
    assert [solves_in(seconds) for seconds in (0.0, 0.002, 0.005, 0.02, 0.035)] == [1, 1, 1, 4, 7]
    assert solves_in(np.inf) == solves_in(10.0) == 8


@pytest.mark.parametrize("name", ["can", "box"])
def test_a_correction_goes_on_by_a_problem_an_update_and_its_answer_is_that_of_its_own_stamp(name, request):
    grasp = request.getfixturevalue(name)
    tracker = Tracker(grasp.rig, grasp.model)
    before, longest = None, 0
    for observation in fast(grasp):
        tracker.update(observation)
        now, last = tracker.track_state.search, tracker.track_state.correction
        if before is not None and now is not None and now.started is before.started:
            assert len(now.answers) == len(before.answers) + 1
        elif before is not None and last is not None:  # it has ended
            assert last.stamp == before.started.stamp < observation.stamp
        before = now
        longest = max(longest, 0 if now is None else len(now.answers))
    assert longest > 1
    assert off(grasp, tracker.estimate) < 2 * tracker.sigma


def test_what_goes_on_is_lost_with_the_object_and_survives_a_copy(box):
    tracker = Tracker(box.rig, box.model)
    for observation in fast(box):
        tracker.update(observation)
        search = tracker.track_state.search
        if search is not None and len(search.answers) == 2:
            break
    copies = copy.deepcopy(tracker), pickle.loads(pickle.dumps(tracker))
    solved = [len(each.track_state.search.answers) for each in copies]
    assert solved == [2, 2]
    for k in range(1, 25):
        free = replace(observation, stamp=observation.stamp + 0.01 * k, wrenches={})
        answers = [each.update(free) for each in (tracker, *copies)]
        assert len({answer.answer.tobytes() for answer in answers}) == 1
    assert tracker.track_state.search is None
    assert tracker.track_state.correction is None


def test_an_error_in_a_correction_is_said_with_its_evidence_and_the_tracker_goes_on(can):
    """Once: the next correction, of later observations, ends without it, and the answer is the old one until then."""
    tracker = Tracker(can.rig, can.model)
    accepted, failed, before, reasons = follower.accepted, [], None, list[str]()

    def raising(model, state, *given):
        if state.monitor.corrections == 3 and not failed:
            failed.append((state.stamp, state.touch.fingertips.fingers))
            raise np.linalg.LinAlgError("singular")
        return accepted(model, state, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(follower, "accepted", raising)
        for observation in fast(can):
            answer = tracker.update(observation)
            state = tracker.track_state
            if state.monitor.failure is not None:
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
