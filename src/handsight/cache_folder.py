"""The cache folder and its files: distance fields, compiled kernels, and whatever else can be computed again.

Cached files are trusted, and compiled kernels are code, so no other user may be able to write to the folder.
"""

import contextlib
import os
import stat
import tempfile
import warnings
import zlib
from functools import cache
from pathlib import Path

from handsight.files import atomic_file


class CacheWarning(UserWarning):
    """Another cache folder than the requested one is used; this costs time, but changes no result."""


def cache_folder() -> Path:
    """Returns `$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; it may not exist.

    If it is not private, a temporary folder is returned, as by `private_folder`.
    """
    if configured := os.environ.get("HANDSIGHT_CACHE"):
        return private_folder(Path(configured))
    home = os.path.expanduser("~")
    places = (os.environ.get("XDG_CACHE_HOME", ""), f"{home}/.cache" if os.path.isdir(home) else "")
    # Relative paths are ignored: XDG's specification demands it, and a relative home is no home.
    return private_folder(Path(next(filter(os.path.isabs, places), os.devnull), "handsight"))


def private_folder(base: Path, name: str = "") -> Path:
    """Returns `base / name` if the user can write there, and nobody else but root; else `name` in a temporary folder.

    The temporary folder is the user's own, and using it issues a CacheWarning, once.
    """
    reason = why_unusable(base / name)
    if reason is None:
        return base / name
    folder = _temporary_folder() / name
    other = "HANDSIGHT_CACHE or NUMBA_CACHE_DIR may name another"
    _warn_once(f"{reason}; {folder} is used as cache instead ({other})")
    return folder


def read_entry(path: Path, name: str) -> memoryview:
    """Returns the content that `write_entry` wrote; raises OSError without a file, ValueError for a damaged one."""
    data = memoryview(path.read_bytes())
    if data[:4] != checksum(name, data[4:]):
        raise ValueError("damaged, or of another name")
    return data[4:]


def write_entry(path: Path, name: str, content: bytes) -> None:
    """Writes a file for `read_entry`; it appears complete or not at all. Raises OSError."""
    for folder in reversed([path.parent, *path.parent.parents]):
        folder.mkdir(mode=0o755, exist_ok=True)  # others can at most read, whatever the umask
    with atomic_file(path, mode=0o644) as file:
        file.write(checksum(name, content))
        file.write(content)


def checksum(name: str, content: bytes | memoryview) -> bytes:
    """Returns the first four bytes of an entry; they protect against damage and mixed-up names, not against attacks."""
    return zlib.crc32(content, zlib.crc32(name.encode())).to_bytes(4, "little")


def why_unusable(folder: Path) -> str | None:
    """Returns why a folder cannot be created, or why another user could put files there; None: it can be used.

    Only the folder itself is checked, or the nearest existing parent. Users who can write further up could replace the
    folder, but then it would belong to them. On systems without POSIX owners, other users are not checked.
    """
    place = Path(os.path.realpath(folder))
    nearest = next(path for path in (place, *place.parents) if os.path.exists(path))
    if not nearest.is_dir() or (nearest != place and not os.access(nearest, os.W_OK | os.X_OK)):
        return f"{folder}: cannot be written"
    status = nearest.stat()
    if nearest != place and status.st_mode & stat.S_ISVTX:
        return None  # in a sticky folder such as /tmp, others can add folders, but not move the user's
    if not hasattr(os, "getuid"):
        return None
    if status.st_uid not in (os.getuid(), 0):
        return f"{folder}: {nearest} belongs to another user ({status.st_uid})"
    others = stat.S_IWOTH if _is_private_group(status.st_gid) else stat.S_IWOTH | stat.S_IWGRP
    if status.st_mode & others:
        return f"{folder}: others can write to {nearest} (mode {stat.S_IMODE(status.st_mode):04o})"
    return None


def _is_private_group(gid: int) -> bool:
    """Returns whether a group has the user as its only member.

    Many systems have such a group for each user, and it may write to the user's files.
    """
    import grp
    import pwd

    try:
        group = grp.getgrgid(gid)
        name = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return False
    return group.gr_name == name and set(group.gr_mem) <= {name}


@cache
def _warn_once(message: str) -> None:
    warnings.warn(message, CacheWarning, stacklevel=3)


@cache
def _temporary_folder() -> Path:
    """Returns the user's own temporary folder, or one that cannot be created where that is not private."""
    with contextlib.suppress(OSError):  # no temporary folder can be written to
        folder = Path(tempfile.gettempdir(), f"handsight-{os.getuid() if hasattr(os, 'getuid') else 'cache'}")
        folder.mkdir(mode=0o700, exist_ok=True)
        if why_unusable(folder) is None and os.access(folder, os.W_OK | os.X_OK):
            return folder
    return Path(os.devnull, "handsight")
