"""Bags of ROS 1 and the sqlite3 files (`.db3`) of rosbag 2, as rosbags reads them: complete files with their index."""

import bz2
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from handsight.errors import InvalidFile
from handsight.messages import RawMessage
from handsight.messages.read import rosbags_module
from handsight.recording.source import MAX_UNPACKED, Source, seconds, unpacked


class BagSource(Source):
    """A file that a reader of rosbags reads."""

    def __init__(self, path: Path, reader: Any, tool: str) -> None:
        """Opens the reader; raises InvalidFile, with the tool that mends such a file, where it cannot be opened."""
        super().__init__(path, tool)
        try:
            reader.open()
            self._connections = list(reader.connections)
        except Exception as error:  # rosbags raises anything where the bytes are not as they should be
            reason = str(error) or type(error).__name__
            raise InvalidFile(f"{path}: expected a complete recording, got: {reason}; {self.tool}") from None
        self._reader = reader
        for connection in self._connections:
            self.topics[str(connection.topic)] = str(connection.msgtype)

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics in order of log time, up to the first damage."""
        connections = [each for each in self._connections if str(each.topic) in wanted]
        if not connections:  # rosbags would yield all
            return
        for connection, log, data in self.undamaged(self._reader.messages(connections)):
            encoding = getattr(connection.ext, "serialization_format", "ros1")
            about = str(connection.topic), str(connection.msgtype), str(encoding)
            yield RawMessage(*about, seconds(log), bytes(data), connection.msgdef.data)

    def close(self) -> None:
        """Closes the file."""
        self._reader.close()


class Rosbag1Source(BagSource):
    """One `.bag` file."""

    MAGIC = b"#ROSBAG V2.0\n"

    def __init__(self, path: Path) -> None:
        """Opens the bag; raises InvalidFile, MissingExtra."""
        reader = rosbags_module("rosbags.rosbag1").Reader(path)
        super().__init__(path, reader, f"rosbag reindex {path.name}")
        compressions = {bz2.decompress: "bz2", rosbags_module("lz4.frame").decompress: "lz4"}
        for place, chunk in reader.chunks.items():
            compression = compressions.get(chunk.decompressor, "")
            bounded = partial(unpacked, compression=compression, most=MAX_UNPACKED)
            reader.chunks[place] = chunk._replace(decompressor=bounded)


class SqliteSource(BagSource):
    """One `.db3` file."""

    MAGIC = b"SQLite format 3\0"

    def __init__(self, path: Path) -> None:
        """Opens the database; raises InvalidFile, MissingExtra."""
        reader = rosbags_module("rosbags.rosbag2").Reader.STORAGE_PLUGINS[".db3"](path)
        super().__init__(path, reader, f"sqlite3 {path.name} .recover")
