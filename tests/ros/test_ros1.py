"""The node of ROS 1 among real processes: a master, rosbag, Ctrl-C."""

import shutil
import socket
import sys
import time
from importlib.util import find_spec

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from rosbags import rosbag1

from handsight.cli.demo import DATA
from handsight.messages import RosType
from handsight.messages.read import typestore
from tests.live.recorded import in_ros1, said, tracked
from tests.ros.pages import free_port, gone, served
from tests.ros.ros1 import (
    PACKAGE,
    by_stamp,
    endless_publisher,
    graph,
    messages_of,
    needs_ros1,
    poses_of,
    read_until,
    stamp_of,
)

pytestmark = [needs_ros1, pytest.mark.slow]
RIG = DATA / "can.rig.yaml"


def bag(path, messages, *, spoilt=""):
    """A recording of ROS 1 without the truth; what comes on the topic `spoilt` is of another type than it should be."""
    store = typestore("ros1")
    with rosbag1.Writer(path) as writer:
        connections = {}
        for each in in_ros1(each for each in messages if each.topic != "/truth/object"):
            kind, data = each.type, each.data
            if each.topic == spoilt:
                kind, data = (
                    "std_msgs/msg/Header",
                    each.data[: 16 + int.from_bytes(each.data[12:16], "little")],
                )
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(each.topic, kind, typestore=store)
            sec = int(each.log_time)
            writer.write(connections[each.topic], sec * 10**9 + round((each.log_time - sec) * 1e9), data)
    return path


def play(running, path, limit=60.0):
    """The recording, played at its own pace, heard by the node alone and whole."""
    process = running.run("rosbag", "play", "--quiet", "--wait-for-subscribers", "--delay=0.5", str(path))
    process.wait(limit)
    assert process.returncode == 0, process.log.read_text()


def test_poses_are_those_of_track_and_ctrl_c_ends_within_a_second(tmp_path):
    expected = tracked(said())
    topics = "/handsight/pose", "/tf", "/handsight/markers", "/diagnostics"
    played = bag(tmp_path / "can.bag", said())
    with graph(tmp_path) as running:
        options = {"view": free_port()} if find_spec("viser") else {}
        node = running.node(RIG, object="can", equal="true", **options)
        address = served(node) if options else ""
        recorder = running.record(*topics)
        with (
            running.reader("/handsight/pose", "geometry_msgs/PoseWithCovarianceStamped") as poses,
            running.reader("/tf", "tf2_msgs/TFMessage") as transforms,
        ):
            play(running, played)
            # The last is answered a second after its message.
            found = by_stamp(read_until(poses, "geometry_msgs/msg/PoseWithCovarianceStamped", max(expected)))
            links = read_until(transforms, "tf2_msgs/msg/TFMessage", max(expected))
        ended = running.interrupt(node)
        assert (node.returncode, "Traceback" in node.log.read_text()) == (0, False)
        running.wait_for(lambda: not options or gone(address), "the page's end")
        path = running.recorded(recorder)
        assert set(found) == set(expected)
        np.testing.assert_allclose(
            [found[stamp][:3] for stamp in expected], [T[:3, 3] for T in expected.values()], rtol=0, atol=1e-9
        )
        own = [link for each in links for link in each.transforms if link.child_frame_id == "object"]
        assert [stamp_of(link) for link in own] == sorted(found)
        assert max(found) in poses_of(path)
        assert len(messages_of(path, "/handsight/markers")) > 5
        statuses = [s for each in messages_of(path, "/diagnostics") for s in each.status]
        assert "the position is known to 7 mm only" in {status.message for status in statuses}
        told = [value.value for status in statuses for value in status.values]
        assert not [sentence for sentence in told if "too late" in sentence]  # it does not hear itself
        assert ended < 5.0  # of a machine that may be busy; alone it is below one


