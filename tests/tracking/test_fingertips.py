"""Contacts in the palm from raw wrenches, with the uncertainty that joints and neighbouring tips add."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
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


def test_contacts_of_tips_near_each_other_are_less_certain(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    joints = dict(last.joint_positions)
    assert {"ff", "mf"} <= set(felt.fingers)
    # The forefinger's spread and bend are made the middle finger's, tilted towards it.
    for joint in ("J2", "J1", "J0"):
        joints[f"robot0:FF{joint}"] = joints[f"robot0:MF{joint}"]
    joints["robot0:FFJ3"], joints["robot0:MFJ3"] = -0.1, 0.1
    touching = sensors.contacts(replace(last, joint_positions=joints))
    assert touching.fingers == felt.fingers
    for i, finger in enumerate(felt.fingers):
        C, alone = touching.contacts.covariance[i], felt.contacts.covariance[i]
        if finger in ("ff", "mf"):
            assert np.sqrt(C[0, 0] + C[1, 1] + C[2, 2]) > 2e-3 * np.sqrt(3 / 2)
            assert np.trace(C) > 1.5 * np.trace(alone)
        elif finger == "th":
            np.testing.assert_allclose(C, alone, rtol=0, atol=1e-3 * np.abs(alone).max())


def test_there_is_no_contact_without_joint_positions(can):
    felt = FingertipSensors(can.rig).contacts(replace(can.held[-1], joint_positions=None))
    assert felt.contacts is None
    assert set(felt.reasons.values()) == {"no joint positions"}


def test_contacts_are_those_of_compensated_wrenches_at_the_tips(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    Ts = dict(zip(can.rig.hand.tips, can.rig.hand.Ts_palm_tip(last.joint_positions), strict=True))
    for i, name in enumerate(felt.fingers):
        finger = can.rig.fingers[name]
        T = Ts[name] @ finger.T_frame_surface
        R = last.T_world_palm[:3, :3] @ T[:3, :3] @ finger.tip.T_surface_sensor[:3, :3]
        raw = last.wrenches[name]
        load = hs.contact.compensate(raw[:3], raw[3:], R.T @ can.rig.gravity, finger.calibration)
        contact = hs.contact_from_wrench(*load, finger.tip).moved(T)
        np.testing.assert_allclose(felt.contacts.points_palm[i], contact.point, atol=1e-12)
        np.testing.assert_allclose(felt.contacts.normals_palm[i], contact.normal, atol=1e-10)


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
