"""What a robot with more than wrenches sends: tactile arrays, images of its hand, touches of a search, stamps that go back."""

import functools
import random
from collections import Counter
from dataclasses import replace

import numpy as np

import handsight as hs
from handsight import se3
from handsight.contact.taxels import TactileSurface
from handsight.correction import WeightEvidence
from handsight.errors import HandsightError
from handsight.live import LiveTracker
from handsight.messages import RawMessage, RosType
from handsight.rig import Rig, Table
from handsight.search import Area, Belief, Touch
from handsight.tracking.camera_calibration import HandViews
from tests.corpus.arguments import GOOD
from tests.corpus.door import Case, Door, check_covariance, check_pose, check_sentence, spoilt_value
from tests.corpus.observations import BOX, check_answer, gripper, observed
from tests.live.recorded import model, rig, said

PRESSED = np.where(np.add.outer(range(6), range(4)) < 4, 0.3, 0.0)
"""Readings of the palm's array (6, 4): a corner of it is pressed."""


@functools.cache
def with_skin() -> Rig:
    """Returns the gripper with a tactile array on its palm, between the tips."""
    at = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.03]))
    array = TactileSurface.grid(frame="palm", T_frame_grid=at, rows=6, columns=4, pitch=0.005, threshold=0.05)
    return replace(gripper(), skin={"palm": array})


def skin(readings: list[object]) -> None:
    """Updates a tracker with these readings of the palm's array, one after the other."""
    tracker, refused = hs.Tracker(with_skin(), BOX), None
    for k, reading in enumerate([np.zeros((6, 4)), np.zeros((6, 4)), *readings, PRESSED]):
        try:
            tracker.update(replace(observed(0.02 * k, visible=k == 0), skin={"palm": reading}))
        except HandsightError as error:
            refused = error
        check_answer(tracker)
        for fault in tracker.skin.faults.values():
            check_sentence(str(fault))
    if refused is not None:
        raise refused


def skin_spoilt(rng: random.Random) -> None:
    """Updates a tracker with readings of which some have corrupted values."""
    rows = [PRESSED.tolist() for _ in range(3)]
    rows[rng.randrange(3)] = spoilt_value(rows[0], rng)  # type: ignore[call-overload]
    skin([np.array(row) if rng.random() < 0.5 and _regular(row) else row for row in rows])


def _regular(rows: object) -> bool:
    try:
        np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    return True


WEIGHT: dict[str, object] = {
    "mass": 0.5,
    "center_of_mass": [0.0, 0.0, 0.0],
    "sigma_center_of_mass": 0.002,
    "center_palm": [0.01, 0.0, 0.02],
    "covariance": (1e-4 * np.eye(3)).tolist(),
}


def weight_spoilt(rng: random.Random) -> None:
    """Declares a weight, and corrects a pose by a measured one, with one corrupted value."""
    given = {**WEIGHT}
    key = rng.choice(sorted(given))
    given[key] = spoilt_value(given[key], rng)
    weigh(given)


def weigh(given: dict[str, object]) -> None:
    """Declares a weight, and corrects a pose by a measured one."""
    keys = ("mass", "center_of_mass", "sigma_center_of_mass")
    heavy = BOX.with_weight(**{name: given[name] for name in keys})  # type: ignore[arg-type]
    measured = WeightEvidence(heavy.center_of_mass, given["center_palm"], given["covariance"])  # type: ignore[arg-type]
    contacts = hs.Contacts(GOOD["points"], GOOD["normals"])  # type: ignore[arg-type]
    vision = hs.PosePrior.from_sigmas(np.eye(4), 0.02, 0.2)
    estimate = hs.correct_pose(heavy, contacts, vision=vision, weight=measured)
    check_pose(estimate.T_palm_object)
    check_covariance(estimate.covariance)


SEARCH: dict[str, object] = {
    "low": [-0.1, -0.1],
    "high": [0.1, 0.1],
    "free": [[-0.3, 0.0, 0.07], [-0.2, 0.0, 0.07]],
    "radius": 0.01,
    "sigma": 0.0025,
    "point": [-0.04, 0.0, 0.07],
    "normal": [-1.0, 0.0, 0.0],
    "seed": 3,
}


def search_spoilt(rng: random.Random) -> None:
    """Searches the box on a table by a touch with one corrupted value."""
    given = {**SEARCH}
    key = rng.choice(sorted(given))
    given[key] = spoilt_value(given[key], rng)
    search(given)


