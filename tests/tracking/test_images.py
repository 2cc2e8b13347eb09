"""A tracker with depth images: images alone, a misplaced camera, and images that cannot be the camera's."""

import copy
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.live import LiveTracker
from handsight.messages import ObservationStream
from handsight.messages.topics import rig_topics
from handsight.objects.symmetry import nearest
from handsight.observation import Detection2D, PoseMeasurement
from handsight.recording import RecordingWriter
from handsight.recording.mcap import McapSource
from handsight.tracking import TrackerSettings
from handsight.tracking.replay import Tally, replay
from handsight.vision import ObjectDetection
from testbed.refusals import refused
from testbed.sight_scenes import SQUARE, TABLE
from tests.live.recorded import answered, poses

K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
WRONG = se3.compose(se3.rotation_exp(np.deg2rad([3.0, -4, 5])), np.array([0.05, -0.04, 0.03]))
"""What the camera's calibration is wrong by, in the world."""
LATE = 5
"""Observations by which an image may come late."""


def rig_with_images(rig):
    return replace(rig, camera=replace(rig.camera, intrinsics=K, size=(320, 240)))


@pytest.fixture(scope="module")
def seen(can):
    """A grasp of a can as a camera sees it that is not where the rig has it; no pose is given, and no wrench yet."""
    rig = rig_with_images(can.rig)
    return rig, pictures(rig, can.model, can.samples, every=5)


def pictures(rig, model, samples, *, every, late=0, wrong=WRONG, way=lambda stamp: np.zeros(3), twin=None):
    """Observations with drawn images; `way(stamp)`: where the hand, the object in it, has gone by then [m].

    `twin`: how far from the object, as it first stands, another like it stands [m]; None: there is none.
    """
    beside = samples[0].observation.T_world_palm @ samples[0].T_palm_object
    beside[:3, 3] += np.zeros(3) if twin is None else twin
    camera, shape = Camera.of(rig.camera), rig.hand.shape()
    T_camera_world = se3.inverse(rig.camera.T_mount_camera) @ wrong
    rng, out, taken = np.random.default_rng(0), [], []
    for k, sample in enumerate(samples):
        observation = sample.observation
        T_world_palm = se3.compose(np.eye(3), way(observation.stamp)) @ observation.T_world_palm
        parts = [
            (T_world_palm, shape.vertices_palm(observation.joint_positions), shape.faces),
            (T_world_palm @ sample.T_palm_object, model.vertices, model.faces),
            (np.eye(4), TABLE, SQUARE),
            *([] if twin is None else [(beside, model.vertices, model.faces)]),
        ]
        vertices, faces, count = [], [], 0
        for T, points, triangles in parts:
            vertices.append(se3.apply(T_camera_world @ T, points))
            faces.append(triangles + count)
            count += len(points)
        if k % every == 0:
            depth = camera.draw(np.concatenate(vertices), np.concatenate(faces)).depth
            there = np.isfinite(depth)
            noise = 1e-3 * rng.normal(size=depth.shape).astype(np.float32)
            taken.append((k, observation.stamp, np.where(there, depth + noise, np.nan).astype(np.float32)))
        image = stamp = None
        if taken and taken[0][0] + late <= k:
            _, stamp, image = taken.pop(0)
        out.append(
            replace(
                observation,
                vision=None,
                wrenches={},
                T_world_palm=T_world_palm,
                depth=image,
                image_stamp=stamp,
            )
        )
    return out


def error(model, estimate, T):
    """Of the middle [m] and turn [rad], modulo symmetry."""
    T = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
    middle = model.center_object[None]
    shift = se3.apply(estimate.T_palm_object, middle) - se3.apply(T, middle)
    turn = se3.rotation_log(estimate.T_palm_object[:3, :3] @ T[:3, :3].T)
    return np.linalg.norm(shift), np.linalg.norm(turn)


def followed(rig, model, observations, **settings):
    tracker = hs.Tracker(rig, model, settings=TrackerSettings(**settings))
    for observation in observations:
        tracker.update(observation)
    return tracker


def test_images_alone_find_an_object_though_the_camera_is_misplaced(can, seen):
    """The camera is wrong by 7 cm and 7 degrees; the hand in the picture says so."""
    rig, observations = seen
    tracker = followed(rig, can.model, observations)
    shift, turn = error(can.model, tracker.estimate, can.T_palm_object)
    assert shift < 0.006
    assert turn < np.deg2rad(4)
    assert tracker.state == "tracking"
    sigma = tracker.sigma
    assert shift / 3.5 < sigma < 0.01
    counts = tracker.images
    assert list(counts) == ["looked_at", "object_seen", "hand_sought", "hand_seen"]  # keys of summary.json
    assert counts["looked_at"] == sum(o.depth is not None for o in observations)
    assert counts["object_seen"] > 0.9 * counts["looked_at"]
    assert counts["hand_seen"] > 0.7 * counts["hand_sought"] > 0


