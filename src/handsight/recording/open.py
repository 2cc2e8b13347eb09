"""A path to a recording as a stream of Observations; its first bytes tell its kind, not its name."""

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
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

KINDS: tuple[type[Source], ...] = (McapSource, Rosbag1Source, SqliteSource)
COMPRESSED = re.compile(rb"""compression_mode:\s*['"]?(file|message)""", re.IGNORECASE)
MAX_METADATA = 1 << 20
EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"
MAX_NAMED = 12
"""Topics in a message."""
MAX_DAMAGE_SENTENCES = 5


def open_recording(path: str | Path, rig: Rig) -> "Recording":
    """Returns the recording of what a rig has measured: `.mcap`, `.bag`, `.db3`, or the folder of a rosbag 2.

    The rig gives each topic its role. Raises InvalidFile where there is no recording or none with joint states, and
    MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


@dataclass(slots=True, kw_only=True)
class RecordingReport(Report):
    """A `RecordingReport` counts the content of a recording, as far as it was read."""

    files: Sequence[Source]
    """One, or several as a recorder splits them; each has in `damage` what could not be read."""

    @property
    def truncated(self) -> str | None:
        """Where a file ends too early; None: all are complete."""
        return next((file.truncated for file in self.files if file.truncated), None)

    def sentences(self) -> list[str]:
        """Returns a sentence for each problem that a user should know of, worst first; empty: nothing is wrong."""
        messages, damage = list[str](), list[str]()
        for file in self.files:
            if file.truncated:
                messages.append(f"{file.path}: cut: {file.truncated}; what lies before was read")
            damage += [f"{file.path}: damaged: {what}" for _, what in sorted(file.damage.items())]
        messages = [printable(each) for each in messages + damage[:MAX_DAMAGE_SENTENCES]]
        if len(damage) > MAX_DAMAGE_SENTENCES:
            messages.append(
                f"{self.files[0].path}: damaged in {len(damage) - MAX_DAMAGE_SENTENCES} more places"
            )
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
        """The camera by its CameraInfo; None where none was read."""
        return self._stream.intrinsics

    def observations(self) -> Iterator[Observation]:
        """Yields the observations in order of stamp, one for each joint state message.

        The file is read as the iterator goes on, in bounded memory. Each call begins again, and so do `report` and
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
        """Returns a sentence for all that the rig needs and was not read so far; joints and frames after
        `observations` only."""
        return self._stream.lacks()

    def _without_joints(self) -> InvalidFile:
        topic, names = self._rig.topics.joint_states, sorted(self._topics)
        more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
        cut = f" ({self.report.truncated})" if self.report.truncated else ""
        return InvalidFile(
            f"{self._path}: expected joint states on {topic}, got none; "
            f"topics there: {', '.join(names[:MAX_NAMED]) or 'none'}{more}{cut}"
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
        metadata = path / "metadata.yaml"
        mode = COMPRESSED.search(read_bytes(metadata, MAX_METADATA)) if metadata.exists() else None
        packed = mode is not None and mode[1].lower() == b"file"
        endings = (".mcap.zstd", ".db3.zstd") if packed else (".mcap", ".db3")
        files = [file for file in path.iterdir() if file.name.endswith(endings)]
        if not files:
            raise InvalidFile(f"{path}: {EXPECTED}, got a folder without {' or '.join(endings)} files")
        for file in sorted(files, key=lambda file: (len(file.name), file.name)):
            if not packed:
                source = _open_file(file)
                source.packed = mode is not None
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
    for kind in KINDS:
        if first.startswith(kind.MAGIC):
            return kind(path)
    came = f"a file that begins with {first!r}" if first else "an empty file"
    raise InvalidFile(f"{path}: {EXPECTED}, got {came}")
