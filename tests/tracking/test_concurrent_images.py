"""Images do not block touch: one thread evaluates them, and what it answers late is fused at its stamp."""

import copy
import pickle
import threading
import time
import warnings
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.observation import PoseMeasurement
from handsight.tracking import TrackerSettings, follower
from handsight.tracking.camera_from_palm import CameraFromPalm
from handsight.tracking.concurrent_images import ConcurrentImages, ImageWarning
from handsight.tracking.images import ImageResult, Instant, ObjectInImages, TakenImage
from handsight.vision import locate
from tests.tracking.test_images import error, pictures, rig_with_images

SETTINGS = TrackerSettings(concurrent_images=True)


class Slow:
    """Answers so many observations later."""

    later = 8

    def __init__(self, rig, model):
        self._images, self._answers = ObjectInImages(rig, model), deque([None] * self.later)

    def __getattr__(self, name):
        return getattr(self._images, name)

    def evaluated(self, taken):
        self._answers.append(self._images.evaluated(taken))
        return self._answers.popleft()


@pytest.fixture
def slow(monkeypatch):
    monkeypatch.setattr(follower, "ConcurrentImages", Slow)


def test_an_image_that_is_answered_late_is_placed_by_its_stamp(can, slow):
    """A palm that carries the can at 20 cm/s, and answers 0.16 s after their images: 3 cm of its way."""
    rig = rig_with_images(can.rig)
    carried = [sample for sample in can.samples if sample.phase == "hold"]

    def way(stamp):
        return np.array([0.2 * (stamp - carried[0].observation.stamp), 0, 0.05])

    taken = pictures(rig, can.model, carried, every=3, wrong=np.eye(4), way=way)
    taken = [replace(o, wrenches=s.observation.wrenches) for o, s in zip(taken, carried, strict=True)]
    tracker = hs.Tracker(rig, can.model, settings=SETTINGS)
    for observation in taken:
        tracker.update(observation)
    assert tracker.images["object_seen"] > 10
    assert error(can.model, tracker.estimate, can.T_palm_object)[0] < 0.006
    assert tracker.vision.rejected == 0


@pytest.mark.parametrize("on", ["world", "palm"])
def test_before_the_grasp_a_late_image_says_where_the_object_is_in_the_world(can, slow, monkeypatch, on):
    """A palm that passes the can at 20 cm/s, with a camera in the world or on the palm."""
    rig, passing = rig_with_images(can.rig), can.samples[:40]
    if on == "palm":
        T_palm_camera = se3.inverse(passing[0].observation.T_world_palm) @ rig.camera.T_mount_camera
        rig = replace(rig, camera=replace(rig.camera, on="palm", T_mount_camera=T_palm_camera))
    T_world_object = passing[0].observation.T_world_palm @ passing[0].T_palm_object

    def evaluated(self, taken):
        pose = None
        if taken is not None:
            T_world_palm = taken.then.T_world_palm
            T_world_camera = rig.camera.T_mount_camera if on == "world" else T_world_palm @ T_palm_camera
            T = se3.inverse(T_world_camera) @ T_world_object
            pose = ImageResult(PoseMeasurement(T, "camera", 1e-6 * np.eye(6), taken.stamp), None)
        self._answers.append(pose)
        return self._answers.popleft()

    monkeypatch.setattr(Slow, "evaluated", evaluated)
    tracker = hs.Tracker(rig, can.model, settings=SETTINGS)
    for k, sample in enumerate(passing):
        T_world_palm = (
            se3.compose(np.eye(3), np.array([4e-3 * k, 0, 0])) @ passing[0].observation.T_world_palm
        )
        depth = np.zeros((240, 320), np.float32) if k % 3 == 0 else None
        seen = replace(sample.observation, T_world_palm=T_world_palm, depth=depth, vision=None, wrenches={})
        tracker.update(seen)
    expected = se3.inverse(T_world_palm) @ T_world_object
    assert error(can.model, tracker.estimate, expected)[0] < 1e-3


def test_an_image_from_before_the_grasp_is_left_out_after_it(can, slow, monkeypatch):
    """It comes when the hand has closed, and says where the object was."""
    rig, answers = rig_with_images(can.rig), []
    closing = next(k for k, s in enumerate(can.samples) if s.phase == "hold")

    def evaluated(self, taken):
        return answers.pop() if answers else None

    monkeypatch.setattr(Slow, "evaluated", evaluated)
    start = hs.PosePrior.from_sigmas(can.T_palm_object, 0.005, 0.1)
    tracker = hs.Tracker(rig, can.model, settings=SETTINGS, start=start)
    for sample in can.samples[: closing + 5]:
        tracker.update(replace(sample.observation, vision=None, depth=np.zeros((240, 320), np.float32)))
    since = tracker.track_state.belief.grasp.since
    assert tracker.track_state.belief.grasp.grasped
    elsewhere = PoseMeasurement(np.eye(4), "camera", 1e-6 * np.eye(6), since - 0.01)
    before = tracker.vision.rejected
    for stamp, rejected in ((since - 0.01, before), (since + 0.01, before + 1)):
        answers.append(ImageResult(replace(elsewhere, stamp=stamp), None))
        closing += 1
        tracker.update(replace(can.samples[closing + 5].observation, vision=None))
        assert tracker.vision.rejected == rejected


