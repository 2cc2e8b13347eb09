"""Input of a tracker: observations, a start, settings. A gripper with two slides holds a box under a camera."""

import contextlib
import functools
import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import handsight as hs
from handsight import se3
from handsight.contact import Sphere, WrenchCalibration
from handsight.errors import HandsightError
from handsight.hand import Hand
from handsight.observation import PoseMeasurement
from handsight.recording import TrackRow
from handsight.rig import Finger, MountedCamera, Rig
from handsight.tracking import TrackerSettings, calibrate_camera
from handsight.tracking.replay import Tally, replay
from tests.corpus.door import Case, Door, check_covariance, check_pose, spoilt_value

GRIPPER = """<robot name="gripper">
  <link name="world"/><link name="palm"/><link name="left_tip"/><link name="right_tip"/>
  <joint name="wrist" type="continuous"><parent link="world"/><child link="palm"/><axis xyz="0 0 1"/></joint>
  <joint name="left" type="prismatic"><parent link="palm"/><child link="left_tip"/>
    <origin xyz="0.04 0 0.1"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="right" type="prismatic"><parent link="palm"/><child link="right_tip"/>
    <origin xyz="-0.04 0 0.1"/><axis xyz="-1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""
BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])
T_PALM_BOX = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.1]))
PUSHED = np.array([0.0, 0.0, -2.0, 0.0, 0.0, 0.0])
"""The wrench of a contact at a tip's pole [N, N m]; a hundredth of it is too weak for a contact."""


