"""Where handsight keeps what it can compute again, distance fields and compiled kernels, and files that are whole."""

import atexit
import contextlib
import os
import shutil
import stat
import tempfile
import uuid
import warnings
import zlib
from functools import cache
from pathlib import Path

EVERYBODY, GROUP = stat.S_IWOTH, stat.S_IWGRP
BINARY = getattr(os, "O_BINARY", 0)
"""Windows alone asks."""


class CacheWarning(UserWarning):
    """The folder to keep things in is not the one that was asked for; that costs time and nothing else."""


def cache_folder() -> Path:
    """`$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; it may not exist yet.

    A folder among the temporary files, and one CacheWarning, where others could put files there, or where there is no
    home that can be written to.
    """
    if named := os.environ.get("HANDSIGHT_CACHE"):
        return private_folder(Path(named))
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # else it is not to be used, says its specification
        return private_folder(Path(base, "handsight"))
    home = Path(os.path.expanduser("~"))
    folder = home / ".cache/handsight"
    if home.is_absolute() and home.is_dir() and _can_be_created(folder):
        return private_folder(folder)
    return _fallback(f"{home}: no home folder that can be written to")


def private_folder(base: Path, name: str = "") -> Path:
    """`base / name` where nobody but the user and root can put files; else `name` in a temporary folder of the user's.

    What is kept is believed, and kernels are code: who can write there could have it run.
    """
    why = _other_writer(base / name)
    return base / name if why is None else _fallback(why) / name


def read_entry(path: Path, name: str) -> memoryview:
    """What `write_entry` has put there under that name. Raises OSError where there is no file, ValueError for another one."""
    data = memoryview(path.read_bytes())
    if data[:4] != checksum(name, data[4:]):
        raise ValueError("damaged, or of another name")
    return data[4:]


def write_entry(path: Path, name: str, content: bytes) -> None:
    """Safe under several processes: the file appears complete or not at all. Raises OSError."""
    for folder in reversed([path.parent, *path.parent.parents]):
        folder.mkdir(mode=0o755, exist_ok=True)  # for others to read at most, whatever the umask
    temporary = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
    try:
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BINARY, 0o644), "wb") as file:
            file.write(checksum(name, content))
            file.write(content)
        os.replace(temporary, path)
    finally:  # still there only where that failed
        with contextlib.suppress(OSError):
            os.unlink(temporary)


def checksum(name: str, content: bytes | memoryview) -> bytes:
    """What a file begins with: against damage and mixing up, not against malice, which `private_folder` keeps out."""
    return zlib.crc32(content, zlib.crc32(name.encode())).to_bytes(4, "little")


def _other_writer(folder: Path) -> str | None:
    """Who else could put files there, directly or by moving a folder above it; None: nobody, or no such modes here."""
    if not hasattr(os, "getuid"):
        return None
    place = Path(os.path.realpath(folder))
    # In a container the root of all may belong to nobody that is known there.
    trusted = {os.getuid(), 0, os.stat("/").st_uid}
    for path in (place, *place.parents):
        try:
            found = path.stat()
        except OSError:
            continue  # not there yet
        if found.st_uid not in trusted:
            return f"{folder}: {path} belongs to another user ({found.st_uid})"
        # Where a folder is sticky, as /tmp is, others can add to it but not move what is the user's.
        sticky = path != place and found.st_mode & stat.S_ISVTX
        if not sticky and found.st_mode & (
            EVERYBODY if _is_private_group(found.st_gid) else EVERYBODY | GROUP
        ):
            return f"{folder}: others can write to {path} (mode {stat.S_IMODE(found.st_mode):04o})"
    return None


def _is_private_group(gid: int) -> bool:
    """Whether a group is the user's own, as many systems give each user one and let it write by default."""
    import grp
    import pwd

    try:
        group, name = grp.getgrgid(gid), pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return False
    return group.gr_name == name and set(group.gr_mem) <= {name}


def _can_be_created(folder: Path) -> bool:
    """Whether a folder is there, or can be made."""
    nearest = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    return nearest == folder or os.access(nearest, os.W_OK | os.X_OK)


def _fallback(why: str) -> Path:
    folder = _temporary_folder()
    _warn_once(
        f"{why}; {folder} is used as cache instead (HANDSIGHT_CACHE or NUMBA_CACHE_DIR may name another)"
    )
    return folder


@cache
def _warn_once(sentence: str) -> None:
    warnings.warn(sentence, CacheWarning, stacklevel=2)


@cache
def _temporary_folder() -> Path:
    """A folder of the user's own, the same for all processes; one of this process alone where that is another's."""
    try:
        base = Path(tempfile.gettempdir())
    except FileNotFoundError:  # nowhere can be written
        return Path(os.devnull, "handsight")
    lasting = base / f"handsight-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"
    with contextlib.suppress(OSError):
        lasting.mkdir(mode=0o700, exist_ok=True)
        if _other_writer(lasting) is None and os.access(lasting, os.W_OK | os.X_OK):
            return lasting
    folder = tempfile.mkdtemp(prefix="handsight-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)
