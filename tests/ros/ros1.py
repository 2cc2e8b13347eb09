"""A ROS 1 graph of processes on a free port of this machine alone, ended with the test."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import xmlrpc.client
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from xmlrpc.server import SimpleXMLRPCServer

import numpy as np
import pytest

from handsight.messages.read import typestore
from handsight.recording.bags import Rosbag1Source

PACKAGE = Path(__file__).parents[2] / "ros" / "handsight_ros1"
MISSING = [name for name in ("rosmaster", "rosbag") if shutil.which(name) is None]
needs_ros1 = pytest.mark.skipif(bool(MISSING), reason=f"ROS 1 is not installed: no {', '.join(MISSING)}")


class Graph:
    """A master and what talks to it."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri, self.folder, self.processes = f"http://127.0.0.1:{self.port}", folder, []
        self.environment = {key: value for key, value in os.environ.items() if not key.startswith("ROS")} | {
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_LOG_DIR": str(folder),
            "ROS_HOME": str(folder),
            "PYTHONUNBUFFERED": "1",
        }
        self.master = self.start_master()

    def start_master(self):
        process = self.run("rosmaster", "--core", "-p", str(self.port))
        self.wait_for(lambda: self.state() is not None, "the master")
        return process

    def run(self, *command):
        """A process; what it says is in `said`. Debian's own Python runs Debian's commands."""
        environment = dict(self.environment)
        if command[0] != sys.executable:
            environment.pop("PYTHONPATH", None)
        log = self.folder / f"{len(self.processes)}.log"
        with log.open("wb") as file:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )
        process.log = log
        self.processes.append(process)
        return process

    def node(self, rig, **parameters):
        """The node, ready."""
        script = PACKAGE / "scripts" / "handsight_node"
        given = [f"_{key}:={value}" for key, value in {"rig": rig, **parameters}.items()]
        process = self.run(sys.executable, str(script), *given)
        self.wait_for(lambda: "is ready" in process.log.read_text(), "the node", process)
        return process

    def state(self):
        """Publishers, subscribers and services, by name those who are; None: no master."""
        try:
            code, _, found = xmlrpc_call(self.uri, "getSystemState", "/test")
        except (OSError, xmlrpc.client.Error):
            return None
        return [dict(each) for each in found] if code == 1 else None

    def subscribers(self, topic):
        return (self.state() or [{}, {}])[1].get(topic, [])

    @contextmanager
    def reader(self, topic, kind):
        """Somebody who subscribes, and reads nothing but what a test takes: a socket, TCPROS by hand."""
        code, _, where = xmlrpc_call(self.uri, "lookupNode", "/test", "/handsight")
        assert code == 1
        _, _, (_, host, port) = xmlrpc_call(where, "requestTopic", "/reader", topic, [["TCPROS"]])
        fields = {"callerid": "/reader", "topic": topic, "type": kind, "md5sum": "*"}
        lines = [f"{key}={value}".encode() for key, value in fields.items()]
        said = b"".join(len(line).to_bytes(4, "little") + line for line in lines)
        with socket.socket() as reader:
            reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            reader.settimeout(90.0)
            reader.connect((host, port))
            reader.sendall(len(said).to_bytes(4, "little") + said)
            # Only one whose header has come hears all that is said.
            size = int.from_bytes(reader.recv(4, socket.MSG_WAITALL), "little")
            assert len(reader.recv(size, socket.MSG_WAITALL)) == size
            yield reader

    def record(self, *topics):
        """`rosbag record`, listening."""
        path = self.folder / f"recorded{len(self.processes)}.bag"
        before = {topic: len(self.subscribers(topic)) for topic in topics}
        process = self.run("rosbag", "record", "--buffsize=0", "--tcpnodelay", "-O", str(path), *topics)
        self.wait_for(
            lambda: all(len(self.subscribers(topic)) > before[topic] for topic in topics), "record", process
        )
        process.path = path
        return process

    def wait_for(self, condition, what, process=None, limit=90.0):
        begun = time.monotonic()
        while not condition():
            if process is not None and process.poll() is not None:
                raise AssertionError(f"{what} ended: {process.log.read_text()[-2000:]}")
            if time.monotonic() - begun > limit:
                told = "" if process is None else process.log.read_text()[-2000:]
                raise AssertionError(f"waited {limit} s for {what}: {told}")
            time.sleep(0.05)

    @staticmethod
    def interrupt(process, limit=60.0):
        """Ctrl-C; how long it took to end [s]."""
        begun = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        process.wait(limit)
        return time.monotonic() - begun

    def recorded(self, recorder):
        """Where it is, once it is closed: `rosbag record` is ended before what it has begun."""
        self.interrupt(recorder)
        self.wait_for(recorder.path.exists, f"{recorder.path.name} to be closed")
        return recorder.path

    def close(self):
        for process in reversed(self.processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait(30)


def xmlrpc_call(uri, name, *arguments):
    with xmlrpc.client.ServerProxy(uri) as server:
        return getattr(server, name)(*arguments)


@contextmanager
def graph(folder):
    running = Graph(folder)
    try:
        yield running
    finally:
        running.close()


@contextmanager
def endless_publisher(running, topic):
    """Somebody who publishes joint states, and whose first message is announced to be of 4 GiB less 16 bytes.

    Yields how many bytes were sent, and whether the connection was ended.
    """
    sent = [0, False]

    def publish(server):
        client, _ = server.accept()
        with client:
            client.recv(4096)
            fields = (
                "callerid=/endless",
                "md5sum=3066dcd76a6cfaef579bd0f34173e9fd",
                "type=sensor_msgs/JointState",
            )
            said = b"".join(len(each).to_bytes(4, "little") + each.encode() for each in fields)
            client.sendall(len(said).to_bytes(4, "little") + said + (0xFFFFFFF0).to_bytes(4, "little"))
            with suppress(OSError):
                while sent[0] < 1 << 28:
                    sent[0] += client.send(bytes(1 << 16))
                    time.sleep(0.001)
            sent[1] = sent[0] < 1 << 28

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=publish, args=(server,), daemon=True).start()
        master = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        where = ["TCPROS", "127.0.0.1", server.getsockname()[1]]
        master.register_function(lambda *_: (1, "", where), "requestTopic")
        threading.Thread(target=master.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{master.server_address[1]}"
        xmlrpc_call(running.uri, "registerPublisher", "/endless", topic, "sensor_msgs/JointState", address)
        try:
            yield sent
        finally:
            master.shutdown()
            master.server_close()


def read_until(reader, kind, stamp):
    """The messages that a reader receives, of a kind with a header or of transforms, until one of that time [s].

    None is lost, unlike by `rosbag record`, whose queue of 100 overflows on a busy machine when the first seconds of
    answers come at once.
    """
    found, last = [], -1.0
    with reader.makefile("rb") as file:
        while last < stamp - 1e-6:
            data = file.read(int.from_bytes(file.read(4), "little"))
            assert data, "the publisher ended"
            found.append(typestore("ros1").deserialize_ros1(data, kind))
            last = stamp_of(getattr(found[-1], "transforms", found[-1:])[-1])
    return found


def stamp_of(message):
    """When a message with a header was stamped [s]."""
    return round(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, 6)


def messages_of(path, topic):
    """What was recorded on a topic, read."""
    with closing(Rosbag1Source(path)) as source:
        return [
            typestore("ros1").deserialize_ros1(each.data, each.type) for each in source.messages((topic,))
        ]


def poses_of(path):
    """By stamp the position and quaternion that were recorded."""
    return by_stamp(messages_of(path, "/handsight/pose"))


def by_stamp(messages):
    """Position and quaternion of PoseWithCovarianceStamped by stamp."""
    poses = {stamp_of(message): message.pose.pose for message in messages}
    return {
        stamp: np.array(
            [p.position.x, p.position.y, p.position.z, *(getattr(p.orientation, a) for a in "xyzw")]
        )
        for stamp, p in poses.items()
    }
