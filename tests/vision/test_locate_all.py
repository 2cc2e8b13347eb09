"""`locate_all` explains a depth image by several objects: each that is there is found once, whatever else is
asked."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.vision import locate, locate_all
from handsight.vision.object.locate import MIN_PROBABILITY
from testbed.refusals import refused
from testbed.sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy


@functools.cache
def models():
    vertices, faces = letter()
    return {
        "letter": hs.ObjectModel.from_mesh(vertices - vertices.mean(axis=0), faces),
        "tin": hs.ObjectModel.cylinder(0.035, 0.05),
        "brick": hs.ObjectModel.box((0.1, 0.06, 0.04)),
        "slab": hs.ObjectModel.box((0.16, 0.12, 0.03)),
    }


TOUCHING = (
    ("brick", (0.0, 0.0), 0.0),
    ("brick", (0.0, 0.11), 0.1),
    ("letter", (0.085, 0.02), 1.6),
    ("tin", (-0.087, 0.01), 0.0),
)
"""Objects on a table, some of which touch each other: place [m] and turn [rad] of each."""
TWO = {"brick": 2}


@functools.cache
def scene(placed, seed=0):
    """Depth of objects on a table, and (name, T_camera_object) of each."""
    rng, truths = np.random.default_rng([seed, 5]), []
    T_camera_table = looking(rng, 0.5)
    shapes, Ts = [], []
    for name, place, turn in placed:
        model = models()[name]
        lift = np.array([*place, -model.bounds_object[0, 2]])
        T = se3.compose(se3.rotation_exp(np.array([0, 0, turn])), lift)
        shapes.append((model.vertices, model.faces))
        Ts.append(T)
        truths.append((name, T_camera_table @ T))
    depth, labels = drawn(T_camera_table, shapes, np.array(Ts).reshape(-1, 4, 4))
    return noisy(depth, rng), truths, labels


def right(instance, T_true):
    return mssd(models()[instance.name], T_true, instance.detection.Ts_camera_object[:1])[0] < 0.1


def answered(found):
    """Names and poses, in an order that depends on them alone."""
    each = [(i.name, i.detection.Ts_camera_object[0]) for i in found.instances]
    return sorted(each, key=lambda one: (one[0], *one[1][:3, 3]))


def test_each_of_several_that_touch_is_found_once():
    depth, truths, labels = scene(TOUCHING)
    found = locate_all(models(), depth, CAMERA, counts=TWO)
    assert sorted(i.name for i in found.instances) == sorted(name for name, _ in truths)
    for k, (name, T) in enumerate(truths):
        (one,) = [i for i in found.instances if i.name == name and right(i, T)]
        assert MIN_PROBABILITY <= one.detection.probability <= 1
        assert (labels[one.pixels] == k).mean() > 0.9
        assert (np.linalg.eigvalsh(one.detection.covariances) > 0).all()
    assert np.sum([i.pixels for i in found.instances], axis=0).max() == 1
    assert list(found.missing) == ["slab"]
    assert found.instances == tuple(sorted(found.instances, key=lambda i: -i.detection.probability))


def test_each_is_there_once_unless_more_are_asked_for():
    depth, _, _ = scene(TOUCHING)
    found = locate_all(models(), depth, CAMERA)
    assert sorted(i.name for i in found.instances) == ["brick", "letter", "tin"]


def test_the_order_of_the_objects_changes_nothing():
    depth, _, _ = scene(TOUCHING)
    first, names = locate_all(models(), depth, CAMERA, counts=TWO), list(models())[::-1]
    second = locate_all({name: models()[name] for name in names}, depth, CAMERA, counts=TWO)
    for (a, T), (b, other) in zip(answered(first), answered(second), strict=True):
        assert a == b
        np.testing.assert_array_equal(T, other)


def test_an_absent_object_changes_nothing():
    depth, _, _ = scene(TOUCHING)
    some = {name: model for name, model in models().items() if name != "slab"}
    for (a, T), (b, other) in zip(
        answered(locate_all(models(), depth, CAMERA, counts=TWO)),
        answered(locate_all(some, depth, CAMERA, counts=TWO)),
        strict=True,
    ):
        assert a == b
        np.testing.assert_allclose(T, other, atol=5e-3)


def test_equal_objects_at_exchanged_places_are_the_same_answer():
    first, second = TOUCHING[:2]
    (depth, _, _), (other, _, _) = scene((first, second)), scene((second, first))
    np.testing.assert_array_equal(depth, other)
    found = locate_all({"brick": models()["brick"]}, depth, CAMERA, counts=TWO)
    assert len(found.instances) == 2
    apart = np.subtract(*(i.detection.Ts_camera_object[0, :3, 3] for i in found.instances))
    assert np.linalg.norm(apart) == pytest.approx(0.11, abs=5e-3)


def test_what_is_found_elsewhere_takes_part():
    """In a detector's mask; an object without detections is not searched."""
    depth, truths, labels = scene(TOUCHING)
    inside = labels == 2
    letter_there = locate(models()["letter"], depth, CAMERA, mask=inside)
    found = locate_all(models(), depth, CAMERA, counts=TWO, found={"letter": [letter_there], "tin": []})
    assert sorted(i.name for i in found.instances) == ["brick", "brick", "letter"]
    assert set(found.missing) == {"tin", "slab"}
    (one,) = [i for i in found.instances if i.name == "letter"]
    assert right(one, truths[2][1])


def test_where_nothing_is_nothing_is_found():
    depth, _, _ = scene(())
    for image in (depth, np.zeros_like(depth), np.full_like(depth, np.nan)):
        found = locate_all(models(), image, CAMERA)
        assert found.instances == ()
        assert set(found.missing) == set(models())
        assert all(found.missing.values())


WRONG = {
    "no models": (lambda d: {"models": {}}, "models"),
    "a count of another": (lambda d: {"counts": {"mug": 1}}, "counts"),
    "a count below none": (lambda d: {"counts": {"tin": -1}}, "counts['tin']"),
    "half an object": (lambda d: {"counts": {"tin": 1.5}}, "counts['tin']"),
    "millimetres": (lambda d: {"depth": 1000 * d}, "depth"),
    "a mask of another size": (lambda d: {"mask": d[1:] > 0}, "mask"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_named(case):
    change, field = WRONG[case]
    depth, _, _ = scene(TOUCHING)
    with refused(InvalidInput, field):
        locate_all(**{"models": models(), "depth": depth, "camera": CAMERA} | change(depth))
