"""An object that is grasped and not lifted yet stands on the table; a finger that flickers moves nothing."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.rig import Table
from handsight.tracking import Tracker, TrackerSettings
from tracking.gripper import BOX, T_PALM_BOX, gripper, observed

TABLE = 0.03
"""Height of the table on which the gripper's box stands while the palm is at the world's origin [m]."""


def standing():
    """A tracker of the box on the table, grasped by the gripper."""
    rig = replace(gripper(), table=Table(height=TABLE))
    start = hs.PosePrior.from_sigmas(T_PALM_BOX, 0.01, 0.05)
    tracker = Tracker(rig, BOX, start=start, settings=TrackerSettings(rate=50.0))
    for k in range(20):
        tracker.update(observed(0.02 * k))
    return tracker


def palm(sinks, tilt, along):
    """The palm's pose in the world: lower, tilted about the line through both tips, and moved over the table."""
    return se3.compose(se3.rotation_exp(np.array([tilt, 0.0, 0.0])), np.array([along, 0.3 * along, -sinks]))


def base(tracker, T_world_palm):
    """The lowest corner of the box in the world [m]."""
    corners = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.045, 0.045) for z in (-0.07, 0.07)])
    return se3.apply(T_world_palm @ tracker.estimate.T_palm_object, corners)[:, 2].min()


@pytest.mark.parametrize("sinks", [-0.004, 0.006])
def test_what_stands_keeps_its_height_and_tilt_until_the_palm_lifts_it(sinks):
    tracker = standing()
    assert abs(base(tracker, np.eye(4)) - TABLE) < 1e-3
    T = palm(0.0, 0.0, 0.0)
    for k in range(50):
        share = (k + 1) / 50
        T = palm(share * sinks, share * 0.06, share * 0.05)
        tracker.update(observed(0.4 + 0.02 * k, T_world_palm=T))
        assert abs(base(tracker, T) - TABLE) < 1.5e-3
    place = T @ tracker.estimate.T_palm_object
    assert abs(place[2, 2] - 1) < 1e-3
    # It slides with the palm, and is lifted with it.
    assert np.linalg.norm(place[:2, 3] - T[:2, 3]) < 0.01
    held = tracker.estimate.T_palm_object
    for k in range(50):
        T = T.copy()
        T[2, 3] += 1e-3
        tracker.update(observed(1.4 + 0.02 * k, T_world_palm=T))
    lifted = 0.05 + max(-sinks, 0.0) - 0.005
    assert base(tracker, T) - TABLE == pytest.approx(lifted, abs=2e-3)
    assert np.linalg.norm(tracker.estimate.T_palm_object[:3, 3] - held[:3, 3]) < 0.01


def test_what_was_lifted_tilts_with_the_palm_however_low_that_is():
    tracker = standing()
    for k in range(120):
        height = 1e-3 * min(k, 20) - 5e-4 * max(k - 60, 0)
        T = palm(-height, 0.01 * max(k - 20, 0), 0.0)
        tracker.update(observed(0.4 + 0.02 * k, T_world_palm=T))
    assert not tracker.track_state.belief.grasp.lifted
    assert np.linalg.norm(se3.difference(tracker.estimate.T_palm_object, T_PALM_BOX)[3:]) < 0.02


def test_a_finger_that_flickers_is_no_regrasp():
    """It touches in every other observation for two seconds: the pose is as certain as if it touched in all."""
    sigmas = []
    for flickers in (False, True):
        tracker = standing()
        for k in range(400):
            seen = observed(0.4 + 0.005 * k)
            if flickers and k % 2:
                seen.wrenches["left"] *= 0.01
            tracker.update(seen)
        sigmas.append(tracker.sigma)
    assert sigmas[1] == pytest.approx(sigmas[0], rel=0.1)


def test_sigma_and_covariance_say_the_same_after_a_regrasp():
    """A finger that lets go for longer has let go, and the object may have moved."""
    tracker = standing()
    before = tracker.sigma
    for k in range(30):
        seen = observed(0.4 + 0.02 * k)
        seen.wrenches["left"] *= 0.01
        tracker.update(seen)
    after = tracker.estimate.bounded_covariance[:3, :3]
    assert tracker.sigma > before
    assert tracker.sigma == pytest.approx(np.sqrt(np.linalg.eigvalsh(after)[-1]), rel=0.1)


@pytest.mark.parametrize("finger", ["ff", "mf", "th"])
def test_a_contact_of_one_reading_before_the_grasp_changes_nothing_of_it(box, finger):
    """Such as noise of a sensor: the tip is in the air, and so is what it would say of the object."""
    held = box.observations[-1]
    first = box.observations[2]
    noisy = list(box.observations)
    noisy[2] = replace(first, wrenches={**first.wrenches, finger: held.wrenches[finger]})
    middle = np.append(box.model.center_object, 1.0)
    errors = []
    for observations in (box.observations, noisy):
        tracker = Tracker(box.rig, box.model)
        touched = [bool(tracker.update(each)) and tracker.fingertips.fingers for each in observations]
        errors.append(np.linalg.norm((tracker.estimate.T_palm_object - box.T_palm_object) @ middle))
    assert touched[2] == (finger,)
    assert not touched[3]
    assert errors[1] < errors[0] + 1e-3
