"""What is wrong with joint positions and names is said in one sentence."""

import re

import numpy as np
import pytest

from hand.hands import SHADOW, shadow_file
from handsight.errors import InvalidInput
from handsight.hand import Hand

pytest.importorskip("mujoco")

GOOD = {"shoulder": 0.0, "lift": 0.1, "knuckle": 0.5, "jaw": 0.01}


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ({"knuckle": 0.5}, "joint_positions: expected a position for jaw; got knuckle"),
        ({}, "joint_positions: expected a position for knuckle, jaw; got none"),
        ({"knuckle": 0.5, "jaw": np.nan}, "joint_positions['jaw']: expected a finite number, got nan"),
        ({"knuckle": np.inf, "jaw": 0.0}, "joint_positions['knuckle']: expected a finite number, got inf"),
        ({"knuckle": "0.5", "jaw": 0.0}, "joint_positions['knuckle']: expected a finite number, got 0.5"),
        ({"knuckle": None, "jaw": 0.0}, "joint_positions['knuckle']: expected a finite number, got None"),
        ({"knuckle": [0.5], "jaw": [0.0]}, "joint_positions['knuckle']: expected a finite number, got [0.5]"),
        ({"knuckle": [0.5], "jaw": 0.0}, "joint_positions['knuckle']: expected a finite number, got [0.5]"),
        ({"knuckle": 1j, "jaw": 0.0}, "joint_positions['knuckle']: expected a finite number, got 1j"),
        ([0.5, 0.0], "joint_positions: expected a mapping from joint to position, got [0.5, 0.0]"),
        (None, "joint_positions: expected a mapping from joint to position, got None"),
    ],
)
def test_positions_that_are_missing_or_no_numbers_are_named(robot, positions, message):
    for refuse in (robot.Ts_palm_tip, robot.kinematics):
        with pytest.raises(InvalidInput, match=f"^{re.escape(message)}$"):
            refuse(positions)


def test_the_palm_in_the_world_needs_the_arms_joints(robot):
    with pytest.raises(
        InvalidInput, match=r"^joint_positions: expected a position for shoulder, lift; got knuckle, jaw$"
    ):
        robot.T_world_palm({"knuckle": 0.5, "jaw": 0.01})


def test_the_joints_of_the_file_are_named_with_their_limits(robot):
    assert robot.joint_names == ("shoulder", "lift", "knuckle", "jaw")
    assert robot.limits.tolist() == [[-np.inf, np.inf], [0, 0.3], [-0.2, 1.6], [0, 0.02]]


@pytest.mark.parametrize(
    ("points", "tips", "message"),
    [
        (np.zeros((3, 3)), None, "points_palm: expected finite numbers of shape (2, 3), got shape (3, 3)"),
        (
            [[0, 0, np.nan]] * 2,
            None,
            "points_palm: expected finite numbers of shape (2, 3), got [[0, 0, nan], [0, 0, nan]]",
        ),
        (np.zeros((1, 3)), [2], "tips: expected numbers from 0 to 1, got [2]"),
        (np.zeros((1, 3)), [-1], "tips: expected numbers from 0 to 1, got [-1]"),
        (
            np.zeros((2, 3)),
            [0],
            "points_palm: expected finite numbers of shape (1, 3), got [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]",
        ),
    ],
)
def test_points_that_fit_no_tips_are_refused(robot, points, tips, message):
    with pytest.raises(InvalidInput, match=f"^{re.escape(message)}$"):
        robot.kinematics(GOOD).jacobians(points, tips)


@pytest.mark.parametrize(
    ("palm", "tips", "message"),
    [
        (
            "plam",
            {},
            "palm: expected a body of two_fingers.urdf, got 'plam'; the nearest valid one is 'palm'",
        ),
        (
            "PALM",
            {},
            "palm: expected a body of two_fingers.urdf, got 'PALM'; the nearest valid one is 'palm'",
        ),
        (
            "",
            {},
            "palm: expected a body of two_fingers.urdf, got ''; valid: arm, base, far, mount, palm, sliding, turning, world",
        ),
        (
            "palm",
            {"ff": "turning_"},
            "tips['ff']: expected a body of two_fingers.urdf, got 'turning_'; the nearest valid one is 'turning'",
        ),
        (
            "palm",
            {"ff": "far"},
            "two_fingers.urdf: expected hinges and slides on the way, got joint 'loose' of 'far', which moves in more than one direction",
        ),
    ],
)
def test_bodies_that_are_not_there_or_hang_on_other_joints_are_named(robot_file, palm, tips, message):
    with pytest.raises(InvalidInput, match=f"^{re.escape(message)}$"):
        Hand.from_file(robot_file, palm=palm, tips=tips)


def test_the_nearest_body_is_found_without_its_prefix():
    shadow_file()
    with pytest.raises(InvalidInput, match=r"got 'ffdistal'; the nearest valid one is 'robot0:ffdistal'$"):
        Hand.from_file(SHADOW, palm="robot0:palm", tips={"ff": "ffdistal"})
