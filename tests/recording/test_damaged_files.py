"""A file that was cut or damaged gives what lies before, or is refused; none brings the reader down or fills memory."""

import bz2
import sqlite3
import struct
import tracemalloc
from contextlib import contextmanager
from zlib import crc32

import numpy as np
import pytest
from backports import zstd
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.errors import HandsightError, InvalidFile
from handsight.recording import open_recording
from messages.ros import START, Messages, everything, rig, touched
from recording.bags import alone, read, save

M = Messages()


def record(op: int, body: bytes) -> bytes:
    """Returns a record of an MCAP file."""
    return struct.pack("<BQ", op, len(body)) + body


def text(data: bytes) -> bytes:
    """Returns a string as an MCAP file stores it."""
    return struct.pack("<I", len(data)) + data


def packed_messages(count: int) -> bytes:
    """Returns an MCAP file in which a zstd chunk with this number of empty joint states is repeated three times."""
    raw = record(5, struct.pack("<HIQQ", 1, 0, 10**9, 10**9)) * count
    packed = zstd.compress(raw)
    head = record(
        3, struct.pack("<H", 1) + text(b"sensor_msgs/msg/JointState") + text(b"ros2msg") + text(b"")
    )
    head += record(4, struct.pack("<HH", 1, 1) + text(b"/joint_states") + text(b"cdr") + text(b""))
    about = struct.pack("<QQQI", 10**9, 10**9, len(raw), 0) + text(b"zstd") + struct.pack("<Q", len(packed))
    return b"\x89MCAP0\r\n" + head + 3 * record(6, about + packed) + record(2, bytes(20)) + b"\x89MCAP0\r\n"


def whole(folder, kind, count=400, **options):
    """The bytes of a recording, and where it lies. Long enough for two chunks where compression is none."""
    names = [f"j{i}" for i in range(120)]
    rows = touched(count, messages=Messages(1 if kind == "bag" else 2))
    if kind != "bag":
        rows += [
            (
                "/joint_states",
                START + i / 100 + 1e-3,
                M.joints(START + i / 100 + 1e-3, names, np.arange(120.0)),
            )
            for i in range(count)
        ]
    path = save(folder, sorted(rows, key=lambda row: row[1]), kind, **options)
    path = path if kind == "bag" else alone(path)
    return path, path.read_bytes()


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89MCAP1\r\n"])
def test_another_file_than_a_recording_is_refused(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(InvalidFile):
        open_recording(path, rig())


def test_a_missing_file_and_an_empty_folder_are_refused(tmp_path):
    for path in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(InvalidFile):
            open_recording(path, rig())


@pytest.mark.parametrize(
    "statements",
    [
        ["CREATE TABLE cats (name)"],
        [
            "CREATE TABLE topics (id, name, type, serialization_format)",
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) "
            "SELECT i AS topic_id, i AS timestamp, i AS data FROM n",
        ],
    ],
    ids=["another", "an endless view"],
)
def test_another_database_than_a_rosbag_2_is_refused(tmp_path, statements):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as base:
        for statement in statements:
            base.execute(statement)
    base.close()
    with pytest.raises(InvalidFile):
        open_recording(path, rig())


@pytest.mark.parametrize("compression", [None, "STORAGE"])
def test_an_mcap_cut_in_the_middle_of_a_chunk_gives_the_chunks_before(tmp_path, compression):
    path, data = whole(tmp_path, "mcap", count=1500, compression=compression)
    _, recording = read(path)
    all_of_it = recording.report.observations
    path.write_bytes(data[: int(len(data) * 0.6)])
    observations, recording = read(path)
    assert 0.1 * all_of_it < len(observations) < 0.9 * all_of_it
    assert any("mcap recover" in fault for fault in recording.report.faults)


