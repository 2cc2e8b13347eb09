"""A file that was cut or damaged gives what can be read of it, and says what was lost; none brings the reader down."""

import sqlite3
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.errors import HandsightError, InvalidFile
from handsight.recording import chunks, open_recording
from messages.ros import START, Messages, everything, rig, touched
from recording.bags import alone, read, save
from tests.corpus.recordings import packed_messages

M = Messages()
EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"


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


@pytest.mark.parametrize(
    ("content", "came"),
    [
        (b"", "an empty file"),
        (b"hello", "a file that begins with b'hello'"),
        (b"\x89MCAP1\r\n", "a file that begins"),
    ],
)
def test_another_file_than_a_recording_is_refused_in_a_sentence(tmp_path, content, came):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(InvalidFile) as error:
        open_recording(path, rig())
    assert str(error.value).startswith(f"{path}: {EXPECTED}, got {came}")


def test_a_missing_file_and_an_empty_folder_are_refused_in_a_sentence(tmp_path):
    with pytest.raises(InvalidFile, match="got no file"):
        open_recording(tmp_path / "none.mcap", rig())
    with pytest.raises(InvalidFile, match=r"got a folder without .mcap or .db3 files"):
        open_recording(tmp_path, rig())


def test_another_database_than_a_rosbag_2_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE cats (name)")
    base.close()
    with pytest.raises(InvalidFile, match=r"a.db3: expected a rosbag 2 in sqlite3, got: the tables cats$"):
        open_recording(path, rig())


def test_a_view_in_place_of_a_table_is_not_run(tmp_path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) "
            "SELECT i AS topic_id, i AS timestamp, i AS data FROM n"
        )
    base.close()
    with pytest.raises(InvalidFile, match="got: the tables topics$"):
        open_recording(path, rig())


@pytest.mark.parametrize("kind", ["mcap", "bag"])
@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_in_the_middle_of_a_chunk_gives_what_lies_before(tmp_path, kind, compressed):
    compression = {"mcap": "STORAGE", "bag": "LZ4"}[kind] if compressed else None
    path, data = whole(tmp_path, kind, compression=compression)
    _, recording = read(path)
    all_of_it = recording.report.observations
    cut = int(len(data) * 0.4)
    path.write_bytes(data[:cut])
    observations, recording = read(path)
    assert 0.1 * all_of_it < len(observations) < 0.9 * all_of_it
    assert f"the file ends at byte {cut}" in recording.report.truncated
    assert any(
        said.startswith(f"{path}: cut: the file ends at byte {cut}") for said in recording.report.sentences()
    )


def test_a_database_that_was_cut_gives_what_lies_before(tmp_path):
    path, data = whole(tmp_path, "db3", count=2000)
    cut = int(len(data) * 0.6)
    path.write_bytes(data[:cut])
    observations, recording = read(path)
    assert len(observations) > 1000
    assert recording.report.truncated == f"the file ends at byte {cut} of {len(data)}"


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_file_that_was_never_closed_lacks_only_its_end(tmp_path, kind):
    path, data = whole(tmp_path, kind)
    if kind == "mcap":  # from DataEnd on there is only the summary
        at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    else:
        at = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)[0]
    first, _ = read(path)
    path.write_bytes(data[:at])
    observations, recording = read(path)
    assert [seen.stamp for seen in observations] == [seen.stamp for seen in first]
    assert recording.report.truncated is not None


def test_a_file_longer_than_what_was_written_is_read(tmp_path):
    path, data = whole(tmp_path, "mcap")
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    first, _ = read(path)
    path.write_bytes(data[:at] + bytes(1 << 20))
    observations, recording = read(path)
    assert len(observations) == len(first)
    assert "without MCAP's footer" in recording.report.truncated


def test_a_file_cut_before_its_first_topic_says_so(tmp_path):
    path, data = whole(tmp_path, "mcap")
    path.write_bytes(data[:60])
    with pytest.raises(
        InvalidFile,
        match=r"expected joint states on /joint_states, got none; topics there: none \(the file ends",
    ):
        open_recording(path, rig())


