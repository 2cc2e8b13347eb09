"""Real ROS 2 (rclpy and Fast DDS, in a virtual environment of its own) says a recording to the node and to the bridge."""

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.cli.demo import DATA
from handsight.live import Answer
from handsight.live.asked import START_TOPIC
from handsight.messages.decode import typestore
from handsight.messages.topics import POSE_COVARIANCE
from tests.live.recorded import poses, read, rig, said, tracked
from tests.ros.ros2 import processes, same

pytestmark = pytest.mark.slow
ROOT, RIG = Path(__file__).parents[2], DATA / "can.rig.yaml"
NODE = ROOT / "ros" / "handsight_ros2" / "handsight_ros2" / "node.py"


def python_of(release):
    """The Python of a release of ROS 2, made by .ci/lab-ros2."""
    python = ROOT / f".ros2-{release}" / "bin" / "python"
    if not python.is_file():
        pytest.skip(f"there is no ROS 2 {release} here: .ci/lab-ros2 {release} makes it")
    return str(python)


def installed(python, package):
    folders = (Path(python).parents[1] / "lib").glob(f"python3.*/site-packages/{package}")
    return any(folders)


def started(running, kind, python):
    """The node or the bridge, ready; waits as for a recording."""
    if kind == "bridge":
        return running.bridge(RIG, "--equal")
    given = [text for value in (f"rig:={RIG}", "equal:=true") for text in ("-p", value)]
    process = running.run(python, str(NODE), "--ros-args", *given)
    running.wait_for(lambda: "is ready" in process.log.read_text(), "the node", process)
    return process


def answers_of(running, python, messages, folder):
    """What rclpy hears when it says that, after a while of silence."""
    played, answered = folder / "said.pickle", folder / "answered.pickle"
    played.write_bytes(pickle.dumps([(m.topic, m.type, m.log_time, m.data) for m in messages]))
    script = Path(__file__).with_name("rclpy_robot.py")
    robot = running.run(python, str(script), str(played), str(answered))
    assert robot.wait(90) == 0, robot.log.read_text()[-2000:]
    return [Answer(*each) for each in pickle.loads(answered.read_bytes())]


def ended_well(running, follower):
    ended = running.interrupt(follower)
    assert (follower.returncode, "Traceback" in follower.log.read_text()) == (0, False)
    assert ended < 5.0  # of a machine that may be busy; alone it is below one


@pytest.mark.parametrize("kind", ["node", "bridge"])
def test_poses_are_those_of_track(tmp_path, kind):
    python = python_of("jazzy")
    if not installed(python, "tf2_msgs"):
        pytest.skip(
            "tf2_msgs could not be built for ROS 2 jazzy (it needs cmake): there is no pose without /tf"
        )
    messages = [each for each in said() if each.topic != "/truth/object"]
    with processes(tmp_path) as running:
        follower = started(running, kind, python)
        answers = answers_of(running, python, messages, tmp_path)
        same(answers, tracked(messages))
        assert sum(each.topic == "/handsight/markers" for each in answers) > 5
        assert [s.message for each in answers if each.topic == "/diagnostics" for s in read(each).status]
        ended_well(running, follower)


def in_the_palm(message):
    """A camera's pose as a user's, which needs no /tf."""
    store = typestore("cdr")
    seen = store.deserialize_cdr(message.data, POSE_COVARIANCE)
    moved = replace(seen, header=replace(seen.header, frame_id=rig().frames["palm"]))
    return message._replace(topic=START_TOPIC, data=bytes(store.serialize_cdr(moved, POSE_COVARIANCE)))


def test_fast_dds_3_is_heard_and_hears(tmp_path):
    """Without the bridge's cure joint states, and poses out, would be lost."""
    python = python_of("kilted")
    messages = [each for each in said() if each.topic not in ("/truth/object", "/tf", "/vision/object")]
    start = in_the_palm(next(each for each in said() if each.topic == "/vision/object"))
    with processes(tmp_path) as running:
        follower = started(running, "bridge", python)
        answers = answers_of(running, python, [start, *messages], tmp_path)
        joints = sum(each.topic == "/joint_states" for each in messages)
        # The start is taken when the worker gets to it.
        assert len(poses(answers)) > joints / 2
        assert max(poses(answers)) == round(messages[-1].log_time, 6)
        ended_well(running, follower)
