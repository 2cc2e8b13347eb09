"""A path to a recording as a stream of Observations: what kind it is, its first bytes tell, not its name."""

import re
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from handsight.errors import InvalidFile
from handsight.messages import CameraIntrinsics, ObservationStream, RawMessage, Report
from handsight.observation import Observation
from handsight.recording.chunks import Source
from handsight.recording.mcap import McapSource
from handsight.recording.rosbag1 import Rosbag1Source
from handsight.recording.rosbag2 import CompressedFolder, SqliteSource
from handsight.rig import Rig

KINDS: tuple[type[Source], ...] = (McapSource, Rosbag1Source, SqliteSource)
COMPRESSED = re.compile(rb"""compression_mode:\s*['"]?(file|message)""", re.IGNORECASE)
MAX_METADATA = 1 << 20
EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"
MAX_NAMED = 12
"""Topics in a message."""
MAX_DAMAGE_TOLD = 5


def open_recording(path: str | Path, rig: Rig) -> "Recording":
    """The recording, as what a rig has measured: `.mcap`, `.bag`, `.db3`, or the folder of a rosbag 2.

    The rig says which topic is what. Raises InvalidFile where there is no recording or none with joint states, and
    MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


@dataclass(slots=True, kw_only=True)
class RecordingReport(Report):
    """What a recording held, as far as it was read."""

    source: Source
    """The file; what of it could not be read is in its `damage`."""

    @property
    def truncated(self) -> str | None:
        """Where the file ends too early; None: it is complete."""
        return self.source.truncated

    def sentences(self) -> list[str]:
        """All that is worth telling a user, worst first; empty: nothing is wrong."""
        path, said = self.source.path, list[str]()
        damage = [what for _, what in sorted(self.source.damage.items())]
        if self.truncated:
            said.append(f"{path}: cut: {self.truncated}; what lies before was read")
        said += [f"{path}: damaged: {part}" for part in damage[:MAX_DAMAGE_TOLD]]
        if len(damage) > MAX_DAMAGE_TOLD:
            said.append(f"{path}: damaged in {len(damage) - MAX_DAMAGE_TOLD} more places")
        return said + Report.sentences(self)  # a dataclass with slots knows no bare super()


class Recording:
    """A recording, open; what was met so far is in `report`, `truth` and `intrinsics`."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self._rig, self._source = rig, open_source(path)
        self._begin()
        if rig.topics.joint_states not in self._source.topics:
            self.close()
            raise self._without_joints()

    def _begin(self) -> None:
        self.report = RecordingReport(self._rig.topics.joint_states, source=self._source)
        """Counts and sentences."""
        self._stream = ObservationStream(self._rig, self._source.topics, report=self.report)
        self.truth = self._stream.truth
        """Stamps [s] and `T_palm_object` (4, 4) from the rig's topic of the truth; never in an observation."""

    @property
    def intrinsics(self) -> CameraIntrinsics | None:
        """Of the camera's images; None where no CameraInfo was met."""
        return self._stream.intrinsics

    def observations(self) -> Iterator[Observation]:
        """What was measured, in order of stamp, one observation for each joint state message.

        Read as it is asked for, in bounded memory. Each call begins again, and so do `report` and `truth`. Raises
        InvalidFile at the end if there were no joint states.
        """
        self._begin()
        for message in self._source.messages(self._stream.topics):
            yield from self._stream.put(message)
        yield from self._stream.finish()
        if not self.report.topics[self._rig.topics.joint_states].messages:
            raise self._without_joints()

    def lacks(self) -> list[str]:
        """What the rig needs and was not met so far, a sentence each; joints and frames after `observations` only."""
        return self._stream.lacks()

    def _without_joints(self) -> InvalidFile:
        topic, there = self._rig.topics.joint_states, sorted(self._source.topics)
        more = f" and {len(there) - MAX_NAMED} more" if len(there) > MAX_NAMED else ""
        cut = f" ({self._source.truncated})" if self._source.truncated else ""
        return InvalidFile(
            f"{self._source.path}: expected joint states on {topic}, got none; "
            f"topics there: {', '.join(there[:MAX_NAMED]) or 'none'}{more}{cut}"
        )

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_source(path: Path) -> Source:
    """The messages of a recording; raises InvalidFile where there is none."""
    try:
        if path.is_dir():
            return _open_folder(path)
        if not path.is_file():
            raise InvalidFile(f"{path}: {EXPECTED}, got no file")
        with path.open("rb") as file:
            first = file.read(16)
        for kind in KINDS:
            if first.startswith(kind.MAGIC):
                return kind(path)
    except OSError as error:
        raise InvalidFile(f"{path}: {error.strerror or error}") from None
    came = f"a file that begins with {first!r}" if first else "an empty file"
    raise InvalidFile(f"{path}: {EXPECTED}, got {came}")


def _open_folder(path: Path) -> Source:
    """A rosbag 2: its files one after the other, the tenth after the ninth."""
    metadata = path / "metadata.yaml"
    if metadata.is_file() and COMPRESSED.search(metadata.read_bytes()[:MAX_METADATA]):
        return CompressedFolder(path)
    files = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3")]
    if not files:
        raise InvalidFile(f"{path}: {EXPECTED}, got a folder without .mcap or .db3 files")
    return _SplitFiles(path, sorted(files, key=lambda file: (len(file.name), file.name)))


class _SplitFiles(Source):
    """Several files, as a recorder splits them."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        super().__init__(path)
        with ExitStack() as opened:
            self._parts = [opened.enter_context(closing(open_source(file))) for file in files]
            self._opened = opened.pop_all()
        for part in self._parts:
            self.topics |= part.topics
        self._gather()

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """As `Source.messages`, of each file after the other."""
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
