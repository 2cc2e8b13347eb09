"""The hand in a picture is masked where it is drawn, and nothing else."""

from importlib.util import find_spec

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from handsight import se3
from handsight.vision import hand_mask
from handsight.vision.palm.hand_in_image import AROUND
from testbed.sight_scenes import CAMERA

if find_spec("gymnasium_robotics") is None:  # it is not imported: only its files are used
    pytest.skip("the Shadow hand's files come with handsight[sim]", allow_module_level=True)

from handsight.simulation import Scenario, rig_of

T_CAMERA_PALM = se3.compose(se3.rotation_exp(np.array([0.4, 2.6, 0.3])), np.array([0.02, -0.03, 0.5]))


@pytest.fixture(scope="module")
def hand():
    return rig_of(Scenario(object="can")).hand


def bent(hand, angle):
    return dict.fromkeys(hand.joint_names, angle)


def test_a_hands_shape_moves_with_its_links(hand):
    shape = hand.shape()
    open_, closed = shape.vertices_palm(bent(hand, 0.0)), shape.vertices_palm(bent(hand, 0.4))
    Ts = dict(zip(hand.tips.values(), hand.Ts_palm_tip(bent(hand, 0.4)), strict=True))
    for k, body in enumerate(shape.bodies):
        mine = shape.body_of == k
        spans = [np.linalg.norm(v[mine] - v[mine][0], axis=1) for v in (open_, closed)]
        np.testing.assert_allclose(*spans, atol=1e-12)
        if body in Ts:
            np.testing.assert_allclose(
                se3.apply(Ts[body], shape.vertices_body[mine]), closed[mine], atol=1e-12
            )
    assert set(hand.tips.values()) <= set(shape.bodies)
    assert (shape.body_of[shape.faces].min(axis=1) == shape.body_of[shape.faces].max(axis=1)).all()
    fewer = hand.shape(without=["robot0:palm"])
    assert set(fewer.bodies) == set(shape.bodies) - {"robot0:palm"}


def test_the_hand_is_masked_and_what_is_behind_or_before_it_is_not(hand):
    shape = hand.shape()
    vertices = shape.vertices_palm(bent(hand, 0.2))
    drawn = CAMERA.draw(se3.apply(T_CAMERA_PALM, vertices), shape.faces).depth
    there = np.isfinite(drawn)
    assert there.sum() > 2000
    wall = np.where(there, drawn, 0.9).astype(np.float32)
    mask = hand_mask(CAMERA, wall, vertices, shape.faces, T_CAMERA_PALM)
    assert mask[there].all()
    assert not mask[~there].any()  # the wall is far behind
    for off in (-0.15, 0.2):  # an object in the hand hides it, and is hidden by it
        other = np.where(there, drawn + off, 0.9).astype(np.float32)
        assert not hand_mask(CAMERA, other, vertices, shape.faces, T_CAMERA_PALM).any()
    # A pixel beside the hand is its, if it is as far: joints are not known better.
    beside = binary_dilation(there, np.ones((2 * AROUND + 1,) * 2)) & ~there
    level = np.full(wall.shape, np.median(drawn[there]), np.float32)
    near = hand_mask(CAMERA, level, vertices, shape.faces, T_CAMERA_PALM)
    assert near[beside].any()
    assert not near[~there & ~beside].any()


def test_a_hand_out_of_the_image_masks_nothing(hand):
    shape = hand.shape()
    T = se3.compose(np.eye(3), np.array([0, 0, -1.0]))
    depth = np.ones((240, 320), np.float32)
    assert not hand_mask(CAMERA, depth, shape.vertices_palm(bent(hand, 0.0)), shape.faces, T).any()
