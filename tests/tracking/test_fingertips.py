"""Contacts in the palm from raw wrenches, with the uncertainty that joints and neighbouring tips add."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.tracking import FingertipSensors


def test_one_degree_of_every_joint_is_in_each_contacts_covariance(can):
    """Against drawing the joint errors: covariance of where the same point of each tip comes to lie."""
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    none = replace(can.rig, sigma_joint=0.0, sigma_joint_offset=1e-9)
    felt, alone = sensors.contacts(last), FingertipSensors(none).contacts(last)
    rng = np.random.default_rng(0)
    hand, names = can.rig.hand, list(last.joint_positions)
    order = list(hand.tips)
    Ts = hand.Ts_palm_tip(last.joint_positions)
    draws = []
    for _ in range(2000):
        off = rng.normal(scale=np.hypot(can.rig.sigma_joint_offset, can.rig.sigma_joint), size=len(names))
        moved = {name: last.joint_positions[name] + d for name, d in zip(names, off, strict=True)}
        draws.append(hand.Ts_palm_tip(moved))
    draws = np.array(draws)
    for i, finger in enumerate(felt.fingers):
        k = order.index(finger)
        local = se3.apply(se3.inverse(Ts[k]), felt.contacts.points_palm[i][None])
        points = se3.apply(draws[:, k], local)[:, 0]
        added = (felt.contacts.covariance[i] - alone.contacts.covariance[i])[:3, :3]
        np.testing.assert_allclose(added, np.cov(points.T), atol=0.12 * np.trace(added))
        assert 0.5e-3 < np.sqrt(np.trace(added) / 3) < 3e-3


def test_there_is_no_contact_without_joint_positions(can):
    felt = FingertipSensors(can.rig).contacts(replace(can.held[-1], joint_positions=None))
    assert felt.contacts is None
    assert set(felt.reasons.values()) == {"no joint positions"}


def test_without_gravity_the_tips_weight_is_not_subtracted_and_a_silent_sensor_is_reported(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    still = replace(can.rig, gravity=np.zeros(3))
    unknown = replace(last, T_world_palm=None)
    one, other = sensors.contacts(unknown), FingertipSensors(still).contacts(last)
    np.testing.assert_array_equal(one.contacts.points_palm, other.contacts.points_palm)
    assert np.abs(one.contacts.points_palm - sensors.contacts(last).contacts.points_palm).max() > 1e-6
    wrenches = {name: load for name, load in last.wrenches.items() if name != one.fingers[0]}
    quiet = sensors.contacts(replace(last, wrenches=wrenches))
    assert quiet.reasons[one.fingers[0]] == "silent"
    assert quiet.fingers == one.fingers[1:]


@pytest.mark.parametrize("k", range(3))
def test_a_finger_on_the_table_does_not_touch_the_object(can, k):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    finger, normal, point = felt.fingers[k], felt.contacts.normals_palm[k], felt.contacts.points_palm[k]
    up = np.linalg.qr(np.column_stack([normal, np.eye(3)[:, :2]]))[0].T
    up = up * np.sign(up[0] @ normal)
    R = np.stack([up[1], np.cross(up[0], up[1]), up[0]])  # in the world the contact's normal is up

    def placed(lift, tilt=0.0, sensors=sensors):
        turn = se3.rotation_exp(np.array([tilt, 0, 0]))
        T = se3.compose(turn @ R, np.zeros(3))
        T[2, 3] = can.rig.table.height + lift - (turn @ R @ point)[2]
        return sensors.contacts(replace(last, T_world_palm=T))

    assert placed(0.0).reasons[finger] == "on the table"
    assert finger not in placed(0.0).fingers
    assert finger in placed(0.03).fingers
    assert finger in placed(-0.03).fingers
    assert finger in placed(0.0, tilt=0.5).fingers
    assert finger in placed(0.0, sensors=FingertipSensors(replace(can.rig, table=None))).fingers
