"""Opening of recordings as streams of observations; a file's kind is known from its first bytes, not from its name."""

import re
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from handsight.camera import Camera
from handsight.errors import InvalidFile, printable
from handsight.files import read_bytes
from handsight.messages import ObservationStream, Report
from handsight.observation import Observation
from handsight.recording.chunks import Source, unpack_file
from handsight.recording.mcap import McapSource
from handsight.recording.rosbag1 import Rosbag1Source
from handsight.recording.rosbag2 import SqliteSource
from handsight.rig import Rig

EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"


def open_recording(path: str | Path, rig: Rig) -> "Recording":
    """Returns a rig's recording: an MCAP file, a bag of ROS 1, a `.db3` file, or the folder of a rosbag 2.

    The rig says what each topic is for. Raises InvalidFile for anything else, and for a recording without a topic of
    joint states; MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


@dataclass(slots=True, kw_only=True)
class RecordingReport(Report):
    """A `RecordingReport` counts the messages of a recording that have been read."""

    files: Sequence[Source]
    """The recording's file, or files if the recorder has split it; `damage` of each has what could not be read."""

    @property
    def truncated(self) -> str | None:
        """Where the first cut file ends, in words; None: all files are complete."""
        return next((file.truncated for file in self.files if file.truncated), None)

    def sentences(self) -> list[str]:
        """Returns a sentence for each problem that a user should know about, worst first."""
        messages, damage, most_damage = list[str](), list[str](), 5
        for file in self.files:
            if file.truncated:
                messages.append(f"{file.path}: cut: {file.truncated}; what lies before was read")
            damage += [f"{file.path}: damaged: {what}" for _, what in sorted(file.damage.items())]
        messages = [printable(each) for each in messages + damage[:most_damage]]
        if len(damage) > most_damage:
            messages.append(f"{self.files[0].path}: damaged in {len(damage) - most_damage} more places")
        return messages + Report.sentences(self)  # super() does not work in a dataclass with slots


