"""Gels and pads in a tracker: fingers without wrenches that touch, and gels' images from a recording."""

import json
from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest

import handsight as hs
from cli.commands import called
from handsight import se3
from handsight.contact import TactileSurface
from handsight.messages.encode import header
from handsight.recording import RecordingWriter, open_recording
from handsight.rig.save import text
from handsight.tracking import FingertipSensors, SkinContacts, SkinSensors, TrackerSettings
from messages.test_sensor_messages import observed, robot, serialized
from testbed import pad_scenes
from testbed.skin_scenes import R_FINGER_PAD

GEL = pad_scenes.gel()
IMAGE = pad_scenes.ROWS, pad_scenes.COLUMNS


def pad_of(finger, **fields):
    """The sensed part of a simulated finger's tip, as a pad."""
    T, axes = finger.T_frame_surface, np.asarray(finger.tip.semi_axes)
    direction = np.array([0, -0.9, np.sqrt(1 - 0.9**2)])
    normal = T[:3, :3] @ (direction / axes)
    given = {"frame": finger.frame, "threshold": 0.5, "pitch": 0.02}
    given |= {"sigma_point": 2e-3, "sigma_normal": np.deg2rad(60)}
    return TactileSurface(points=se3.apply(T, direction * axes), normals=normal[None], **given | fields)


def with_pads(rig, observations, wrenches=()):
    """The rig with a pad on each tip, and observations in which it says whether the finger's wrench is a contact; of
    the wrenches these alone are kept."""
    sensors, found = FingertipSensors(rig), []
    for observation in observations:
        touching = sensors.contacts(observation).fingers
        readings = {name: np.array([float(name in touching)]) for name in rig.fingers}
        kept = {name: observation.wrenches[name] for name in wrenches}
        found.append(replace(observation, skin=readings, wrenches=kept))
    return replace(rig, skin={name: pad_of(finger) for name, finger in rig.fingers.items()}), found


def followed(rig, model, observations):
    tracker = hs.Tracker(rig, model, settings=TrackerSettings(uncertain_position=0.015))
    for observation in observations:
        tracker.update(observation)
    return tracker


def across(can, T):
    """The error across the can's axis [m]."""
    shift, axis = se3.difference(T, can.T_palm_object)[:3], can.T_palm_object[:3, 2]
    return float(np.linalg.norm(shift - shift @ axis * axis))


def test_a_hand_whose_fingers_say_only_that_they_touch_is_tracked_better_than_by_vision(can):
    rig, observations = with_pads(can.rig, can.observations)
    tracker = followed(rig, can.model, observations)
    alone = followed(can.rig, can.model, [replace(each, wrenches={}) for each in can.observations])
    assert tracker.state == "tracking", tracker.reason
    assert len(tracker.fingertips.fingers) >= 3
    assert across(can, tracker.estimate.T_palm_object) < 0.6 * across(can, alone.estimate.T_palm_object)
    assert tracker.estimate.consistent
    assert np.isnan(tracker.fingertips.loads).all()


def test_a_fingers_wrench_says_more_than_its_pad_and_is_used_alone(can):
    name = next(iter(FingertipSensors(can.rig).contacts(can.observations[-1]).fingers))
    rig, observations = with_pads(can.rig, can.observations[-1:], wrenches=[name])
    skin = SkinSensors(rig).observed(observations[0], touched=True)
    assert name not in skin.tips
    assert len(skin.tips) >= 2
    mixed = FingertipSensors(rig).contacts(observations[0], None, skin)
    by_wrench = FingertipSensors(can.rig).contacts(can.observations[-1])
    for one, other in ((mixed, by_wrench),):
        i, k = one.fingers.index(name), other.fingers.index(name)
        np.testing.assert_array_equal(one.contacts.points_palm[i], other.contacts.points_palm[k])
    other_finger = next(iter(skin.tips))
    spread = np.trace(mixed.contacts.covariance[mixed.fingers.index(other_finger), :3, :3])
    assert spread > 3 * np.trace(by_wrench.contacts.covariance[:, :3, :3].mean(axis=0))


