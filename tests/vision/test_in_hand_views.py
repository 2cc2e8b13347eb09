"""What a hand holds, in depth images of both: the hand goes, and what is clear of it stays."""

import functools

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.objects import ObjectModel
from testbed.refusals import refused

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.simulation import Scenario, rig_of
from handsight.vision.reconstruction.parts import in_fingers
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, InHandView
from testbed.scenes import can
from testbed.sight_scenes import CAMERA, curled, letter, pictures_of, turned_before

SIGMA_JOINT = float(np.deg2rad(1.0))
LETTER = ObjectModel.from_mesh(*letter())


def middle_of(hand, joint_positions):
    """The mean of the fingertips in the palm."""
    return hand.Ts_palm_tip(joint_positions)[:, :3, 3].mean(axis=0)


@functools.cache
def grip():
    """Joints as believed, the hand's true triangles, the can's in the palm, and its pose there."""
    hand, rng = rig_of(Scenario(object="can")).hand, np.random.default_rng(2)
    believed, shape = curled(hand, rng), hand.shape()
    true = {name: value + SIGMA_JOINT * rng.normal() for name, value in believed.items()}
    vertices = shape.vertices_palm(true)
    middle = middle_of(hand, believed)
    away = middle - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    T_palm_object = se3.compose(se3.random(rng)[:3, :3], middle + 0.35 * away)
    return hand, believed, (vertices, shape.faces), T_palm_object


def scene(n):
    """T_camera_palm (n, 4, 4) of views all around, and noisy depth images."""
    _, believed, (vertices, faces), T_palm_object = grip()
    held = se3.apply(T_palm_object, np.array(can().vertices))
    both = np.concatenate([vertices, held]), np.concatenate([faces, can().faces + len(vertices)])
    Ts = turned_before(n) @ se3.compose(np.eye(3), -T_palm_object[:3, 3])
    return Ts, pictures_of(Ts, both, np.random.default_rng(3))


def test_no_pixel_of_the_hand_is_left_and_what_is_clear_of_it_is():
    hand, believed, (vertices, faces), T_palm_object = grip()
    held = InHandView(hand, SIGMA_JOINT)
    thing = se3.apply(T_palm_object, np.array(can().vertices))
    for T in turned_before(3) @ se3.compose(np.eye(3), -T_palm_object[:3, 3]):
        both = np.concatenate([vertices, thing]), np.concatenate([faces, can().faces + len(vertices)])
        labels = np.repeat([0, 1], [len(faces), len(can().faces)])
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
    T_palm_middle = se3.compose(np.eye(3), middle_of(hand, believed))
    tips = hand.Ts_palm_tip(believed)[:, :3, 3] - T_palm_middle[:3, 3]
    rec = Reconstruction(CAMERA, IN_HAND_BOUNDS / 1.5)
    for T, depth in zip(Ts, images, strict=True):
        alone = held.without_hand(CAMERA, depth, believed, T)
        assert rec.grow(View(alone, T @ T_palm_middle), estimate=False) is not None
    surface = in_fingers(rec.volume, tips)
    off = can().evaluate(se3.apply(se3.inverse(T_palm_object) @ T_palm_middle, surface.points)).distance
    assert len(surface.points) > 1500
    assert np.abs(off).mean() < 1e-3
    assert np.abs(off).max() < 5e-3


@functools.cache
def can_in_hand():
    """What was fused of a can in the hand, and the fingertips."""
    hand, believed, _, _ = grip()
    Ts, images = scene(12)
    held, middle = InHandView(hand, SIGMA_JOINT), middle_of(hand, believed)
    rec = Reconstruction(CAMERA, IN_HAND_BOUNDS)
    for T, depth in zip(Ts, images, strict=True):
        alone = held.without_hand(CAMERA, depth, believed, T)
        rec.grow(View(alone, T @ se3.compose(np.eye(3), middle)), estimate=False)
    return rec.volume, hand.Ts_palm_tip(believed)[:, :3, 3] - middle


@pytest.mark.parametrize("away", [[0, 0, 0.1], [0.1, 0.1, 0]])
def test_what_the_fingers_do_not_hold_is_refused(away):
    """A can that stays where it is, for fingers that are elsewhere."""
    volume, tips = can_in_hand()
    with pytest.raises(InvalidInput):
        in_fingers(volume, tips + 2 * np.array(away))


def test_what_goes_on_beyond_what_is_fused_is_background():
    """A wall through the grip."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    rec, tips = Reconstruction(CAMERA, IN_HAND_BOUNDS), np.array([[0.02, 0, 0], [-0.02, 0, 0]])
    for T in turned_before(80)[:3]:
        depth = CAMERA.draw(se3.apply(T, corners), np.array([[0, 1, 2], [0, 2, 3]])).depth
        view = View(np.where(np.isfinite(depth), depth, 0).astype(np.float32), T, tips)
        rec.grow(view, estimate=False)
    with pytest.raises(InvalidInput):
        in_fingers(rec.volume, tips)


def test_a_hand_without_shapes_cannot_be_distinguished_from_the_object_it_holds(tmp_path):
    file = tmp_path / "hand.urdf"
    file.write_text(
        '<robot name="two"><link name="palm"/><link name="tip"/><joint name="bend" type="revolute">'
        '<parent link="palm"/><child link="tip"/><axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" '
        'velocity="1"/></joint></robot>'
    )
    bare = Hand.from_file(file, palm="palm", tips={"tip": "tip"})
    with refused(InvalidInput, "hand"):
        InHandView(bare, SIGMA_JOINT)
