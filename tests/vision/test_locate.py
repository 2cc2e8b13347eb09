"""`locate` says where an object is, or that it is not there and why; what is no such input is said too."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.vision import DepthTracker, locate, recognise
from handsight.vision.object.locate import MIN_PROBABILITY, search_mask
from testbed.refusals import refused
from testbed.sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy, on_table


@functools.cache
def models():
    return {
        "letter": hs.ObjectModel.from_mesh(*letter()),
        "tin": hs.ObjectModel.cylinder(0.035, 0.03),
        "brick": hs.ObjectModel.box((0.09, 0.055, 0.035)),
    }


@functools.cache
def picture(name, seed=0):
    """Of one object alone on a table; None: of the table."""
    rng = np.random.default_rng([seed, 3])
    model = models()["letter" if name is None else name]
    lift = np.array([0, 0, -model.bounds_object[0, 2]])
    T_camera_table = looking(rng, 0.45)
    shapes = [] if name is None else [(model.vertices + lift, model.faces)]
    Ts = on_table(rng, shapes) if shapes else []
    depth, _ = drawn(T_camera_table, shapes, Ts)
    T = None if name is None else T_camera_table @ Ts[0] @ se3.compose(np.eye(3), lift)
    return T, noisy(depth, rng)


@pytest.mark.parametrize("name", ["letter", "tin", "brick"])
def test_what_is_there_is_found_and_named(name):
    T, depth = picture(name)
    found = locate(models()[name], depth, CAMERA)
    assert found.reason is None
    assert mssd(models()[name], T, found.Ts_camera_object)[0] < 0.1
    assert MIN_PROBABILITY <= found.probability <= 1
    answer = recognise(models(), depth, CAMERA)
    assert answer.name == name == next(iter(answer.scores))
    assert answer.none + sum(answer.scores.values()) == pytest.approx(1)
    assert min(answer.scores.values()) >= 0


def nowhere(found, reason):
    assert found.Ts_camera_object.shape == (0, 4, 4)
    assert found.covariances.shape == (0, 6, 6)
    assert len(found.weights) == len(found.candidates) == 0
    assert reason in found.reason
    return True


BLANK = np.zeros((240, 320), np.float32)
EMPTY = {
    "no depth": (BLANK, "no pixel has a depth"),
    "not a number": (BLANK + np.nan, "no pixel has a depth"),
    "infinite": (BLANK + np.inf, "no pixel has a depth"),
    "behind": (BLANK - 0.5, "no pixel has a depth"),
    "a wall": (BLANK + 0.8, "nothing is seen there but the table"),
}


@pytest.mark.parametrize("case", EMPTY)
def test_where_nothing_is_it_is_nowhere(case):
    depth, reason = EMPTY[case]
    assert nowhere(locate(models()["letter"], depth, CAMERA), reason)
    answer = recognise(models(), depth, CAMERA)
    assert answer.name is None
    assert answer.none == 1
    assert reason in answer.reason


@pytest.mark.parametrize(("there", "wanted"), [("tin", "letter"), ("tin", "brick")])
def test_another_object_is_not_it(there, wanted):
    """Rather none than another of the same height, and nowhere if it is of another one."""
    _, depth = picture(there)
    found = locate(models()[wanted], depth, CAMERA)
    assert found.probability < 0.5
    if "letter" in (there, wanted):
        assert nowhere(found, "is right with a probability of 0.")
    others = {name: model for name, model in models().items() if name != there}
    answer = recognise(others, depth, CAMERA)
    assert answer.name is None
    assert "nothing there looks like one of them" in answer.reason


def test_one_pixel_and_things_of_other_sizes_have_an_answer():
    _, depth = picture("letter")
    pixel = np.zeros(depth.shape, bool)
    pixel[120, 160] = True
    assert nowhere(locate(models()["letter"], depth, CAMERA, mask=pixel), "nothing is seen there")
    huge, tiny = hs.ObjectModel.box((1.5, 1.2, 0.9)), hs.ObjectModel.box((0.006, 0.005, 0.004))
    for model in (huge, tiny):
        found = locate(
            model, depth, CAMERA
        )  # the table may be a side of the huge one: more of it is not in the picture
        assert (found.reason is None) == (len(found.weights) > 0)
        assert np.isfinite(found.Ts_camera_object).all()
        assert (np.linalg.eigvalsh(found.covariances) > 0).all()


@pytest.mark.parametrize(
    ("name", "change", "field"),
    [
        ("depth", lambda d: 1000 * d, "depth"),
        ("depth", lambda d: d[:100], "depth"),
        ("depth", lambda d: d[None], "depth"),
        ("mask", lambda d: d[:, 1:] > 0, "mask"),
        ("hand", lambda d: d[1:] > 0, "hand"),
    ],
)
def test_what_is_no_such_image_is_said(name, change, field):
    _, depth = picture("letter")
    arguments = {"depth": depth} | {name: change(depth)}
    with refused(InvalidInput, field):
        locate(models()["letter"], arguments.pop("depth"), CAMERA, **arguments)


def test_depth_in_which_an_object_would_be_wider_than_the_image_is_doubted():
    """By `locate`, and by what follows an object, without another search; nothing is said of depth that may be right."""
    _, depth = picture("letter")
    found = locate(models()["letter"], depth / 10, CAMERA)
    doubt = "it would be wider than the image: depth in another unit (--depth-scale)?"
    assert found.reason is not None
    assert found.reason.endswith(doubt)
    lost = DepthTracker(models()["letter"], CAMERA).update(0.0, depth / 10)
    assert (lost.state, lost.reason) == ("lost", f"not found: {found.reason}")
    reason = locate(hs.ObjectModel.sphere(0.1), depth, CAMERA).reason
    assert reason is not None
    assert doubt not in reason


def test_who_asks_for_an_object_twice_has_no_more_of_it():
    """The probability that none of them is there does not fall with the number of objects that could be meant."""
    _, depth = picture("tin")
    once = recognise({"a": models()["brick"]}, depth, CAMERA)
    twice = recognise({name: models()["brick"] for name in "abc"}, depth, CAMERA)
    assert twice.none == pytest.approx(once.none)
    assert sum(twice.scores.values()) == pytest.approx(once.scores["a"])
    assert twice.scores["b"] == pytest.approx(twice.scores["c"])


def around(T, by=60):
    """A box about the object's origin [pixels]."""
    u, v = CAMERA.project(T[None, :3, 3])[0]
    return u - by, v - by, u + by, v + by


