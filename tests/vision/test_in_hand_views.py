"""What a hand holds, in depth images of both: the hand goes, and what is clear of it stays."""

import functools

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput
from handsight.hand import Hand

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from hand_scenes import curled
from handsight.simulation import Scenario, rig_of
from handsight.vision.reconstruction.completion import one_object
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, InHandView
from sight_scenes import CAMERA
from views_around import CAN, pictures_of, turned_before

SIGMA_JOINT = float(np.deg2rad(1.0))


@functools.cache
def grip():
    """Joints as believed, the hand's true triangles, the can's in the palm, and its pose there."""
    hand, rng = rig_of(Scenario(object="can")).hand, np.random.default_rng(2)
    believed, shape = curled(hand, rng), hand.shape()
    true = {name: value + SIGMA_JOINT * rng.normal() for name, value in believed.items()}
    vertices = shape.vertices_palm(true)
    middle = InHandView(hand, SIGMA_JOINT).middle(believed)
    away = middle - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    T_palm_object = se3.compose(se3.random(rng)[:3, :3], middle + 0.35 * away)
    return hand, believed, (vertices, shape.faces), T_palm_object


def scene(n):
    """T_camera_palm (n, 4, 4) of views all around, and noisy depth images."""
    _, believed, (vertices, faces), T_palm_object = grip()
    held = se3.apply(T_palm_object, np.array(CAN.vertices))
    both = np.concatenate([vertices, held]), np.concatenate([faces, CAN.faces + len(vertices)])
    Ts = turned_before(n) @ se3.compose(np.eye(3), -T_palm_object[:3, 3])
    return Ts, pictures_of(Ts, both, np.random.default_rng(3))


def test_no_pixel_of_the_hand_is_left_and_what_is_clear_of_it_is():
    hand, believed, (vertices, faces), T_palm_object = grip()
    held = InHandView(hand, SIGMA_JOINT)
    thing = se3.apply(T_palm_object, np.array(CAN.vertices))
    for T in turned_before(3) @ se3.compose(np.eye(3), -T_palm_object[:3, 3]):
        both = np.concatenate([vertices, thing]), np.concatenate([faces, CAN.faces + len(vertices)])
        labels = np.repeat([0, 1], [len(faces), len(CAN.faces)])
        drawn = CAMERA.draw(se3.apply(T, both[0]), both[1], labels)
        depth = np.where(np.isfinite(drawn.depth), drawn.depth, 0).astype(np.float32)
        left = held.without_hand(CAMERA, depth, believed, T)
        assert (drawn.labels == 0).sum() > 500
        assert not left[(drawn.labels == 0) & (depth > 0)].any()
        points = se3.apply(se3.inverse(T), CAMERA.points(depth)[drawn.labels == 1].astype(float))
        gap = np.linalg.norm(points[:, None] - vertices[None, ::7], axis=-1).min(axis=1)
        np.testing.assert_array_equal(
            left[drawn.labels == 1][gap > 0.03], depth[drawn.labels == 1][gap > 0.03]
        )
        assert (gap > 0.03).sum() > 100


def test_what_is_turned_in_the_hand_is_found_without_a_piece_of_the_hand():
    """The hand reaches centimetres beyond the can."""
    hand, believed, _, T_palm_object = grip()
    held = InHandView(hand, SIGMA_JOINT)
    Ts, images = scene(12)
    T_palm_middle = se3.compose(np.eye(3), held.middle(believed))
    rec = Reconstruction(CAMERA, IN_HAND_BOUNDS / 1.5)
    for T, depth in zip(Ts, images, strict=True):
        alone = held.without_hand(CAMERA, depth, believed, T)
        assert rec.grow(View(alone, T @ T_palm_middle), estimate=False) is not None
    surface = one_object(rec.volume.surface(), rec.volume, table=False)
    off = CAN.evaluate(se3.apply(se3.inverse(T_palm_object) @ T_palm_middle, surface.points)).distance
    assert len(surface.points) > 1500
    assert np.abs(off).mean() < 1e-3
    assert np.abs(off).max() < 5e-3


def test_a_hand_without_shapes_cannot_be_distinguished_from_the_object_it_holds(tmp_path):
    file = tmp_path / "hand.urdf"
    file.write_text(
        '<robot name="two"><link name="palm"/><link name="tip"/><joint name="bend" type="revolute">'
        '<parent link="palm"/><child link="tip"/><axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" '
        'velocity="1"/></joint></robot>'
    )
    bare = Hand.from_file(file, palm="palm", tips={"tip": "tip"})
    with pytest.raises(InvalidInput, match="expected shapes of its links in .*hand.urdf, got none"):
        InHandView(bare, SIGMA_JOINT)
