"""Joints in degrees, forces in millinewtons and vision in millimetres are told with the likely factor."""

import numpy as np

from handsight import se3
from handsight.observation import Observation, PoseMeasurement
from handsight.rig.units import Units
from messages.ros import JOINTS, rig


def said(angle, force, distance, joints=("j1",)):
    robot = rig()
    robot.hand.limits = np.tile([-0.3, 1.6], (3, 1))
    units = Units(robot)
    T = se3.compose(np.eye(3), np.array([0.0, 0.0, distance]))
    finger = next(iter(robot.fingers))
    wrench = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
    for k in range(20):
        positions = dict.fromkeys(JOINTS, 0.1) | dict.fromkeys(joints, angle)
        units.put(Observation(0.01 * k, positions, wrenches={finger: wrench}, vision=PoseMeasurement(T)))
    return units.sentences()


def test_values_in_a_wrong_unit_are_reported():
    joint, force, vision = said(45.0, 2000.0, 650.0)
    assert joint.endswith("joint 'j1' up to 45 where its file limits it to 1.6 (degrees? 0.785 rad)")
    assert force.endswith("up to 2000 N (millinewtons? 2 N)")
    assert vision.endswith("poses up to 650 m away (millimetres? 0.65 m)")


def test_joints_in_degrees_are_one_sentence():
    (joints,) = said(45.0, 1.0, 0.6, joints=JOINTS)
    assert joints.endswith(f"(degrees? 0.785 rad); and {len(JOINTS) - 1} more like that")


def test_the_values_of_a_real_hand_are_not_reported():
    assert said(1.7, 20.0, 0.9) == []
