"""A path to what lies in it: by its first bytes, not by its name."""

import re
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from handsight.errors import InvalidFile, MissingExtra
from handsight.messages.decode import RawMessage
from handsight.recording import mcap, rosbag1, rosbag2_sqlite
from handsight.recording.chunks import Source, normal_type, seconds

KINDS: dict[bytes, type[Source]] = {
    mcap.MAGIC: mcap.McapSource,
    rosbag1.MAGIC: rosbag1.Rosbag1Source,
    rosbag2_sqlite.MAGIC: rosbag2_sqlite.SqliteSource,
}
COMPRESSED = re.compile(rb"""compression_mode:\s*['"]?(file|message)""", re.IGNORECASE)
LARGEST_METADATA = 1 << 20
EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"


def open_source(path: Path) -> Source:
    """The recording, open; raises InvalidFile where there is none."""
    try:
        if path.is_dir():
            return _folder(path)
        if not path.is_file():
            raise InvalidFile(f"{path}: {EXPECTED}, got no file")
        with path.open("rb") as file:
            first = file.read(16)
        for magic, kind in KINDS.items():
            if first.startswith(magic):
                return kind(path)
    except OSError as error:
        raise InvalidFile(f"{path}: {error.strerror or error}") from None
    came = f"a file that begins with {first!r}" if first else "an empty file"
    raise InvalidFile(f"{path}: {EXPECTED}, got {came}")


def _folder(path: Path) -> Source:
    """A rosbag 2: its files one after the other, the tenth after the ninth."""
    about = path / "metadata.yaml"
    if about.is_file() and COMPRESSED.search(about.read_bytes()[:LARGEST_METADATA]):
        return _Compressed(path)
    files = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3")]
    if not files:
        raise InvalidFile(f"{path}: {EXPECTED}, got a folder without .mcap or .db3 files")
    return _Files(path, sorted(files, key=lambda file: (len(file.name), file.name)))


class _Files(Source):
    """Several files, as a recorder splits them."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        super().__init__(path)
        self._parts: list[Source] = []
        with ExitStack() as opened:
            for file in files:
                part = open_source(file)
                opened.callback(part.close)
                self._parts.append(part)
                self.topics |= part.topics
            self._opened = opened.pop_all()
        self._gather()

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        for part in self._parts:
            yield from part.messages(wanted)
            self._gather()

    def _gather(self) -> None:
        for i, part in enumerate(self._parts):
            if part.truncated and self.truncated is None:
                self.truncated = f"{part.path.name}: {part.truncated}"
            for at, said in part.damage.items():
                self.damage[(i << 64) + at] = f"{part.path.name}: {said}"

    def close(self) -> None:
        self._opened.close()


class _Compressed(Source):
    """A rosbag 2 whose files or messages are compressed as wholes; rosbags unpacks it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise MissingExtra("recordings need rosbags: pip install 'handsight[robot]'") from None
        try:
            self._reader: Any = Reader(path)
            self._reader.open()
        except Exception as error:  # rosbags and what it is built on raise many kinds
            raise InvalidFile(f"{path}: {EXPECTED}, got: {error}") from None
        self.topics = {c.topic: normal_type(c.msgtype) for c in self._reader.connections}

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """As `Source.messages`."""
        connections = [c for c in self._reader.connections if c.topic in wanted]
        try:
            for c, log, data in self._reader.messages(connections) if connections else ():
                yield RawMessage(c.topic, normal_type(c.msgtype), "cdr", seconds(log), bytes(data))
        except Exception as error:
            self.truncated = f"it cannot be read to its end ({error})"

    def close(self) -> None:
        self._reader.close()
