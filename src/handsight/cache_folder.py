"""The folder for what can be computed again, such as distance fields and compiled kernels, and its files.

Cached files are trusted, and compiled kernels are code. So the folder must be one that no other user can write to.
"""

import atexit
import contextlib
import os
import shutil
import stat
import tempfile
import warnings
import zlib
from functools import cache
from pathlib import Path

from handsight.files import atomic_file


class CacheWarning(UserWarning):
    """Another cache folder than the requested one is used; this costs time and nothing else."""


def cache_folder() -> Path:
    """Returns `$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; it may not exist yet.

    Where others could write to that folder, or where no home can be written to, it is a folder among the temporary
    files instead, with one CacheWarning.
    """
    if configured := os.environ.get("HANDSIGHT_CACHE"):
        return private_folder(Path(configured))
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # its specification forbids the use of a relative one
        return private_folder(Path(base, "handsight"))
    home = Path(os.path.expanduser("~"))
    folder = home / ".cache/handsight"
    if home.is_absolute() and home.is_dir():
        nearest = next(path for path in (folder, *folder.parents) if os.path.exists(path))
        if nearest == folder or os.access(nearest, os.W_OK | os.X_OK):
            return private_folder(folder)
    return _fallback(f"{home}: no home folder that can be written to")


def private_folder(base: Path, name: str = "") -> Path:
    """Returns `base / name` where only the user and root can write, else `name` in a temporary folder of the user."""
    reason = _other_writer(base / name)
    return base / name if reason is None else _fallback(reason) / name


def read_entry(path: Path, name: str) -> memoryview:
    """Returns what `write_entry` wrote under that name; raises OSError without a file, ValueError for a damaged one."""
    data = memoryview(path.read_bytes())
    if data[:4] != checksum(name, data[4:]):
        raise ValueError("damaged, or of another name")
    return data[4:]


def write_entry(path: Path, name: str, content: bytes) -> None:
    """Writes a file that `read_entry` reads; the file appears complete or not at all. Raises OSError."""
    for folder in reversed([path.parent, *path.parent.parents]):
        folder.mkdir(mode=0o755, exist_ok=True)  # others can read at most, whatever the umask
    with atomic_file(path, mode=0o644) as file:
        file.write(checksum(name, content))
        file.write(content)


def checksum(name: str, content: bytes | memoryview) -> bytes:
    """Returns the first four bytes of an entry; they protect against damage and mixed-up names, not against malice."""
    return zlib.crc32(content, zlib.crc32(name.encode())).to_bytes(4, "little")


def _other_writer(folder: Path) -> str | None:
    """Returns why another user could put files there, directly or by moving a folder above; None where nobody could.

    On systems without POSIX owners nothing is known of others, and None is returned.
    """
    if not hasattr(os, "getuid"):
        return None
    place = Path(os.path.realpath(folder))
    # In a container the root folder may belong to a user that is not known there.
    trusted = {os.getuid(), 0, os.stat("/").st_uid}
    for path in (place, *place.parents):
        try:
            status = path.stat()
        except OSError:
            continue  # not created yet
        if status.st_uid not in trusted:
            return f"{folder}: {path} belongs to another user ({status.st_uid})"
        # In a sticky folder, as /tmp is, others can add files but not move what is the user's.
        sticky = path != place and status.st_mode & stat.S_ISVTX
        writers = stat.S_IWOTH if _is_private_group(status.st_gid) else stat.S_IWOTH | stat.S_IWGRP
        if not sticky and status.st_mode & writers:
            return f"{folder}: others can write to {path} (mode {stat.S_IMODE(status.st_mode):04o})"
    return None


def _is_private_group(gid: int) -> bool:
    """Returns whether a group has the user as its only member; many systems create one for each user, with write
    permission."""
    import grp
    import pwd

    try:
        group, name = grp.getgrgid(gid), pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return False
    return group.gr_name == name and set(group.gr_mem) <= {name}


def _fallback(reason: str) -> Path:
    folder = _temporary_folder()
    _warn_once(
        f"{reason}; {folder} is used as cache instead (HANDSIGHT_CACHE or NUMBA_CACHE_DIR may name another)"
    )
    return folder


@cache
def _warn_once(message: str) -> None:
    warnings.warn(message, CacheWarning, stacklevel=2)


@cache
def _temporary_folder() -> Path:
    """Returns a folder of the user, shared by all processes; or one of this process where another user has that one."""
    try:
        base = Path(tempfile.gettempdir())
    except FileNotFoundError:  # no temporary folder can be written to
        return Path(os.devnull, "handsight")
    shared = base / f"handsight-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"
    with contextlib.suppress(OSError):
        shared.mkdir(mode=0o700, exist_ok=True)
        if _other_writer(shared) is None and os.access(shared, os.W_OK | os.X_OK):
            return shared
    folder = tempfile.mkdtemp(prefix="handsight-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)
