"""Mistakes that a recording shows: each is named where it was made, and none where none was made."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.rig.save import pose_text
from handsight.tracking.consistency import Excerpt
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.mistakes import TURNS, find_mistakes

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
Z90, Z180, X180 = (dict(TURNS)[name] for name in ("90° about z", "180° about z", "180° about x"))


@pytest.fixture(scope="module")
def recorded(simulated):
    """`recorded(object, **scenario)`: a rig, the object's model, and observations of a grasp that lifts and turns."""
    from handsight.simulation import Scenario, rig_of

    def record(object, **fields):
        scenario = Scenario(object=object, motion="manipulate", **{"rate": 10, **fields})
        rig = rig_of(scenario)
        return rig, rig.objects[object].model(), [each.observation for each in simulated(scenario)]

    return record


def found(rig, observations, model=None):
    """What is said of observations as a rig reads them."""
    excerpt, tips = Excerpt(rig), FingertipSensors(rig)
    for observation in observations:
        excerpt.put(observation, touched=bool(tips.contacts(observation).fingers))
    return [str(each) for each in find_mistakes(excerpt, model)]


def with_fingers(change, *names):
    def changed(rig):
        fingers = {n: change(f) if not names or n in names else f for n, f in rig.fingers.items()}
        return replace(rig, fingers=fingers)

    return changed


def camera(change):
    return lambda rig: replace(
        rig, camera=replace(rig.camera, T_mount_camera=change(rig.camera.T_mount_camera))
    )


def other_sign(finger):
    known = finger.calibration
    return replace(
        finger, calibration=replace(known, reading="on_sensor" if known.reading == "on_tip" else "on_tip")
    )


def turned_sensor(R):
    return lambda finger: replace(
        finger, tip=finger.tip.with_sensor(finger.tip.T_surface_sensor @ se3.compose(R, np.zeros(3)))
    )


def into_finger(finger):
    T = se3.compose(X180, np.zeros(3))
    tip = finger.tip.with_sensor(T @ finger.tip.T_surface_sensor)
    return replace(finger, T_frame_surface=finger.T_frame_surface @ T, tip=tip)


def wrenches(change):
    return lambda o: replace(o, wrenches={name: change(name, o.wrenches) for name in o.wrenches})


def joints(change):
    return lambda o: replace(o, joint_positions=change(o.joint_positions))


def as_wxyz(o):
    if o.vision is None:
        return o
    T = o.vision.T_frame_object
    q = se3.quaternion_from_rotation(T[:3, :3])[[3, 0, 1, 2]]  # w, x, y, z, read as x, y, z, w
    return replace(o, vision=replace(o.vision, T_frame_object=se3.from_position_quaternion(T[:3, 3], q)))


def turned_palm(R):
    return lambda o: replace(o, T_world_palm=o.T_world_palm @ se3.compose(R, np.zeros(3)))


SWAPPED = {"ff": "mf", "mf": "ff"}
IN_RIG = {
    "the other sign of the forces of all fingers": with_fingers(other_sign),
    "the other sign of the forces of th": with_fingers(other_sign, "th"),
    "the sensor of ff turned by 90° about -z": with_fingers(turned_sensor(Z90), "ff"),
    "the sensor of all fingers turned by 90° about -z": with_fingers(turned_sensor(Z90)),
    "the sensor of th turned by 180° about x": with_fingers(turned_sensor(X180), "th"),
    "the tip of each finger pointing along its -z": with_fingers(into_finger),
    "gravity the other way": lambda rig: replace(rig, gravity=-rig.gravity),
}
OF_CAMERA = {
    "the camera in its inverse pose": camera(se3.inverse),
    "the camera turned by 90° about -z": camera(lambda T: T @ se3.compose(Z90, np.zeros(3))),
}
IN_RECORDING = {
    "another order of the topics of ff, mf": wrenches(lambda name, all: all[SWAPPED.get(name, name)]),
    "the other sign of the forces of all": wrenches(lambda name, all: -all[name]),
    "vision's quaternion as w, x, y, z": as_wxyz,
    "joints in degrees": joints(lambda q: {name: np.rad2deg(x) for name, x in q.items()}),
    "forces in millinewtons, torques in mN m": wrenches(lambda name, all: 1e3 * all[name]),
    "torques in N mm": wrenches(lambda name, all: all[name] * np.repeat([1, 1e3], 3)),
    "positions of joints in reverse": joints(lambda q: dict(zip(q, list(q.values())[::-1], strict=True))),
    "the palm in the world turned by 90° about -z": turned_palm(Z90),
}


