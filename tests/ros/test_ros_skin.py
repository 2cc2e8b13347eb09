"""The nodes of ROS 1 and ROS 2 among real processes, with a robot whose fingertips are taxels."""

import pickle

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("cyclonedds", reason="the processes of ROS 2 need cyclonedds")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from rosbags import rosbag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handsight.messages.read import typestore
from handsight.rig.save import write
from tests.live.recorded import poses, read
from tests.live.skin_messages import PLAIN, content, raw, skin_messages, skin_rig, tracked_skin
from tests.ros.ros1 import by_stamp, graph, needs_ros1, read_until
from tests.ros.ros2 import NODE, processes
from tests.ros.test_ros1 import play
from tests.ros.test_ros2_rclpy import answers_of, ended_well, robot

pytestmark = pytest.mark.slow


def rig_file(folder, rig):
    write(rig, folder / "skin.rig.yaml")
    return folder / "skin.rig.yaml"


def across(place, T):
    """How far a place is from the can's, across its axis; along it nothing but vision tells, to 27 mm at the end.

    Plain arrays are timed by when they come, so that single poses have other readings than those of the file.
    """
    off = place - T[:3, 3]
    return float(np.linalg.norm(off - (off @ T[:3, 2]) * T[:3, 2]))


@needs_ros1
def test_the_node_of_ros_1_reads_every_drivers_taxels_by_the_definition_that_comes_with_them(tmp_path):
    rig, messages = skin_rig(), skin_messages("ros1")
    (expected, _), store = tracked_skin(rig, messages), typestore("ros1")
    short = [
        content(each.type, each.log_time, {"ff": np.zeros((29, 3))})
        for each in messages
        if each.topic == "/tactile"
    ]
    with rosbag1.Writer(tmp_path / "skin.bag") as writer:
        connections = {}
        for each in messages:
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(each.topic, each.type, typestore=store)
            writer.write(connections[each.topic], round(each.log_time * 1e9), each.data)
            if each.topic == "/tactile":  # refused, and the node goes on
                wrong = raw(each.topic, each.type, "ros1", each.log_time, short.pop(0))
                writer.write(connections[each.topic], round(each.log_time * 1e9), wrong.data)
    with graph(tmp_path) as running:
        node = running.node(rig_file(tmp_path, rig), object="can", equal="true")
        with (
            running.reader("/handsight/pose", "geometry_msgs/PoseWithCovarianceStamped") as reader,
            running.reader("/diagnostics", "diagnostic_msgs/DiagnosticArray") as health,
        ):
            play(running, tmp_path / "skin.bag")
            found = by_stamp(read_until(reader, "geometry_msgs/msg/PoseWithCovarianceStamped", max(expected)))
            said = health.recv(1 << 20)
        running.interrupt(node)
        assert (node.returncode, "Traceback" in node.log.read_text()) == (0, False)
    assert set(found) >= set(expected)
    assert b"touching" in said
    assert np.median([across(found[stamp][:3], T) for stamp, T in expected.items()]) < 1e-3


def test_the_node_of_ros_2_reads_taxels_of_any_type_whose_package_is_sourced(tmp_path):
    rig, messages = skin_rig(PLAIN), skin_messages(types=PLAIN)
    expected, _ = tracked_skin(rig, [each._replace(definition=defined(each.type)) for each in messages])
    wrong = raw(
        "/mf/taxels", PLAIN["mf"][1], "cdr", 0.0, content(PLAIN["mf"][1], 0.0, {"mf": np.zeros((29, 3))})
    )
    given = [(m.topic, m.type, m.log_time, m.data) for m in messages]
    given.insert(len(given) // 2, (wrong.topic, wrong.type, given[len(given) // 2][2], wrong.data))
    named = "messages left out: skin mf: expected 30 x 3 taxels"
    with processes(tmp_path) as running:
        plays = robot(
            running,
            "jazzy",
            tmp_path,
            ("say", given),
            ("hear", "/handsight/pose", len(expected)),
            ("told", named),
        )
        node = running.node(rig_file(tmp_path, rig), object="can", equal="true")
        answers = answers_of(plays, tmp_path)
        ended_well(running, node)
    found = poses(answers)
    assert set(found) >= set(expected)
    assert np.median([across(found[stamp][0][:3], T) for stamp, T in expected.items()]) < 1e-3
    told = [
        value.value
        for each in answers
        if each.topic == "/diagnostics"
        for s in read(each).status
        for value in s.values
    ]
    assert any("expected 30 x 3 taxels, got 87 numbers" in sentence for sentence in told)
    touching = [
        s.values[2].value for each in answers if each.topic == "/diagnostics" for s in read(each).status[:1]
    ]
    assert any("th" in fingers for fingers in touching)  # which is of a type that nobody expects of taxels


def defined(kind):
    """The definition of a type that ROS 2 has itself."""
    return get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(kind)[0]


KINDS = (
    "geometry_msgs/msg/PoseArray",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "visualization_msgs/msg/MarkerArray",
    "std_msgs/msg/UInt16MultiArray",
)


def test_a_definition_from_a_messages_class_is_that_of_its_package(tmp_path):
    """Read by rosbags, both have the same fields."""
    script = tmp_path / "definitions.py"
    script.write_text(
        "import pickle, sys\n"
        f"sys.path.insert(0, {str(NODE.parent)!r})\n"
        "import node\n"
        f"found = {{kind: node.definition(node.made(*kind.split('/'))) for kind in {KINDS!r}}}\n"
        "pickle.dump(found, open(sys.argv[1], 'wb'))\n"
    )
    with processes(tmp_path) as running:
        process = running.rclpy("jazzy", script, tmp_path / "found.pickle")
        assert process.wait(60) == 0, process.log.read_text()[-2000:]
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, text in pickle.loads((tmp_path / "found.pickle").read_bytes()).items():
        for name, (_, fields) in get_types_from_msg(text, kind).items():
            assert fields == store.fielddefs[name][1], name
