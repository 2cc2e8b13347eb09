"""`locate` says where an object is, or that it is not there and why; what is no such input is said too."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.vision import locate, recognise
from handsight.vision.object.first_pose import probabilities
from handsight.vision.object.locate import LOCATE
from sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy, on_table


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
    found = locate(models()[name], CAMERA, depth)
    assert found.reason is None
    assert mssd(models()[name], T, found.Ts_camera_object)[0] < 0.1
    assert LOCATE.min_probability <= found.probability <= 1
    answer = recognise(models(), CAMERA, depth)
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
    assert nowhere(locate(models()["letter"], CAMERA, depth), reason)
    answer = recognise(models(), CAMERA, depth)
    assert answer.name is None
    assert answer.none == 1
    assert reason in answer.reason


def test_on_an_empty_table_it_is_nowhere():
    _, depth = picture(None)
    found = locate(models()["letter"], CAMERA, depth)
    assert len(found.weights) == 0
    assert found.reason


@pytest.mark.parametrize(("there", "wanted"), [("tin", "letter"), ("tin", "brick"), ("letter", "tin")])
def test_another_object_is_not_it(there, wanted):
    """Rather none than another of the same height, and nowhere if it is of another one."""
    _, depth = picture(there)
    found = locate(models()[wanted], CAMERA, depth)
    assert found.probability < 0.5
    if "letter" in (there, wanted):
        assert nowhere(found, "is right with a probability of 0.0")
    others = {name: model for name, model in models().items() if name != there}
    answer = recognise(others, CAMERA, depth)
    assert answer.name is None
    assert "nothing there looks like one of them" in answer.reason


def test_one_pixel_and_things_of_other_sizes_have_an_answer():
    _, depth = picture("letter")
    pixel = np.zeros(depth.shape, bool)
    pixel[120, 160] = True
    assert nowhere(locate(models()["letter"], CAMERA, depth, wanted=pixel), "nothing is seen there")
    huge, tiny = hs.ObjectModel.box((1.5, 1.2, 0.9)), hs.ObjectModel.box((0.006, 0.005, 0.004))
    for model in (huge, tiny):
        found = locate(
            model, CAMERA, depth
        )  # the table may be a side of the huge one: more of it is not in the picture
        assert (found.reason is None) == (len(found.weights) > 0)
        assert np.isfinite(found.Ts_camera_object).all()
        assert (np.linalg.eigvalsh(found.covariances) > 0).all()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            "depth",
            lambda d: 1000 * d,
            r"depth: expected metres, got a median of \d+(\.\d+)? \(millimetres\?\)",
        ),
        ("depth", lambda d: d[:100], "depth: expected 320 x 240 pixels, got 320 x 100"),
        ("depth", lambda d: d[None], "depth: expected 320 x 240 pixels, got 320 x 240 x 1"),
        ("wanted", lambda d: d[:, 1:] > 0, "wanted: expected 320 x 240 pixels, got 319 x 240"),
        ("hand", lambda d: d[1:] > 0, "hand: expected 320 x 240 pixels, got 320 x 239"),
    ],
)
def test_what_is_no_such_image_is_said(name, change, message):
    _, depth = picture("letter")
    arguments = {"depth": depth} | {name: change(depth)}
    with pytest.raises(InvalidInput, match=message):
        locate(models()["letter"], CAMERA, arguments.pop("depth"), **arguments)


def test_recognition_wants_models():
    with pytest.raises(InvalidInput, match="models: expected at least one, got none"):
        recognise({}, CAMERA, BLANK)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-500, 500), max_size=8))
def test_probabilities_leave_room_for_none(odds):
    p = probabilities(np.array(odds))
    assert (p >= 0).all()
    assert p.sum() <= 1 + 1e-12
    none = 1 - p.sum()
    for one, share in zip(odds, p, strict=True):
        if abs(one) < 20 and none > 1e-6:
            assert np.log(share / none) == pytest.approx(one, abs=1e-6)
