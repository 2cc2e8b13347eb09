"""Recordings of all formats, and the messages in them."""

import dataclasses
import random
import sqlite3
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from handsight import checks
from handsight.errors import InvalidInput
from handsight.messages import Report
from handsight.recording import open_recording
from handsight.recording.chunks import UNPACKERS
from tests.corpus.door import NUMBERS, Case, Door, check_covariance, check_pose, check_sentence, spoilt_bytes
from tests.messages.ros import START, Messages, everything, heard, rig
from tests.recording.bags import alone, save

KINDS = [("mcap", None), ("mcap", "STORAGE"), ("db3", None), ("bag", None), ("bag", "LZ4"), ("bag", "BZ2")]
ROBOT = rig()
M = Messages()


@cache
def good(kind: str, compression: str | None) -> bytes:
    """Returns a recording with a few messages of every type."""
    with tempfile.TemporaryDirectory() as folder:
        ros = Messages(1 if kind == "bag" else 2)
        path = save(Path(folder), everything(ros), kind, compression=compression)
        return (path if kind == "bag" else alone(path)).read_bytes()


def check_observations(observations: list[Any], report: Report, lacks: list[str]) -> None:
    """Asserts that observations are physical and in order, but where the clock went back, and all messages counted.

    The report's sentences are checked too.
    """
    for observation in observations:
        assert all(abs(position) <= 1e6 for position in observation.joint_positions.values())
        for wrench in observation.wrenches.values():
            checks.load(wrench, "wrench", (6,))
        if observation.T_world_palm is not None:
            check_pose(observation.T_world_palm)
            checks.position(observation.T_world_palm[:3, 3], "T_world_palm", (3,))
        if observation.vision is not None:
            check_pose(observation.vision.T_frame_object)
            check_covariance(observation.vision.covariance)
        if observation.depth is not None:
            assert not (observation.depth <= 0).any()
            assert not np.isinf(observation.depth).any()
    back = sum(b.stamp < a.stamp for a, b in pairwise(observations))
    assert back <= (report.backwards[0] if report.backwards else 0)
    for topic in report.topics.values():
        parts = topic.used, topic.duplicated, topic.nan, topic.late, topic.bad, topic.stale, topic.stuck
        assert sum(parts) == topic.messages
        assert min(parts) >= 0
    sentences = [*report.sentences(), *lacks]
    assert len(sentences) < 100
    for each in sentences:
        check_sentence(each)


