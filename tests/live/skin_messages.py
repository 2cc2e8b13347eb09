"""The demo's can, held by tips of three-axis taxels in place of wrenches, as their drivers' messages."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from handsight.messages import ObservationStream, RawMessage
from handsight.messages.encode import Message, header, parts
from handsight.messages.read import typestore
from handsight.tracking import Tracker
from handsight.tracking.replay import Tally, replay
from testbed import skin_scenes
from tests.live.recorded import in_ros1, model, rig, said

TYPES = {
    "ff": ("/tactile", "tactile_msgs/msg/TactileState", ""),
    "mf": ("/mf/taxels", "std_msgs/msg/Float32MultiArray", ""),
    "rf": ("/rf/cloud", "sensor_msgs/msg/PointCloud2", "[fx,fy,fz]"),
    "lf": ("/xServTopic", "xela_server_ros2/msg/SensStream", "sensors[sensor_pos=1].forces"),
    "th": ("/xServTopic", "xela_server_ros2/msg/SensStream", "sensors[sensor_pos=2].forces"),
}
"""By finger the topic and the type of its taxels' messages, and the path to its readings."""
PLAIN = {name: (f"/{name}/taxels", "std_msgs/msg/Float32MultiArray", "") for name in TYPES}
"""The same where no driver's package is installed; one is of a type that nobody expects of taxels, as a hand's own is."""
PLAIN |= {"rf": TYPES["rf"], "th": ("/th/hand", "geometry_msgs/msg/PoseArray", "poses.position")}


@lru_cache
def held():
    """The rig with taxels, and what they read."""
    wrenches, stream = rig(), ObservationStream(rig())
    observations = [seen for each in said() for seen in stream.put(each)] + stream.finish()
    known, shapes = skin_scenes.with_taxels(wrenches, np.random.default_rng(0))
    return known, tuple(skin_scenes.taxel_observations(known, shapes, observations, 5))


def skin_rig(types=TYPES):
    """The rig that hears them."""
    known, _ = held()
    topics = replace(
        known.topics,
        wrenches={},
        skin={name: topic for name, (topic, _, _) in types.items()},
        skin_fields={name: path for name, (_, _, path) in types.items() if path},
    )
    return replace(known, topics=topics)


def skin_messages(encoding="cdr", types=TYPES):
    """All that the robot says but wrenches, and its taxels, in order."""
    base = [each for each in said() if "wrench" not in each.topic and each.topic != "/truth/object"]
    base = list(base if encoding == "cdr" else in_ros1(base))
    for seen in held()[1]:
        for topic, kind in dict.fromkeys((topic, kind) for topic, kind, _ in types.values()):
            readings = {name: seen.skin[name] for name, (own, _, _) in types.items() if own == topic}
            kind = kind if encoding == "cdr" else kind.replace("server_ros2", "server_ros")
            base.append(raw(topic, kind, encoding, seen.stamp, content(kind, seen.stamp, readings)))
    return sorted(base, key=lambda each: each.log_time)


def raw(topic, kind, encoding, stamp, message):
    """A message as bytes."""
    data = getattr(typestore(encoding), f"serialize_{encoding}")(message, kind)
    return RawMessage(topic, kind, encoding, stamp, bytes(data))


def content(kind, stamp, readings):
    """A message of that type with the readings (30, 3) by finger."""
    (name, values), *_ = readings.items()
    if kind.endswith("TactileState"):
        channels = [Message(name=each, values=f.astype(np.float32).ravel()) for each, f in readings.items()]
        return Message(header=header(stamp), sensors=channels)
    if kind.endswith("MultiArray"):
        layout = Message(dim=[], data_offset=0)
        return Message(layout=layout, data=values.astype(np.float32).ravel())
    if kind.endswith("PoseArray"):
        still = parts("xyzw", np.array([0.0, 0, 0, 1]))
        poses = [Message(position=parts("xyz", row), orientation=still) for row in values]
        return Message(header=header(stamp), poses=poses)
    if kind.endswith("PointCloud2"):
        columns = [
            Message(name=f"f{axis}", offset=4 * k, datatype=7, count=1) for k, axis in enumerate("xyz")
        ]
        data = values.astype("<f4").view(np.uint8).ravel()
        return Message(
            header=header(stamp), height=1, width=len(values), fields=columns, is_bigendian=False,
            point_step=12, row_step=12 * len(values), data=data, is_dense=True,
        )  # fmt: skip
    full = [
        Message(
            message=1, time=stamp, model="uSCuFT", sensor_pos=k, taxels=[],
            forces=[parts("xyz", row) for row in values.astype(np.float32)],
        )
        for k, values in enumerate(readings.values(), start=1)
    ]  # fmt: skip
    return Message(sensors=full)


def tracked_skin(known, messages):
    """Stamps and poses, as `handsight track` has them, and the tracker at the end."""
    stream, tracker = ObservationStream(known), Tracker(known, model())
    observations = [seen for each in messages for seen in stream.put(each)] + stream.finish()
    steps = list(replay(observations, tracker, Tally()))
    return {round(step.stamp, 6): step.estimate.T_palm_object for step in steps}, tracker
