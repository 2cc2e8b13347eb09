"""The rigs of `examples/`, each with its hand's real file: where the taxels are, and messages as the vendors send them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import handsight as hs
from hand.hands import data_file
from handsight import se3
from handsight.messages import ObservationStream, RawMessage
from handsight.messages.encode import Message, header, parts
from handsight.messages.read import typestore
from handsight.rig.layouts import misplaced

EXAMPLES = Path(hs.__file__).with_name("data") / "rigs"
HANDS = {
    "allegro": "allegro_hand/allegro_hand_right.urdf",
    "allegro_xela": "allegro_hand/allegro_hand_right.urdf",
    "leap_xela": "leap_hand/right_hand.xml",
    "inspire": "inspire_hand/inspire_hand_right.urdf",
    "dg5f": "dg5f_description/urdf/dg5f_right.urdf",
    "shadow": "shadow_hand/right_hand.xml",
}
TACTILE = ("allegro_xela", "leap_xela", "inspire")
REGIONS = {"tip": 9, "nail": 96, "pad": 80, "middle_section": 0}
"""Counts of an Inspire finger; the thumb has a middle section of 9 and a pad of 96."""
LARGEST, BEYOND = 4e-3, 0.03
"""Distance of a taxel from its link's mesh; a length along its normal that is farther than a link is thick [m]."""


@pytest.fixture
def rig(request, monkeypatch):
    """An example's rig; skipped where its hand's file is absent."""
    hands = data_file(f"hands/{HANDS[request.param]}").parents[HANDS[request.param].count("/")]
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(hands))
    return hs.Rig.from_file(EXAMPLES / f"{request.param}.rig.yaml")


def of(*names):
    return pytest.mark.parametrize("rig", names, indirect=True)


@of(*HANDS)
def test_the_end_and_the_front_of_each_tips_shape_are_on_its_links_mesh(rig):
    """The end is where the tip points; the front and the sides are where an object touches it. One hand has no mesh."""
    meshes = rig.hand.link_meshes()
    assert len(rig.hand.moving) >= 2 * len(rig.fingers)
    for name, finger in rig.fingers.items():
        if finger.frame in meshes:
            mesh = trimesh.Trimesh(*meshes[finger.frame], process=False)
            axes = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
            ends = se3.apply(finger.T_frame_surface, axes * finger.tip.semi_axes)
            _, distance, _ = trimesh.proximity.closest_point_naive(mesh, ends)
            assert distance.max() < 2e-3, (name, distance)


@of(*TACTILE)
def test_taxels_are_on_their_links_with_normals_out_of_them(rig):
    assert not misplaced(rig.skin, rig.hand)
    meshes = rig.hand.link_meshes()
    for name, surface in rig.skin.items():
        mesh = trimesh.Trimesh(*meshes[surface.frame], process=False)
        _, distance, _ = trimesh.proximity.closest_point_naive(mesh, surface.points)
        assert distance.max() < LARGEST, (name, distance.max())
        _, beyond, _ = trimesh.proximity.closest_point_naive(mesh, surface.points + BEYOND * surface.normals)
        assert beyond.min() > 0.6 * BEYOND, (name, beyond.min())


@of("allegro_xela", "leap_xela")
def test_xelas_surfaces_have_as_many_taxels_as_its_sensors_and_no_sensor_twice(rig):
    counts = {"tip": 30, "low": 16, "high": 16, "middle": 16}
    for name, surface in rig.skin.items():
        expected = 24 if name.startswith("palm") else counts[name.split("_")[1]]
        assert (len(surface.points), surface.components) == (expected, 3)
    paths = list(rig.topics.skin_fields.values())
    assert len(set(paths)) == len(paths) == len(rig.skin)


@of("inspire")
def test_inspires_surfaces_are_all_regions_of_its_message(rig):
    sizes = {rig.topics.skin_fields[name]: len(each.points) for name, each in rig.skin.items()}
    assert sizes == {path: values.size for path, values in regions().items()}
    assert sum(sizes.values()) == 1062


def regions():
    """Zeros for each region of an InspireHandTouch, by path."""
    found = {"palm": np.zeros(112, np.int16)}
    for finger in ("little", "ring", "middle", "index", "thumb"):
        thumb = {"pad": 96, "middle_section": 9} if finger == "thumb" else {}
        found |= {f"{finger}.{region}": np.zeros(n, np.int16) for region, n in (REGIONS | thumb).items() if n}
    return found


def inspire(values, stamp):
    some = {"total_pressure": 0.0, "max_pressure": 0.0, "contact_count": 0}
    fingers = {}
    for path, each in values.items():
        finger, _, region = path.partition(".")
        if region:
            empty = {"middle_section": np.zeros(0, np.int16)}
            fingers.setdefault(finger, Message(name=finger, **some | empty)).__dict__[region] = each
    rest = {"total_contact": 0.0, "fingers_in_contact": 0, "stable_contact": False}
    message = Message(header=header(stamp), **fingers, palm=values["palm"], **rest)
    return "inspire_hand_ros2/msg/InspireHandTouch", message


def xela(values, stamp):
    sensors = []
    for path, forces in values.items():
        position = int(path.split("=")[1].split("]")[0])
        forces = [parts("xyz", force.astype(np.float32)) for force in forces]
        taxels = [Message(x=0, y=0, z=0) for _ in forces]
        sensors.append(
            Message(message=1, time=stamp, model="uSPa44", sensor_pos=position, taxels=taxels, forces=forces)
        )
    return "xela_server_ros2/msg/SensStream", Message(sensors=sensors)