def test_a_tracker_asks_its_source_for_first_poses_and_detections_before_it(can, seen):
    """The source never finds anything, so that the object is seen only where a detection or a pose says where."""
    rig, observations = seen
    asked = []

    def nothing(model, depth, camera, *, hand=None, table=None, noise=None):
        asked.append(depth.shape)
        return ObjectDetection.nowhere("I am blind")

    def seen_by(**hint):
        tracker = hs.Tracker(rig, can.model, source=nothing)
        for observation in observations[:12]:
            tracker.update(replace(observation, **(hint if observation.depth is not None else {})))
        return tracker.images["object_seen"]

    assert seen_by() == 0
    assert set(asked) == {(240, 320)}
    camera, T = (
        Camera.of(rig.camera),
        se3.inverse(rig.camera.T_mount_camera) @ WRONG @ observations[0].T_world_palm,
    )
    T_camera_object = T @ can.T_palm_object
    u, v = camera.project(T_camera_object[None, :3, 3])[0]
    box = (u - 60, v - 60, u + 60, v + 60)
    assert seen_by(detections=(Detection2D("bottle", 1.0, box),)) == 0
    assert seen_by(detections=(Detection2D(can.model.name, 0.7, box),)) > 0
    assert seen_by(vision=PoseMeasurement(T_camera_object)) > 0
    labels = np.zeros((240, 320), np.int32)
    labels[max(int(v) - 60, 0) : int(v) + 60, max(int(u) - 60, 0) : int(u) + 60] = 7
    assert seen_by(mask=labels) > 0
    assert seen_by(mask=labels[1:]) == 0


def test_touch_is_fused_with_images(can, seen):
    rig, observations = seen
    felt = [
        replace(o, wrenches=sample.observation.wrenches)
        for o, sample in zip(observations, can.samples, strict=True)
    ]
    tracker = followed(rig, can.model, felt)
    shift, turn = error(can.model, tracker.estimate, can.T_palm_object)
    assert shift < 0.005
    assert turn < np.deg2rad(4)
    assert tracker.corrections > 0
    bias, covariance = tracker.vision_bias()
    expected = WRONG[:3, :3] @ tracker.smoother.pivot  # where the truth's pivot is seen
    off = expected + WRONG[:3, 3] - tracker.smoother.pivot - bias[:3]
    assert np.linalg.norm(off) < 4 * np.sqrt(covariance.diagonal()[:3].sum()) < 0.05


def test_touch_says_which_of_two_equal_objects_is_in_the_hand(can):
    """Both stand in view; images alone follow the other one, where that is seen better."""
    rig, alone = rig_with_images(can.rig), []
    for twin in ((0.0, -0.15, 0.0), (0.15, 0.0, 0.0)):
        images = pictures(rig, can.model, can.samples, every=2, twin=np.array(twin))
        trackers = hs.Tracker(rig, can.model), hs.Tracker(rig, can.model)
        for observation, sample in zip(images, can.samples, strict=True):
            trackers[0].update(observation)
            trackers[1].update(replace(observation, wrenches=sample.observation.wrenches))
        truth = can.samples[-1].T_palm_object
        off = [apart(each.estimate.T_palm_object, truth, can.model) for each in trackers]
        alone.append(off[0])
        assert off[1] < 0.004
        assert trackers[1].state == "tracking"
    assert max(alone) > 0.14


def test_a_pose_from_outside_counts_where_the_images_do_not_show_the_object(can):
    """Blank images show nothing; the poses of another estimator come with them, and between them."""
    rig = rig_with_images(can.rig)
    images = pictures(rig, can.model, can.samples[:30], every=2, wrong=np.eye(4))
    blank, shown = hs.Tracker(rig, can.model), hs.Tracker(rig, can.model)
    T_camera_world = se3.inverse(rig.camera.T_mount_camera)
    off = se3.compose(np.eye(3), np.array([0.03, 0.0, 0.0]))
    for observation, sample in zip(images, can.samples, strict=False):
        T = T_camera_world @ observation.T_world_palm @ sample.T_palm_object
        depth = observation.depth
        nothing = None if depth is None else np.full_like(depth, np.nan)
        blank.update(replace(observation, depth=nothing, vision=PoseMeasurement(T)))
        shown.update(replace(observation, vision=PoseMeasurement(off @ T)))
    assert apart(blank.estimate.T_palm_object, can.samples[29].T_palm_object, can.model) < 0.01
    assert apart(shown.estimate.T_palm_object, can.samples[29].T_palm_object, can.model) < 0.01


def apart(T, T_true, model):
    """How far apart the middles of the object at two poses are [m]."""
    return np.linalg.norm((T - T_true)[:3] @ np.append(model.center_object, 1.0))


