"""Real ROS 2 (rclpy and Fast DDS, in a virtual environment of its own) says a recording to the node and to the bridge."""

import pickle
from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.cli.demo import DATA
from handsight.live import Answer
from tests.live.recorded import read, said, tracked
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


@pytest.mark.parametrize(("kind", "release"), [("node", "jazzy"), ("bridge", "jazzy"), ("bridge", "kilted")])
def test_poses_are_those_of_track(tmp_path, kind, release):
    python = python_of(release)
    with_tf = installed(python, "tf2_msgs")
    messages = [each for each in said() if each.topic != "/truth/object" and (with_tf or each.topic != "/tf")]
    played, answered = tmp_path / "said.pickle", tmp_path / "answered.pickle"
    played.write_bytes(pickle.dumps([(m.topic, m.type, m.log_time, m.data) for m in messages]))
    with processes(tmp_path) as running:
        follower = started(running, kind, python)
        robot = running.run(
            python, str(Path(__file__).with_name("rclpy_robot.py")), str(played), str(answered)
        )
        expected = tracked(messages)
        assert robot.wait(90) == 0, robot.log.read_text()[-2000:] + follower.log.read_text()[-2000:]
        answers = [Answer(*each) for each in pickle.loads(answered.read_bytes())]
        same(answers, expected)
        assert sum(each.topic == "/handsight/markers" for each in answers) > 5
        told = [s.message for each in answers if each.topic == "/diagnostics" for s in read(each).status]
        assert told
        ended = running.interrupt(follower)
        assert (follower.returncode, "Traceback" in follower.log.read_text()) == (0, False)
        assert ended < 5.0  # of a machine that may be busy; alone it is below one
