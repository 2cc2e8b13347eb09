"""A path to a recording as a stream of Observations; the first bytes of a file tell its kind, not its name."""

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

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
    """Returns the recording of a rig's measurements: `.mcap`, `.bag`, `.db3`, or the folder of a rosbag 2.

    The rig gives each topic its role. Raises InvalidFile where there is no recording or none with joint states, and
    MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


@dataclass(slots=True, kw_only=True)
class RecordingReport(Report):
    """A `RecordingReport` counts the content of a recording, as far as it was read."""

    files: Sequence[Source]
    """One file, or several where the recorder has split it; each has in `damage` what could not be read."""

    @property
    def truncated(self) -> str | None:
        """Where the first file that was cut ends; None: all are complete."""
        return next((file.truncated for file in self.files if file.truncated), None)

    def sentences(self) -> list[str]:
        """Returns a sentence for each problem that a user should know of, worst first."""
        messages, damage, most_damage = list[str](), list[str](), 5
        for file in self.files:
            if file.truncated:
                messages.append(f"{file.path}: cut: {file.truncated}; what lies before was read")
            damage += [f"{file.path}: damaged: {what}" for _, what in sorted(file.damage.items())]
        messages = [printable(each) for each in messages + damage[:most_damage]]
        if len(damage) > most_damage:
            messages.append(f"{self.files[0].path}: damaged in {len(damage) - most_damage} more places")
        return messages + Report.sentences(self)  # a dataclass with slots knows no bare super()


class Recording:
    """A `Recording` is an open recording; `report`, `truth` and `intrinsics` hold what was read so far."""

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
        """Counts and sentences."""
        self._stream = ObservationStream(self._rig, self._topics, report=self.report)
        self.truth = self._stream.truth
        """Stamps [s] and `T_palm_object` (4, 4) from the rig's topic of the truth; never in an observation."""

    @property
    def intrinsics(self) -> Camera | None:
        """The camera by its CameraInfo; None: no CameraInfo was read so far."""
        return self._stream.intrinsics

    def camera(self) -> Camera:
        """Returns the camera of the images by its CameraInfo, else by the rig; raises InvalidInput without both."""
        return self._stream.camera()

    def calibrated_rig(self) -> Rig:
        """Returns the rig, with the camera of the first CameraInfo where it takes depth images and has no intrinsics.

        The CameraInfo is searched for in the first thousand observations.
        """
        camera, topics = self._rig.camera, self._rig.topics
        if camera is None or camera.intrinsics is not None or None in (topics.depth, topics.camera_info):
            return self._rig
        for _ in islice(self.observations(), 1000):
            if self.intrinsics is not None:
                break
        return self._stream.calibrated(self._rig)

    def observations(self) -> Iterator[Observation]:
        """Yields the observations in order of stamp, one for each joint state message.

        The file is read as the iterator goes on, in bounded memory. Each call begins again, with a new `report` and
        `truth`. Raises InvalidFile at the end if there were no joint states.
        """
        self._begin()
        for file in self._files:
            for message in file.messages(self._stream.topics):
                yield from self._stream.put(message)
        yield from self._stream.finish()
        if not self.report.topics[self._rig.topics.joint_states].messages:
            raise self._without_joints()

    def lacks(self) -> list[str]:
        """Returns a sentence for each thing that the rig needs and that was not read so far.

        What is missing is known of topics from the beginning, of joints and frames after `observations`.
        """
        return self._stream.lacks()

    def _without_joints(self) -> InvalidFile:
        topic, names = self._rig.topics.joint_states, sorted(self._topics)
        most = 12
        more = f" and {len(names) - most} more" if len(names) > most else ""
        cut = f" ({self.report.truncated})" if self.report.truncated else ""
        return InvalidFile(
            f"{self._path}: expected joint states on {topic}, got none; "
            f"topics there: {', '.join(names[:most]) or 'none'}{more}{cut}"
        )

    def close(self) -> None:
        """Closes the file."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_files(path: Path) -> Iterator[Source]:
    """Yields the files of a recording in the order of their numbers; raises InvalidFile, MissingExtra."""
    try:
        if not path.is_dir():
            yield _open_file(path)
            return
        metadata, packed = path / "metadata.yaml", None  # how a recorder has compressed files or messages
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
            # The unpacked file is gone as soon as it is closed; where open files cannot be removed, later.
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
