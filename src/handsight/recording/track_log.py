"""A track on disk until its files are written, so that memory does not grow with a recording."""

import pickle
from collections.abc import Iterator
from contextlib import AbstractContextManager
from tempfile import TemporaryFile

from handsight.files import write_errors
from handsight.recording.write import TrackRow


class TrackLog(AbstractContextManager["TrackLog"]):
    """The rows of a track, in a temporary file without a name."""

    def __init__(self) -> None:
        """Raises NotWritten where there is no place for temporary files."""
        with write_errors("temporary file"):
            self._file = TemporaryFile()  # noqa: SIM115
        self._count = 0

    def append(self, row: TrackRow) -> None:
        """Adds a row; one that Ctrl-C interrupts is left out. Raises NotWritten."""
        with write_errors("temporary file"):
            pickle.dump(row, self._file)
        self._count += 1

    def rows(self) -> Iterator[TrackRow]:
        """Yields the rows until now, one at a time."""
        self._file.seek(0)
        for _ in range(self._count):
            yield pickle.load(self._file)

    def __exit__(self, *_: object) -> None:
        self._file.close()
