"""Objects out of depth images: what is fused, where views are found to be, and what goes to the model."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import handsight as hs
from handsight import se3
from handsight.vision import STRUCTURED_LIGHT, locate
from handsight.vision.reconstruction.parts import above_table, parts_of, share_observed
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import on_table
from handsight.vision.reconstruction.volume import Volume
from testbed.scenes import can
from testbed.sight_scenes import (
    CAMERA,
    drawn,
    letter,
    mssd,
    path_around,
    pictures_around,
    standing,
    wrong_poses,
)

BOUNDS = np.array([[-0.1, -0.1, -0.02], [0.1, 0.1, 0.15]])
LETTER = hs.ObjectModel.from_mesh(*letter())
THINGS = {"can": can(), "letter": LETTER, "box": hs.ObjectModel.box((0.05, 0.08, 0.1))}


def grown(Ts, images, *, estimate):
    rec = Reconstruction(CAMERA, BOUNDS)
    found = [rec.grow(View(depth, T), estimate=estimate) for T, depth in zip(Ts, images, strict=True)]
    return rec, found


@functools.cache
def views(name, n=24, turns=1.0):
    rng = np.random.default_rng([n, len(name)])
    Ts, shape = path_around(n, rng, turns=turns), standing(THINGS[name])
    return Ts, pictures_around(Ts, shape, rng)


def off(name, points, rng=None):
    """How far points of the table lie off the thing [m], laid on it as well as they can be."""
    from scipy.optimize import least_squares

    model = THINGS[name]
    low, high = model.bounds_object
    shift = np.append((low + high)[:2] / 2, low[2])

    def distance(x):
        T = se3.compose(se3.rotation_exp(x[3:]), x[:3])
        return model.evaluate(se3.apply(T, points) + shift).distance

    best = least_squares(
        lambda x: distance(x)[::7], np.zeros(6), loss="soft_l1", f_scale=1e-3, x_scale=[1e-3] * 3 + [1e-2] * 3
    )
    return distance(best.x)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_plane_from_images_without_noise_is_exact(seed):
    """To a hundredth of a cell: along each ray the distance is exact, and it changes linearly."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    volume = Volume(np.array([[-0.04] * 3, [0.04] * 3]), 0.004)
    for T in path_around(3, rng, turns=0.2) @ se3.compose(np.eye(3), np.array([0, 0, 0.05])):
        placed = se3.apply(T, corners)
        volume.fuse(CAMERA, CAMERA.draw(placed, np.array([[0, 1, 2], [0, 2, 3]])).depth, T)
    points, normals = volume.surface()
    inside = (np.abs(points[:, :2]) < 0.03).all(axis=1)
    assert inside.sum() > 100
    assert np.abs(points[inside, 2]).max() < 6e-4  # a pixel stands for all that falls on it
    assert np.abs(np.median(points[inside, 2])) < 1e-4
    assert (normals[inside, 2] > 0.98).all()


def test_without_views_there_is_no_surface():
    volume = Volume(BOUNDS, 0.004)
    volume.fuse(CAMERA, np.zeros((240, 320), np.float32), path_around(1, np.random.default_rng(0))[0])
    assert len(volume.surface().points) == 0
    assert not volume.observed().any()


def test_free_space_is_clear_and_hidden_space_is_unknown():
    T, (depth, *_) = views("can")[0][0], views("can")[1]
    volume = Volume(BOUNDS, 0.003)
    volume.fuse(CAMERA, depth, T)
    eye = se3.inverse(T)[:3, 3]
    middle = np.array([0, 0, 0.05])
    before, behind = (
        middle + way * 0.08 * (eye - middle) / np.linalg.norm(eye - middle) for way in (1, -0.3)
    )
    assert volume.among(volume.clear(), before[None]).all()
    assert not volume.among(volume.observed(), behind[None]).any()


