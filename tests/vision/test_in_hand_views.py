"""What a hand holds, in depth images of both: the hand goes, and what is clear of it stays."""

import functools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from handsight import se3
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.objects import ObjectModel

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from hand_scenes import curled
from handsight.simulation import Scenario, rig_of
from handsight.vision.reconstruction.completion import one_object
from handsight.vision.reconstruction.grips import GRIP, InHandReconstruction, in_fingers
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, InHandView
from sight_scenes import CAMERA, letter
from views_around import CAN, pictures_of, turned_before

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
    T_palm_middle = se3.compose(np.eye(3), middle_of(hand, believed))
    rec = Reconstruction(CAMERA, IN_HAND_BOUNDS / 1.5)
    for T, depth in zip(Ts, images, strict=True):
        alone = held.without_hand(CAMERA, depth, believed, T)
        assert rec.grow(View(alone, T @ T_palm_middle), estimate=False) is not None
    surface = one_object(rec.volume.surface(), rec.volume, table=False)
    off = CAN.evaluate(se3.apply(se3.inverse(T_palm_object) @ T_palm_middle, surface.points)).distance
    assert len(surface.points) > 1500
    assert np.abs(off).mean() < 1e-3
    assert np.abs(off).max() < 5e-3


def grip_of(model, seed, n=14, share=0.7):
    """Views of another grip: by what the hand is believed to be, and T_palm_object."""
    hand, rng = grip()[0], np.random.default_rng(seed)
    believed, shape = curled(hand, rng), hand.shape()
    vertices = shape.vertices_palm(
        {name: value + SIGMA_JOINT * rng.normal() for name, value in believed.items()}
    )
    middle = middle_of(hand, believed)
    R, away = se3.random(rng)[:3, :3], middle - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    T_palm_object = se3.compose(R, middle + 0.25 * away - R @ model.center_object)
    there = se3.apply(T_palm_object, np.array(model.vertices))
    both = np.concatenate([vertices, there]), np.concatenate([shape.faces, model.faces + len(vertices)])
    Ts = np.roll(turned_before(int(n / share)), rng.integers(n), axis=0)[:n] @ se3.compose(np.eye(3), -middle)
    held, tips = InHandView(hand, SIGMA_JOINT), hand.Ts_palm_tip(believed)[:, :3, 3]
    images = [
        held.without_hand(CAMERA, depth, believed, T)
        for T, depth in zip(Ts, pictures_of(Ts, both, np.random.default_rng(3)), strict=True)
    ]
    return [View(depth, T, tips) for T, depth in zip(Ts, images, strict=True)], T_palm_object


def judged(model, surface, T_frame_object):
    """Mean error of a surface's points [m], and the share of the object's surface near one of them."""
    points = se3.apply(se3.inverse(T_frame_object), surface.points)
    covered = cKDTree(points).query(model.sample(2000)[0])[0] < 0.004
    return np.abs(model.evaluate(points).distance).mean(), covered.mean()


@functools.cache
def regripped(name):
    """The reconstruction of an object in two grips, and T_palm_object of both."""
    model = {"letter": LETTER, "can": CAN}[name]
    grips = [grip_of(model, seed) for seed in (0, 1)]
    T_palm_middle = se3.compose(np.eye(3), grips[0][0][0].tips_object.mean(axis=0))
    rec = InHandReconstruction(CAMERA)
    for view in [*grips[0][0], *grips[1][0]]:
        tips = view.tips_object - T_palm_middle[:3, 3]
        rec.grow(View(view.depth, view.T_camera_object @ T_palm_middle, tips))
    return model, rec, [se3.inverse(T_palm_middle) @ T for _, T in grips]


@pytest.mark.parametrize("name", ["letter", "can"])
def test_two_grips_give_one_surface_that_is_as_accurate_and_shows_more(name):
    model, rec, Ts = regripped(name)
    assert len(rec.grips) == 2
    alone = [
        judged(model, in_fingers(grip.volume, grip.tips_object)[0], T)
        for grip, T in zip(rec.grips, Ts, strict=True)
    ]
    first = max(range(2), key=lambda k: rec.grips[k].volume.views)
    _, surface, sentences = rec.merged()
    assert sentences == ["2 of 2 grips aligned"]
    error, covered = judged(model, surface, Ts[first])
    assert error < 1.25 * max(error for error, _ in alone)
    assert covered > max(covered for _, covered in alone) + 0.03


def test_a_grip_of_another_object_is_left_out_and_said():
    _, rec, _ = regripped("letter")
    other = InHandReconstruction(CAMERA)
    other.grips = [rec.grips[0], regripped("can")[1].grips[1]]
    _, _, sentences = other.merged()
    assert sentences[0] == "1 of 2 grips aligned"
    assert sentences[1].startswith("left out a grip of ")
    assert "got one that fits it nowhere" in sentences[1]


@pytest.mark.parametrize("away", [[0, 0, 0.1], [0.1, 0.1, 0]])
def test_what_the_fingers_do_not_hold_is_refused_and_its_place_said(away):
    """A can that stays where it is, for fingers that are elsewhere."""
    _, rec, _ = regripped("can")
    grip = rec.grips[0]
    found, why = in_fingers(grip.volume, grip.tips_object + away)
    assert found is None
    assert "expected an object between the fingers, got a surface of" in why
    assert "mm from the nearest fingertip" in why
    rec = InHandReconstruction(CAMERA)
    with pytest.raises(InvalidInput, match="expected an object in the hand, got none"):
        rec.merged()


def test_what_goes_on_beyond_what_is_fused_is_background():
    """A wall through the grip."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    rec, tips = InHandReconstruction(CAMERA), np.array([[0.02, 0, 0], [-0.02, 0, 0]])
    for T in turned_before(80)[:3]:
        depth = CAMERA.draw(se3.apply(T, corners), np.array([[0, 1, 2], [0, 2, 3]])).depth
        rec.grow(View(np.where(np.isfinite(depth), depth, 0).astype(np.float32), T, tips))
    assert rec.views <= GRIP.min_views
    with pytest.raises(InvalidInput, match="cut by the edge of what is fused"):
        rec.merged()


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