def observations(rig, topic_messages, joints, count=24):
    """Observations of `count` instants, 20 ms from one to the next: messages by topic are made for each instant."""
    stream, found = ObservationStream(rig), []
    store = typestore("cdr")
    for k in range(count):
        stamp = 100 + 0.02 * k
        names = list(joints)
        state = Message(
            header=header(stamp), name=names, position=np.array(list(joints.values())), velocity=np.zeros(0),
            effort=np.zeros(0),
        )  # fmt: skip
        sent = {rig.topics.joint_states: ("sensor_msgs/msg/JointState", state)} | topic_messages(
            k, stamp + 0.001
        )
        for topic, (kind, message) in sent.items():
            data = bytes(store.serialize_cdr(message, kind))
            found += stream.put(RawMessage(topic, kind, "cdr", stamp, data))
    return [*found, *stream.finish()]


def tracked(rig, given):
    tracker = hs.Tracker(rig, rig.objects["can"].model())
    for each in given:
        tracker.update(each)
    return tracker.fingertips


@of(*TACTILE)
def test_a_message_of_the_vendors_form_gives_a_contact_at_the_pressed_taxel(rig):
    """Each finger's first surface in turn is pressed about a taxel in its middle."""
    joints = dict.fromkeys(rig.hand.joint_names, 0.3)
    full, of_message = (3000, inspire) if "palm" in rig.skin else (2.0, xela)
    for finger, on in rig.fingers.items():
        name = next(name for name, each in rig.skin.items() if each.frame == on.frame)
        surface = rig.skin[name]
        middle = np.linalg.norm(surface.points - surface.points.mean(axis=0), axis=1).argmin()
        away = np.linalg.norm(surface.points - surface.points[middle], axis=1)
        force = full * np.exp(-((away / (0.9 * surface.pitch)) ** 2))

        def sent(k, stamp, name=name, force=force):
            values = {}
            for other, each in rig.skin.items():
                read = np.zeros((len(each.points), each.components))
                if other == name and k >= 12:
                    read[:, -1] = force
                values[rig.topics.skin_fields[other]] = (
                    read if of_message is xela else read[:, 0].astype(np.int16)
                )
            return {next(iter(rig.topics.skin.values())): of_message(values, stamp)}

        touch = tracked(rig, observations(rig, sent, joints))
        assert touch.fingers == (finger,)
        T = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(joints), strict=True))[finger]
        expected = se3.apply(T, surface.points[[middle]])[0]
        assert np.linalg.norm(touch.contacts.points_palm[0] - expected) < surface.pitch
        inward = -T[:3, :3] @ surface.normals[middle]
        assert touch.contacts.normals_palm[0] @ inward > 0.9


@of("dg5f", "allegro")
def test_a_push_on_a_tip_reaches_the_tracker_as_a_wrench(rig):
    """A push of 2 N at the tip's side, square to its surface, as its sensor reads it."""
    joints = dict.fromkeys(rig.hand.joint_names, 0.3)
    finger, on = list(rig.fingers.items())[1]
    T_sensor = se3.inverse(on.tip.T_surface_sensor)
    normal = np.array([0.6, 0.0, 0.8])  # outward, in the surface's axes
    point = on.tip.radius * normal
    sign = {"on_sensor": 1, "on_tip": -1}[on.calibration.reading]
    force = -2 * T_sensor[:3, :3] @ normal
    torque = np.cross(se3.apply(T_sensor, point[None])[0], force)
    rng = np.random.default_rng(0)

    def sent(k, stamp):
        messages = {}
        for name, topic in rig.topics.wrenches.items():
            f, t = (sign * force, sign * torque) if name == finger and k >= 12 else (np.zeros(3), np.zeros(3))
            wrench = Message(force=parts("xyz", f + 1e-3 * rng.normal(size=3)), torque=parts("xyz", t))
            messages[topic] = (
                "geometry_msgs/msg/WrenchStamped",
                Message(header=header(stamp), wrench=wrench),
            )
        return messages

    touch = tracked(rig, observations(rig, sent, joints))
    assert touch.fingers == (finger,)
    T = rig.hand.Ts_palm_tip(joints)[list(rig.hand.tips).index(finger)] @ on.T_frame_surface
    assert np.linalg.norm(touch.contacts.points_palm[0] - se3.apply(T, point[None])[0]) < 1e-3


@of("shadow")
def test_a_shadow_tips_own_contact_reaches_the_tracker(rig):
    joints = dict.fromkeys(rig.hand.joint_names, 0.3)
    point = np.array([0.0, -0.0072, 0.0])  # on the pad's side, from the surface's centre

    def sent(k, stamp):
        messages = {}
        for name, topic in rig.topics.contacts.items():
            force = 1.5 if name == "mf" and k >= 12 else 0.0
            zero = parts("xyz", np.zeros(3))
            message = Message(
                header=header(stamp), tangential_force=zero, contact_position=parts("xyz", point),
                contact_normal=parts("xyz", np.array([0.0, 1.0, 0])), f_normal=force, l_torque=0.0,
            )  # fmt: skip
            messages[topic] = ("sr_robot_msgs/msg/ShadowContactStateStamped", message)
        return messages

    touch = tracked(rig, observations(rig, sent, joints))
    assert touch.fingers == ("mf",)
    T = rig.hand.Ts_palm_tip(joints)[list(rig.hand.tips).index("mf")] @ rig.fingers["mf"].T_frame_surface
    np.testing.assert_allclose(touch.contacts.points_palm[0], se3.apply(T, point[None])[0], atol=1e-6)
