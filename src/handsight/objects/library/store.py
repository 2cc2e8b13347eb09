"""Files of a library: whole or not there, written by one at a time, and known by their SHA-256."""

import contextlib
import hashlib
import os
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from handsight.errors import InvalidFile, NotWritten
from handsight.files import open_regular, write_errors

LOCK = ".handsight.lock"
LOCK_SECONDS = 60.0
"""An add holds the lock for as long as three small files take to write."""

if sys.platform == "win32":
    import msvcrt

    def _take(file: BinaryIO) -> None:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _take(file: BinaryIO) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """A file to be written, which is there under its name at the end, complete; raises NotWritten.

    Whatever ends it before, a kill too, leaves what was under that name as it was.
    """
    temporary = path.with_name(f".{path.name}-{uuid.uuid4().hex}.part")
    with write_errors(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(
                    file.fileno()
                )  # else a machine that loses power may keep the name and lose the content
            os.replace(temporary, path)
        finally:  # still there only where that failed
            with contextlib.suppress(OSError):
                os.unlink(temporary)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Inside, no other thread or process is; raises NotWritten where another one stays, or where nothing can be locked.

    It is the system's lock of an open file: it ends with its process, however that ends, so none is ever left behind,
    and between machines the file server keeps it (NFS, SMB). A folder whose system has no locks is refused: two writers
    there could lose what one of them added.
    """
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        file = open(folder / LOCK, "ab")  # noqa: SIM115
    with file:
        until = time.monotonic() + LOCK_SECONDS
        while True:
            try:
                with write_errors(folder):
                    _take(file)
                break
            except NotWritten as error:
                if not isinstance(error.__context__, BlockingIOError | PermissionError):
                    raise
                if time.monotonic() > until:
                    message = f"another process has been adding to it for {LOCK_SECONDS:g} s"
                    raise NotWritten(f"{folder}: cannot be written: {message}") from None
            time.sleep(0.02)
        yield


def check_content(path: Path, sha256: str | None, size: int | None) -> None:
    """Raises InvalidFile where a file is not there, or not of that size [bytes] and SHA-256; None: of any."""
    with open_regular(path) as file:
        came = os.fstat(file.fileno()).st_size
        if size is not None and came != size:
            raise InvalidFile(f"{path}: expected {size} bytes, got {came}: changed since it was added")
        if sha256 is None:
            return
        try:
            digest = hashlib.sha256()
            while chunk := file.read(1 << 20):
                digest.update(chunk)
        except OSError as error:
            raise InvalidFile(f"{path}: cannot be read: {error.strerror or error}") from None
    check_sha256(path, sha256, digest.hexdigest())


def check_sha256(name: str | Path, sha256: str, found: str) -> None:
    """Raises InvalidFile, which begins with the name, where a file's SHA-256 is not what it was when it was added."""
    if found != sha256:
        message = f"expected the SHA-256 {sha256[:12]}…, got {found[:12]}…: changed since it was added"
        raise InvalidFile(f"{name}: {message}")