@functools.cache
def gripper(world_from="tf"):
    """Returns the rig; its tips, of 10 mm radius, touch the box while the joints are at zero."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gripper.urdf"
        path.write_text(GRIPPER)
        tips = {"left": "left_tip", "right": "right_tip"}
        hand = Hand.from_file(path, palm="palm", tips=tips)
    none = WrenchCalibration(*(np.zeros(3),) * 2, 0.0, *(np.zeros(3),) * 3, 1.0, "on_sensor")
    towards = {"left": [0.0, -math.pi / 2, 0.0], "right": [0.0, math.pi / 2, 0.0]}
    fingers = {
        name: Finger(
            frame=tips[name],
            T_frame_surface=se3.compose(se3.rotation_exp(np.array(turn)), np.zeros(3)),
            tip=Sphere(0.01),
            calibration=none,
        )
        for name, turn in towards.items()
    }
    return Rig(
        hand=hand, fingers=fingers, camera=MountedCamera(sigma_position_constant=0.003), world_from=world_from
    )


def observed(stamp, *, touching=True, visible=False, T_world_palm=None):
    """Returns a valid observation; `visible`: with a pose of the box that is off by 2 mm and 2 mrad per axis."""
    T = np.eye(4) if T_world_palm is None else T_world_palm
    force = PUSHED if touching else 0.01 * PUSHED
    return hs.Observation(
        stamp,
        {"wrist": 0.0, "left": 0.0, "right": 0.0},
        {"left": force.copy(), "right": force.copy()},
        PoseMeasurement(T @ se3.moved(T_PALM_BOX, np.full(6, 0.002))) if visible else None,
        T.copy(),
    )


def check_answer(tracker):
    """Asserts what must hold for a tracker after each update, whatever its input was."""
    assert tracker.state in ("tracking", "uncertain", "lost")
    assert (tracker.reason == "") == (tracker.state == "tracking")
    estimate = tracker.estimate
    if estimate is None:
        assert tracker.state == "lost"
        return
    check_pose(estimate.T_palm_object)
    check_covariance(estimate.covariance)
    assert np.isfinite(estimate.information).all()
    assert tracker.sigma >= 0
    # The estimate can be written to a file.
    TrackRow(tracker.stamp, estimate.T_palm_object, estimate.covariance, tracker.state)


def spoilt_observation(observation, rng):
    """Returns an observation with one of its values, or a part of one, corrupted."""
    part = rng.choice(["stamp", "joint_positions", "wrenches", "vision", "T_world_palm", "all"])
    if part == "all":
        return rng.choice([None, 3.0, "observation", {"stamp": 1.0}, PoseMeasurement(np.eye(4))])
    value = getattr(observation, part)
    if part == "vision":
        return replace(observation, vision=spoilt_vision(rng))
    if isinstance(value, dict):
        value = {key: as_list(each) for key, each in value.items()}
    spoilt = spoilt_value(as_list(value), rng)
    return replace(observation, **{part: as_array(spoilt)})


def spoilt_vision(rng):
    """Returns a pose measurement with a corrupted part; raises HandsightError where that is refused."""
    given = {
        "T": T_PALM_BOX.tolist(),
        "frame": "world",
        "covariance": np.diag([4e-6] * 3 + [4e-4] * 3).tolist(),
    }
    key = rng.choice(sorted(given))
    given[key] = spoilt_value(given[key], rng)
    return PoseMeasurement(given["T"], given["frame"], given["covariance"])


def as_list(value):
    return value.tolist() if isinstance(value, np.ndarray) else value


def as_array(value):
    """Returns lists of numbers as arrays, because callers pass both."""
    if isinstance(value, dict):
        return {key: as_array(each) for key, each in value.items()}
    if isinstance(value, list):
        try:
            return np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            return value
    return value


def update_spoilt(rng):
    """Updates a tracker with valid observations and a corrupted one among them, which must change nothing if refused."""
    tracker = hs.Tracker(gripper(rng.choice(["tf", "joints"])), BOX)
    for k in range(4):
        tracker.update(observed(0.02 * k, touching=rng.random() < 0.7, visible=k % 2 == 0))
    known, refusal = tracker.estimate.T_palm_object.copy(), None
    try:
        tracker.update(spoilt_observation(observed(0.08, visible=rng.random() < 0.5), rng))
    except HandsightError as error:
        np.testing.assert_array_equal(tracker.estimate.T_palm_object, known)
        refusal = error
    check_answer(tracker)
    for k in range(5, 9):
        tracker.update(observed(0.02 * k, visible=k % 2 == 0))
        check_answer(tracker)
    if refusal is not None:
        assert tracker.state == "tracking", tracker.reason
        raise refusal


def begin_spoilt(rng):
    """Builds and updates a tracker with a corrupted start or corrupted settings."""
    start = {"T": T_PALM_BOX.tolist(), "covariance": np.diag([1e-4] * 3 + [1e-2] * 3).tolist()}
    settings = {"rate": 10.0, "memory": 2.0, "process_noise_position": 0.001, "regrasp_rotation": 0.05}
    settings |= {"lost_after": 3.0, "moved": 0.001, "answer": "best", "samples": 0, "outside": 0}
    spoilt = rng.choice([start, settings])
    key = rng.choice(sorted(spoilt))
    spoilt[key] = spoilt_value(spoilt[key], rng)
    if settings["samples"] != 0 or settings["outside"] != 0:
        TrackerSettings(**settings)
        settings |= {"samples": 0, "outside": 0}  # a million of them is allowed, and slow
    prior = hs.PosePrior(start["T"], start["covariance"])
    tracker = hs.Tracker(gripper(), BOX, start=prior, settings=TrackerSettings(**settings))
    for k, touching in enumerate((False, True, True, False, True)):
        tracker.update(observed(0.3 * k, touching=touching, visible=k % 2 == 1))
        check_answer(tracker)


def replay_spoilt(rng):
    """Replays observations of which some have corrupted stamps or values, and calibrates the camera with them."""
    stream = [observed(10 + 0.02 * k, visible=k % 5 == 0) for k in range(30)]
    for _ in range(rng.choice([0, 1, 2])):
        k, jump = rng.randrange(30), rng.choice([-1e9, -100.0, -1.5, -0.5, 1.5, 100.0, 1e9])
        end = rng.choice([k + 1, 30])
        stream[k:end] = [replace(each, stamp=each.stamp + jump) for each in stream[k:end]]
    for k in rng.sample(range(30), rng.choice([0, 1, 3])):
        with contextlib.suppress(HandsightError):  # of a pose that cannot be made
            stream[k] = spoilt_observation(stream[k], rng)
    tally, tracker = Tally(), hs.Tracker(gripper(), BOX)
    steps = list(replay(stream, tracker, tally))
    check_answer(tracker)
    assert tally.observations == len(stream)
    assert tally.answered == len(steps)
    assert tally.refused.total() == tracker.refused
    assert math.isfinite(tally.recorded)
    assert sum(tally.states.values()) <= tally.recorded + 1e-6
    if (found := calibrate_camera(stream, gripper(), BOX)) is not None:
        check_pose(found.T_mount_camera)
        check_covariance(found.covariance)
    if tracker.refused:
        raise HandsightError(next(iter(tally.refused)))


def poisoned(**changes):
    """Updates a tracker with one bad observation among good ones; raises its refusal.

    Asserts that the good ones are answered as by a tracker that never got the bad one.
    """
    tracker, alone = hs.Tracker(gripper(), BOX), hs.Tracker(gripper(), BOX)
    refusal = None
    for k in range(20):
        good = observed(0.02 * k, visible=k % 5 == 0)
        if k == 10:
            before = vars(tracker).copy()
            try:
                tracker.update(replace(good, stamp=good.stamp - 0.01, **changes))
            except HandsightError as error:
                refusal = error
            assert {k for k, v in vars(tracker).items() if v is not before[k]} <= {
                "refused",
                "_left_out_in_a_row",
            }
        expected, estimate = alone.update(good), tracker.update(good)
        np.testing.assert_array_equal(estimate.T_palm_object, expected.T_palm_object)
        np.testing.assert_array_equal(estimate.information, expected.information)
        assert tracker.state == alone.state
    assert tracker.refused == 1
    raise refusal


def clocked(stamps):
    """Returns the tracker after valid observations with these stamps, and its state and reason after each."""
    tracker, states = hs.Tracker(gripper(), BOX), []
    for stamp in stamps:
        tracker.update(observed(stamp, visible=True))
        check_answer(tracker)
        states.append((tracker.state, tracker.reason))
    return tracker, states


def one_stamp_ahead():
    """A single stamp far ahead is left out, and the track goes on."""
    stamps = [10 + 0.02 * k for k in range(40)]
    tracker, _ = clocked([*stamps[:20], 1e9, *stamps[20:]])
    assert (tracker.undone, tracker.late, tracker.stamp) == (1, 0, stamps[-1])
    assert tracker.state == "tracking", tracker.reason


def a_clock_set_back():
    """After a clock was set back a new track starts, and the reason says so."""
    tracker, states = clocked([*(100 + 0.02 * k for k in range(20)), *(40 + 0.02 * k for k in range(80))])
    assert tracker.stamp == 40 + 0.02 * 79
    assert "the clock went back by 60.4 s: a new track" in states[21][1]
    assert tracker.state == "tracking", tracker.reason


def huge_vision():
    """Updates a tracker with the largest poses and covariances that are accepted."""
    tracker = hs.Tracker(gripper(), BOX)
    for k in range(20):
        T = se3.compose(np.eye(3), np.full(3, 5.0 if k % 3 else -5.0))
        sigmas = np.array([1e3, 1e-9, 1e-9, 1e3, 1e3, 1e-9])[np.roll(range(6), k)]
        vision = PoseMeasurement(T, "world", np.diag(sigmas**2))
        tracker.update(replace(observed(0.02 * k, touching=k > 10), vision=vision))
        check_answer(tracker)


REFLECTED = np.diag([1.0, 1.0, -1.0, 1.0])
DOORS = [
    Door("Tracker.update", update_spoilt, 160),
    Door("Tracker", begin_spoilt, 110),
    Door("replay", replay_spoilt, 40),
]
CASES = [
    Case("a palm at NaN", lambda: poisoned(T_world_palm=np.full((4, 4), np.nan)), "observation.T_world_palm: "),
    Case("a palm that is scaled", lambda: poisoned(T_world_palm=np.diag([2.0, 2, 2, 1])), "not orthonormal"),
    Case("a palm that is mirrored", lambda: poisoned(T_world_palm=REFLECTED), "a reflection"),
    Case("a palm of (3, 3)", lambda: poisoned(T_world_palm=np.eye(3)), "expected finite numbers of shape (4, 4)"),
    Case("a palm 1e200 away", lambda: poisoned(T_world_palm=_at(1e200)), "expected metres within 1000"),
    Case("a wrench of five", lambda: poisoned(wrenches={"left": np.zeros(5)}), "wrenches['left']: expected 6"),
    Case("a wrench of 1e20 N", lambda: poisoned(wrenches={"left": np.full(6, 1e20)}), "wrenches['left']: expected newt"),
    Case("a wrench in words", lambda: poisoned(wrenches={"left": ["1"] * 6}), "wrenches['left']: expected 6"),
    Case("a finger misspelt", lambda: poisoned(wrenches={"lef": PUSHED}), "expected names of the rig, got 'lef'; the nearest valid one is 'left'"),
    Case("a contact of no finger", lambda: poisoned(contacts={"thumb": None}), "contacts: expected names of the rig, got 'thumb'"),
    Case("skin of no array", lambda: poisoned(skin={3: np.zeros((2, 2))}), "skin: expected names of the rig, got '3'"),
    Case("a joint misspelt", lambda: poisoned(joint_positions={"lef": 0.0, "right": 0.0}), "expected a position for left"),
    Case("joints in degrees", lambda: poisoned(joint_positions={"left": 45.0, "right": 0.0}), "joint 'left' at 45 where its file limits it to 1 (degrees? 0.785 rad)"),
    Case("millinewtons", lambda: poisoned(wrenches={"left": 1e3 * PUSHED}), "finger left at 2000 N (millinewtons? 2 N)"),
    Case("vision 600 m away", lambda: poisoned(vision=PoseMeasurement(_at(600.0))), "poses at 600 m away (millimetres? 0.6 m)"),
    Case("vision 600 m from the palm in the world", lambda: poisoned(vision=PoseMeasurement(_at(600.0), "world")), "poses at 600 m away"),
    Case("a rotation's sigma in degrees", lambda: hs.PosePrior.from_sigmas(np.eye(4), 0.01, 15.0), "sigma_rotation: expected radians within 3.142, got 15 (degrees? 0.2618 rad)"),
    Case("wrenches in a list", lambda: poisoned(wrenches=[np.zeros(6)]), "wrenches: expected a mapping"),
    Case("a slide 1e20 m out", lambda: poisoned(joint_positions={"left": 1e20, "right": 0.0}), "joint_positions: finger"),
    Case("a pose that is an array", lambda: poisoned(vision=np.eye(4)), "vision: expected a PoseMeasurement or None"),
    Case("nanoseconds", lambda: clocked([1.7e18]), "stamp: expected seconds within 1e+11, got 1.7e+18 (mill"),
    Case("no observation", lambda: hs.Tracker(gripper(), BOX).update(None), "expected an Observation, got NoneType"),
    Case("a prior that is a pose", lambda: hs.Tracker(gripper(), BOX, start=np.eye(4)), "start: expected a PosePrior"),
    Case("no corrections a second", lambda: TrackerSettings(rate=0.0), "settings.rate: expected a number above 0"),
    Case("a pose 1e20 away", lambda: PoseMeasurement(_at(1e20)), "vision.T_frame_object: translation: expected"),
    Case("a frame that is an array", lambda: PoseMeasurement(np.eye(4), np.eye(4)), "vision.frame: expected one of"),
    Case("one stamp far ahead", one_stamp_ahead, None),
    Case("a clock set back", a_clock_set_back, None),
    Case("vision as wild as it may be", huge_vision, None),
]  # fmt: skip


def _at(x):
    T = np.eye(4)
    T[0, 3] = x
    return T
