"""The scale of a mesh that has none, by a depth image and by touches; where they do not tell it, it is not guessed."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.vision.scale import ScaleUnknown, scale_by_depth, scale_by_touch
from testbed.sight_scenes import WIDE, drawn, letter, looking, mug, noisy

SHAPES = {"letter": letter, "mug": mug}


@functools.cache
def shape(name):
    """A model as large as objects are, by how much it is smaller than the true one, and the true vertices and faces."""
    vertices, faces = SHAPES[name]()
    by = hs.ObjectModel.from_mesh(vertices, faces).diameter / 0.1
    return hs.ObjectModel.from_mesh(vertices / by, faces), by, (vertices, faces)


def picture(name, seed, size=1.0):
    """Depth with noise and mask of the shape on a table, `size` times as large."""
    vertices, faces = shape(name)[2]
    rng = np.random.default_rng([seed, 11])
    standing = size * (vertices - [0, 0, vertices[:, 2].min()])
    image = drawn(looking(rng, 0.5 + 0.4 * (size - 1)), [(standing, faces)], [np.eye(4)], WIDE)
    return noisy(image.depth, rng), image.labels == 0


@pytest.mark.parametrize(("name", "size"), [("letter", 0.6), ("mug", 2.0)])
def test_a_depth_image_tells_the_scale_within_three_sigmas(name, size):
    model, by, _ = shape(name)
    depth, mask = picture(name, 1, size)
    found = scale_by_depth(model, depth, WIDE, mask)
    assert abs(found.factor - size * by) < 3 * found.sigma
    assert found.sigma < 0.05 * found.factor


def test_a_face_alone_leaves_the_scale_open():
    """Of a box's side the middle only, without an outline."""
    depth = np.full(WIDE.size[::-1], 0.5)
    mask = np.zeros(depth.shape, dtype=bool)
    mask[200:280, 280:360] = True
    with pytest.raises(ScaleUnknown):
        scale_by_depth(hs.ObjectModel.box((0.05, 0.06, 0.07)), depth, WIDE, mask)


def touches(name, count, seed):
    """Contacts at places of the true shape, anywhere in the palm's frame, with errors of 1 mm and .1 rad."""
    model, by, _ = shape(name)
    rng = np.random.default_rng(seed)
    points, normals = model.sample(400, seed)
    outer = (model.evaluate(points).gradient * normals).sum(axis=1) > 0.9
    chosen = rng.permutation(np.flatnonzero(outer))[:count]
    points, normals = points[chosen], normals[chosen]
    T = se3.compose(se3.random(rng)[:3, :3], np.array([0.1, -0.05, 0.4]))
    there = se3.apply(T, by * points) + 1e-3 * rng.normal(size=points.shape)
    return hs.Contacts(there, normals @ T[:3, :3].T + 0.1 * rng.normal(size=points.shape)), T


@pytest.mark.parametrize(("seed", "rough"), [(3, True), (1, False)])
def test_touches_with_or_without_a_rough_pose_tell_the_scale_within_three_sigmas(seed, rough):
    model, by, _ = shape("letter")
    contacts, T = touches("letter", 12, seed)
    prior = hs.PosePrior.from_sigmas(se3.moved(T, np.array([0.01, -0.01, 0, 0.1, 0, -0.1])), 0.02, 0.2)
    found = scale_by_touch(model, contacts, vision=prior if rough else None)
    assert abs(found.factor - by) < 3 * found.sigma


def test_touches_of_one_plane_leave_the_scale_open():
    points = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0], [0.02, 0.03, 0]])
    contacts = hs.Contacts(points, np.tile([0, 0, 1.0], (4, 1)))
    with pytest.raises(ScaleUnknown):
        scale_by_touch(hs.ObjectModel.box((0.05, 0.06, 0.07)), contacts)
    with pytest.raises(ScaleUnknown):
        scale_by_touch(hs.ObjectModel.box((0.05, 0.06, 0.07)), contacts.select([0, 1]))
