"""Observations to an MCAP file that ROS 2, Foxglove and `open_recording` read."""

import math
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput, MissingExtra
from handsight.messages.topics import IMAGE, INFO, JOINTS, POSE, POSE_COVARIANCE, TF, WRENCH
from handsight.observation import Observation
from handsight.rig import Rig

LATEST = float(2**31)
"""Seconds are 32 bits in a message's stamp."""

Fields = dict[str, Any]
"""A message, or a part of one, by the names of its fields."""


class McapFile:
    """An MCAP file with zstd chunks, open for writing; it is at `path` once it is closed."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidFile where nothing can be written, MissingExtra without rosbags."""
        try:
            from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise MissingExtra("recordings need rosbags: pip install 'handsight[robot]'") from None
        self._path = path
        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        if path.is_dir():
            raise InvalidFile(f"{path}: expected a file to write, got a folder")
        try:
            # rosbags writes a folder with the file in it: beside the file, so that it need only be renamed.
            self._folder = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
            self._writer: Any = Writer(self._folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except OSError as error:
            raise InvalidFile(f"{path}: cannot be written: {error.strerror}") from None
        self._connections: dict[str, Any] = {}
        self._open = True

    def write(self, topic: str, kind: str, stamp: float, fields: Mapping[str, Any]) -> None:
        """Append a message of that type, logged at its stamp; its parts are dicts of their fields."""
        if not self._open:
            raise InvalidInput(f"{self._path}: expected an open file to write to, got a closed one")
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self._made(kind, fields), kind)
        sec, nanosec = _split(stamp)
        self._writer.write(self._connections[topic], sec * 10**9 + nanosec, data)

    def _made(self, kind: str, fields: Mapping[str, Any]) -> Any:
        """The message; its field definitions say (name, (node, type's name)), of lists (node, ((node, name), _))."""
        made, definitions = dict(fields), self._store.fielddefs[kind][1]
        for name, (_, kind_of_part) in definitions:
            if isinstance(made[name], dict):
                made[name] = self._made(kind_of_part, made[name])
            elif isinstance(made[name], list) and made[name] and isinstance(made[name][0], dict):
                made[name] = [self._made(kind_of_part[0][1], part) for part in made[name]]
        return self._store.types[kind](**made)

    def close(self) -> None:
        """Bring the file to its place; a second time does nothing."""
        if not self._open:
            return
        self._open = False
        try:
            self._writer.close()
            (self._folder / "bag" / "bag.mcap").replace(self._path)
        except OSError as error:
            raise InvalidFile(f"{self._path}: cannot be written: {error.strerror}") from None
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RecordingWriter:
    """What a rig measured, as one MCAP file; topics and frame ids are the rig's."""

    def __init__(self, path: str | Path, rig: Rig) -> None:
        """The file is at `path` once it is closed; what was there is replaced. Raises InvalidFile, MissingExtra."""
        self._rig, self._file = rig, McapFile(Path(path))

    def write(self, observation: Observation) -> None:
        """Append all that the observation has, logged at its stamp.

        Depth is kept in whole millimetres (16UC1), as RGB-D cameras give it; beyond 65 m there is none. Raises
        InvalidInput where the rig has no topic for something, and for stamps that a message cannot hold.
        """
        stamp, topics, frames = observation.stamp, self._rig.topics, self._rig.frames
        top, fields = header(stamp), Fields()
        if observation.joint_positions is not None:
            names, position = list(observation.joint_positions), [*observation.joint_positions.values()]
            fields = {
                "position": np.array(position, np.float64),
                "velocity": np.zeros(0),
                "effort": np.zeros(0),
            }
            self._file.write(topics.joint_states, JOINTS, stamp, {"header": top, "name": names, **fields})
        for finger, wrench in observation.wrenches.items():
            self._write_wrench(stamp, finger, wrench)
        if observation.T_world_palm is not None:
            T = se3.check(observation.T_world_palm, "T_world_palm")
            body = {"translation": vector(T[:3, 3]), "rotation": quaternion(T[:3, :3])}
            named = {"header": header(stamp, frames["world"]), "child_frame_id": frames["palm"]}
            fields = {"transforms": [{**named, "transform": body}]}
            self._file.write(_topic(topics.tf, "tf"), TF, stamp, fields)
        if observation.vision is not None:
            pose = pose_with_covariance(observation.vision.T_frame_object, observation.vision.covariance)
            fields = {"header": header(stamp, frames[observation.vision.frame]), "pose": pose}
            self._file.write(_topic(topics.vision, "vision"), POSE_COVARIANCE, stamp, fields)
        if observation.color is not None:
            color = np.asarray(observation.color, np.uint8)
            self._write_image(stamp, _topic(topics.color, "color"), "rgb8", color)
        if observation.depth is not None:
            depth = _millimetres(observation.depth)
            self._write_image(stamp, _topic(topics.depth, "depth"), "16UC1", depth)

    def write_truth(self, stamp: float, T_palm_object: ArrayLike) -> None:
        """Append where the object truly is, (4, 4), on the rig's topic for it; raises InvalidInput."""
        T = se3.check(T_palm_object, "T_palm_object")
        fields = {"header": header(stamp, self._rig.frames["palm"]), "pose": pose(T)}
        self._file.write(_topic(self._rig.topics.truth, "truth"), POSE, stamp, fields)

    def _write_wrench(self, stamp: float, finger: str, wrench: Array) -> None:
        topics = self._rig.topics.wrenches
        if finger not in topics:
            raise InvalidInput(f"wrenches: expected fingers {', '.join(topics) or '(none)'}, got {finger!r}")
        value = checks.finite(wrench, f"wrenches[{finger!r}]", (6,))
        body = {"force": vector(value[:3]), "torque": vector(value[3:])}
        # The sensor's own frame; none of the rig's frame ids.
        fields = {"header": header(stamp, f"{finger}_sensor"), "wrench": body}
        self._file.write(topics[finger], WRENCH, stamp, fields)

    def _write_image(self, stamp: float, topic: str, encoding: str, pixels: NDArray[Any]) -> None:
        top = {"header": header(stamp, self._rig.frames["camera"])}
        top |= {"height": pixels.shape[0], "width": pixels.shape[1]}
        data = np.frombuffer(pixels.tobytes(), dtype=np.uint8)
        fields = {"encoding": encoding, "is_bigendian": 0, "step": len(data) // len(pixels), "data": data}
        self._file.write(topic, IMAGE, stamp, top | fields)
        camera, info = self._rig.camera, self._rig.topics.camera_info
        if camera is None or camera.intrinsics is None or info is None:
            return
        K = np.asarray(camera.intrinsics, dtype=np.float64)
        P = np.hstack([K, np.zeros((3, 1))])
        fields = {"distortion_model": "plumb_bob", "d": np.zeros(5), "binning_x": 0, "binning_y": 0}
        fields |= {"k": K.ravel(), "r": np.eye(3).ravel(), "p": P.ravel()}
        fields["roi"] = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        self._file.write(info, INFO, stamp, top | fields)

    def close(self) -> None:
        """Bring the file to its place; raises InvalidFile where it cannot be written."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close; after an error too, so that what was written is kept."""
        self.close()


def header(stamp: float, frame: str = "") -> Fields:
    """A std_msgs/Header; raises InvalidInput for a stamp that it cannot hold."""
    sec, nanosec = _split(stamp)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def vector(xyz: Array) -> Fields:
    """A geometry_msgs/Vector3 or Point."""
    return dict(zip("xyz", xyz.tolist(), strict=True))


def quaternion(R: Array) -> Fields:
    """A geometry_msgs/Quaternion."""
    return dict(zip("xyzw", se3.quaternion_from_rotation(R).tolist(), strict=True))


def pose(T: Array) -> Fields:
    """A geometry_msgs/Pose."""
    return {"position": vector(T[:3, 3]), "orientation": quaternion(T[:3, :3])}


def pose_with_covariance(T: Array, covariance: Array | None) -> Fields:
    """A geometry_msgs/PoseWithCovariance; without covariance it is all zero."""
    flat = np.zeros(36) if covariance is None else np.asarray(covariance, dtype=np.float64).ravel()
    return {"pose": pose(T), "covariance": flat}


def _topic(topic: str | None, name: str) -> str:
    if topic is None:
        raise InvalidInput(f"topics.{name}: expected a topic in the rig to write to, got none")
    return topic


def _split(stamp: float) -> tuple[int, int]:
    """Seconds and nanoseconds; raises InvalidInput."""
    if not 0 <= stamp < LATEST:
        raise InvalidInput(f"stamp: expected seconds from 0 to {LATEST:.0f}, got {stamp}")
    # The whole seconds first: 1.7e9 s in nanoseconds is more than a float holds.
    sec = math.floor(stamp)
    nanosec = round((stamp - sec) * 1e9)
    return (sec + 1, 0) if nanosec == 10**9 else (sec, nanosec)


def _millimetres(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    with np.errstate(invalid="ignore"):
        known = (depth > 0) & (depth < 65.5)
    return np.where(known, np.round(np.where(known, depth, 0) * 1000), 0).astype("<u2")