def test_an_image_that_comes_late_is_placed_by_its_stamp(can):
    """A palm that carries the can at 20 cm/s, and images that arrive a tenth of a second after they were taken."""
    rig = rig_with_images(can.rig)
    held = [sample for sample in can.samples if sample.phase == "hold"]

    def way(stamp):
        return np.array([0.2 * (stamp - held[0].observation.stamp), 0, 0.05])

    late = pictures(rig, can.model, held, every=3, late=LATE, wrong=np.eye(4), way=way)
    # The fingers feel it, so that it is known to ride with the palm.
    late = [replace(o, wrenches=s.observation.wrenches) for o, s in zip(late, held, strict=True)]
    right = followed(rig, can.model, late)
    wrong = followed(rig, can.model, [replace(o, image_stamp=None) for o in late])
    assert error(can.model, right.estimate, can.T_palm_object)[0] < 0.006
    # The camera is where the rig has it; to one that takes images for new, the palm is seen behind itself.
    pivot = can.T_palm_object[:3, 3]
    off = [
        np.linalg.norm(t.vision.camera_from_palm.confirmed[0].bias(pivot).T_a_b[:3, 3])
        for t in (right, wrong)
    ]
    assert off[0] < 0.006
    assert off[1] == pytest.approx(0.02 * LATE / 5, abs=0.006)


def test_an_image_that_cannot_be_the_cameras_is_refused_and_changes_nothing(can, seen):
    rig, observations = seen
    tracker, spared = (hs.Tracker(rig, can.model) for _ in range(2))
    for k, observation in enumerate(observations[:60]):
        if k in (20, 30, 40) and observation.depth is not None:
            wrong = [np.ones((10, 10), np.float32), np.ones((240, 320), np.uint16), "a picture"][k // 10 - 2]
            with refused(InvalidInput, "observation.depth"):
                tracker.update(replace(observation, depth=wrong))
        one, other = tracker.update(observation), spared.update(observation)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(one.T_palm_object, other.T_palm_object)
    assert tracker.refused == 3


@pytest.mark.parametrize("fill", [np.nan, 0.0, np.inf, -1.0, 0.7])
def test_empty_images_give_no_pose(can, seen, fill):
    rig, observations = seen
    empty = [
        o if o.depth is None else replace(o, depth=np.full_like(o.depth, fill)) for o in observations[:30]
    ]
    tracker = followed(rig, can.model, empty)
    assert tracker.estimate is None
    assert tracker.state == "lost"
    assert tracker.images["object_seen"] == 0
    assert tracker.images["hand_seen"] == 0


def test_an_image_far_ahead_measures_nothing(can, seen):
    rig, observations = seen
    tracker, spared = (hs.Tracker(rig, can.model) for _ in range(2))
    for k, observation in enumerate(observations[:60]):
        if k == 31:
            jumped = replace(
                observations[30], stamp=observation.stamp + 50, image_stamp=observation.stamp + 50
            )
            tracker.update(replace(jumped, depth=np.ones((240, 320), np.float32)))
        one, other = tracker.update(observation), spared.update(observation)
        if one is not None:
            np.testing.assert_allclose(one.T_palm_object, other.T_palm_object, atol=1e-12)
    assert tracker.late == 1


def test_copies_of_a_tracker_answer_in_several_threads_as_in_one(can, seen):
    """They begin with the same state, and each is updated by one thread."""
    rig, observations = seen
    tracker = followed(rig, can.model, observations[:20])
    copies = [copy.copy(tracker) for _ in range(5)]

    def poses_of(each):
        answers = [each.update(observation) for observation in observations[20:80]]
        return np.array([answer.T_palm_object for answer in answers])

    expected = poses_of(copies[0])
    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(poses_of, copies[1:]):
            np.testing.assert_array_equal(found, expected)


def test_a_live_tracker_uses_images_as_a_replay_does(can, seen, tmp_path):
    """The same bytes through a node's worker as through `replay`, images among them."""
    rig, observations = seen
    rig = replace(rig, topics=replace(rig.topics, depth="/camera/depth", camera_info="/camera/info"))
    path = tmp_path / "images.mcap"
    with RecordingWriter(path, rig) as writer:
        for each in observations[:40]:
            image_stamp = None if each.image_stamp is None else 1000.0 + each.image_stamp
            writer.write(replace(each, stamp=1000.0 + each.stamp, image_stamp=image_stamp))
    with closing(McapSource(path)) as source:
        messages = list(source.messages(rig_topics(rig)))
    stream = ObservationStream(rig)
    heard = [each for message in messages for each in stream.put(message)] + stream.finish()
    assert sum(each.depth is not None for each in heard) == 8
    steps = replay(heard, hs.Tracker(rig, can.model), Tally())
    expected = {round(step.stamp, 6): step.estimate.T_palm_object[:3, 3] for step in steps}
    running = LiveTracker(rig, can.model, encoding="cdr", equal=True)
    found = poses(answered(running, messages, at_once=7))
    assert running.tracker.images["object_seen"] > 0
    assert set(found) == set(expected)
    for stamp, position in expected.items():
        np.testing.assert_allclose(found[stamp][0][:3], position, rtol=0, atol=1e-9)
