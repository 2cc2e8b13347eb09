"""A track on disk, so that memory is constant, and a checkpoint from which tracking goes on after its process ended."""

import contextlib
import hashlib
import hmac
import os
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from handsight import cache_folder
from handsight.files import atomic_file, write_errors
from handsight.recording.write import TrackRow


class TrackLog:
    """A `TrackLog` is the folder `track.part` beside the results.

    What is read of it becomes objects of Python, so only what this user's own process has written is read: it is signed
    with a key in the cache folder.
    """

    def __init__(self, folder: Path, seal: str) -> None:
        """`seal`: a text of all that the track depends on; a checkpoint with another is not used. Raises NotWritten."""
        self._key, self._digest = _key() + seal.encode(), hashlib.sha256()
        with write_errors(folder):
            self.folder = folder / "track.part"
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._rows = (self.folder / "rows").open("a+b")
        end, size, self.state = 0, self._digest.digest_size, None
        with contextlib.suppress(Exception):  # there is none, or one of another track, or a damaged one
            content = (self.folder / "checkpoint").read_bytes()
            end = int.from_bytes(content[size : size + 8], "little")  # of the rows that belong to it
            self._rows.seek(0)
            for left in range(end, 0, -(1 << 20)):
                self._digest.update(self._rows.read(min(left, 1 << 20)))
            if hmac.compare_digest(content[:size], self._signature(content[size:])):
                self.state = pickle.loads(content[size + 8 :])
        if self.state is None:
            end, self._digest = 0, hashlib.sha256()
        self._rows.truncate(end)
        self._rows.seek(end)

    def _signature(self, content: bytes) -> bytes:
        """Returns the signature of the rows until now and of a checkpoint's content."""
        return hmac.digest(self._key, self._digest.digest() + content, "sha256")

    def append(self, row: TrackRow) -> None:
        """Adds a row."""
        data = pickle.dumps(row)
        self._digest.update(data)
        self._rows.write(data)

    def rows(self) -> Iterator[TrackRow]:
        """Yields the rows until now, one at a time."""
        self._rows.flush()
        with (self.folder / "rows").open("rb") as file:
            while file.peek(1):
                yield pickle.load(file)

    def save(self, state: Any) -> None:
        """Writes a checkpoint: the next log of this track has the rows until now, and `state`. Raises NotWritten."""
        with write_errors(self.folder):
            self._rows.flush()
            os.fsync(self._rows.fileno())
            content = self._rows.tell().to_bytes(8, "little") + pickle.dumps(state)
            with atomic_file(self.folder / "checkpoint") as file:
                file.write(self._signature(content))
                file.write(content)

    def close(self, *, resumable: bool) -> None:
        """Closes the log, and removes it unless it has a checkpoint and the track is `resumable`."""
        self._rows.close()
        if not (resumable and (self.folder / "checkpoint").exists()):
            shutil.rmtree(self.folder, ignore_errors=True)


def _key() -> bytes:
    """Returns the user's key, made when it is first asked for; another each time where it cannot be kept."""
    path = cache_folder.cache_folder() / "key"
    with contextlib.suppress(OSError):
        if not path.exists():
            path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            with atomic_file(path, mode=0o600) as file:
                file.write(os.urandom(32))
        if len(key := path.read_bytes()) == 32:
            return key
    return os.urandom(32)
