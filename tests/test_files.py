"""What is no regular file is refused unread, in a sentence that begins with its name."""

import os

import pytest

from handsight.errors import InvalidFile
from handsight.files import open_regular, read_bytes, text_file
from testbed.refusals import refused


def test_a_file_is_read_and_so_is_a_link_to_it(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert read_bytes(tmp_path / "a", 3) == b"abc"
    assert read_bytes(str(tmp_path / "b"), 3) == b"abc"


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"abcd")
    with refused(InvalidFile, "a"):
        read_bytes(tmp_path / "a", 3, "a")


def test_what_is_no_regular_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    for path in (
        tmp_path,
        tmp_path / "fifo",
        "/dev/zero",
        tmp_path / "none",
        tmp_path / "circle",
        "a" * 5000,
        "a\0b",
    ):
        for door in (open_regular, lambda path, name: read_bytes(path, 10, name)):
            with pytest.raises(InvalidFile):
                door(path, "x")


def test_a_text_file_gets_its_name_once_it_is_complete_and_a_pipe_is_written_at_once(tmp_path):
    place, link = tmp_path / "a.csv", tmp_path / "b.csv"
    place.write_text("before")
    link.symlink_to(place)
    with pytest.raises(UnicodeEncodeError), text_file(link) as file:
        file.write("half, and half a character: \ud800")
    assert place.read_text() == "before"
    with text_file(link) as file:
        file.write("µ\n")
        assert place.read_text() == "before"
    assert (place.read_bytes(), link.is_symlink()) == ("µ\n".encode(), True)
    os.mkfifo(tmp_path / "fifo")
    reader = os.open(tmp_path / "fifo", os.O_RDONLY | os.O_NONBLOCK)
    with text_file(tmp_path / "fifo") as file:
        file.write("now")
        file.flush()
        assert os.read(reader, 10) == b"now"
    os.close(reader)
    assert {path.name for path in tmp_path.iterdir()} == {"a.csv", "b.csv", "fifo"}
