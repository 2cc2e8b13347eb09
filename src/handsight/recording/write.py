"""Observations to an MCAP file that ROS 2, Foxglove and `open_recording` read."""

import math
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
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


class McapFile:
    """An MCAP file with zstd chunks, open for writing; it is at `path` once it is closed."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidFile where nothing can be written, MissingExtra without rosbags."""
        try:
            from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise MissingExtra("recordings need rosbags: pip install 'handsight[robot]'") from None
        self._path, self._store = path, get_typestore(Stores.ROS2_HUMBLE)
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
        """Append a message of that type, logged at its stamp."""
        if not self._open:
            raise InvalidInput(f"{self._path}: expected an open file to write to, got a closed one")
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self.make(kind, **fields), kind)
        sec, nanosec = _split(stamp)
        self._writer.write(self._connections[topic], sec * 10**9 + nanosec, data)

    def make(self, kind: str, **fields: Any) -> Any:
        """A message, or a part of one."""
        return self._store.types[kind](**fields)

    def header(self, stamp: float, frame: str = "") -> Any:
        """A std_msgs/Header."""
        sec, nanosec = _split(stamp)
        time = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def vector(self, xyz: Array, kind: str = "Vector3") -> Any:
        """A geometry_msgs/Vector3, or a Point."""
        x, y, z = (float(value) for value in xyz)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, R: Array) -> Any:
        """A geometry_msgs/Quaternion."""
        x, y, z, w = se3.quaternion_from_rotation(R).tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, T: Array) -> Any:
        """A geometry_msgs/Pose."""
        position, orientation = self.vector(T[:3, 3], "Point"), self.quaternion(T[:3, :3])
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def pose_with_covariance(self, T: Array, covariance: Array | None) -> Any:
        """A geometry_msgs/PoseWithCovariance; without covariance it is all zero."""
        flat = np.zeros(36) if covariance is None else np.asarray(covariance, dtype=np.float64).ravel()
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(T), covariance=flat)

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
        stamp, topics = observation.stamp, self._rig.topics
        _split(stamp)
        if observation.joint_positions is not None:
            self._joints(stamp, observation.joint_positions)
        for finger, wrench in observation.wrenches.items():
            self._wrench(stamp, finger, wrench)
        if observation.T_world_palm is not None:
            self._transform(stamp, _topic(topics.tf, "tf"), observation.T_world_palm)
        if observation.vision is not None:
            vision, frame = observation.vision, self._frame(observation.vision.frame)
            pose = self._file.pose_with_covariance(vision.T_frame_object, vision.covariance)
            fields = {"header": self._file.header(stamp, frame), "pose": pose}
            self._file.write(_topic(topics.vision, "vision"), POSE_COVARIANCE, stamp, fields)
        if observation.color is not None:
            self._image(stamp, _topic(topics.color, "color"), "rgb8", np.asarray(observation.color, np.uint8))
        if observation.depth is not None:
            self._image(stamp, _topic(topics.depth, "depth"), "16UC1", _millimetres(observation.depth))

    def write_truth(self, stamp: float, T_palm_object: ArrayLike) -> None:
        """Append where the object truly is, (4, 4), on the rig's topic for it; raises InvalidInput."""
        T = se3.check(T_palm_object, "T_palm_object")
        fields = {"header": self._file.header(stamp, self._frame("palm")), "pose": self._file.pose(T)}
        self._file.write(_topic(self._rig.topics.truth, "truth"), POSE, stamp, fields)

    def _frame(self, role: str) -> str:
        return self._rig.frames[role]

    def _joints(self, stamp: float, positions: Mapping[str, float]) -> None:
        fields = {
            "header": self._file.header(stamp),
            "name": list(positions),
            "position": np.array(list(positions.values()), dtype=np.float64),
            "velocity": np.zeros(0),
            "effort": np.zeros(0),
        }
        self._file.write(self._rig.topics.joint_states, JOINTS, stamp, fields)

    def _wrench(self, stamp: float, finger: str, wrench: Array) -> None:
        topics = self._rig.topics.wrenches
        if finger not in topics:
            raise InvalidInput(f"wrenches: expected fingers {', '.join(topics) or '(none)'}, got {finger!r}")
        value = checks.finite(wrench, f"wrenches[{finger!r}]", (6,))
        body = self._file.make(
            "geometry_msgs/msg/Wrench",
            force=self._file.vector(value[:3]),
            torque=self._file.vector(value[3:]),
        )
        # The sensor's own frame; none of the rig's frame ids.
        fields = {"header": self._file.header(stamp, f"{finger}_sensor"), "wrench": body}
        self._file.write(topics[finger], WRENCH, stamp, fields)

    def _transform(self, stamp: float, topic: str, T_world_palm: Array) -> None:
        file, T = self._file, se3.check(T_world_palm, "T_world_palm")
        body = file.make(
            "geometry_msgs/msg/Transform",
            translation=file.vector(T[:3, 3]),
            rotation=file.quaternion(T[:3, :3]),
        )
        stamped = file.make(
            "geometry_msgs/msg/TransformStamped",
            header=file.header(stamp, self._frame("world")),
            child_frame_id=self._frame("palm"),
            transform=body,
        )
        file.write(topic, TF, stamp, {"transforms": [stamped]})

    def _image(self, stamp: float, topic: str, encoding: str, pixels: NDArray[Any]) -> None:
        h, w = pixels.shape[:2]
        header = self._file.header(stamp, self._frame("camera"))
        fields = {
            "header": header,
            "height": h,
            "width": w,
            "encoding": encoding,
            "is_bigendian": 0,
            "step": pixels.nbytes // h,
            "data": np.frombuffer(pixels.tobytes(), dtype=np.uint8),
        }
        self._file.write(topic, IMAGE, stamp, fields)
        camera, info = self._rig.camera, self._rig.topics.camera_info
        if camera is not None and camera.intrinsics is not None and info is not None:
            self._info(stamp, info, camera.intrinsics, (w, h))

    def _info(self, stamp: float, topic: str, K: Array, size: tuple[int, int]) -> None:
        roi = self._file.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        fields = {
            "header": self._file.header(stamp, self._frame("camera")),
            "height": size[1],
            "width": size[0],
            "distortion_model": "plumb_bob",
            "d": np.zeros(5),
            "k": np.asarray(K, dtype=np.float64).ravel(),
            "r": np.eye(3).ravel(),
            "p": np.hstack([K, np.zeros((3, 1))]).ravel(),
            "binning_x": 0,
            "binning_y": 0,
            "roi": roi,
        }
        self._file.write(topic, INFO, stamp, fields)

    def close(self) -> None:
        """Bring the file to its place; raises InvalidFile where it cannot be written."""
        self._file.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close; after an error too, so that what was written is kept."""
        self.close()


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