@pytest.mark.skipif(shutil.which("roslaunch") is None, reason="roslaunch is not installed")
def test_the_launch_file_starts_and_ends_the_node(tmp_path):
    with graph(tmp_path) as running:
        running.environment |= {"ROS_PACKAGE_PATH": str(PACKAGE.parent), "HANDSIGHT_PYTHON": sys.executable}
        launched = running.run(
            "roslaunch", "handsight_ros1", "handsight.launch", f"rig:={RIG}", "object:=can", "rate:=20"
        )
        try:
            running.wait_for(lambda: "is ready" in launched.log.read_text(), "the node", launched)
            assert running.subscribers("/joint_states") == ["/handsight"]
        finally:
            running.interrupt(launched)  # which ends the node; killed, it would leave it
        running.wait_for(lambda: not running.subscribers("/joint_states"), "the node's end")


def test_the_node_survives_what_happens_in_a_lab(tmp_path):
    """A master that is restarted, a sender that dies, a reader that never reads, a wrong type; and services."""
    played = bag(tmp_path / "can.bag", said(), spoilt="/th/wrench")
    with graph(tmp_path) as running:
        node = running.node(RIG)
        running.master.kill()
        running.master.wait()
        running.start_master()
        offered = {"/handsight/reset", "/handsight/set_object"}
        running.wait_for(lambda: offered <= set(running.state()[2]), "the node's return", node)
        assert running.subscribers("/joint_states")
        recorder = running.record("/handsight/pose", "/diagnostics")
        dies = running.run("rosbag", "play", "--quiet", "--wait-for-subscribers", str(played))
        running.wait_for(
            lambda: "tracking" in node.log.read_text() or "uncertain" in node.log.read_text(), "poses", node
        )
        dies.kill()
        with running.reader("/handsight/pose", "geometry_msgs/PoseWithCovarianceStamped"):
            play(running, played)
        called = running.run("rosservice", "call", "/handsight/reset")
        assert called.wait(60) == 0
        assert "success: True" in called.log.read_text()
        time.sleep(1.5)
        path = running.recorded(recorder)
        assert max(poses_of(path)) > said()[-1].log_time - 0.5
        told = [
            value.value
            for each in messages_of(path, "/diagnostics")
            for status in each.status
            for value in status.values
        ]
        wrong = f"/th/wrench: expected {RosType.WRENCH}, got std_msgs/msg/Header"
        assert any(wrong in sentence for sentence in told), told[-20:]
        assert "registered anew" in node.log.read_text()


def test_a_wrong_parameter_is_said_in_a_sentence_and_so_is_that_there_is_no_master(tmp_path):
    with graph(tmp_path) as running:
        for given, expected in (
            ({"object": "spoon"}, "object: expected a name of the rig (can)"),
            ({"images": "maybe"}, "parameter images: expected true or false, got maybe (a text)"),
            (
                {"images": "true", "objekt": "can"},
                "parameter objekt: unknown key; the nearest valid one is 'object'",
            ),
        ):
            with pytest.raises(AssertionError) as error:
                running.node(RIG, **given)
            assert expected in str(error.value)
            assert "Traceback" not in str(error.value)
        running.master.kill()
        running.master.wait()
        with pytest.raises(AssertionError) as error:
            running.node(RIG)
        assert f"handsight: no ROS master answers at {running.uri}" in str(error.value)


def test_a_silent_connection_keeps_no_subscriber_waiting(tmp_path):
    kind = "diagnostic_msgs/DiagnosticArray"
    with graph(tmp_path) as running:
        running.node(RIG, object="can")
        with (
            running.reader("/diagnostics", kind) as first,
            socket.create_connection(first.getpeername()) as silent,
        ):
            began = time.monotonic()
            with running.reader("/diagnostics", kind):
                assert time.monotonic() - began < 3.0
            silent.settimeout(30.0)
            assert silent.recv(1) == b""  # the node has closed it


def test_a_publisher_of_a_message_of_4_gib_is_disconnected(tmp_path):
    with graph(tmp_path) as running, endless_publisher(running, "/joint_states") as sent:
        node = running.node(RIG, object="can")
        refused = "/joint_states: expected messages of at most 16777216 bytes"
        running.wait_for(lambda: refused in node.log.read_text(), "the refusal", node)
        running.wait_for(lambda: sent[1], "the end of the connection", node)
        assert sent[0] < 1 << 25