@pytest.mark.parametrize(("kind", "tool"), [("bag", "rosbag reindex"), ("db3", "sqlite3")])
@pytest.mark.parametrize("part", [0.4, 0.95])
def test_a_bag_that_was_cut_is_refused_with_the_tool_that_mends_it(tmp_path, kind, tool, part):
    path, data = whole(tmp_path, kind)
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(InvalidFile, match=tool):
        open_recording(path, rig())


def test_an_mcap_that_was_never_closed_lacks_only_its_end(tmp_path):
    path, data = whole(tmp_path, "mcap")
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")  # from DataEnd on there is only the summary
    first, _ = read(path)
    for rest in (b"", bytes(1 << 20)):  # and the space that a recorder may have reserved
        path.write_bytes(data[:at] + rest)
        observations, recording = read(path)
        assert [seen.stamp for seen in observations] == [seen.stamp for seen in first]
        assert recording.report.faults


def test_a_bag_that_was_never_closed_is_refused_with_the_tool_that_mends_it(tmp_path):
    path, data = whole(tmp_path, "bag")
    at = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)[0]
    path.write_bytes(data[:at])
    with pytest.raises(InvalidFile, match="rosbag reindex"):
        open_recording(path, rig())


def test_an_mcap_without_its_index_is_read(tmp_path):
    path, data = whole(tmp_path, "mcap")
    first, _ = read(path)
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    path.write_bytes(data[:at] + footer + data[:8])
    observations, recording = read(path)
    assert [seen.stamp for seen in observations] == [seen.stamp for seen in first]
    assert recording.report.faults == []


def test_a_file_cut_before_its_first_topic_is_refused(tmp_path):
    path, data = whole(tmp_path, "mcap")
    path.write_bytes(data[:60])
    with pytest.raises(InvalidFile, match="mcap recover"):
        open_recording(path, rig())


def test_a_damaged_chunk_is_reported_and_what_lies_before_is_read(tmp_path):
    path, data = whole(tmp_path, "mcap", count=1500)
    first, _ = read(path)
    at = len(data) // 2
    spoilt = bytearray(data)
    spoilt[at : at + 3000] = bytes(3000)
    path.write_bytes(spoilt)
    observations, recording = read(path)
    assert 0 < len(observations) < len(first)
    # The last ones may lack a wrench that came in the damaged chunk.
    assert [seen.stamp for seen in observations] == [seen.stamp for seen in first[: len(observations)]]
    assert len(recording.report.faults) == 1


def mcap_with_chunk(path, packed, size, compression, crc=0):
    """An MCAP file of one chunk that may lie."""
    name = compression.encode()
    body = (
        struct.pack("<QQQI", 0, 0, size, crc)
        + struct.pack("<I", len(name))
        + name
        + struct.pack("<Q", len(packed))
        + packed
    )
    header = struct.pack("<BQ", 1, 8) + bytes(8)
    path.write_bytes(b"\x89MCAP0\r\n" + header + struct.pack("<BQ", 6, len(body)) + body)
    return path


def bombs():
    import lz4.frame
    from backports import zstd

    zeros = bytes(1 << 24)
    return {"zstd": zstd.compress(zeros), "lz4": lz4.frame.compress(zeros), "bz2": bz2.compress(zeros)}


