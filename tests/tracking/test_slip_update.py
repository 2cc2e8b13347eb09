"""While the object slips, the pose is uncertain along the slip, and the tracker reports it and corrects."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from forces.loads import load
from forces.loads import rig as some_rig
from handsight import se3
from handsight.contact import Contacts
from handsight.errors import InvalidInput
from handsight.forces.friction import Friction
from handsight.tracking import FingertipContacts, Tracker, TrackerSettings
from handsight.tracking.slip_update import LATERAL_SHARE, ONSET_DELAY, SIGMA_SPEED, SlipUpdate
from tracking.gripper import BOX, gripper, observed

FINGERS = ("ff", "mf", "th")
FRICTION, PERIOD = 0.7, 0.004


def felt(ratio, angle=0.0):
    """Three contacts with normals along z, all loaded alike; the object slips along x, turned by an angle."""
    points = np.array([[0.02, 0, 0], [-0.02, 0, 0], [0, 0.02, 0]])
    contacts = Contacts(points, np.tile([0.0, 0, 1], (3, 1)))
    return FingertipContacts(FINGERS, contacts, {}, loads=np.array([load(ratio * FRICTION, angle=angle)] * 3))


def slipping():
    part = SlipUpdate(some_rig())
    part.detector.friction = Friction(FRICTION, 0.01)
    return part


def run(part, seconds, ratio, begin, period=PERIOD):
    """Returns the covariance (6, 6) of the motion of an object at the origin."""
    moved = np.zeros((6, 6))
    for k in range(round(seconds / period)):
        motion = part.update(begin + (k + 1) * period, felt(ratio), np.eye(4))
        moved += 0.0 if motion is None else motion
    return moved


def test_a_grip_that_holds_does_not_change_the_pose():
    part = slipping()
    assert not run(part, 0.5, 0.9, 0.0).any()
    assert not part.now.slipping
    assert part.now.least == pytest.approx(0.9, rel=1e-6)


@pytest.mark.parametrize("period", [0.002, 0.01])
def test_the_sigma_along_a_slip_grows_with_its_time_whatever_the_rate(period):
    part = slipping()
    run(part, 0.1, 0.3, 0.0, period)
    found = run(part, 0.3, 1.0, 0.1, period)
    since = part.detector.stamp - part.now.began + ONSET_DELAY
    assert np.sqrt(found[0, 0]) == pytest.approx(np.hypot(1, LATERAL_SHARE) * SIGMA_SPEED * since, rel=1e-6)
    assert np.sqrt(found[1, 1]) == pytest.approx(LATERAL_SHARE * SIGMA_SPEED * since, rel=0.01)
    assert np.abs(found[3:, 3:] - np.diag(np.diagonal(found)[3:])).max() < 1e-9


def test_each_slip_counts_anew_and_adds_to_those_before():
    part = slipping()
    once = run(part, 0.2, 1.0, 0.0)
    between = run(part, 0.3, 0.2, 0.2)
    assert not part.now.slipping
    twice = once + between + run(part, 0.2, 1.0, 0.5)
    assert twice[0, 0] > 1.7 * once[0, 0]


def test_a_correction_is_due_when_a_slip_begins_while_it_lasts_and_when_it_ends():
    part, asked, corrected = slipping(), [], 0.0
    for k in range(200):
        stamp = (k + 1) * PERIOD
        part.update(stamp, felt(1.0 if 0.2 < stamp <= 0.4 else 0.2), np.eye(4))
        if part.news(corrected):
            asked.append(stamp)
            corrected = stamp
    assert asked[0] == part.now.began
    assert asked[-1] == part.now.ended
    gaps = np.diff(asked)
    assert gaps.max() < 0.06
    assert 0.2 < asked[0] < asked[-1] < 0.55
    assert len(asked) > 8


def test_a_reading_without_contacts_is_no_slip():
    part = slipping()
    run(part, 0.1, 1.0, 0.0)
    assert part.update(0.2, FingertipContacts((), None, {}), np.eye(4)) is None
    assert not part.now.slipping


def test_a_tracker_takes_declared_friction_from_its_argument_the_object_and_the_rig(box):
    assert (
        Tracker(box.rig, box.model, friction=(0.4, 0.02)).track_state.slip.detector.friction.coefficient
        == 0.4
    )
    model = box.model.with_friction(0.6, 0.03)
    assert Tracker(box.rig, model).track_state.slip.detector.friction.sigma == 0.03
    fingers = {
        name: replace(finger, friction=0.5, sigma_friction=0.1) for name, finger in box.rig.fingers.items()
    }
    both = Tracker(replace(box.rig, fingers=fingers), model).track_state.slip.detector.friction
    assert 0.58 < both.coefficient < 0.6
    for wrong in (0.4, (0.4,), (0.0, 0.1), (0.4, -1.0), (np.nan, 0.1)):
        with pytest.raises(InvalidInput):
            Tracker(box.rig, box.model, friction=wrong)


def slippery(tracker, seen, count, friction):
    """Returns the tracker after `count` copies of an observation, with a known coefficient of friction."""
    known = Friction(friction, 0.01 * friction)
    known.update = lambda *loads: None
    tracker.track_state.slip.detector.friction = known
    for _ in range(count):
        tracker.update(replace(seen, stamp=tracker.stamp + 0.01, vision=None))
    return tracker


def surface_sigma(tracker):
    """The root mean square deviation of points of the object's surface [m]."""
    C = tracker.estimate.bounded_covariance
    return np.sqrt(np.trace(C[:3, :3]) + tracker.model.radius**2 * np.trace(C[3:, 3:]))


