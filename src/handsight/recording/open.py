"""Opening of recordings as streams of observations; a file's kind is known from its first bytes, not from its name."""

import os
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from handsight.camera import Camera
from handsight.checks import suggestion
from handsight.errors import InvalidFile
from handsight.files import open_regular, read_bytes
from handsight.messages import ObservationStream
from handsight.messages.read import rosbags_module
from handsight.observation import Observation
from handsight.recording.bags import Rosbag1Source, SqliteSource
from handsight.recording.mcap import MAX_EXPANSION, SPARE_UNPACKED, McapSource
from handsight.recording.source import ZSTD, Source
from handsight.rig import Rig

ENDINGS = ".mcap", ".db3"
EXPECTED = "expected a recording (MCAP, a bag of ROS 1, or a rosbag 2: its folder or its .db3)"


def open_recording(path: str | Path, rig: Rig) -> "Recording":
    """Returns a rig's recording: an MCAP file, a bag of ROS 1, a `.db3` file, or the folder of a rosbag 2.

    The rig says what each topic is for. Raises InvalidFile for anything else, and for a recording without a topic of
    joint states; MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


class Recording(AbstractContextManager["Recording"]):
    """An open recording; `report`, `truth` and `intrinsics` are of the part that has been read."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self._path = path
        self._rig = rig
        self._topics = dict[str, str]()
        with ExitStack() as opened:
            self._files = [opened.enter_context(closing(file)) for file in open_files(path)]
            for file in self._files:
                self._topics |= file.topics
            self._begin()
            if rig.topics.joint_states not in self._topics:
                raise self._without_joints()
            self._opened = opened.pop_all()

    def _begin(self) -> None:
        self._stream = ObservationStream(self._rig, self._topics)
        self.report = self._stream.report
        """Counts of the messages, and sentences about what is wrong with them."""
        self.report.files = self._files
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
        camera = self._rig.camera
        topics = self._rig.topics
        if camera is None or camera.intrinsics is not None or None in (topics.depth, topics.camera_info):
            return self._rig
        for _ in islice(self.observations(), 1000):
            if self.intrinsics is not None:
                break
        return self._stream.calibrated(self._rig)

    def observations(self) -> Iterator[Observation]:
        """Yields the observations in order of stamp, one for each joint state message.

        The file is read as the iterator advances, in bounded memory. Each call starts at the beginning, with a new
        `report` and `truth`. Raises InvalidFile at the end if there were no joint states.
        """
        self._begin()
        for file in self._files:
            for message in file.messages(self._stream.topics):
                yield from self._stream.put(message)
        yield from self._stream.finish()
        joints = self.report.topics.get(self._rig.topics.joint_states)
        if joints is None or not joints.messages:
            raise self._without_joints()

    def lacks(self) -> list[str]:
        """Returns sentences as `ObservationStream.lacks`; missing joints and frames are known after `observations`."""
        return self._stream.lacks()

    def _without_joints(self) -> InvalidFile:
        topic = self._rig.topics.joint_states
        faults = "".join(f"; {fault}" for fault in self.report.faults[:1])
        there = suggestion(topic, self._topics) or "; there is no topic"
        return InvalidFile(f"{self._path}: expected joint states on {topic}, got none{there}{faults}")

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
        files = [f for f in path.iterdir() if f.name.removesuffix(".zstd").endswith(ENDINGS)]
        if not files:
            raise InvalidFile(f"{path}: {EXPECTED}, got a folder without {' or '.join(ENDINGS)} files")
        messages_packed = _messages_packed(path)
        for file in sorted(files, key=lambda file: (len(file.name), file.name)):
            source = _open_packed_file(file) if file.suffix == ".zstd" else _open_file(file)
            source.packed = messages_packed
            yield source
    except OSError as error:
        raise InvalidFile(f"{error.filename or path}: {error.strerror or error}") from None


def _messages_packed(folder: Path) -> bool:
    """Returns whether the recorder has compressed each message on its own."""
    metadata = folder / "metadata.yaml"
    pattern = rb"""compression_mode:\s*['"]?message"""
    text = read_bytes(metadata, 1 << 20) if metadata.exists() else b""
    return re.search(pattern, text, re.IGNORECASE) is not None


def _open_packed_file(path: Path) -> Source:
    """Returns a file that is compressed with zstd as a whole, unpacked up to the first damage.

    Raises InvalidFile, also where it unpacks to far more than a recording would.
    """
    zstd = rosbags_module(ZSTD)
    # The unpacked file is removed at once, though still open; on systems that forbid this, it stays.
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        copy = Path(folder) / path.stem
        with open_regular(path) as packed, copy.open("wb") as file, suppress(EOFError, zstd.ZstdError):
            most = SPARE_UNPACKED + MAX_EXPANSION * os.fstat(packed.fileno()).st_size
            with zstd.open(packed) as pieces:  # what lies before an error is read
                while piece := pieces.read(1 << 20):
                    file.write(piece)
                    if file.tell() > most:
                        raise InvalidFile(f"{path}: expected at most {most} bytes when unpacked, got more")
        try:
            source = _open_file(copy)
        except InvalidFile as error:
            raise InvalidFile(str(error).replace(str(copy), str(path))) from None
    source.path = path
    return source


def _open_file(path: Path) -> Source:
    with open_regular(path) as file:
        first = file.read(16)
    for kind in (McapSource, Rosbag1Source, SqliteSource):
        if first.startswith(kind.MAGIC):
            return kind(path)
    raise InvalidFile(f"{path}: {EXPECTED}, got a file that begins with {first!r}")
