"""A contact that a fingertip senses directly counts like one from a wrench."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidInput
from handsight.observation import ContactMeasurement
from handsight.tracking import FingertipSensors, Tracker
from testbed.refusals import refused


def frames(rig, observation, finger):
    """`T_frame_palm` by the names that a contact's frame may have."""
    Ts = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(observation.joint_positions), strict=True))
    T_palm_body, tip = Ts[finger], rig.fingers[finger]
    body, surface = se3.inverse(T_palm_body), se3.inverse(T_palm_body @ tip.T_frame_surface)
    return {"tip": surface, tip.frame: body, "palm": np.eye(4), rig.hand.palm: np.eye(4)}


def ready(rig, observation, felt, frame="tip", **said):
    """The observation with its contacts in place of its wrenches, each given in a frame of that name."""
    contacts = {}
    for i, finger in enumerate(felt.fingers):
        known = frames(rig, observation, finger)
        name = rig.fingers[finger].frame if frame == "body" else frame
        T = known[name]
        point = se3.apply(T, felt.contacts.points_palm[i][None])[0]
        contacts[finger] = ContactMeasurement(point, T[:3, :3] @ felt.contacts.normals_palm[i], name, **said)
    contacts |= {finger: None for finger in rig.fingers if finger not in contacts}
    return replace(observation, wrenches={}, contacts=contacts)


@pytest.mark.parametrize("frame", ["tip", "body", "palm"])
def test_a_contact_in_any_frame_has_its_place_in_the_palm_and_the_errors_of_its_joints(can, frame):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    found = sensors.contacts(ready(can.rig, last, felt, frame))
    assert found.fingers == felt.fingers
    assert set(found.reasons) == set(felt.reasons)
    assert set(found.reasons.values()) <= {"free"}
    np.testing.assert_allclose(found.contacts.points_palm, felt.contacts.points_palm, atol=1e-12)
    np.testing.assert_allclose(found.contacts.normals_palm, felt.contacts.normals_palm, atol=1e-12)
    np.testing.assert_allclose(found.by_error, felt.by_error, atol=1e-12)
    for i, finger in enumerate(felt.fingers):
        C, n, tip = found.contacts.covariance[i], felt.contacts.normals_palm[i], can.rig.fingers[finger]
        own = C - found.by_error[i] @ found.by_error[i].T
        np.testing.assert_allclose(own[:3, :3], tip.sigma_point**2 * np.eye(3), atol=1e-15)
        np.testing.assert_allclose(
            own[3:, 3:], tip.sigma_normal**2 * (np.eye(3) - np.outer(n, n)), atol=1e-15
        )


def test_a_normal_along_the_tips_push_is_reversed(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    seen = ready(can.rig, last, felt)
    turned = {
        name: contact and replace(contact, normal=-3 * contact.normal)
        for name, contact in seen.contacts.items()
    }
    found = sensors.contacts(replace(seen, contacts=turned))
    np.testing.assert_allclose(found.contacts.normals_palm, felt.contacts.normals_palm, atol=1e-12)


def test_a_contacts_own_covariance_is_rotated_into_the_palm(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt, own = sensors.contacts(last), np.diag([1e-6, 4e-6, 9e-6, 1e-4, 1e-4, 1e-4])
    found = sensors.contacts(ready(can.rig, last, felt, covariance=own))
    for i, finger in enumerate(found.fingers):
        R = frames(can.rig, last, finger)["tip"][:3, :3].T
        C = found.contacts.covariance[i] - found.by_error[i] @ found.by_error[i].T
        np.testing.assert_allclose(C[:3, :3], R @ own[:3, :3] @ R.T, atol=1e-15)


def test_a_contact_with_too_small_a_force_is_none(can):
    sensors, last = FingertipSensors(can.rig), can.held[-1]
    felt = sensors.contacts(last)
    light = 0.5 * min(finger.tip.min_force for finger in can.rig.fingers.values())
    found = sensors.contacts(ready(can.rig, last, felt, force=light))
    assert found.contacts is None
    assert set(found.reasons.values()) == {"free"}


def test_a_tracker_follows_contacts_as_it_follows_wrenches(can):
    sensors = FingertipSensors(can.rig)
    by_wrench, by_contact = (Tracker(can.rig, can.model) for _ in range(2))
    for seen in can.observations:
        felt = sensors.contacts(seen)
        one, other = by_wrench.update(seen), by_contact.update(ready(can.rig, seen, felt))
    assert by_contact.fingertips.fingers == by_wrench.fingertips.fingers
    assert by_contact.corrections > 0
    assert np.linalg.norm(one.T_palm_object[:3, 3] - other.T_palm_object[:3, 3]) < 3 * by_wrench.sigma


@pytest.mark.parametrize(
    ("contacts", "field"),
    [
        ({"ff": "touching"}, "observation.contacts['ff']"),
        ([1], "observation.contacts"),
    ],
)
def test_a_value_that_is_not_a_contact_is_refused(can, contacts, field):
    with refused(InvalidInput, field):
        Tracker(can.rig, can.model).update(replace(can.held[-1], contacts=contacts))


def test_an_unknown_frame_is_refused_with_the_list_of_known_ones(can):
    last = can.held[-1]
    contact = ContactMeasurement(np.zeros(3), np.array([0.0, 0, 1]), "moon")
    with refused(InvalidInput, "observation.contacts['ff'].frame"):
        FingertipSensors(can.rig).contacts(replace(last, contacts={"ff": contact}))


@pytest.mark.parametrize(
    ("said", "field"),
    [
        ({"point": [0, 0, np.nan]}, "contact.point"),
        ({"normal": np.zeros(3)}, "contact.normal"),
        ({"frame": ""}, "contact.frame"),
        ({"force": np.inf}, "contact.force"),
        ({"covariance": -np.eye(6)}, "contact.covariance"),
    ],
)
def test_an_invalid_field_of_a_contact_is_named(said, field):
    with refused(InvalidInput, field):
        ContactMeasurement(**({"point": np.zeros(3), "normal": np.array([0.0, 0, 1])} | said))