def test_a_damaged_chunk_is_reported_and_the_others_are_read(tmp_path):
    path, data = whole(tmp_path, "mcap", count=1500)
    _, recording = read(path)
    before = recording.report.observations
    at = len(data) // 2
    spoilt = bytearray(data)
    spoilt[at : at + 3000] = bytes(3000)
    path.write_bytes(spoilt)
    observations, recording = read(path)
    assert len(observations) < before
    assert len(recording.report.files[0].damage) == 1
    assert any("damaged: chunk at byte" in said for said in recording.report.sentences())


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
    import bz2

    import lz4.frame
    from backports import zstd

    zeros = bytes(1 << 24)
    return {"zstd": zstd.compress(zeros), "lz4": lz4.frame.compress(zeros), "bz2": bz2.compress(zeros)}


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_unpacks_to_no_more_than_it_says(tmp_path, compression):
    packed = bombs()[compression]
    tracemalloc.start()
    data, fault = chunks.unpacked(packed, compression, 1000)
    assert tracemalloc.get_traced_memory()[1] < 4e6
    tracemalloc.stop()
    assert (data, fault) == (bytes(1000), None)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2", ""])
def test_a_chunk_that_says_it_is_huge_is_not_unpacked(tmp_path, compression):
    packed = (bombs() | {"": b"x"})[compression]
    data, fault = chunks.unpacked(packed, compression, 1 << 62)
    assert data == b""
    assert fault == f"says it unpacks to {1 << 62} bytes, at most {chunks.CHUNKS.max_unpacked} are read"
    with pytest.raises(InvalidFile, match="expected joint states"):
        open_recording(mcap_with_chunk(tmp_path / "a.mcap", packed, 1 << 62, compression), rig())


def test_frames_one_after_another_are_unpacked(tmp_path):
    from backports import zstd

    data, fault = chunks.unpacked(zstd.compress(b"ab") + zstd.compress(b"cd"), "zstd", 4)
    assert (data, fault) == (b"abcd", None)


def test_an_unknown_compression_is_named():
    assert chunks.unpacked(b"x", "rar", 5) == (b"", "expected compression none, lz4, zstd or bz2, got 'rar'")


def test_a_chunk_with_a_wrong_checksum_is_not_used(tmp_path):
    from zlib import crc32

    path, data = whole(tmp_path, "mcap", count=50)
    begin = data.index(b"\x06", 8)
    size = struct.unpack_from("<Q", data, begin + 9 + 16)[0]
    records = data[begin + 9 + 40 :][:size]
    mcap_with_chunk(path, records, size, "", crc32(records))
    assert len(read(path)[0]) == 100
    mcap_with_chunk(path, records, size, "", crc32(records) ^ 1)
    with pytest.raises(InvalidFile, match="expected joint states"):
        open_recording(path, rig())


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
    assert survived > 20


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
def test_a_file_packed_from_next_to_nothing_is_refused_before_the_disk_is_full(tmp_path, kind, monkeypatch):
    monkeypatch.setattr(chunks, "CHUNKS", chunks.CHUNKS._replace(spare_unpacked=1 << 20))
    path = save(tmp_path, touched(), kind, compression="FILE")
    (file,) = path.glob("*.zstd")
    compress = chunks.rosbags_module(chunks.UNPACKERS["zstd"][0]).compress
    file.write_bytes(compress(bytes(1 << 24)))
    with pytest.raises(
        InvalidFile, match=f"^{file}: expected at most 200 times its bytes when unpacked, got more$"
    ):
        open_recording(path, rig())
    file.write_bytes(b"nothing of that kind")
    with pytest.raises(InvalidFile, match=f"^{file}: expected a file compressed by zstd, got none"):
        open_recording(path, rig())


def test_empty_messages_do_not_take_memory(tmp_path):
    """A few kilobytes that unpack to 28 MB of messages of nothing."""
    path = tmp_path / "a.mcap"
    path.write_bytes(packed_messages(300_000))
    tracemalloc.start()
    observations, recording = read(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert observations == []
    assert most < 100e6
    assert any(
        "at least a byte of the file for each message" in said for said in recording.report.sentences()
    )
