"""Thin and open shells: both sides of a wall, the inside through the opening, and turns that only a handle shows."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.objects import propose_symmetries
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import first_pose, spread_of_modes
from handsight.vision.object.region import scene_of
from testbed.sight_scenes import CAMERA, bowl, drawn, looking, mssd, mug, noisy, on_table


@functools.cache
def shell(kind):
    mesh = {"bowl": bowl, "sheet": lambda: bowl(sheet=True), "mug": mug, "cup": lambda: bowl(0.05, 0.0015)}[
        kind
    ]
    model = hs.ObjectModel.from_mesh(*mesh())
    return model.with_symmetries(propose_symmetries(model, 0.02 * model.diameter))


def visible_from(model, way):
    """Places and normals of the samples that are visible from about a direction."""
    samples, directions, visible, _ = appearance_of(model).sides
    bits = np.unpackbits(visible[(directions @ way).argmax()], bitorder="little").astype(bool)
    return samples[:, bits]


@pytest.mark.parametrize("kind", ["bowl", "sheet", "cup"])
def test_the_inside_of_a_bowl_is_visible_through_its_opening_alone(kind):
    """Inside, normals point to the middle of the ball that the bowl is a part of."""
    model = shell(kind)
    middle = np.array([0, 0, 0.05 if kind == "cup" else 0.08])

    def inside(way):
        places, normals = visible_from(model, np.array(way))
        return ((middle - places) * normals).sum(axis=1) > 0

    assert inside([0.0, 0, 1]).mean() > 0.95
    assert inside([0.0, 0, -1]).mean() < 0.02
    assert inside([1.0, 0, -0.2]).mean() < 0.02  # through the wall
    # From a little above, of the inside only the far wall.
    places, _ = visible_from(model, np.array([0.9, 0, 0.43]))
    within = inside([0.9, 0, 0.43])
    assert 0.1 < within.mean() < 0.7
    assert places[within, 0].mean() < -0.2 * model.radius


def tabletop(kind, seed):
    """A shell on a table, upright, beside a block, and its pixels."""
    rng = np.random.default_rng([seed, 11])
    block = hs.ObjectModel.box((0.05, 0.05, 0.1))
    shapes = [
        (shell(kind).vertices, shell(kind).faces),
        (block.vertices + np.array([0, 0, 0.05]), block.faces),
    ]
    Ts, T_camera_table = on_table(rng, shapes, gap=0.13), looking(rng, rng.uniform(0.4, 0.6))
    depth, labels = drawn(T_camera_table, shapes, Ts)
    return T_camera_table @ Ts[0], noisy(depth, rng), labels == 0


@pytest.mark.parametrize(("kind", "least"), [("bowl", 7), ("sheet", 7), ("cup", 6)])
def test_a_bowl_on_a_table_is_found(kind, least):
    """Of eight noisy pictures, each within a tenth of the diameter, and its probability is not that of nothing."""
    model, right = shell(kind), 0
    for seed in range(8):
        T, depth, _ = tabletop(kind, seed)
        found = first_pose(model, scene_of(CAMERA, depth, extent=1.5 * model.diameter))
        right += mssd(model, T, found.Ts_camera_object[:1])[0] < 0.1 and found.probability > 0.02
    assert right >= least


def test_one_of_a_mug_s_modes_has_its_handle_where_it_is():
    model, right = shell("mug"), 0
    for seed in range(8):
        T, depth, wanted = tabletop("mug", seed)
        found = first_pose(model, scene_of(CAMERA, depth, wanted=wanted, extent=1.5 * model.diameter))
        right += mssd(model, T, found.Ts_camera_object).min() < 0.1
    assert right >= 7


def towards(model, T_camera_object):
    """The direction of the handle, +x, along that to the camera, both on the table."""
    way = -se3.inverse(T_camera_object)[:3, :3] @ T_camera_object[:3, 3]
    return way[0] / np.hypot(*way[:2])


def test_a_handle_that_is_visible_decides_and_one_that_is_hidden_does_not():
    """Of sixteen pictures: the first mode where the handle is on the camera's side; where it is behind, no mode is sure."""
    model, right, sure = shell("mug"), [], []
    for seed in range(20, 36):
        T, depth, wanted = tabletop("mug", seed)
        found = first_pose(model, scene_of(CAMERA, depth, wanted=wanted, extent=1.5 * model.diameter))
        if towards(model, T) > 0:
            right.append(mssd(model, T, found.Ts_camera_object[:1])[0] < 0.1)
        elif towards(model, T) < -0.6:
            sure.append(found.weights[0])
    assert len(right) > 3
    assert np.mean(right) > 0.75
    assert len(sure) > 1
    assert max(sure) < 0.7, sure


def test_a_mode_is_as_wide_as_the_spins_that_fit_as_well_and_turns_of_a_box_are_modes_by_themselves():
    """Small steps lead from each spin of a mug to the others; a far one, or one at another place, is not meant."""

    def spread(model, angles, places=(0, 0, 0, 0)):
        turns = np.deg2rad(angles)[:, None] * np.array([0, 0, 1.0])
        T = se3.compose(np.eye(3), np.array([0, 0, 0.5]))
        Ts = T @ se3.compose(se3.rotation_exp(turns), np.zeros((len(turns), 3)))
        return spread_of_modes(model, Ts, np.full(len(Ts), 1 / len(Ts)), np.array(places))

    near, far = np.deg2rad([20.0, 40.0])
    found = spread(shell("mug"), [0, 20, 40, 180])
    assert found[:, 5, 5] == pytest.approx(
        [(near**2 + far**2) / 3, 2 * near**2 / 3, (near**2 + far**2) / 3, 0]
    )
    assert spread(shell("mug"), [0, 20, 40, 180], (0, 1, 1, 1))[0] == pytest.approx(0)
    box = hs.ObjectModel.box((0.05, 0.053, 0.08))
    assert spread(box, [0, 90, 180, 270]) == pytest.approx(0, abs=1e-9)