@pytest.mark.parametrize("name", THINGS)
@pytest.mark.parametrize("estimate", [False, True])
def test_a_thing_is_found_as_it_is(name, estimate):
    """But for the camera's constant error; also where each pose is 4 mm, 2 degrees off."""
    Ts, images = views(name)
    rec, found = grown(
        wrong_poses(Ts, np.random.default_rng(3)) if estimate else Ts, images, estimate=estimate
    )
    assert None not in found
    surface = next(parts_of(rec.volume.surface(), rec.volume)) if estimate else above_table(rec.volume)
    points = surface.points[surface.points[:, 2] > 0.01]
    error, constant = off(name, points), 2 * float(STRUCTURED_LIGHT.bias(np.array(0.5)))
    assert abs(np.median(error)) < constant
    assert np.abs(error).mean() < constant
    assert np.abs(error - np.median(error)).mean() < 1e-3


@pytest.mark.slow
def test_the_poses_of_views_are_found_without_the_cameras_motion():
    Ts, images = views("letter", 72)
    rec, found = grown(np.repeat(Ts[:1], len(Ts), axis=0), images, estimate=True)
    assert None not in found
    turned = np.zeros(3)
    for T, view in zip(Ts, found, strict=True):
        before, turned = turned, se3.difference(se3.inverse(view.T_camera_object), se3.inverse(T))[3:]
        # A spin adds up from view to view; from one to the next it is small.
        assert np.linalg.norm(turned - before) < np.deg2rad(3)
    points = rec.volume.surface().points
    assert np.abs(off("letter", points[points[:, 2] > 0.01])).mean() < 2e-3


def test_a_view_of_something_else_does_not_fit():
    Ts, images = views("can")
    rec, _ = grown(Ts[:6], images[:6], estimate=True)
    before = rec.volume.voxels.copy()
    other = drawn(Ts[6], [(letter()[0] + [0.05, 0.04, 0.06], letter()[1])], [np.eye(4)]).depth
    alone = np.where(np.isfinite(other), other, 0).astype(np.float32)
    alone[np.isfinite(drawn(Ts[6], [], []).depth) & (alone == drawn(Ts[6], [], []).depth)] = 0
    assert rec.grow(View(alone, Ts[6])) is None
    assert rec.grow(View(np.full((240, 320), np.nan, np.float32), Ts[6])) is None
    np.testing.assert_array_equal(rec.volume.voxels, before)


@pytest.mark.parametrize("name", ["can", "box"])
@pytest.mark.parametrize("turns", [0.05, 0.4, 1.0])
def test_the_share_that_was_observed_is_of_the_closed_surface(name, turns):
    """It is an upper bound: more may be hidden behind what is seen."""
    Ts, images = views(name, 12, turns)
    rec, _ = grown(Ts, images, estimate=False)
    surface = above_table(rec.volume)
    truth = THINGS[name].sample(4000)[0] - [*THINGS[name].center_object[:2], THINGS[name].bounds_object[0, 2]]
    covered = (cKDTree(surface.points).query(truth)[0] < 0.004).mean()
    assert covered - 0.05 < share_observed(surface, rec.volume) < covered + 0.25
    assert share_observed(surface, rec.volume) < 0.9  # the base is hidden


def test_the_thing_on_the_table_is_found_and_nothing_where_there_is_none():
    Ts, images = views("can")
    T, bounds = on_table(CAMERA, images[0])
    up = Ts[0][:3, 2]
    assert np.rad2deg(np.arccos(T[:3, 2] @ up)) < 2
    points = se3.apply(se3.inverse(T) @ Ts[0], standing(can())[0])
    assert (points > bounds[0] - 2e-3).all()
    assert (points < bounds[1]).all()
    assert on_table(CAMERA, np.zeros((240, 320), np.float32)) is None
    empty = drawn(Ts[0], [], []).depth
    assert on_table(CAMERA, np.where(np.isfinite(empty), empty, 0).astype(np.float32)) is None


def test_a_reconstructed_model_is_located_in_an_image():
    Ts, images = views("letter")
    rec, _ = grown(Ts, images, estimate=False)
    model = hs.ObjectModel.from_points(above_table(rec.volume).points[::3])
    answer = locate(model, images[3], CAMERA)
    assert answer.reason is None
    T_table_letter = se3.compose(np.eye(3), standing(LETTER)[0][0] - np.array(LETTER.vertices)[0])
    assert mssd(LETTER, Ts[3] @ T_table_letter, answer.Ts_camera_object)[0] < 0.1