def test_a_box_is_the_mask_of_its_pixels_and_what_is_outside_the_image_is_cut_off():
    mask = search_mask(CAMERA, (-7.3, 10.2, 4.1, 12.0), None)
    rows, columns = np.nonzero(mask)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (0, 5, 10, 12)
    assert mask.sum() == 6 * 3
    half = np.zeros(mask.shape, np.uint8)
    half[:, :3] = 255
    assert search_mask(CAMERA, (-7.3, 10.2, 4.1, 12.0), half).sum() == 3 * 3
    assert search_mask(CAMERA, None, None) is None
    T, depth = picture("letter")
    boxed = locate(models()["letter"], depth, CAMERA, box=around(T))
    masked = locate(models()["letter"], depth, CAMERA, mask=search_mask(CAMERA, around(T), None))
    np.testing.assert_array_equal(boxed.Ts_camera_object, masked.Ts_camera_object)
    assert mssd(models()["letter"], T, boxed.Ts_camera_object)[0] < 0.1


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"box": (320, 0, 400, 50)}, "box"),
        ({"box": (-9, -9, -1, -1)}, "box"),
        ({"box": (200, 100, 50, 60)}, "box"),
        ({"box": (0, 0, np.nan, 50)}, "box"),
        ({"box": (0, 0, 50)}, "box"),
        ({"score": 0}, "score"),
        ({"score": 97.0}, "score"),
        ({"start": np.eye(3)}, "start"),
        ({"start": np.zeros((0, 4, 4))}, "start"),
        ({"start": 2 * np.eye(4)}, "start"),
        ({"start": [np.eye(4), np.full((4, 4), np.nan)]}, "start"),
    ],
)
def test_what_no_detector_says_is_said(arguments, field):
    with refused(InvalidInput, field):
        locate(models()["letter"], BLANK, CAMERA, **arguments)


@pytest.mark.parametrize("name", ["letter", "brick"])
def test_the_right_one_of_poses_from_elsewhere_is_the_answer(name):
    """One that is nearly right, in single precision; one 15 cm beside it, one upside down."""
    T, depth = picture(name)
    model = models()[name]
    near = se3.moved(T, np.array([3e-3, -2e-3, 4e-3, 0.05, -0.04, 0.06]))
    beside = se3.moved(T, np.array([0.15, 0, 0, 0, 0, 0]))
    over = T @ se3.compose(se3.rotation_exp(np.array([1.1, 0.7, 0])), np.zeros(3))
    for starts in (near, np.array([beside, over, near.astype(np.float32)])):
        found = locate(model, depth, CAMERA, start=starts)
        assert mssd(model, T, found.Ts_camera_object)[0] < 0.1


@pytest.mark.parametrize("case", ["no depth", "a wall"])
def test_where_nothing_is_a_given_pose_is_wrong(case):
    found = locate(models()["letter"], EMPTY[case][0], CAMERA, start=np.eye(4))
    assert not len(found.weights)


def test_a_start_where_another_object_is_is_wrong():
    T, depth = picture("tin")
    found = locate(models()["letter"], depth, CAMERA, start=T)
    assert not len(found.weights)
    assert found.probability < MIN_PROBABILITY


def test_a_covariance_of_a_start_holds_what_the_image_does_not_show():
    """The spin of a tin whose symmetry is not declared."""
    tin = models()["tin"].with_symmetries(hs.ObjectModel.box((1, 1, 1)).symmetries.__class__())
    T, depth = picture("tin")
    turned = T @ se3.compose(se3.rotation_exp(np.array([0, 0, 0.5])), np.zeros(3))
    start = GaussianPose(turned, np.diag([1e-5] * 3 + [1e-4] * 3))
    held = locate(tin, depth, CAMERA, start=start).Ts_camera_object
    spins = se3.rotation_log(turned[:3, :3].T @ held[:, :3, :3])
    assert np.abs(spins).max(axis=1).min() < 0.05