def test_a_pad_that_stays_pressed_is_not_taken_for_its_rest(can):
    pad = pad_of(next(iter(can.rig.fingers.values())), frame=can.rig.hand.palm)
    sensors = SkinSensors(replace(can.rig, skin={"a": pad}))
    skin = SkinContacts()
    for k in range(200):
        reading = [0.2 + (1.0 if k >= 10 else 0.0)]
        skin = sensors.observed(hs.Observation(0.01 * k, skin={"a": reading}), skin, touched=False)
    assert skin.pressed
    assert skin.watched["a"].baseline[0, 0] == pytest.approx(0.2)


def test_a_pad_that_is_pressed_on_the_palm_is_no_evidence_of_slips(can):
    """It says where it is touched, and measures no force."""
    pad = TactileSurface.grid(
        frame=can.rig.hand.palm, T_frame_grid=np.eye(4), rows=1, columns=1, pitch=0.026, threshold=0.5
    )
    rig = replace(can.rig, skin={"palm pad": pad})
    tracker = followed(
        rig,
        can.model,
        [replace(each, skin={"palm pad": [[float(k > 20)]]}) for k, each in enumerate(can.observations)],
    )
    assert tracker.skin.pressed
    assert tracker.slip.unmeasured == ()


def test_a_gel_on_a_tip_is_the_fingers_contact(can):
    """It is as good as the finger's calibration and its joints, and no better."""
    name, finger = next(iter(can.rig.fingers.items()))
    R = finger.T_frame_surface[:3, :3] @ R_FINGER_PAD
    T = se3.compose(R, finger.T_frame_surface[:3, 3] + 0.01 * R[:, 2])
    gel = pad_scenes.gel(frame=finger.frame, T_frame_grid=T)
    rig = replace(can.rig, skin={name: gel})
    image = np.full(gel.shape, 5e-4)
    observation = replace(can.observations[-1], skin={name: image}, wrenches={})
    skin = SkinSensors(rig).observed(observation, touched=True)
    assert not skin.bears  # it is one patch, the finger's
    touch = FingertipSensors(rig).contacts(observation, None, skin)
    assert touch.fingers == (name,)
    assert skin.evidence() is None
    contacts = touch.contacts
    T_palm = skin.touches[name][1].placed[0] @ T
    local = se3.apply(se3.inverse(T_palm), contacts.points_palm)
    np.testing.assert_allclose(local[:, 2], -5e-4, atol=1e-6)
    normal, J = T_palm[:3, 2], touch.by_error[0, :3]
    variances = np.einsum("i,nij,j->n", normal, contacts.covariance[:, :3, :3], normal)
    common = finger.sigma_point**2 + ((normal @ J) ** 2).sum()
    assert (variances > 0.98 * common).all()


@pytest.fixture(scope="module")
def gelled(can):
    """The can's rig with a gel in the palm's frame that lies where the can is, and its observations with images."""
    T = can.T_palm_object
    outward = -T[:3, 3] + (T[:3, 3] @ T[:3, 2]) * T[:3, 2]  # from the can's axis to the palm's origin
    z = -outward / np.linalg.norm(outward)
    R = np.column_stack([np.cross(T[:3, 2], z), T[:3, 2], z])
    T_palm_gel = se3.compose(R, T[:3, 3] - (0.033 - 5e-4) * z)
    gel = pad_scenes.gel(frame=can.rig.hand.palm, T_frame_grid=T_palm_gel, scale=-1e-3)
    rng, observations = np.random.default_rng(1), []
    rest = 4.0 + 0.01 * rng.normal(size=IMAGE)
    pressed = pad_scenes.hanging(pad_scenes.rigid(can.model, se3.inverse(T_palm_gel) @ T), 1e-3)
    sensors = FingertipSensors(can.rig)
    for each in can.observations:
        touching = sensors.contacts(each).contacts is not None
        image = rest + 0.01 * rng.normal(size=IMAGE) - 1e3 * pressed * touching
        observations.append(replace(each, stamp=1000 + each.stamp, skin={"gel": image}))
    topics = replace(can.rig.topics, skin={"gel": "/gel/height"})
    return replace(can.rig, skin={"gel": gel}, topics=topics), observations