@contextmanager
def at_most(most):
    """Asserts that no more than this is allocated at any time [bytes]."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def refused_within(path, most):
    """Asserts that a recording is refused, and that no more than this was allocated [bytes]."""
    with at_most(most), pytest.raises(InvalidFile):
        open_recording(path, rig())


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_unpacks_to_no_more_than_it_says(tmp_path, compression):
    refused_within(mcap_with_chunk(tmp_path / "a.mcap", bombs()[compression], 1000, compression), 6e6)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2", "", "rar"])
def test_a_chunk_that_says_it_is_huge_or_of_an_unknown_kind_is_not_unpacked(tmp_path, compression):
    packed = bombs().get(compression, b"x")
    refused_within(mcap_with_chunk(tmp_path / "a.mcap", packed, 1 << 62, compression), 6e6)


@pytest.mark.parametrize("op", [3, 4, 5, 6, 9])
@pytest.mark.parametrize("length", [1 << 60, 1 << 34, (1 << 64) - 1, 3])
def test_a_length_that_lies_takes_no_memory(tmp_path, op, length):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", op, length) + b"\xff" * 100)
    refused_within(path, 6e6)


def test_a_chunk_with_a_wrong_checksum_is_not_used(tmp_path):
    path, data = whole(tmp_path, "mcap", count=50)
    begin = data.index(b"\x06", 8)
    size = struct.unpack_from("<Q", data, begin + 9 + 16)[0]
    records = data[begin + 9 + 40 :][:size]
    mcap_with_chunk(path, records, size, "", crc32(records))
    assert len(read(path)[0]) == 100
    mcap_with_chunk(path, records, size, "", crc32(records) ^ 1)
    with pytest.raises(InvalidFile):
        open_recording(path, rig())


def test_a_chunk_of_a_bag_that_unpacks_to_gigabytes_is_not_unpacked(tmp_path):
    path = save(tmp_path, touched(messages=Messages(1)), "bag", compression="BZ2")
    data = bytearray(path.read_bytes())
    at, packed = data.index(b"BZh"), bz2.compress(bytes(1 << 28))
    data[at : at + len(packed)] = packed
    path.write_bytes(data)
    with at_most(300e6), pytest.raises(InvalidFile):
        read(path)


def spoilt(data, rng):
    """Some bytes, or eight at once, set at random; one in three is cut as well."""
    data = bytearray(data)
    for _ in range(rng.integers(20)):
        at, width = rng.integers(len(data)), rng.choice([1, 1, 8])
        data[at : at + width] = rng.bytes(width)
    return data[: rng.integers(len(data))] if rng.random() < 0.3 else data


@pytest.mark.parametrize(
    ("kind", "compression"),
    [("mcap", None), ("mcap", "STORAGE"), ("bag", None), ("bag", "LZ4"), ("bag", "BZ2"), ("db3", None)],
)
def test_no_damage_brings_the_reader_down_and_every_message_is_counted_once(tmp_path, kind, compression):
    path = save(tmp_path, everything(Messages(1 if kind == "bag" else 2)), kind, compression=compression)
    path = path if kind == "bag" else alone(path)
    data, rng, survived = path.read_bytes(), np.random.default_rng(0), 0
    for i in range(250):
        path = tmp_path / f"spoilt{i}"
        path.write_bytes(spoilt(data, rng))
        try:
            observations, recording = read(path)
        except HandsightError:
            continue
        survived += bool(observations)
        for topic in recording.report.topics.values():
            counts = topic.used, topic.duplicated, topic.nan, topic.late, topic.bad, topic.stale, topic.stuck
            assert sum(counts) == topic.messages
        assert all(isinstance(said, str) for said in recording.report.sentences() + recording.lacks())
        path.unlink()
    assert survived > 10


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.binary(max_size=400))
def test_random_bytes_behind_the_magic_are_no_recording(tmp_path_factory, tail):
    folder = tmp_path_factory.mktemp("random")
    for magic in (b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0"):
        path = folder / "a"
        path.write_bytes(magic + tail)
        with pytest.raises(InvalidFile):
            read(path)


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_file_packed_from_next_to_nothing_is_refused_before_the_disk_is_full(tmp_path, kind):
    from backports import zstd

    path = save(tmp_path, touched(), kind, compression="FILE")
    (file,) = path.glob("*.zstd")
    for content in (zstd.compress(bytes(3 << 27)), b"nothing of that kind"):
        file.write_bytes(content)
        with pytest.raises(InvalidFile):
            open_recording(path, rig())


def test_empty_messages_do_not_take_memory(tmp_path):
    """A few kilobytes that unpack to many megabytes of messages of nothing."""
    path = tmp_path / "a.mcap"
    path.write_bytes(packed_messages(20_000))
    with at_most(50e6):
        observations, _ = read(path)
    assert observations == []
