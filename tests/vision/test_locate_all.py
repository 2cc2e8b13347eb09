"""`locate_all` explains a depth image by several objects: each that is there is found once, whatever else is asked."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.vision import locate, locate_all
from handsight.vision.object.locate import LOCATE
from sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy


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
    ("brick", (0.0, 0.061), 0.1),
    ("letter", (0.085, 0.02), 1.6),
    ("tin", (-0.087, 0.01), 0.0),
)
"""Objects on a table that touch each other: place [m] and turn [rad] of each."""


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
    found = locate_all(models(), depth, CAMERA)
    assert sorted(i.name for i in found.instances) == sorted(name for name, _ in truths)
    for k, (name, T) in enumerate(truths):
        (one,) = [i for i in found.instances if i.name == name and right(i, T)]
        assert LOCATE.min_probability <= one.probability <= 1
        assert (labels[one.pixels] == k).mean() > 0.9
        assert (np.linalg.eigvalsh(one.detection.covariances) > 0).all()
    assert list(found.missing) == ["slab"]
    assert found.instances == tuple(sorted(found.instances, key=lambda i: -i.probability))


def test_each_pixel_is_explained_once():
    depth, _, _ = scene(TOUCHING)
    found = locate_all(models(), depth, CAMERA)
    assert np.sum([i.pixels for i in found.instances], axis=0).max() == 1


def test_the_order_of_the_objects_changes_nothing():
    depth, _, _ = scene(TOUCHING)
    first, names = locate_all(models(), depth, CAMERA), list(models())[::-1]
    second = locate_all({name: models()[name] for name in names}, depth, CAMERA)
    for (a, T), (b, other) in zip(answered(first), answered(second), strict=True):
        assert a == b
        np.testing.assert_array_equal(T, other)


def test_an_absent_object_changes_nothing():
    depth, _, _ = scene(TOUCHING)
    some = {name: model for name, model in models().items() if name != "slab"}
    for (a, T), (b, other) in zip(
        answered(locate_all(models(), depth, CAMERA)), answered(locate_all(some, depth, CAMERA)), strict=True
    ):
        assert a == b
        np.testing.assert_allclose(T, other, atol=5e-3)


def test_equal_objects_at_exchanged_places_are_the_same_answer():
    first, second = TOUCHING[:2]
    (depth, _, _), (other, _, _) = scene((first, second)), scene((second, first))
    np.testing.assert_array_equal(depth, other)
    found = locate_all({"brick": models()["brick"]}, depth, CAMERA)
    assert len(found.instances) == 2
    apart = np.subtract(*(i.detection.Ts_camera_object[0, :3, 3] for i in found.instances))
    assert np.linalg.norm(apart) == pytest.approx(0.061, abs=5e-3)


@pytest.mark.parametrize("name", ["letter", "tin", "brick"])
def test_one_object_alone_is_where_locate_has_it(name):
    depth, _, _ = scene(((name, (0.0, 0.0), 0.4),))
    alone, found = locate(models()[name], depth, CAMERA), locate_all({name: models()[name]}, depth, CAMERA)
    (one,) = found.instances
    np.testing.assert_array_equal(one.detection.Ts_camera_object, alone.Ts_camera_object)
    np.testing.assert_array_equal(one.detection.covariances, alone.covariances)
    assert one.probability == alone.probability


def test_no_more_are_found_than_are_counted():
    depth, _, _ = scene(TOUCHING)
    for count in (0, 1, 2, 3):
        found = locate_all(models(), depth, CAMERA, counts={"brick": count})
        assert sum(i.name == "brick" for i in found.instances) == min(count, 2)


def test_what_is_found_elsewhere_takes_part():
    """In a detector's mask; an object without detections is not searched."""
    depth, truths, labels = scene(TOUCHING)
    inside = labels == 2
    letter_there = locate(models()["letter"], depth, CAMERA, mask=inside)
    found = locate_all(models(), depth, CAMERA, found={"letter": [letter_there], "tin": []})
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
    "no models": (lambda d: {"models": {}}, "models: expected at least one, got none"),
    "a count of another": (lambda d: {"counts": {"mug": 1}}, "counts: expected names of models, got 'mug'"),
    "a count below none": (lambda d: {"counts": {"tin": -1}}, r"counts\['tin'\]: expected a whole number from 0 to 10000, got -1"),
    "half an object": (lambda d: {"counts": {"tin": 1.5}}, r"counts\['tin'\]: expected"),
    "millimetres": (lambda d: {"depth": 1000 * d}, "depth: expected metres"),
    "a mask of another size": (lambda d: {"mask": d[1:] > 0}, "mask: expected 320 x 240 pixels, got 320 x 239"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said(case):
    change, message = WRONG[case]
    depth, _, _ = scene(TOUCHING)
    given = {"models": models(), "depth": depth, "camera": CAMERA} | change(depth)
    with pytest.raises(InvalidInput, match=message):
        locate_all(**given)
