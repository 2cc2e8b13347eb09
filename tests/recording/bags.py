"""Recordings made with rosbags' own writers."""

import shutil

from rosbags import rosbag1, rosbag2

from handsight.recording import open_recording
from tests.messages.ros import STORES, nanoseconds, rig


def save(folder, rows, kind="mcap", *, compression=None):
    """The path of a recording of (topic, log [s], message), written by rosbags in the given order."""
    path = folder / f"bag{len(list(folder.iterdir()))}"
    store = STORES[1 if kind == "bag" else 2]
    if kind == "bag":
        path = path.with_suffix(".bag")
        writer = rosbag1.Writer(path)
        if compression:
            writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, compression))
        encode = store.serialize_ros1
    else:
        plugin = getattr(rosbag2.StoragePlugin, {"mcap": "MCAP", "db3": "SQLITE3"}[kind])
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if compression:
            mode = getattr(rosbag2.CompressionMode, compression)
            writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        encode = store.serialize_cdr
    with writer:
        connections = {}
        for topic, log, message in rows:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], nanoseconds(log), encode(message, name))
    return path


def alone(path):
    """The one data file of a rosbag 2's folder, without its metadata.yaml."""
    (file,) = (f for f in path.iterdir() if f.suffix in (".mcap", ".db3"))
    return shutil.copy(file, path.with_suffix(f"{file.suffix}"))


def read(path, robot=None):
    """Observations, and the recording after it was read to its end."""
    with open_recording(path, robot or rig()) as recording:
        return list(recording.observations()), recording
