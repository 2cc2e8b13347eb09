"""Real ROS 2 (rclpy and Fast DDS, in an environment of its own) says a recording to the node and to the bridge."""

import pickle
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.cli.demo import DATA
from handsight.live import Answer
from handsight.messages import RosType
from handsight.messages.encode import Message, header, pose_with_covariance
from handsight.messages.read import typestore
from tests.live.recorded import read, said, tracked
from tests.ros.ros2 import processes, same

pytestmark = pytest.mark.slow
RIG = DATA / "can.rig.yaml"
ROBOT = Path(__file__).with_name("rclpy_robot.py")
STRING, A = "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0\0\0"
"""A type that nobody expects of a sensor, and a message of it."""


def users_pose():
    """A pose in the palm."""
    at = {"header": header(0.0, "palm"), "pose": pose_with_covariance(np.eye(4), None)}
    return bytes(typestore("cdr").serialize_cdr(Message(**at), RosType.POSE_COVARIANCE))


def robot(running, release, folder, *steps):
    """A robot that does that; see its script."""
    (folder / "steps.pickle").write_bytes(pickle.dumps(steps))
    return running.rclpy(release, ROBOT, folder / "steps.pickle", folder / "answers.pickle")


def answers_of(process, folder):
    """What it heard by the end."""
    assert process.wait(120) == 0, process.log.read_text()[-2000:]
    return [Answer(*each) for each in pickle.loads((folder / "answers.pickle").read_bytes())]


def sentences_of(answers):
    """What the diagnostics said."""
    statuses = [s for each in answers if each.topic == "/diagnostics" for s in read(each).status]
    return [value.value for status in statuses for value in status.values]


def ended_well(running, follower):
    ended = running.interrupt(follower)
    assert (follower.returncode, "Traceback" in follower.log.read_text()) == (0, False)
    assert ended < 5.0  # of a machine that may be busy; alone it is below one


@pytest.mark.parametrize(("release", "kind"), [("jazzy", "node"), ("jazzy", "bridge"), ("kilted", "bridge")])
def test_poses_are_those_of_track(tmp_path, release, kind):
    """Without the bridge's cure for Kilted's Fast DDS 3 joint states, and poses out, would be lost."""
    messages = [each for each in said() if each.topic != "/truth/object"]
    expected = tracked(messages)
    play = [(m.topic, m.type, m.log_time, m.data) for m in messages]
    with processes(tmp_path) as running:
        plays = robot(running, release, tmp_path, ("say", play), ("hear", "/handsight/pose", len(expected)))
        follower = (
            running.bridge(RIG, "--as-recorded") if kind == "bridge" else running.node(RIG, equal="true")
        )
        answers = answers_of(plays, tmp_path)
        same(answers, expected)
        assert sum(each.topic == "/handsight/markers" for each in answers) > 5
        links = [link for each in answers if each.topic == "/tf" for link in read(each).transforms]
        assert {link.child_frame_id for link in links} > {"object"}  # and the robot's own
        assert not [text for text in sentences_of(answers) if "too late" in text]  # it does not hear itself
        ended_well(running, follower)


def test_what_the_node_cannot_follow_is_said_in_a_sentence(tmp_path):
    with processes(tmp_path) as running:
        for given, expected in (
            ({"objekt": "can"}, "parameter objekt: unknown key; the nearest valid one is 'object'"),
            ({"images": "maybe"}, "parameter images: expected true or false, got maybe (a text)"),
        ):
            with pytest.raises(AssertionError) as error:
                running.node(RIG, **given)
            assert expected in str(error.value)
            assert "Traceback" not in str(error.value)


def test_the_node_serves_names_a_wrong_type_and_subscribes_to_what_comes_late(tmp_path):
    """Vision comes late and with a covariance: at first the node has subscribed to poses without one."""
    wrong = "/th/wrench"
    play = [
        (m.topic, *((STRING, m.log_time, A) if m.topic == wrong else (m.type, m.log_time, m.data)))
        for m in said()
        if m.topic != "/truth/object"
    ]
    half = len(play) // 2
    touch = [each for each in play[:half] if each[0] != "/vision/object"]
    named = f"on {wrong}: expected {RosType.WRENCH}, got {STRING}"
    with processes(tmp_path) as running:
        asks = robot(
            running,
            "jazzy",
            tmp_path,
            ("say", touch),
            ("told", named),
            ("say", play[half:]),
            ("hear", "/handsight/pose", 5),
            ("say", touch),
            ("told", "the clock went back by"),
            ("call", "/handsight/reset"),
            ("set", "object", "spoon"),
            ("call", "/handsight/set_object"),
            ("set", "object", "can"),
            ("call", "/handsight/set_object"),
            ("say", [("/handsight/object", STRING, 0.0, A)]),
            ("told", "/handsight/object: object: expected a name of the rig (can)"),
            ("say", [("/handsight/reset", "std_msgs/msg/Empty", 0.0, b"\0\1\0\0\0")]),
            ("told", "begun anew: vision's next pose starts"),
            ("say", [("/handsight/start", RosType.POSE_COVARIANCE, 0.0, users_pose())]),
            ("told", "begun anew from the user's pose"),
        )
        node = running.node(RIG, object="can")
        answers = answers_of(asks, tmp_path)
        reset, spoon, can = (each.data for each in answers if each.type == "std_srvs/srv/Trigger")
        assert reset == (True, "begun anew: vision's next pose starts")
        assert spoon[0] is False
        assert spoon[1].startswith("object: expected a name of the rig (can)")
        assert can == (True, "the object is can: vision's next pose starts")
        ended_well(running, node)
