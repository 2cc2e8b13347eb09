"""A track that grows on disk, so that memory does not, and with which tracking goes on after its process has ended.

It is the folder `track.part` beside the results: `rows` until now, and a `checkpoint`. Both are pickled, so the folder
is the user's own.
"""

import contextlib
import io
import os
import pickle
import shutil
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from handsight import cache_folder
from handsight.files import write_errors
from handsight.recording.chunks import Source
from handsight.recording.open import Recording
from handsight.recording.write import TrackRow


def logged_rows(folder: Path) -> Iterator[TrackRow]:
    """Yields the rows of the log in a folder, one at a time."""
    with (_part(folder) / "rows").open("rb") as file:
        while file.peek(1):
            yield pickle.load(file)


def remove_log(folder: Path, *, resumable: bool) -> None:
    """Removes the log in a folder; if it is to be `resumable`, only where it has no checkpoint yet."""
    if not (resumable and (_part(folder) / "checkpoint").exists()):
        shutil.rmtree(_part(folder), ignore_errors=True)
        with contextlib.suppress(OSError):  # the folder itself is empty after wrong input only
            folder.rmdir()


def _part(folder: Path) -> Path:
    return cache_folder.private_folder(folder, "track.part")


class TrackLog(contextlib.AbstractContextManager["TrackLog"]):
    """A `TrackLog` is such a folder, open for a recording."""

    def __init__(self, folder: Path, seal: str, recording: Recording) -> None:
        """`seal`: a text of all that the track depends on; a checkpoint with another is not used. Raises NotWritten."""
        self._folder, self._seal, self._recording = folder, seal, recording
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            part = _part(folder)
            part.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._checkpoint, self._rows = part / "checkpoint", (part / "rows").open("a+b")

    def append(self, row: TrackRow) -> None:
        """Adds a row."""
        pickle.dump(row, self._rows)

    def save(self, state: object) -> None:
        """Writes a checkpoint: `state`, between two observations of the recording. Raises NotWritten."""
        content = io.BytesIO()
        with write_errors(self._checkpoint):
            self._rows.flush()
            os.fsync(self._rows.fileno())
            _Pickler(content, protocol=5).dump((self._rows.tell(), self._recording.place, state))
            cache_folder.write_entry(self._checkpoint, self._seal, content.getvalue())

    def restored(self) -> Any:
        """Returns the state of the last checkpoint, to which rows and recording go back; None, and no rows, where there
        is no checkpoint of this track."""
        size, state = 0, None
        with contextlib.suppress(Exception):  # there is none, or one of another track, or a damaged one
            content = cache_folder.read_entry(self._checkpoint, self._seal)
            end, place, found = _Unpickler(content, self._recording.report.files).load()
            if self._rows.seek(0, io.SEEK_END) >= end:
                self._recording.place, size, state = place, end, found
        self._rows.truncate(size)
        self._rows.seek(size)
        return state

    def __exit__(self, kind: object, *_: object) -> None:
        with write_errors(self._rows.name):
            self._rows.close()
        if kind is not None:
            remove_log(self._folder, resumable=True)


class _Pickler(pickle.Pickler):
    """A `_Pickler` leaves out the files of a recording."""

    def persistent_id(self, value: object) -> str | None:
        return str(value.path) if isinstance(value, Source) else None

    def reducer_override(self, value: object) -> Any:
        return (struct.Struct, (value.format,)) if isinstance(value, struct.Struct) else NotImplemented


class _Unpickler(pickle.Unpickler):
    """An `_Unpickler` takes the files of an open recording in their place."""

    def __init__(self, content: memoryview, files: Sequence[Source]) -> None:
        super().__init__(io.BytesIO(content))
        self._files = {str(file.path): file for file in files}

    def persistent_load(self, path: str) -> Source:
        return self._files[path]
