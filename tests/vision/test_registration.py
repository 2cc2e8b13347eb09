"""A depth pixel's colour is that of what it sees; what hides a surface from the colour camera does not lend it its own."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.vision import register_color
from sight_scenes import CAMERA, drawn, letter, looking, on_table

COLOR_CAMERA = Camera(np.array([[560.0, 0, 322.0], [0, 565, 236.0], [0, 0, 1]]), (640, 480))
LENS = np.array([-0.12, 0.03, 1e-3, -5e-4])


def beside(rng, shift):
    """T_color_depth of a camera so far beside the other [m], turned back towards what is .6 m away."""
    side = shift * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
    turn = np.array([-side[1], side[0], 0.0]) / 0.6 + rng.normal(scale=0.02, size=3)
    return se3.compose(se3.rotation_exp(turn), -side + rng.normal(scale=0.005, size=3))


@pytest.mark.parametrize(("shift", "share"), [(0.03, 0.995), (0.15, 0.98), (0.3, 0.97)])
def test_what_both_cameras_see_has_its_colour_and_what_is_hidden_has_none(shift, share):
    """`share` of what both see is found: the farther apart, the more is behind what an edge may go on to."""
    box = hs.ObjectModel.box((0.05, 0.06, 0.04))
    shapes = [letter(), (box.vertices + np.array([0, 0, 0.02]), box.faces)]
    hidden = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 11])
        T_camera_table, Ts = looking(rng, rng.uniform(0.45, 0.7)), on_table(rng, shapes)
        T_color_depth = beside(rng, shift)
        depth, labels = drawn(T_camera_table, shapes, Ts)
        there, there_labels = drawn(T_color_depth @ T_camera_table, shapes, Ts, COLOR_CAMERA)
        picture = np.repeat((there_labels + 3).astype(np.uint8)[..., None], 3, axis=-1)
        color, seen = register_color(depth, CAMERA, picture, COLOR_CAMERA, T_color_depth)
        # The truth: whether the colour camera's own drawing has something nearer where the point falls.
        known = np.isfinite(depth)
        placed = se3.apply(T_color_depth, CAMERA.points(depth)[known].astype(float))
        u, v = np.rint(COLOR_CAMERA.project(placed)).T
        inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480)
        nearest = there[v[inside].astype(int), u[inside].astype(int)]
        is_seen, is_hidden = np.zeros((2, len(placed)), dtype=bool)
        is_seen[inside] = placed[inside, 2] < nearest + 0.003
        is_hidden[inside] = placed[inside, 2] > nearest + 0.015
        assert not seen[~known].any()
        assert not seen[known][~inside].any()
        assert seen[known][is_seen].mean() > share
        # What the colour camera alone sees (sides of things) may hide more.
        assert seen[known][is_hidden].sum() < 0.15 * is_hidden.sum() + 100
        assert (color[seen][:, 0] == labels[seen] + 3).mean() > 0.99
        assert (color[~seen] == 0).all()
        hidden += is_hidden.sum()
    assert hidden > 200 * shift / 0.03


@pytest.mark.parametrize("lens", [np.zeros(0), LENS])
def test_colour_is_that_of_the_place_through_any_lens(lens):
    """A wall whose colour tells where it is, seen through lenses by both."""
    camera = Camera(CAMERA.matrix, CAMERA.size, lens)
    color_camera = Camera(COLOR_CAMERA.matrix, COLOR_CAMERA.size, -lens)
    T_color_depth = se3.compose(
        se3.rotation_exp(np.array([0.01, -0.04, 0.02])), np.array([-0.05, 0.01, 0.004])
    )
    normal, origin = (
        T_color_depth[:3, 2],
        se3.apply(T_color_depth, [[0, 0, 0.8]])[0],
    )  # of the wall, in the colour camera
    rays = np.concatenate([color_camera.rays, np.ones((480, 640, 1))], axis=-1).astype(float)
    on_wall = rays * (normal @ origin / (rays @ normal))[..., None]
    places = se3.apply(se3.inverse(T_color_depth), on_wall.reshape(-1, 3)).reshape(480, 640, 3)
    picture = np.round(127.5 + 200 * places).clip(0, 255).astype(np.uint8)  # 5 mm a step
    depth = np.full((240, 320), 0.8, dtype=np.float32)
    color, seen = register_color(depth, camera, picture, color_camera, T_color_depth)
    assert 0.6 < seen.mean() < 1
    expected = 127.5 + 200 * camera.points(depth)[seen]
    np.testing.assert_allclose(color[seen][:, :2], expected[:, :2], atol=0.9)


def test_a_camera_registered_with_itself_gives_its_own_image():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 0.52, (240, 320)).astype(np.float32)
    depth[::5, ::3] = np.nan
    picture = rng.integers(0, 255, (240, 320, 3), dtype=np.uint8)
    color, seen = register_color(depth, CAMERA, picture, CAMERA, np.eye(4))
    inner = np.isfinite(depth)
    inner[[0, -1]] = inner[:, [0, -1]] = False  # its border may round to beyond it
    assert seen[inner].all()
    np.testing.assert_array_equal(color[seen], picture[seen])
    assert not seen[np.isnan(depth)].any()


def test_nothing_is_visible_without_depth_or_from_behind():
    picture = np.full((480, 640, 3), 9, np.uint8)
    nowhere = np.full((240, 320), np.nan, np.float32)
    assert not register_color(nowhere, CAMERA, picture, COLOR_CAMERA, np.eye(4)).visible.any()
    back = se3.compose(se3.rotation_exp(np.array([0, np.pi, 0])), np.zeros(3))
    wall = np.full((240, 320), 0.8, np.float32)
    assert not register_color(wall, CAMERA, picture, COLOR_CAMERA, back).visible.any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"color": np.zeros((240, 320, 3), np.uint8)}, r"color: expected bytes of shape \(480, 640, 3\) as its camera's, got uint8 of \(240, 320, 3\)"),
        ({"color": np.zeros((480, 640), np.uint8)}, r"color: expected bytes .*, got uint8 of \(480, 640\)"),
        ({"color": np.zeros((480, 640, 3))}, "color: expected bytes .*, got float64"),
        ({"depth": np.zeros((480, 640), np.float32)}, r"depth: expected 320 x 240 pixels, got 640 x 480"),
        ({"T_color_depth": np.ones((4, 4))}, "T_color_depth: "),
    ],
)  # fmt: skip
def test_images_of_another_size_than_their_cameras_are_said(changes, message):
    given = {
        "depth": np.ones((240, 320), np.float32),
        "color": np.zeros((480, 640, 3), np.uint8),
        "T_color_depth": np.eye(4),
    }
    given |= changes
    with pytest.raises(InvalidInput, match=f"^{message}"):
        register_color(given["depth"], CAMERA, given["color"], COLOR_CAMERA, given["T_color_depth"])