def read(data: bytes) -> Report:
    """Reads a recording from a file, checks its observations, and returns its report."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording"
        path.write_bytes(data)
        with open_recording(path, ROBOT) as recording:
            check_observations(list(recording.observations()), recording.report, recording.lacks())
            return recording.report


def put(rows: list[Any]) -> Report:
    """Puts messages into a stream, as from a robot, checks the observations, and returns the report."""
    observations, stream = heard(rows, ROBOT)
    check_observations(observations, stream.report, stream.lacks())
    return stream.report


def spoilt_message(message: Any, rng: random.Random) -> Any:
    """Returns a ROS message in which a number or a name is replaced."""
    name = rng.choice(
        [field.name for field in dataclasses.fields(message) if field.init and field.name != "__msgtype__"]
    )
    part = getattr(message, name)
    new: Any = part
    if dataclasses.is_dataclass(part):
        new = spoilt_message(part, rng)
    elif isinstance(part, np.ndarray) and part.size:
        new = part.copy()
        new[rng.randrange(part.size)] = rng.choice(NUMBERS[:-1] if part.dtype.kind == "f" else [0, 1, 127])
    elif isinstance(part, float):
        new = float(rng.choice(NUMBERS[:-1]))
    elif isinstance(part, str):
        new = rng.choice(["", "\x1b[2J\n", "a" * 3000, "palm", "world", "/camera", "rgb8", "32FC1"])
    elif isinstance(part, int):
        new = rng.choice([0, 1, 255]) if name == "is_bigendian" else rng.choice([0, 1, 2**31 - 1, part // 2])
    elif isinstance(part, list) and part:
        k = rng.randrange(len(part))
        new = list(part)
        new[k] = (
            spoilt_message(part[k], rng)
            if dataclasses.is_dataclass(part[k])
            else rng.choice(["", "\x1b", "j1"])
        )
    return dataclasses.replace(message, **{name: new})


def put_spoilt(rng: random.Random) -> None:
    """Puts messages into a stream, of which some have corrupted values."""
    rows = everything(M)
    for _ in range(rng.choice([1, 3, 10])):
        k = rng.randrange(len(rows))
        topic, log, message = rows[k]
        rows[k] = topic, log, spoilt_message(message, rng)
    if sentences := put(rows).sentences():
        raise InvalidInput(sentences[0])  # refused message by message


def one_refused(topic: str, message: Any, says: str) -> Callable[[], None]:
    """Returns a call that asserts that one bad message is refused by its topic, and all others are used."""

    def bring() -> None:
        report = put([*everything(M), (topic, START + 0.0351, message)])
        assert any(says in each for each in report.sentences()), report.sentences()
        found = report.topics[topic]
        assert found.bad == 1
        assert found.used == found.messages - 1
        assert report.observations >= 10

    return bring


def far(x: float) -> np.ndarray:
    """Returns a pose at x [m]."""
    T = np.eye(4)
    T[0, 3] = x
    return T


def record(op: int, body: bytes) -> bytes:
    """Returns a record of an MCAP file."""
    return struct.pack("<BQ", op, len(body)) + body


def text(data: bytes) -> bytes:
    """Returns a string as an MCAP file stores it."""
    return struct.pack("<I", len(data)) + data


def packed_messages(count: int) -> bytes:
    """Returns an MCAP file in which a zstd chunk with this number of empty joint states is repeated three times."""
    raw = record(5, struct.pack("<HIQQ", 1, 0, 10**9, 10**9)) * count
    packed = import_module(UNPACKERS["zstd"][0]).compress(raw)
    head = record(
        3, struct.pack("<H", 1) + text(b"sensor_msgs/msg/JointState") + text(b"ros2msg") + text(b"")
    )
    head += record(4, struct.pack("<HH", 1, 1) + text(b"/joint_states") + text(b"cdr") + text(b""))
    about = struct.pack("<QQQI", 10**9, 10**9, len(raw), 0) + text(b"zstd") + struct.pack("<Q", len(packed))
    return b"\x89MCAP0\r\n" + head + 3 * record(6, about + packed) + record(2, bytes(20)) + b"\x89MCAP0\r\n"


def few_messages() -> None:
    """Of messages that are packed into less than a byte each, few are read, and the report says so."""
    report = read(packed_messages(250_000))
    assert report.topics["/joint_states"].bad < 150_000
    assert any("expected at least a byte of the file for each message" in each for each in report.sentences())


def database(*statements: str) -> bytes:
    """Returns the database of a rosbag2 with one topic, after these statements."""
    with tempfile.TemporaryDirectory() as folder:
        base = sqlite3.connect(Path(folder) / "a.db3")
        base.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)")
        base.execute("INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')")
        for statement in statements:
            base.execute(statement)
        base.commit()
        base.close()
        return (Path(folder) / "a.db3").read_bytes()


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT i AS topic_id, i AS timestamp, i AS data FROM n"
HEAVY = "replace(hex(zeroblob(9000000)), '00', hex(zeroblob(9)))"


def many_topics() -> None:
    """Reads a hundred thousand topics of wrenches whose names have control characters."""
    from handsight.messages import ObservationStream

    topics = {f"/\x1b[2J\n{k}": "geometry_msgs/msg/WrenchStamped" for k in range(100_000)}
    stream = ObservationStream(ROBOT, topics)
    check_observations(stream.finish(), stream.report, stream.lacks())
    assert any(each.startswith("and 99988 more") for each in stream.report.sentences())


DOORS = [
    Door("open_recording", lambda rng: read(spoilt_bytes(good(*rng.choice(KINDS)), rng)) and None, 180),
    Door("ObservationStream", put_spoilt, 100),
]
CASES = [
    *(Case(f"a recording as it should be, {k}", lambda k=k: read(good(*k)) and None, None) for k in KINDS),
    Case("a vision pose 1e20 away", one_refused("/vision/object", M.pose(START + 0.035, far(1e20)), "within 1000 m, got 1e+20"), None),
    Case("a transform 1e200 away", one_refused("/tf", M.tf(START + 0.035, ("a", "b", far(1e200))), "within 1000 m, got 1e+200"), None),
    Case("a wrench of 1e300", one_refused("/ff/wrench", M.wrench(START + 0.035, [0, 0, 1e300, 0, 0, 0]), "within 100000 N"), None),
    Case("a joint at 1e300", one_refused("/joint_states", M.joints(START + 0.035, positions=(0, 1e300, 0)), "joint j1: expected"), None),
    Case("a covariance of 1e160", one_refused("/vision/object", M.pose(START + 0.035, np.eye(4), covariance=1e160 * np.eye(6)), "standard deviations"), None),
    Case("a covariance of 1e308 beside its diagonal", one_refused("/vision/object", M.pose(START + 0.035, np.eye(4), covariance=np.eye(6) + 1.7e308 * (1 - np.eye(6))), "positive semidefinite"), None),
    Case("a covariance of -1", one_refused("/vision/object", M.pose(START + 0.035, np.eye(4), covariance=-np.eye(6)), "positive semidefinite"), None),
    Case("millions of empty messages", few_messages, None),
    Case("columns that compute", lambda: read(database(f"CREATE TABLE messages (topic_id, timestamp, data AS ({HEAVY}))")) and None, "columns that are computed"),
    Case("a view for a table", lambda: read(database(f"CREATE VIEW messages AS {ENDLESS}")) and None, "got: the tables topics"),
    Case("a hundred thousand topics", many_topics, None),
]  # fmt: skip
