"""What is no regular file is refused unread, in a sentence that begins with its name."""

import os

import pytest

from handsight.errors import InvalidFile
from handsight.files import open_regular, read_bytes


def test_a_file_is_read_and_so_is_a_link_to_it(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert read_bytes(tmp_path / "a", 3) == b"abc"
    assert read_bytes(str(tmp_path / "b"), 3) == b"abc"


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"abcd")
    with pytest.raises(InvalidFile, match=r"^a: expected at most 3 bytes, got 4$"):
        read_bytes(tmp_path / "a", 3, "a")


def test_what_is_no_regular_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    for path, came in (
        (tmp_path, "expected a file, got a folder"),
        (tmp_path / "fifo", "expected a file, got something else"),
        ("/dev/zero", "expected a file, got something else"),
        (tmp_path / "none", "cannot be read: No such file or directory"),
        (tmp_path / "circle", "cannot be read: Too many levels of symbolic links"),
        ("a" * 5000, "cannot be read: File name too long"),
        ("a\0b", "not a path"),
    ):
        for door in (open_regular, lambda path, name: read_bytes(path, 10, name)):
            with pytest.raises(InvalidFile, match=rf"^'?x'?: {came}"):
                door(path, "x")
