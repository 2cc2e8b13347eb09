"""Mistakes that a recording shows: each is named where it was made, and none where none was made."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.objects import ObjectModel
from handsight.rig.save import pose_text
from handsight.tracking.consistency import Excerpt
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.mistakes import T_BODY_OPTICAL, find_mistakes

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
X180 = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def recorded(simulated):
    """`recorded(object, **scenario)`: a rig, the object's model, and observations of a grasp that lifts and turns."""
    from handsight.simulation import Scenario, rig_of

    def record(object, **fields):
        scenario = Scenario(object=object, **{"motion": "manipulate", "rate": 10, **fields})
        rig = rig_of(scenario)
        return rig, rig.objects[object].model(), [each.observation for each in simulated(scenario)]

    return record


def excerpt_of(rig, observations):
    """The excerpt of observations as a rig reads them."""
    excerpt, tips = Excerpt(rig), FingertipSensors(rig)
    for observation in observations:
        excerpt.put(observation, touched=bool(tips.contacts(observation).fingers))
    return excerpt


def said(excerpt, model=None):
    named, unexplained = find_mistakes(excerpt, model)
    return [*map(str, named), *filter(None, [unexplained])]


def found(rig, observations, model=None):
    """What is said of observations."""
    return said(excerpt_of(rig, observations), model)


def assert_nothing_is_said(rig, model, observations):
    excerpt = excerpt_of(rig, observations)
    assert said(excerpt, model) == said(excerpt) == []


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


SWAPPED = {"ff": "mf", "mf": "ff"}
IN_RIG = {
    "the other sign of the forces of all fingers": with_fingers(other_sign),
    "the other sign of the forces of th": with_fingers(other_sign, "th"),
    "the other direction of the tip of all fingers": with_fingers(into_finger),
    "gravity the other way": lambda rig: replace(rig, gravity=-rig.gravity),
}
FIRST = next(iter(IN_RIG))
OF_CAMERA = {
    "the camera in its inverse pose": camera(se3.inverse),
    "the camera in its body's frame": camera(lambda T: T @ se3.inverse(T_BODY_OPTICAL)),
}
IN_RECORDING = {
    "exchanged topics of ff, mf": wrenches(lambda name, all: all[SWAPPED.get(name, name)]),
    "vision's quaternion as w, x, y, z": as_wxyz,
    "joints in degrees": joints(lambda q: {name: np.rad2deg(x) for name, x in q.items()}),
    "forces in gram-force": wrenches(lambda name, all: all[name] / 9.80665e-3),
    "torques in N mm": wrenches(lambda name, all: all[name] * np.repeat([1, 1e3], 3)),
    "forces behind the torques": wrenches(lambda name, all: np.roll(all[name], 3)),
    "positions of joints in reverse": joints(lambda q: dict(zip(q, list(q.values())[::-1], strict=True))),
}


def test_nothing_is_named_where_nothing_is_wrong(recorded):
    assert_nothing_is_said(*recorded("box"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("object", "sensors"), [("can", "wrench"), ("can", "xela"), ("box", "paxini"), ("can", "inspire")]
)
def test_nothing_is_named_of_any_sensor_where_nothing_is_wrong(recorded, object, sensors):
    assert_nothing_is_said(*recorded(object, seed=int(object == "box"), sensors=sensors))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensors", "seed"), [("wrench", 0), ("wrench", 1), ("xela", 2), ("paxini", 0), ("inspire", 1)]
)
def test_nothing_is_named_of_what_the_palm_bears_too(recorded, sensors, seed):
    assert_nothing_is_said(*recorded("can", motion="grasp", seed=seed, sensors=sensors, skin=True))


@pytest.mark.parametrize(
    "what", [pytest.param(what, marks=[] if what == FIRST else pytest.mark.slow) for what in IN_RIG]
)
def test_a_mistake_in_the_rig_is_named_with_the_line_that_mends_it(recorded, what):
    rig, model, observations = recorded("box")
    [sentence] = found(IN_RIG[what](rig), observations, model)
    assert sentence.startswith(what)
    assert "set " in sentence


@pytest.mark.slow
@pytest.mark.parametrize("what", IN_RECORDING)
def test_a_mistake_in_what_was_recorded_is_named(recorded, what):
    rig, model, observations = recorded("box")
    [sentence] = found(rig, list(map(IN_RECORDING[what], observations)), model)
    assert sentence.startswith(what)


@pytest.mark.slow
@pytest.mark.parametrize("what", OF_CAMERA)
def test_a_camera_in_another_of_its_frames_is_named_with_its_pose(recorded, what):
    rig, model, observations = recorded("can")
    [sentence] = found(OF_CAMERA[what](rig), observations, model)
    assert sentence.startswith(what)
    assert f"set camera.pose: {pose_text(rig.camera.T_mount_camera)}" in sentence


@pytest.mark.slow
def test_of_two_mistakes_both_are_named(recorded):
    rig, model, observations = recorded("box")
    wrong = IN_RIG["the other sign of the forces of th"](rig)
    sentences = found(wrong, list(map(as_wxyz, observations)), model)
    assert {text.split(" fits better")[0] for text in sentences} == {
        "the other sign of the forces of th",
        "vision's quaternion as w, x, y, z",
    }


@pytest.mark.parametrize("object", ["box", pytest.param("can", marks=pytest.mark.slow)])
def test_the_same_mistake_of_several_fingers_is_one_with_all_their_lines(recorded, object):
    rig, model, observations = recorded(object)
    wrong = with_fingers(other_sign, "ff", "mf", *(["rf", "lf"] if object == "can" else []))(rig)
    [found], unexplained = find_mistakes(excerpt_of(wrong, observations), model)
    meant = {
        name: f"fingers.{name}.sensor.reading: {finger.calibration.reading}"
        for name, finger in rig.fingers.items()
        if finger.calibration != wrong.fingers[name].calibration
    }
    assert found.fixes == meant
    assert not unexplained


def test_a_camera_that_is_far_off_is_no_other_mistake(recorded):
    rig, model, observations = recorded("box")
    shift = se3.compose(np.eye(3), np.array([0.3, 0.0, 0.0]))
    wrong = camera(lambda T: T @ shift)(rig)
    found, unexplained = find_mistakes(excerpt_of(wrong, observations), model)
    assert found == []
    assert "calibrate the camera" in unexplained


def test_what_no_mistake_explains_is_said(recorded):
    rig, _, observations = recorded("can")
    [sentence] = found(rig, observations, ObjectModel.sphere(0.4))
    assert "no mistake explains it" in sentence


def test_an_excerpt_spreads_over_a_recording_of_any_length(recorded):
    rig, _, observations = recorded("can")
    excerpt = Excerpt(rig)
    for k in range(5000):
        excerpt.put(replace(observations[0], stamp=float(k)), touched=False)
    stamps = [each.stamp for each in excerpt.observations]
    assert 20 < len(stamps) <= 100
    assert np.ptp(np.diff(stamps)) == 0
    assert stamps[-1] > 4000
