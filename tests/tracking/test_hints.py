"""Detections and poses of other programs say where a tracker searches first; nothing of them breaks it."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.observation import Detection2D, Observation, PoseMeasurement
from handsight.tracking.hints import MAX_AGE, SearchHints, mask_of
from handsight.vision import FirstPoseSource
from testbed.sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy, on_table

MODEL = hs.ObjectModel.from_mesh(*letter())


def two_letters(seed=1):
    """Depth of two equal objects, and T_camera_object of each."""
    rng = np.random.default_rng([seed, 5])
    T, shapes = looking(rng, 0.5), [letter(), letter()]
    Ts = on_table(rng, shapes)
    return noisy(drawn(T, shapes, Ts)[0], rng), [T @ each for each in Ts]


def around(T):
    pixels = CAMERA.project(se3.apply(T, letter()[0]))
    return *pixels.min(axis=0), *pixels.max(axis=0)


def after(label="letter", **measured):
    return SearchHints(label).after(Observation(1.0, **measured))


@pytest.mark.parametrize("which", [0, 1])
def test_of_equal_objects_the_one_in_the_box_or_mask_or_at_the_pose_is_found(which):
    depth, Ts = two_letters()
    box = around(Ts[which])
    labels = np.zeros(depth.shape, np.int32)
    u0, v0, u1, v1 = np.clip(np.round(box), 0, 319).astype(int)
    labels[v0:v1, u0:u1] = 9
    for hints in (
        after(detections=(Detection2D("mug", 0.99, around(Ts[1 - which])), Detection2D("letter", 0.6, box))),
        after(mask=labels),
        after(label="9", mask=np.where(labels, 9, 4)),
    ):
        source: FirstPoseSource = hints.source()
        found = source(MODEL, depth, CAMERA)
        assert mssd(MODEL, Ts[which], found.Ts_camera_object)[0] < 0.1
    near = se3.moved(Ts[which], np.array([4e-3, 0, 0, 0.05, 0, 0]))
    found = after(vision=PoseMeasurement(near)).source()(MODEL, depth, CAMERA)
    assert mssd(MODEL, Ts[which], found.Ts_camera_object).min() < 0.1


def test_where_a_wrong_detection_has_nothing_the_entire_image_is_searched():
    depth, Ts = two_letters()
    found = after(detections=(Detection2D("letter", 0.9, (0, 0, 9, 9)),)).source()(MODEL, depth, CAMERA)
    assert min(mssd(MODEL, T, found.Ts_camera_object)[0] for T in Ts) < 0.1


def test_hints_are_forgotten_after_a_second():
    box = Detection2D("", None, (10, 10, 50, 50))
    hints = after(detections=(box,), vision=PoseMeasurement(np.eye(4)))
    assert after(vision=PoseMeasurement(np.eye(4), "world")).T_camera_object is None
    later = hints.after(Observation(1.0 + 0.9 * MAX_AGE))
    assert (later.detections, later.T_camera_object is None) == ((box,), False)
    gone = later.after(Observation(1.0 + 1.1 * MAX_AGE))
    assert (gone.detections, gone.T_camera_object) == ((), None)
    none = hints.after(Observation(1.1, detections=()))
    assert none.detections == ()


def test_hints_that_fit_no_image_are_left_out():
    depth, Ts = two_letters()
    beyond = Detection2D("letter", 0.5, (400, 0, 500, 50))
    for hints in (after(detections=(beyond,)), after(mask=np.ones((3, 4), int))):
        found = hints.source()(MODEL, depth, CAMERA)
        assert min(mssd(MODEL, T, found.Ts_camera_object)[0] for T in Ts) < 0.1


@pytest.mark.parametrize(
    ("labels", "label", "pixels"),
    [
        ([[0, 255]], "mug", [[False, True]]),
        ([[0, 255]], "3", [[False, True]]),
        ([[1, 3]], "3", [[False, True]]),
        ([[1, 3]], "4", None),
        ([[1, 3]], "mug", None),
        ([[0, 0]], "3", None),
        ([[0, 0]], "0", None),
    ],
)
def test_a_mask_has_the_objects_number_or_only_one(labels, label, pixels):
    found = mask_of(np.array(labels), label)
    if pixels is None:
        assert found == []
    else:
        np.testing.assert_array_equal(found[0].mask, pixels)