def search(given: dict[str, object]) -> None:
    """Searches the box on a table by one touch."""
    area = Area(given["low"], given["high"], Table(height=0.0), np.eye(3)[None])  # type: ignore[arg-type]
    met = hs.Contacts([given["point"]], [given["normal"]], 0.0025)  # type: ignore[list-item]
    touch = Touch(given["free"], given["radius"], given["sigma"], met)  # type: ignore[arg-type]
    belief = Belief(BOX, area, given["seed"]).after(touch)  # type: ignore[arg-type]
    for mode in belief.modes:
        check_pose(mode.pose_world_object.T_a_b)
        check_covariance(mode.pose_world_object.covariance)
        assert 0 <= mode.probability <= 1


def images_spoilt(rng: random.Random) -> None:
    """Calibrates a camera by images of noise, some of which are none."""
    robot = rig()
    width, height = robot.camera.size
    draw = np.random.default_rng(rng.getrandbits(32))
    views = HandViews(robot)
    stream = []
    for k in range(2):
        depth = draw.uniform(0.3, 1.2, (height, width)).astype(np.float32)
        depth[: draw.integers(height)] = rng.choice([np.nan, np.inf, -1.0, 0.0, 1e30, 0.5])
        odd = [
            depth,
            depth[1:],
            depth.astype(np.int32),
            None,
            "depth",
            np.ma.masked_greater(depth, 0.4),
            [depth],
        ]
        joints = dict.fromkeys(robot.hand.joint_names, 0.1)
        stream.append(hs.Observation(0.1 * k, joints, T_world_palm=np.eye(4), depth=rng.choice(odd)))
    for _ in views.watched(stream):
        pass
    assert views.images <= 2
    if (found := views.calibration()) is not None:
        check_pose(found.T_mount_camera)
        check_covariance(found.covariance)


WITH_HEADER = {RosType.JOINTS, RosType.WRENCH, RosType.POSE_COVARIANCE}


def shifted(message: RawMessage, by: float) -> RawMessage:
    """Returns a message as it came and was stamped so much later [s]."""
    data = bytearray(message.data)
    if message.type in WITH_HEADER:
        sec = int.from_bytes(data[4:8], "little") + int(by)
        data[4:8] = max(sec, 0).to_bytes(4, "little")
    return message._replace(data=bytes(data), log_time=message.log_time + int(by))


def clock_spoilt(rng: random.Random) -> None:
    """Sends a running tracker messages whose clock jumps, once or twice, back or ahead, or that come out of order."""
    messages = list(said(seconds=0.3))
    for _ in range(rng.choice([0, 1, 2])):
        k, by = rng.randrange(len(messages)), rng.choice([-900.0, -60.0, -2.0, 2.0, 60.0, 1e6])
        end = rng.choice([k + 1, len(messages)])
        messages[k:end] = [shifted(each, by) for each in messages[k:end]]
    if rng.random() < 0.3:
        k = rng.randrange(len(messages))
        messages.insert(rng.randrange(len(messages)), messages.pop(k))
    live = LiveTracker(rig(), model(), encoding="cdr")
    for k in range(0, len(messages), 20):
        for each in messages[k : k + 20]:
            live.put(each)
        counts = Counter(answer.topic for answer in live.step(0.0))
        assert sum(counts.values()) < 1000
        check_answer(live.tracker)
    if sentences := [each for each in live._stream.report.sentences() if "went back" in each]:
        check_sentence(sentences[0])
        raise HandsightError(sentences[0])


DOORS = [
    Door("skin", skin_spoilt, 60),
    Door("a declared and a measured weight", weight_spoilt, 120),
    Door("a search by touch", search_spoilt, 30),
    Door("images to calibrate a camera", images_spoilt, 12),
    Door("a running tracker's clock", clock_spoilt, 12),
]
CASES = [
    Case("readings of an array as they should be", lambda: skin([PRESSED]), None),
    Case("an array of another size", lambda: skin([np.zeros((4, 6))]), "skin['palm']: expected 6 rows of 4 numbers"),
    Case("a tip of 1e155 m", lambda: search({**SEARCH, "radius": 1e155}), "touch.radius: expected"),
    Case("a path that is a number", lambda: search({**SEARCH, "free": 1.0}), "touch.free_world: expected finite numbers of shape (n, 3)"),
    Case("a path that is nothing", lambda: search({**SEARCH, "free": {}}), "touch.free_world: expected finite numbers of shape (n, 3)"),
    Case("a touch without a path", lambda: search({**SEARCH, "free": []}), None),
    Case("a search as it should be", lambda: search(SEARCH), None),
    Case("a weight known to 1e-154 m", lambda: weigh({**WEIGHT, "covariance": np.diag([1e-4, 1e-4, 5e-324])}), "weight.covariance: expected a positive definite"),
    Case("a weight as it should be", lambda: weigh(WEIGHT), None),
    Case("a centre of mass in millimetres", lambda: BOX.with_weight(center_of_mass=[0, 0, 20.0]) and None,
         "center_of_mass: expected metres within 5, got [0, 0, 20] (millimetres? [0, 0, 0.02] m)"),
]  # fmt: skip
