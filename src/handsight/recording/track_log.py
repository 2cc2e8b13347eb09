"""A track on disk, so that memory is constant, and a checkpoint from which tracking goes on after its process ended."""

import contextlib
import copyreg
import os
import pickle
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from handsight import cache_folder
from handsight.files import write_errors
from handsight.recording.write import TrackRow

copyreg.pickle(struct.Struct, lambda each: (struct.Struct, (each.format,)))


class TrackLog:
    """A `TrackLog` is the folder `track.part` beside the results; it is trusted, so it is the user's own."""

    def __init__(self, folder: Path, seal: str) -> None:
        """`seal`: a text of all that the track depends on; a checkpoint with another is not used. Raises NotWritten."""
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self.folder, self._seal = cache_folder.private_folder(folder, "track.part"), seal
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._rows = (self.folder / "rows").open("a+b")
        end, self.state = 0, None
        with contextlib.suppress(Exception):  # there is none, or one of another track, or a damaged one
            content = cache_folder.read_entry(self.folder / "checkpoint", seal)
            end, self.state = pickle.loads(content)
        self._rows.truncate(end)
        self._rows.seek(end)

    def append(self, row: TrackRow) -> None:
        """Adds a row."""
        pickle.dump(row, self._rows)

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
            content = pickle.dumps((self._rows.tell(), state))
            cache_folder.write_entry(self.folder / "checkpoint", self._seal, content)

    def close(self, *, resumable: bool) -> None:
        """Closes the log, and removes it unless it has a checkpoint and the track is `resumable`."""
        self._rows.close()
        if not (resumable and (self.folder / "checkpoint").exists()):
            shutil.rmtree(self.folder, ignore_errors=True)