class Recording(AbstractContextManager["Recording"]):
    """A `Recording` is an open recording; `report`, `truth` and `intrinsics` are of the part that has been read."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self._path, self._rig, self._topics = path, rig, dict[str, str]()
        with ExitStack() as opened:
            self._files = [opened.enter_context(closing(file)) for file in open_files(path)]
            for file in self._files:
                self._topics |= file.topics
            self._begin()
            if rig.topics.joint_states not in self._topics:
                raise self._without_joints()
            self._opened = opened.pop_all()

    def _begin(self) -> None:
        self.report = RecordingReport(self._rig.topics.joint_states, files=self._files)
        """Counts of the messages, and sentences about what is wrong with them."""
        self._stream = ObservationStream(self._rig, self._topics, report=self.report)
        self._at, self._ready = 0, deque[Observation]()
        for file in self._files:
            file.place = None
        self.truth = self._stream.truth
        """Stamps [s] and true poses `T_palm_object` (4, 4) on the rig's topic of the truth; never in an observation."""

    @property
    def intrinsics(self) -> Camera | None:
        """The camera of the last CameraInfo; None: none has been read."""
        return self._stream.intrinsics

    def camera(self) -> Camera:
        """Returns the images' camera, as `ObservationStream.camera`."""
        return self._stream.camera()

    def calibrated_rig(self) -> Rig:
        """Returns the rig as `ObservationStream.calibrated`, by a CameraInfo of the first thousand observations."""
        camera, topics = self._rig.camera, self._rig.topics
        if camera is None or camera.intrinsics is not None or None in (topics.depth, topics.camera_info):
            return self._rig
        for _ in islice(self.observations(), 1000):
            if self.intrinsics is not None:
                break
        return self._stream.calibrated(self._rig)

    @property
    def place(self) -> tuple[Any, ...]:
        """Returns all that the next observations depend on, between two of them."""
        return self._at, self._ready, self._stream, self.report, [(f.place, f.damage) for f in self._files]

    def observations(self, place: tuple[Any, ...] | None = None) -> Iterator[Observation]:
        """Yields the observations in order of stamp, one for each joint state message; those after `place`, if given.

        The file is read as the iterator advances, in bounded memory. Each call starts at the beginning, with a new
        `report` and `truth`. Raises InvalidFile at the end if there were no joint states.
        """
        self._begin()
        if place is not None:
            self._at, self._ready, self._stream, self.report, places = place
            self.truth, self.report.files = self._stream.truth, self._files
            for file, known in zip(self._files, places, strict=True):
                file.place, file.damage = known
        while self._at <= len(self._files):
            ended = self._at == len(self._files)
            messages = () if ended else self._files[self._at].messages(self._stream.topics)
            last = [self._stream.finish()] if ended else []
            # First, what was ready at `place`.
            for found in chain([[]], map(self._stream.put, messages), last):
                self._ready.extend(found)
                while self._ready:
                    yield self._ready.popleft()
            self._at += 1
        if not self.report.topics[self._rig.topics.joint_states].messages:
            raise self._without_joints()

    def lacks(self) -> list[str]:
        """Returns sentences as `ObservationStream.lacks`; missing joints and frames are known after `observations`."""
        return self._stream.lacks()

    def _without_joints(self) -> InvalidFile:
        topic, names, most = self._rig.topics.joint_states, sorted(self._topics), 12
        more = f" and {len(names) - most} more" if len(names) > most else ""
        cut = f" ({self.report.truncated})" if self.report.truncated else ""
        there = f"topics there: {', '.join(names[:most]) or 'none'}{more}{cut}"
        return InvalidFile(f"{self._path}: expected joint states on {topic}, got none; {there}")

    def close(self) -> None:
        """Closes the files."""
        self._opened.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def open_files(path: Path) -> Iterator[Source]:
    """Yields the open files of a recording, in the order of their numbers; raises InvalidFile, MissingExtra."""
    try:
        if not path.is_dir():
            yield _open_file(path)
            return
        # Whether the recorder compressed files, messages or nothing.
        metadata, packed = path / "metadata.yaml", None
        if metadata.exists():
            pattern = rb"""compression_mode:\s*['"]?(file|message)"""
            packed = re.search(pattern, read_bytes(metadata, 1 << 20), re.IGNORECASE)
        by_file = packed is not None and packed[1].lower() == b"file"
        endings = (".mcap.zstd", ".db3.zstd") if by_file else (".mcap", ".db3")
        files = [file for file in path.iterdir() if file.name.endswith(endings)]
        if not files:
            raise InvalidFile(f"{path}: {EXPECTED}, got a folder without {' or '.join(endings)} files")
        for file in sorted(files, key=lambda file: (len(file.name), file.name)):
            if not by_file:
                source = _open_file(file)
                source.packed = packed is not None
                yield source
                continue
            # The unpacked file is removed at once, though still open; on systems that forbid this, it stays.
            with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                copy = Path(folder) / file.stem
                with copy.open("wb") as stream:
                    unpack_file(file, stream)
                try:
                    source = _open_file(copy)
                except InvalidFile as error:
                    raise InvalidFile(str(error).replace(str(copy), str(file))) from None
            source.path = file
            yield source
    except OSError as error:
        raise InvalidFile(f"{error.filename or path}: {error.strerror or error}") from None


def _open_file(path: Path) -> Source:
    if not path.is_file():
        raise InvalidFile(f"{path}: {EXPECTED}, got no file")
    with path.open("rb") as file:
        first = file.read(16)
    for kind in (McapSource, Rosbag1Source, SqliteSource):
        if first.startswith(kind.MAGIC):
            return kind(path)
    came = f"a file that begins with {first!r}" if first else "an empty file"
    raise InvalidFile(f"{path}: {EXPECTED}, got {came}")
