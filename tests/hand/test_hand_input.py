"""What is wrong with joint positions and names is said in one sentence."""

import numpy as np
import pytest

from hand.hands import SHADOW, shadow_file
from handsight.errors import InvalidInput
from handsight.hand import Hand
from testbed.refusals import refused

pytest.importorskip("mujoco")

GOOD = {"shoulder": 0.0, "lift": 0.1, "knuckle": 0.5, "jaw": 0.01}


@pytest.mark.parametrize(
    ("positions", "field"),
    [
        ({"jaw": 0.01}, "joint_positions"),
        ({}, "joint_positions"),
        ({"knuckle": 0.5, "jaw": np.nan}, "joint_positions['jaw']"),
        ({"knuckle": np.inf, "jaw": 0.0}, "joint_positions['knuckle']"),
        ({"knuckle": "0.5", "jaw": 0.0}, "joint_positions['knuckle']"),
        ({"knuckle": None, "jaw": 0.0}, "joint_positions['knuckle']"),
        ({"knuckle": [0.5], "jaw": [0.0]}, "joint_positions['knuckle']"),
        ({"knuckle": [0.5], "jaw": 0.0}, "joint_positions['knuckle']"),
        ({"knuckle": 1j, "jaw": 0.0}, "joint_positions['knuckle']"),
        ([0.5, 0.0], "joint_positions"),
        (None, "joint_positions"),
    ],
)
def test_positions_that_are_missing_or_no_numbers_are_named(robot, positions, field):
    for refuse in (robot.Ts_palm_tip, robot.kinematics):
        with refused(InvalidInput, field):
            refuse(positions)


def test_the_palm_in_the_world_needs_the_arms_joints(robot):
    with refused(InvalidInput, "joint_positions"):
        robot.T_world_palm({"knuckle": 0.5, "jaw": 0.01})


def test_the_joints_of_the_file_are_named_with_their_limits(robot):
    assert robot.joint_names == ("shoulder", "lift", "knuckle", "jaw")
    assert robot.limits.tolist() == [[-np.inf, np.inf], [0, 0.3], [-0.2, 1.6], [0, 0.02]]


@pytest.mark.parametrize(
    ("points", "tips", "field"),
    [
        (np.zeros((3, 3)), None, "points_palm"),
        ([[0, 0, np.nan]] * 2, None, "points_palm"),
        (np.zeros((1, 3)), [2], "tips"),
        (np.zeros((1, 3)), [-1], "tips"),
        (np.zeros((2, 3)), [0], "points_palm"),
    ],
)
def test_points_that_fit_no_tips_are_refused(robot, points, tips, field):
    with refused(InvalidInput, field):
        robot.kinematics(GOOD).jacobians(points, tips)


@pytest.mark.parametrize(
    ("palm", "tips", "field"),
    [
        ("plam", {}, "palm"),
        ("PALM", {}, "palm"),
        ("", {}, "palm"),
        ("palm", {"ff": "turning_"}, "tips['ff']"),
        ("palm", {"ff": "far"}, "two_fingers.urdf"),
    ],
)
def test_bodies_that_are_not_there_or_hang_on_other_joints_are_named(robot_file, palm, tips, field):
    with refused(InvalidInput, field):
        Hand.from_file(robot_file, palm=palm, tips=tips)


def test_the_nearest_body_is_found_without_its_prefix():
    shadow_file()
    with refused(InvalidInput, "tips['ff']"):
        Hand.from_file(SHADOW, palm="robot0:palm", tips={"ff": "ffdistal"})
