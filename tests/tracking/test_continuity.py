"""While the same fingers touch an object that does not slip, its pose moves by no more than its own sigma."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.tracking import Tracker


def bent(observation, finger, by=0.2):
    """The same observation; the joints of one finger read `by` [rad] too much."""
    of_finger = f"robot0:{finger.upper()}J"
    q = {name: value + by * name.startswith(of_finger) for name, value in observation.joint_positions.items()}
    assert q != observation.joint_positions
    return replace(observation, joint_positions=q)


def elsewhere(observation, finger):
    """The same observation; the wrench of one finger is of a contact on another place of the tip."""
    wrench = np.array(observation.wrenches[finger])
    wrench[:3] = wrench[[1, 0, 2]] * [1, -1, 1]
    return replace(observation, wrenches={**observation.wrenches, finger: wrench})


def misplaced(observation, finger):
    """The same observation; vision saw the object 60 mm and 30° from where it is, and claims to know it well."""
    if observation.vision is None:
        return observation
    T = se3.moved(observation.vision.T_frame_object, np.array([0.06, 0.0, 0.0, 0.0, 0.5, 0.0]))
    return replace(observation, vision=replace(observation.vision, T_frame_object=T))


def middle(model, estimate):
    """The object's middle in the palm."""
    return estimate.T_palm_object @ np.append(model.center_object, 1.0)


def steps(tracker, observations):
    """Of each update: how far the middle moves [m], the sigma before it, and whether the same fingers touch."""
    for observation in observations:
        before, fingers, sigma = (
            middle(tracker.model, tracker.estimate),
            tracker.fingertips.fingers,
            tracker.sigma,
        )
        estimate = tracker.update(observation)
        yield (
            float(np.linalg.norm(middle(tracker.model, estimate) - before)),
            sigma,
            tracker.fingertips.fingers == fingers,
        )


def held(grasp, ticks):
    """Trackers of a grasp just before some ticks at which three fingers or more hold, and what comes from then on."""
    tracker = Tracker(grasp.rig, grasp.model)
    for k, observation in enumerate(grasp.observations[: max(ticks) + 1]):
        if k in ticks and len(tracker.fingertips.fingers) >= 3:
            yield deepcopy(tracker), grasp.observations[k:]
        tracker.update(observation)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("can", bent), ("can", elsewhere), ("can", misplaced), ("box", bent), ("box", misplaced)],
)
def test_one_wrong_observation_neither_moves_a_grasped_object_nor_makes_it_uncertain(name, wrong, request):
    grasp, count = request.getfixturevalue(name), 0
    for tracker, observations in held(grasp, range(48, len(grasp.observations) - 6, 9)):
        finger, state = tracker.fingertips.fingers[0], tracker.state
        for moved, sigma, same in steps(tracker, [wrong(observations[0], finger)]):
            if same:
                count += 1
                assert moved <= sigma
                assert tracker.state in (state, "tracking"), tracker.reason
        before = middle(tracker.model, tracker.estimate)
        for moved, sigma, same in steps(tracker, observations[1:6]):
            assert moved <= sigma or not same
        assert np.linalg.norm(middle(tracker.model, tracker.estimate) - before) < 0.004
    assert count


@pytest.mark.parametrize("name", ["can", "box"])
def test_between_changes_of_the_contacts_the_answer_moves_by_less_than_its_sigma(name, request):
    grasp = request.getfixturevalue(name)
    tracker = Tracker(grasp.rig, grasp.model)
    tracker.update(grasp.observations[0])
    checked = 0
    for moved, sigma, same in steps(tracker, grasp.observations[1:]):
        if (
            same
            and len(tracker.fingertips.fingers) >= 3
            and not tracker.slip.slipping
            and tracker.estimate.consistent
        ):
            checked += 1
            assert moved <= sigma
    assert checked > 20


def test_what_corrections_keep_saying_counts_within_a_fifth_of_a_second(can):
    """All fingers but the first stay as they are; from some tick on that one reads as if it were elsewhere."""
    tracker, observations = next(held(can, [len(can.observations) - 12]))
    finger = tracker.fingertips.fingers[0]
    for observation in observations[:3]:  # a search for the wrong finger takes longer than two updates may
        tracker.update(bent(observation, finger))
    assert tracker.track_state.correction.disputed_at == observations[0].stamp
    for observation in observations[3:11]:
        tracker.update(bent(observation, finger))
    assert tracker.track_state.correction.disputed_at is None
    assert tracker.estimate.outliers or not tracker.estimate.consistent
