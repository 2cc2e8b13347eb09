"""Where things are kept: in a folder of the user's own that others cannot write to, and what is kept there is whole."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from handsight import cache_folder
from handsight.cache_folder import CacheWarning
from handsight.errors import NotWritten
from handsight.objects.library.folder import locked
from testbed.refusals import refused

posix = pytest.mark.skipif(not hasattr(os, "getuid"), reason="modes and owners as POSIX has them")
root = pytest.mark.skipif(getattr(os, "getuid", lambda: 1)() != 0, reason="only root gives files away")


@pytest.fixture(autouse=True)
def no_warning_yet(monkeypatch, tmp_path):
    cache_folder._warn_once.cache_clear()
    cache_folder._temporary_folder.cache_clear()
    monkeypatch.setattr(cache_folder.tempfile, "tempdir", str(tmp_path))
    for name in ("HANDSIGHT_CACHE", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    yield
    cache_folder._warn_once.cache_clear()
    cache_folder._temporary_folder.cache_clear()


def other_folder(folder, monkeypatch, match):
    """The folder that is used instead of it; the second time nothing is said."""
    monkeypatch.setenv("HANDSIGHT_CACHE", str(folder))
    with pytest.warns(CacheWarning):
        used = cache_folder.cache_folder()
    assert cache_folder.cache_folder() == used
    assert used.stat().st_mode & 0o777 == 0o700
    return used


@posix
@pytest.mark.parametrize(
    ("mode", "others"), [(0o777, True), (0o757, True), (0o1777, True), (0o755, False), (0o700, False)]
)
def test_a_folder_that_others_can_write_to_is_not_used(tmp_path, monkeypatch, mode, others):
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    if others:
        used = other_folder(
            folder, monkeypatch, rf"cache: others can write to .*cache \(mode {mode:04o}\); .* instead"
        )
        assert used == tmp_path / f"handsight-{os.getuid()}"
        # A folder in it cannot be better: whoever can write can move it away.
        if mode != 0o1777:
            other_folder(folder / "below", monkeypatch, "below: others can write to .*cache ")
    else:
        monkeypatch.setenv("HANDSIGHT_CACHE", str(folder))
        assert cache_folder.cache_folder() == folder


@posix
def test_a_group_may_write_that_is_the_users_own(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(0o775)
    monkeypatch.setattr(cache_folder, "_is_private_group", lambda gid: gid == folder.stat().st_gid)
    monkeypatch.setenv("HANDSIGHT_CACHE", str(folder))
    assert cache_folder.cache_folder() == folder
    monkeypatch.setattr(cache_folder, "_is_private_group", lambda gid: False)
    other_folder(folder, monkeypatch, "others can write to")


@root
@pytest.mark.parametrize("below", ["", "below"])
def test_a_folder_of_another_user_is_not_used(tmp_path, monkeypatch, below):
    (tmp_path / "cache").mkdir()
    os.chown(tmp_path / "cache", 12345, 12345)
    other_folder(tmp_path / "cache" / below, monkeypatch, r"cache belongs to another user \(12345\)")


@root
def test_a_home_of_another_user_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "home").mkdir()
    os.chown(tmp_path / "home", 12345, 12345)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    with pytest.warns(CacheWarning):
        cache_folder.cache_folder()


@posix
@pytest.mark.parametrize("home", ["/nonexistent", "", "here", "/dev/null", "~"])
def test_without_a_home_a_temporary_folder_is_used(tmp_path, monkeypatch, home):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(
        os, "access", lambda path, mode: str(path) != "/"
    )  # nobody's home, but root can write there
    with pytest.warns(CacheWarning):
        assert cache_folder.cache_folder() == tmp_path / f"handsight-{os.getuid()}"
    assert [path.name for path in tmp_path.iterdir()] == [f"handsight-{os.getuid()}"]


def test_a_home_that_cannot_be_written_still_keeps_what_is_there(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    with pytest.warns(CacheWarning):
        cache_folder.cache_folder()
    (tmp_path / ".cache/handsight").mkdir(parents=True)
    assert cache_folder.cache_folder() == tmp_path / ".cache/handsight"


@root
def test_where_the_temporary_folder_is_anothers_nothing_is_kept(tmp_path, monkeypatch):
    (tmp_path / "handsight-0").mkdir()
    os.chown(tmp_path / "handsight-0", 12345, 12345)
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    with pytest.warns(CacheWarning):
        folder = cache_folder.cache_folder()
    with pytest.raises(OSError):
        cache_folder.write_entry(folder / "file", "name", b"content")
    assert not list((tmp_path / "handsight-0").iterdir())


@root
def test_a_folder_that_was_replaced_by_another_user_is_not_used(tmp_path, monkeypatch):
    """Where others can write above it, they can move it away, but not make one that is the user's."""
    (tmp_path / "shared/cache").mkdir(parents=True)
    (tmp_path / "shared").chmod(0o777)
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "shared/cache"))
    assert cache_folder.cache_folder() == tmp_path / "shared/cache"
    os.chown(tmp_path / "shared/cache", 12345, 12345)
    other_folder(tmp_path / "shared/cache", monkeypatch, "belongs to another user")


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path, monkeypatch):
    def nowhere():
        raise FileNotFoundError

    monkeypatch.setattr(cache_folder.tempfile, "gettempdir", nowhere)
    monkeypatch.setenv("HOME", "/nonexistent")
    with pytest.warns(CacheWarning):
        folder = cache_folder.cache_folder()
    with pytest.raises(OSError):
        cache_folder.write_entry(folder / "file", "name", b"content")


def test_a_file_is_read_as_it_was_written_under_its_name(tmp_path):
    path = tmp_path / "new" / "file.nbc"
    before = os.umask(0)
    try:
        cache_folder.write_entry(path, "name", b"content")
    finally:
        os.umask(before)
    assert bytes(cache_folder.read_entry(path, "name")) == b"content"
    assert path.parent.stat().st_mode & 0o022 == path.stat().st_mode & 0o022 == 0
    assert [one.name for one in path.parent.iterdir()] == ["file.nbc"]
    complete = path.read_bytes()
    with pytest.raises(ValueError):
        cache_folder.read_entry(path, "other")
    damages = [complete[:k] for k in range(len(complete))]
    damages += [
        complete[:k] + bytes([complete[k] ^ 1 << bit]) + complete[k + 1 :]
        for k in range(len(complete))
        for bit in range(8)
    ]
    for damage in [*damages, b"\0" * len(complete), complete + b"\0"]:
        path.write_bytes(damage)
        with pytest.raises(ValueError):
            cache_folder.read_entry(path, "name")


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="/proc is a folder in which not even root can write"
)
def test_a_user_whose_home_cannot_be_written_is_answered(tmp_path):
    environment = {key: os.environ[key] for key in ("PATH", "PYTHONPATH", "LANG") if key in os.environ}
    environment |= {"HOME": "/proc/self", "TMPDIR": str(tmp_path)}

    def said(*arguments, expect):
        command = [sys.executable, "-m", "handsight.cli", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, env=environment)
        assert (done.returncode, "Traceback" in done.stderr) == (expect, False), done.stderr
        return done.stderr

    assert said("--version", expect=0) == ""
    assert "/proc/self/.local/share/handsight/library: expected a library" in said(
        "objects", "list", expect=2
    )
    with refused(NotWritten, "lab"), locked(Path("/proc/self/lab")):
        pass
