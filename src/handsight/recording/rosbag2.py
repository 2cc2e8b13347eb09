"""The sqlite3 files (`.db3`) of rosbag 2, complete or cut."""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.messages import RawMessage
from handsight.recording.chunks import CHUNKS, TOO_MANY, Budget, Source, seconds

BROKEN = (sqlite3.Error, UnicodeDecodeError)
"""Errors that a damaged file causes; UnicodeDecodeError, as even the text of an error may come from the file."""


class SqliteSource(Source):
    """A `SqliteSource` is one `.db3` file."""

    MAGIC = b"SQLite format 3\0"

    def __init__(self, path: Path) -> None:
        """Reads the topics; raises InvalidFile where the tables are not those of a rosbag 2."""
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
                # Else sqlite refuses a file that is shorter than it should be. The connection stays read-only.
                self._base.execute("PRAGMA writable_schema = ON")
            self._size = size
            self._limit()
            # Views, virtual tables and computed columns are not read, as they might compute for ever.
            real = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
            tables = sorted(str(name) for (name,) in self._base.execute(real))
            if not {"topics", "messages"} <= set(tables):
                raise InvalidFile(f"the tables {', '.join(tables[:12]) or '(none)'}")
            for table in {"topics", "messages", "message_definitions"} & set(tables):
                computed = "SELECT max(hidden) FROM pragma_table_xinfo(?)"
                if self._base.execute(computed, (table,)).fetchone()[0]:
                    raise InvalidFile(f"the table {table} with columns that are computed")
            for key, *about in self._base.execute("SELECT id, name, type, serialization_format FROM topics"):
                self.define(key, *map(str, about))
            if "message_definitions" in tables:  # since ROS 2 Iron
                query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
                self.definitions |= {str(kind): str(text) for kind, text in self._base.execute(query) if text}
        except (*BROKEN, InvalidFile) as error:
            self._base.close()
            raise InvalidFile(f"{path}: expected a rosbag 2 in sqlite3, got: {error}") from None

    def _limit(self) -> None:
        """Interrupts sqlite when, from now on, it takes more steps than reading a file of this size needs.

        A short message takes some tens of steps of sqlite's virtual machine; damaged pages that refer to one another
        would take forever.
        """
        step, most = 10_000, 300_000 + 5 * self._size
        left = iter(range(most // step))
        self._base.set_progress_handler(lambda: next(left, None) is None, step)

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages in order of log time; those of a cut file in the order in which they were written."""
        keys = [key for key, about in self.channels.items() if about[0] in wanted and isinstance(key, int)]
        # The index by time is spread over the file, so it is incomplete where the file was cut.
        rows, order = ("messages NOT INDEXED", "") if self.truncated else ("messages", " ORDER BY timestamp")
        chosen = f"WHERE topic_id IN ({','.join(map(str, keys))})"
        self.place = self.place or 0
        query = f"SELECT topic_id, timestamp, data FROM {rows} {chosen}{order} LIMIT -1 OFFSET {self.place}"
        self._limit()
        budget = Budget(self._size)
        budget.records -= self.place
        try:
            for key, log, data in budget.limited(self._base.execute(query)):
                self.place += 1
                if isinstance(log, int) and isinstance(data, bytes):
                    yield RawMessage(*self.channels[key], seconds(log), data)
        except BROKEN as error:
            self.truncated = self.truncated or f"the file cannot be read to its end ({error})"
        if budget.records == 0:
            self.damage[0] = TOO_MANY

    def close(self) -> None:
        self._base.close()
