"""Writers: observations to an MCAP file for ROS 2, Foxglove and `open_recording`; tracked poses to MCAP, TUM or CSV."""

import csv
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.correction import bounded_covariance
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import text_file, write_errors
from handsight.messages import encode
from handsight.messages.read import rosbags_module, typestore
from handsight.messages.topics import OwnTopic, RosType
from handsight.observation import Observation
from handsight.rig import Rig


class McapFile:
    """An MCAP file with zstd chunks, open for writing; it appears at `path` when it is closed, after an error not."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidFile where nothing can be written, MissingExtra without rosbags."""
        self._store, rosbag2 = typestore("cdr"), rosbags_module("rosbags.rosbag2")
        self._path = path
        final = Path(os.path.realpath(path))  # a link stays one
        if final.is_dir():
            raise InvalidFile(f"{path}: expected a file to write, got a folder")
        with write_errors(path):
            # rosbags writes a folder with the file in it. In the same parent folder, so a rename is enough.
            self._folder = Path(tempfile.mkdtemp(prefix=f".{final.name}-", dir=final.parent))
            plugin = rosbag2.StoragePlugin.MCAP
            mode = rosbag2.CompressionMode.STORAGE
            self._writer = rosbag2.Writer(self._folder / "bag", version=9, storage_plugin=plugin)
            self._writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
            self._writer.open()
        self._connections: dict[str, Any] = {}
        self._open = True

    def append(self, topic: str, kind: str, stamp: float, **fields: object) -> None:
        """Appends a message with that type, stamp and log time [s], and fields; raises InvalidInput once closed."""
        if not self._open:
            raise InvalidInput(f"{self._path}: expected an open file to write to, got a closed one")
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(encode.Message(**fields), kind)
        sec, nanosec = encode.split_stamp(stamp)
        self._writer.write(self._connections[topic], sec * 10**9 + nanosec, data)

    def close(self) -> None:
        """Completes the file and moves it to `path`; a second call does nothing."""
        self._end(keep=True)

    def discard(self) -> None:
        """Ends the writing, and leaves `path` as it was; does nothing once the file is closed."""
        self._end(keep=False)

    def _end(self, *, keep: bool) -> None:
        if not self._open:
            return
        self._open = False
        try:
            with write_errors(self._path):
                self._writer.close()
                if keep:
                    (self._folder / "bag" / "bag.mcap").replace(os.path.realpath(self._path))
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Closes the file; discards it after an error."""
        self._end(keep=kind is None)


class RecordingWriter(McapFile):
    """An MCAP file of a rig's observations, with the rig's topics and frame ids.

    At the end of a `with` block it is closed after an error or Ctrl-C too, so that the messages until then are kept.
    """

    def __init__(self, path: str | Path, rig: Rig) -> None:
        """The file appears at `path` when it is closed, in place of an older one.

        Raises InvalidInput for a rig that reads joint states otherwise than they are written, as JointStates in
        radians; InvalidFile, MissingExtra.
        """
        if rig.topics.joint_reading is not None:
            came = checks.brief(rig.topics.joint_reading)
            raise InvalidInput(
                f"rig.topics.joint_reading: expected None, as a JointState is written, got {came}"
            )
        super().__init__(Path(path))
        self._rig = rig

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, observation: Observation) -> None:
        """Appends all messages of an observation, with its stamp as log time.

        Depth is rounded to whole millimetres (16UC1), as RGB-D cameras give it; beyond 65 m it becomes unknown. A
        contact's covariance is lost, as its message has no field for it. Raises InvalidInput where the rig lacks a
        topic for something in the observation, and for stamps that a message cannot hold.
        """
        stamp = observation.stamp
        topics = self._rig.topics
        frames = self._rig.frames
        top = encode.header(stamp)
        if observation.joint_positions is not None:
            position = np.array([*observation.joint_positions.values()], np.float64)
            joints = {"name": list(observation.joint_positions), "position": position}
            none = dict.fromkeys(("velocity", "effort"), np.zeros(0))
            self.append(topics.joint_states, RosType.JOINTS, stamp, header=top, **joints, **none)
        for finger, wrench in observation.wrenches.items():
            topic = _topic(topics.wrenches.get(finger), f"wrenches.{finger}")
            value = checks.finite(wrench, f"wrenches[{finger!r}]", (6,))
            body = encode.Message(force=encode.parts("xyz", value[:3]), torque=encode.parts("xyz", value[3:]))
            frame = encode.header(stamp, f"{finger}_sensor")  # its own, for which the rig has no name
            self.append(topic, RosType.WRENCH, stamp, header=frame, wrench=body)
        for finger, contact in observation.contacts.items():
            topic = _topic(topics.contacts.get(finger), f"contacts.{finger}")
            fields = encode.contact_fields(contact, stamp, frames["palm"])
            self.append(topic, RosType.CONTACT, stamp, **fields)
        for array, reading in observation.skin.items():  # without a header: its log time is its stamp
            fields = encode.taxel_fields(reading, self._rig.skin.get(array), array)
            topic = _topic(topics.skin.get(array), f"skin.{array}")
            self.append(topic, RosType.ARRAY, stamp, **fields)
        if observation.T_world_palm is not None:
            T_world_palm = se3.check(observation.T_world_palm, "T_world_palm")
            link = encode.transform(T_world_palm, stamp, frames["world"], frames["palm"])
            self.append(_topic(topics.tf, "tf"), RosType.TF, stamp, transforms=[link])
        vision = observation.vision
        if vision is not None:
            top = encode.header(stamp if vision.stamp is None else vision.stamp, frames[vision.frame])
            body = encode.pose_with_covariance(vision.T_frame_object, vision.covariance)
            topic = _topic(topics.vision, "vision")
            self.append(topic, RosType.POSE_COVARIANCE, stamp, header=top, pose=body)
        if observation.color is not None:
            color = np.asarray(observation.color, np.uint8)
            self._write_image(observation, _topic(topics.color, "color"), "rgb8", color)
        if observation.depth is not None:
            depth = np.nan_to_num(observation.depth)
            known = (depth > 0) & (depth < 65.5)
            millimetres = np.round(np.where(known, depth, 0) * 1000).astype("<u2")
            self._write_image(observation, _topic(topics.depth, "depth"), "16UC1", millimetres)

    def write_truth(self, stamp: float, T_palm_object: ArrayLike) -> None:
        """Appends the true pose of the object (4, 4) on the rig's topic of the truth; raises InvalidInput."""
        truth = encode.pose(se3.check(T_palm_object, "T_palm_object"))
        top = encode.header(stamp, self._rig.frames["palm"])
        topic = _topic(self._rig.topics.truth, "truth")
        self.append(topic, RosType.POSE, stamp, header=top, pose=truth)

    def _write_image(
        self, observation: Observation, topic: str, encoding: str, pixels: NDArray[np.generic]
    ) -> None:
        """Appends an image of an observation, and its CameraInfo."""
        stamp = observation.stamp
        taken = observation.image_stamp
        header = encode.header(stamp if taken is None else taken, self._rig.frames["camera"])
        height, width = pixels.shape[:2]
        top = {"header": header, "height": height, "width": width}
        data = np.frombuffer(pixels.tobytes(), dtype=np.uint8)
        fields = {"encoding": encoding, "is_bigendian": 0, "step": len(data) // height, "data": data}
        self.append(topic, RosType.IMAGE, stamp, **top, **fields)
        camera = self._rig.camera
        info = self._rig.topics.camera_info
        if camera is None or camera.intrinsics is None or info is None:
            return
        K = np.asarray(camera.intrinsics, dtype=np.float64)
        matrices = {"k": K.ravel(), "r": np.eye(3).ravel(), "p": np.pad(K, ((0, 0), (0, 1))).ravel()}
        model = "rational_polynomial" if len(camera.lens) > 5 else "plumb_bob"
        d = np.pad(camera.lens, (0, max(5 - len(camera.lens), 0)))
        lens = {"distortion_model": model, "d": d, "binning_x": 0, "binning_y": 0}
        roi = encode.Message(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        self.append(info, RosType.INFO, stamp, **top, **matrices, **lens, roi=roi)


def _topic(topic: str | None, name: str) -> str:
    if topic is None:
        raise InvalidInput(f"topics.{name}: expected a topic in the rig to write to, got none")
    return topic


ROW_CHECKS: dict[str, Callable[[Array, str], Array]] = {
    "T_palm_object": se3.check,
    "covariance": partial(checks.covariance, shape=(6, 6)),
    "information": partial(checks.finite, shape=(6, 6)),
}
"""What checks the arrays of a row, by field; raises InvalidInput."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackRow:
    """The object's tracked pose at one instant; rows without a pose are only in the CSV."""

    stamp: float
    """Time of the pose [s]."""
    T_palm_object: Array | None
    """(4, 4) pose; None: unknown."""
    covariance: Array | None
    """(6, 6) covariance of (δp [m], δθ [rad]) along the palm's axes; None: unbounded in some direction, or unknown."""
    state: str
    """The tracker's state: tracking, uncertain or lost."""
    reason: str = ""
    """Why the state is not tracking; empty where it is."""
    information: Array | None = None
    """(6, 6) information, which may be singular, for where the covariance is None; None: nothing is known."""

    def __post_init__(self) -> None:
        checks.finite(self.stamp, "row.stamp", ())
        for name, check in ROW_CHECKS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(value, f"row.{name}"))

    @property
    def bounded_covariance(self) -> Array:
        """(6, 6) covariance, with a large but finite variance in directions where it is unbounded or unknown."""
        if self.covariance is not None:
            return self.covariance
        return bounded_covariance(np.zeros((6, 6)) if self.information is None else self.information)


def write_track_mcap(path: str | Path, rows: Iterable[TrackRow], *, frame: str = "palm") -> None:
    """Writes an MCAP file with PoseWithCovarianceStamped on /handsight/pose; `frame`: the palm's frame id.

    Where a covariance is unbounded, unobservable directions have the variance of a metre or of a full turn (π²/3), so
    that its largest eigenvalue is at least 1. Raises InvalidFile, MissingExtra.
    """
    with McapFile(Path(path)) as file:
        for row in rows:
            if row.T_palm_object is not None:
                top = encode.header(row.stamp, frame)
                pose = encode.pose_with_covariance(row.T_palm_object, row.bounded_covariance)
                file.append(OwnTopic.POSE, RosType.POSE_COVARIANCE, row.stamp, header=top, pose=pose)


def write_track_tum(path: str | Path, rows: Iterable[TrackRow]) -> None:
    """Writes lines `stamp x y z qx qy qz qw` [s, m], the format of evo and the TUM benchmark; raises InvalidFile."""
    with text_file(path) as file:
        for row in rows:
            if row.T_palm_object is not None:
                file.write(f"{row.stamp:.9f} {' '.join(_pose(row.T_palm_object))}\n")


def write_track_csv(path: str | Path, rows: Iterable[TrackRow]) -> None:
    """Writes a CSV: stamp [s], state, reason, position [m], quaternion xyzw and sigmas [m, rad], empty where unknown.

    Raises InvalidFile.
    """
    with text_file(path) as file:
        table = csv.writer(file, lineterminator="\n")
        columns = ["stamp", "state", "reason", "x", "y", "z", "qx", "qy", "qz", "qw"]
        table.writerow([*columns, *(f"sigma_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))])
        for row in rows:
            pose = [""] * 7 if row.T_palm_object is None else _pose(row.T_palm_object)
            sigmas = [""] * 6
            if row.covariance is not None:
                sigmas = [f"{x:.6g}" for x in np.sqrt(np.diagonal(row.covariance))]
            table.writerow([f"{row.stamp:.9f}", row.state, row.reason, *pose, *sigmas])


def _pose(T: Array) -> list[str]:
    return [f"{x:.9f}" for part in se3.position_quaternion(T).values() for x in part]