@pytest.fixture
def held(box):
    tracker = Tracker(box.rig, box.model, settings=TrackerSettings(uncertain_position=0.03))
    for seen in box.observations:
        tracker.update(seen)
    return tracker


def test_a_tracker_reports_a_slip_and_is_less_certain_after_it(box, held):
    seen, corrections = box.held[-1], held.corrections
    calm = slippery(copy.deepcopy(held), seen, 40, 50.0)
    slippery(held, seen, 20, 50.0)
    assert held.state == "tracking", held.reason
    assert held.corrections == corrections
    assert 0 < held.slip.least < 0.1
    slippery(held, seen, 20, 1e-3)
    assert held.slip.slipping
    assert held.state == "uncertain"
    assert held.reason == "the object slips: every finger that holds it is at the limit of friction"
    assert held.corrections > corrections + 5
    assert surface_sigma(held) > 1.05 * surface_sigma(calm)
    during, sigma = held.corrections, held.sigma
    slippery(held, seen, 20, 50.0)
    assert not held.slip.slipping
    assert held.corrections > during
    assert "slips" not in held.reason
    assert held.sigma > 0.9 * sigma  # nothing has told where it is now
    off = se3.difference(held.estimate.T_palm_object, box.T_palm_object)
    assert off @ np.linalg.solve(held.estimate.covariance, off) < 22.5  # 99.9 % of six numbers


def test_a_slip_ends_the_memory_of_fingers_that_have_let_go(box, held):
    seen = box.held[-1]
    lifted = dict(seen.wrenches)
    finger = next(name for name in ("ff", "mf") if name in held.fingertips.fingers)
    calibration = box.rig.fingers[finger].calibration
    lifted[finger] = np.concatenate([calibration.bias_force, calibration.bias_torque])
    slippery(held, replace(seen, wrenches=lifted), 3, 50.0)
    assert finger in held.track_state.touch.memory.last
    slippery(held, replace(seen, wrenches=lifted), 3, 1e-3)
    assert finger not in held.track_state.touch.memory.last


def test_an_observation_far_ahead_changes_no_slip(box, held):
    seen = slippery(held, box.held[-1], 2, 50.0) and box.held[-1]
    now, stamp = held.slip, held.stamp
    held.update(replace(seen, stamp=stamp + 50.0, vision=None))
    held.update(replace(seen, stamp=stamp + 0.01, vision=None))
    assert held.late == 1
    assert held.track_state.slip.detector.stamp == held.stamp == stamp + 0.01
    assert held.slip.friction == now.friction


def carried(stamp, angle, grip, rng, mass=0.15):
    """An observation of a box that two tips hold still, each half of its weight, in a palm that is turned about the
    line through both by `angle` [rad]; `grip`: with how much force [N]."""
    rig = gripper()
    T_world_palm = se3.compose(se3.rotation_exp(np.array([angle, 0.0, 0.0])), np.zeros(3))
    half = 0.5 * mass * rig.gravity @ T_world_palm[:3, :3]
    seen = observed(stamp, visible=stamp < 0.1, T_world_palm=T_world_palm)
    wrenches = {}
    for name, sign in (("left", 1.0), ("right", -1.0)):
        force_palm = half + np.array([sign * grip, 0.0, 0.0])
        force = force_palm @ rig.fingers[name].T_frame_surface[:3, :3] + 0.01 * rng.normal(size=3)
        wrenches[name] = np.concatenate([force, np.cross([0.0, 0.0, 0.01], force)])
    return replace(seen, wrenches=wrenches)


def test_a_hand_that_turns_what_it_holds_reports_no_slip():
    """The weight turns in the palm at a ratio of .29, as the force of a slide may. After that the box is held by less
    force, at a ratio of .56: whatever friction is, it is at least that."""
    rng = np.random.default_rng(0)
    turns = np.concatenate([np.linspace(0, np.pi, 300), np.linspace(np.pi, 0, 300), np.zeros(300)])
    grips = np.concatenate([np.full(600, 2.54), np.linspace(2.54, 1.31, 150), np.full(150, 1.31)])
    tracker, slips = Tracker(gripper(), BOX), 0
    for k, (angle, grip) in enumerate(zip(turns, grips, strict=True)):
        tracker.update(carried(0.01 * k, angle, grip, rng))
        slips += tracker.slip.slipping
    assert set(tracker.fingertips.fingers) == {"left", "right"}
    assert slips == 0
    assert tracker.slip.friction is None or tracker.slip.friction > 0.5
