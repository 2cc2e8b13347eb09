"""The sqlite3 files of rosbag 2 (`.db3`), complete or cut."""

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.messages import RawMessage
from handsight.recording.chunks import MAX_UNPACKED, Source, normal_type, seconds

BROKEN = (sqlite3.Error, UnicodeDecodeError)
"""What a damaged file raises; its error messages may themselves be no text."""
REAL_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
"""A view or a virtual table may compute for ever."""


class SqliteSource(Source):
    """One `.db3` file."""

    MAGIC = b"SQLite format 3\0"

    def __init__(self, path: Path) -> None:
        """Its topics; raises InvalidFile where its tables are not rosbag 2's."""
        super().__init__(path)
        self._topics: dict[int, tuple[str, str, str]] = {}
        size, expected = path.stat().st_size, _size(path)
        if expected > size:
            self.truncated = f"the file ends at byte {size} of {expected}"
        self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
        try:
            self._open()
        except (*BROKEN, InvalidFile) as error:
            self._base.close()
            raise InvalidFile(f"{path}: expected a rosbag 2 in sqlite3, got: {error}") from None
        self.topics = {topic: kind for topic, kind, _ in self._topics.values()}

    def _open(self) -> None:
        self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_UNPACKED)
        self._base.text_factory = _text
        self._base.execute("PRAGMA trusted_schema = OFF")
        if self.truncated:
            # Only so does sqlite open a file that is shorter than it should be; it stays read-only.
            self._base.execute("PRAGMA writable_schema = ON")
        tables = {str(name) for (name,) in self._base.execute(REAL_TABLES)}
        if not {"topics", "messages"} <= tables:
            raise InvalidFile(f"the tables {', '.join(sorted(tables)) or '(none)'}")
        columns = "id, name, type, serialization_format"
        for key, topic, kind, encoding in self._base.execute(f"SELECT {columns} FROM topics"):
            self._topics[key] = (str(topic), normal_type(str(kind)), str(encoding))

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        keys = [key for key, about in self._topics.items() if about[0] in wanted and isinstance(key, int)]
        # The index by time lies all over the file: of a cut one, the rows as they were written.
        rows, order = ("messages NOT INDEXED", "") if self.truncated else ("messages", " ORDER BY timestamp")
        chosen = f"WHERE topic_id IN ({','.join(map(str, keys))})"
        query = f"SELECT topic_id, timestamp, data FROM {rows} {chosen}{order}"
        try:
            for key, log, data in self._base.execute(query):
                if isinstance(log, int) and isinstance(data, bytes):
                    yield RawMessage(*self._topics[key], seconds(log), data)
        except BROKEN as error:
            self.truncated = self.truncated or f"the file cannot be read to its end ({error})"

    def close(self) -> None:
        self._base.close()


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _size(path: Path) -> int:
    """Bytes that the file's own header says it has."""
    with path.open("rb") as file:
        header = file.read(32)
    page = int.from_bytes(header[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(header[28:32], "big")