def test_a_gels_baseline_is_learnt_at_rest_and_its_contacts_are_on_the_can(can, gelled):
    rig, observations = gelled
    tracker = followed(rig, can.model, observations)
    assert tracker.skin.pressed
    contacts = tracker.skin.contacts()
    places = se3.apply(se3.inverse(can.T_palm_object), contacts.points_palm)
    np.testing.assert_allclose(np.hypot(*places[:, :2].T), 0.033, atol=2e-4)
    assert across(can, tracker.estimate.T_palm_object) < 2e-3


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(("kind", "scale"), [("32FC1", 1.0), ("16UC1", 1e6)])
def test_a_depth_image_of_ros_1_and_2_is_a_gels_reading(encoding, kind, scale):
    image = np.linspace(0, 1e-3, 4800).reshape(IMAGE)
    pixels = (scale * image).astype("<f4" if kind == "32FC1" else "<u2")
    message = Message(header=header(1_700_000_000.0), height=60, width=80, encoding=kind, is_bigendian=0,
                      step=80 * pixels.itemsize, data=pixels.view(np.uint8).ravel())  # fmt: skip
    seen, _ = observed(robot(gel=GEL), serialized("sensor_msgs/msg/Image", message, encoding))
    np.testing.assert_array_equal(seen.skin["gel"], pixels)
    narrow = robot(gel=pad_scenes.gel(columns=41))
    _, topic = observed(narrow, serialized("sensor_msgs/msg/Image", message, encoding))
    assert topic.used == 0
    (reason,) = topic.reasons
    assert reason.startswith("skin gel: expected 30 x 41 taxels")


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_a_bool_and_a_number_are_readings_of_pads(encoding):
    pad = pad_scenes.SHAPES["palm"].pad()
    for kind, value in (("Bool", True), ("UInt8", 1), ("Float32", 1.0), ("UInt16", 1)):
        message = serialized(f"std_msgs/msg/{kind}", Message(data=value), encoding)
        seen, topic = observed(robot(pad=pad), message)
        np.testing.assert_array_equal(seen.skin["pad"], [1.0])
        assert topic.used == 1
    values = np.arange(15, dtype=np.float32)
    several = Message(layout=Message(dim=[], data_offset=0), data=values)
    message = serialized("std_msgs/msg/Float32MultiArray", several, encoding)
    assert observed(robot(pad=pad), message)[1].used == 0
    one = {"thumb": "data[3]", "index": "data[0]"}
    seen, _ = observed(robot(one, thumb=pad, index=pad), message)
    assert (seen.skin["thumb"], seen.skin["index"]) == ([3.0], [0.0])


def test_the_command_tracks_a_recording_with_a_gel(gelled, tmp_path, monkeypatch, capsys):
    rig, observations = gelled
    (tmp_path / "gel.rig.yaml").write_text(text(rig))
    with RecordingWriter(tmp_path / "gel.mcap", rig) as writer:
        for each in observations:
            writer.write(each)
    with open_recording(tmp_path / "gel.mcap", rig) as recording:
        heard = list(recording.observations())
    written = rig.skin["gel"].reading(observations[-1].skin["gel"])
    np.testing.assert_allclose(heard[-1].skin["gel"], written, atol=1e-6)
    assert called(monkeypatch, tmp_path, "track", "gel.mcap", "--object", "can", columns=100) == 0
    assert "pressed in" in capsys.readouterr().err
    summary = json.loads((tmp_path / "gel-track" / "summary.json").read_text())
    assert summary["poses_with_skin"] > 0.7 * len(observations)
    assert called(monkeypatch, tmp_path, "rig", "check", "gel.rig.yaml", columns=120) == 1
    table, said = capsys.readouterr()
    assert "skin gel: " in said + table  # here it hangs in the air, off its link's mesh