def taken_image(rig, observation):
    then = Instant(observation.stamp, observation.joint_positions, observation.T_world_palm)
    return TakenImage(observation.stamp, observation.depth, then, CameraFromPalm(), None, locate)


def test_an_image_of_another_camera_is_refused_at_once(can, slow):
    other = replace(can.samples[0].observation, depth=np.ones((10, 10), np.float32))
    followed = ConcurrentImages(rig_with_images(can.rig), can.model)
    with pytest.raises(InvalidInput, match=r"observation\.depth: expected"):
        followed.evaluated(TakenImage(0.0, other.depth, Instant(0.0, None, None), None, None, locate))


def answer(followed):
    """The next answer of the thread."""
    for _ in range(6000):
        result = followed.evaluated(None)
        if result is not None:
            return result
        time.sleep(0.01)
    raise AssertionError("no answer for a minute")


def test_the_thread_answers_what_the_images_would_and_a_copy_starts_anew(can):
    rig = rig_with_images(can.rig)
    taken = [o for o in pictures(rig, can.model, can.samples[:20], every=3) if o.depth is not None]
    here, there = ObjectInImages(rig, can.model), ConcurrentImages(rig, can.model)
    for observation in taken[:4]:
        image = taken_image(rig, observation)
        assert there.evaluated(image) is None  # at once
        expected, found = here.evaluated(image), answer(there)
        np.testing.assert_array_equal(found.vision.T_frame_object, expected.vision.T_frame_object)
    assert there.counts == here.counts
    assert not there.lost
    for copied in (copy.deepcopy(there), pickle.loads(pickle.dumps(there))):
        assert copied.lost
        copied.evaluated(taken_image(rig, taken[4]))
        assert answer(copied).vision is not None


def wait_for_a_failure(followed):
    while "failed" not in followed.counts:
        assert followed.evaluated(None) is None
        time.sleep(0.01)


def test_what_a_source_of_first_poses_raises_is_said_and_the_next_image_is_evaluated(can):
    rig = rig_with_images(can.rig)
    observation = pictures(rig, can.model, can.samples[:1], every=1)[0]
    followed = ConcurrentImages(rig, can.model)
    followed.evaluated(taken_image(rig, observation)._replace(source=pytest.main))
    with pytest.warns(ImageWarning):
        wait_for_a_failure(followed)
    assert followed.counts["failed"] == 1
    followed.evaluated(taken_image(rig, observation))
    assert answer(followed).hand is not None


def test_an_observation_is_not_refused_for_an_earlier_image(can):
    """The source of first poses fails in the first image; the observations after it are used."""
    rig = rig_with_images(can.rig)
    asked = []

    def failing(*given, **known):
        asked.append(len(asked))
        if len(asked) == 1:
            raise OSError("no network")
        return locate(*given, **known)

    tracker = hs.Tracker(rig, can.model, settings=SETTINGS, source=failing)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for observation in pictures(rig, can.model, can.samples[:40], every=3):
            tracker.update(observation)
            time.sleep(0.05)
    assert [each.category for each in said] == [ImageWarning]
    assert tracker.refused == 0
    assert tracker.images["failed"] == 1
    assert tracker.images["object_seen"] > 0


def test_an_image_that_is_not_in_metres_is_refused_at_once(can):
    rig = rig_with_images(can.rig)
    observation = pictures(rig, can.model, can.samples[:1], every=1)[0]
    millimetres = replace(observation, depth=1000 * observation.depth)
    with pytest.raises(InvalidInput):
        ConcurrentImages(rig, can.model).evaluated(taken_image(rig, millimetres))


def test_a_tracker_that_is_closed_ends_its_thread_after_the_image_that_it_evaluates(can):
    rig = rig_with_images(can.rig)
    before = set(threading.enumerate())
    tracker = hs.Tracker(rig, can.model, settings=SETTINGS)
    tracker.update(pictures(rig, can.model, can.samples[:1], every=1)[0])
    [worker] = set(threading.enumerate()) - before
    tracker.close()
    worker.join(timeout=60.0)
    assert not worker.is_alive()


def test_of_images_that_come_faster_than_they_are_evaluated_the_newest_is(can):
    rig = rig_with_images(can.rig)
    taken = [o for o in pictures(rig, can.model, can.samples[:30], every=3) if o.depth is not None]
    followed = ConcurrentImages(rig, can.model)
    for observation in taken:
        followed.evaluated(taken_image(rig, observation))
    newest = answer(followed)
    while newest.vision.stamp < taken[-1].stamp:
        newest = answer(followed)
    assert newest.vision.stamp == taken[-1].stamp
