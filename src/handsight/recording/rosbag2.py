"""Rosbag 2's own storage: sqlite3 files (`.db3`), complete or cut."""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from handsight.errors import InvalidFile
from handsight.messages import RawMessage
from handsight.recording.chunks import CHUNKS, TOO_MANY, Budget, Source, seconds


class Rosbag2Limits(NamedTuple):
    """`Rosbag2Limits` say how much work a rosbag 2 may be."""

    max_named: int = 12  # tables in a message
    step: int = 10_000  # steps of sqlite's machine from one count of them to the next
    spare_steps: int = 300_000
    """Steps that any file may take. A short message takes some tens; pages that refer to one another never end."""
    steps_per_byte: int = 5  # and for each of its bytes


ROSBAG2 = Rosbag2Limits()

BROKEN = (sqlite3.Error, UnicodeDecodeError)
"""Errors that a damaged file raises; the text of its errors may be damaged too."""
REAL_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
PLAIN = "SELECT max(hidden) FROM pragma_table_xinfo(?)"
"""Not 0 where columns are generated, which may compute for ever, as a view or a virtual table may."""


class SqliteSource(Source):
    """A `SqliteSource` is one `.db3` file."""

    MAGIC = b"SQLite format 3\0"

    def __init__(self, path: Path) -> None:
        """Reads its topics; raises InvalidFile where its tables are not rosbag 2's."""
        super().__init__(path)
        with path.open("rb") as file:
            header = file.read(32)
        page, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
        size, expected = path.stat().st_size, (65536 if page == 1 else page) * pages
        if expected > size:
            self.truncated = f"the file ends at byte {size} of {expected}"
        self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
        try:
            self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, CHUNKS.max_unpacked)
            self._base.text_factory = lambda data: data.decode("utf-8", "replace")
            self._base.execute("PRAGMA trusted_schema = OFF")
            if self.truncated:
                # Only so does sqlite open a file that is shorter than it should be; it stays read-only.
                self._base.execute("PRAGMA writable_schema = ON")
            self._size = size
            self._limit()
            tables = {str(name) for (name,) in self._base.execute(REAL_TABLES)}
            if not {"topics", "messages"} <= tables:
                found = ", ".join(sorted(tables)[: ROSBAG2.max_named]) or "(none)"
                raise InvalidFile(f"the tables {found}")
            for table in ("topics", "messages"):
                if self._base.execute(PLAIN, (table,)).fetchone()[0]:
                    raise InvalidFile(f"the table {table} with columns that are computed")
            for key, *about in self._base.execute("SELECT id, name, type, serialization_format FROM topics"):
                self.define(key, *map(str, about))
        except (*BROKEN, InvalidFile) as error:
            self._base.close()
            raise InvalidFile(f"{path}: expected a rosbag 2 in sqlite3, got: {error}") from None

    def _limit(self) -> None:
        """Has sqlite interrupted when it has done more from now on than a file of this size needs."""
        left = iter(range((ROSBAG2.spare_steps + ROSBAG2.steps_per_byte * self._size) // ROSBAG2.step))
        self._base.set_progress_handler(lambda: next(left, None) is None, ROSBAG2.step)

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields as `Source.stored` does; the messages of a cut file in the order in which they were written."""
        keys = [key for key, about in self.channels.items() if about[0] in wanted and isinstance(key, int)]
        # The index by time lies all over the file: of a cut one, the rows as they were written.
        rows, order = ("messages NOT INDEXED", "") if self.truncated else ("messages", " ORDER BY timestamp")
        chosen = f"WHERE topic_id IN ({','.join(map(str, keys))})"
        query = f"SELECT topic_id, timestamp, data FROM {rows} {chosen}{order}"
        self._limit()
        budget = Budget(self._size)
        try:
            for key, log, data in budget.limited(self._base.execute(query)):
                if isinstance(log, int) and isinstance(data, bytes):
                    yield RawMessage(*self.channels[key], seconds(log), data)
        except BROKEN as error:
            self.truncated = self.truncated or f"the file cannot be read to its end ({error})"
        if budget.records == 0:
            self.damage[0] = TOO_MANY

    def close(self) -> None:
        self._base.close()