def test_nothing_is_named_where_nothing_is_wrong(recorded):
    rig, model, observations = recorded("box")
    assert found(rig, observations, model) == found(rig, observations) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("sensors", ["wrench", "xela", "paxini", "inspire"])
def test_nothing_is_named_of_any_sensor_where_nothing_is_wrong(recorded, sensors, seed):
    rig, model, observations = recorded(("can", "box")[seed % 2], seed=seed, sensors=sensors)
    assert found(rig, observations, model) == found(rig, observations) == []


def cases(mistakes, quick):
    """Mistakes with the object named, and not; all but a few are slow."""
    return [
        pytest.param(what, named, marks=[] if what in quick and not named else pytest.mark.slow)
        for what in mistakes
        for named in (True, False)
    ]


@pytest.mark.parametrize(("what", "named"), cases(IN_RIG, [next(iter(IN_RIG)), "gravity the other way"]))
def test_a_mistake_in_the_rig_is_named(recorded, what, named):
    rig, model, observations = recorded("box")
    [sentence] = found(IN_RIG[what](rig), observations, model if named else None)
    assert what in sentence.split(" fits better")[0]


@pytest.mark.parametrize(
    ("what", "named"), cases(IN_RECORDING, [next(iter(IN_RECORDING)), "vision's quaternion as w, x, y, z"])
)
def test_a_mistake_in_what_was_recorded_is_named(recorded, what, named):
    rig, model, observations = recorded("box")
    [sentence] = found(rig, list(map(IN_RECORDING[what], observations)), model if named else None)
    assert what in sentence.split(" fits better")[0]


@pytest.mark.slow
@pytest.mark.parametrize("what", OF_CAMERA)
def test_a_camera_in_another_of_its_frames_is_named_where_the_object_is(recorded, what):
    rig, model, observations = recorded("can")
    [sentence] = found(OF_CAMERA[what](rig), observations, model)
    assert sentence.startswith(what)
    assert f"set camera.pose: {pose_text(rig.camera.T_mount_camera)}" in sentence


@pytest.mark.slow
def test_the_line_to_change_mends_the_rig(recorded):
    rig, model, observations = recorded("box")
    wrong = IN_RIG["the sensor of ff turned by 90° about -z"](rig)
    [sentence] = found(wrong, observations, model)
    values = sentence.split("quaternion_xyzw: [")[1].split("]")[0].split(",")
    sensor = rig.fingers["ff"].T_frame_surface @ rig.fingers["ff"].tip.T_surface_sensor
    R = se3.rotation_from_quaternion(np.array(values, float))
    np.testing.assert_allclose(R, sensor[:3, :3], atol=1e-6)


@pytest.mark.slow
def test_of_two_mistakes_both_are_named(recorded):
    rig, model, observations = recorded("box")
    wrong = IN_RIG["the other sign of the forces of th"](rig)
    sentences = found(wrong, list(map(as_wxyz, observations)), model)
    assert [text.split(" fits better")[0] for text in sentences] == [
        "the other sign of the forces of th",
        "vision's quaternion as w, x, y, z",
    ]


@pytest.mark.slow
def test_exchanged_fields_of_taxels_are_named(recorded):
    rig, model, observations = recorded("can", sensors="xela")
    a, b = next(iter(rig.skin)), list(rig.skin)[-2]
    exchanged = [
        replace(o, skin=dict(o.skin) | {a: o.skin[b], b: o.skin[a]}) if {a, b} <= o.skin.keys() else o
        for o in observations
    ]
    [sentence] = found(rig, exchanged, model)
    assert sentence.startswith(f"another order of the topics of {a}, {b} fits better")


def test_an_excerpt_spreads_over_a_recording_of_any_length(recorded):
    rig, _, observations = recorded("can")
    excerpt = Excerpt(rig)
    for k in range(5000):
        excerpt.put(replace(observations[0], stamp=float(k)), touched=False)
    stamps = [each.stamp for each in excerpt.observations.some()]
    assert 20 < len(stamps) <= 48
    assert np.ptp(np.diff(stamps)) == 0
    assert stamps[-1] > 4500
