"""Messages made with rosbags' own types, and a rig that listens to them."""

from types import SimpleNamespace

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handsight import se3
from handsight.contact import Sphere, WrenchCalibration
from handsight.hand.couplings import Couplings
from handsight.messages import ObservationStream, RawMessage
from handsight.rig import Finger, MountedCamera, Rig, Topics

STORES = {2: get_typestore(Stores.ROS2_HUMBLE), 1: get_typestore(Stores.ROS1_NOETIC)}
STORES[1].register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
FINGERS = ("ff", "th")
JOINTS = ("j0", "j1", "j2")
START = 1_700_000_000.0


def begun(folder, kind, store):
    """The path of a recording of a kind (bag, mcap, db3) in a folder, its writer, and what makes bytes of messages."""
    if kind == "bag":
        path = folder / "hand.bag"
        return path, rosbag1.Writer(path), store.serialize_ros1
    path = folder / "hand"
    plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
    return path, rosbag2.Writer(path, version=9, storage_plugin=plugin), store.serialize_cdr


def finger(frame, full_scale=None):
    zero = np.zeros(3)
    return Finger(
        frame=frame,
        T_frame_surface=np.eye(4),
        tip=Sphere(0.01),
        calibration=WrenchCalibration(zero, zero, 0.01, zero, zero, zero, 1.0),
        full_scale=full_scale,
    )


def rig(full_scale=None, joints=JOINTS, **topics):
    """A hand that is only a list of joints."""
    usual = {
        "wrenches": {name: f"/{name}/wrench" for name in FINGERS},
        "truth": "/truth",
        "color": "/color",
        "depth": "/depth",
        "camera_info": "/info",
    }
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    fingers = {name: finger(name, full_scale) for name in FINGERS}
    tips = {name: each.frame for name, each in fingers.items()}
    apart = np.tile(np.eye(4), (len(tips), 1, 1))
    apart[:, 0, 3] = np.arange(len(tips))
    return Rig(
        hand=SimpleNamespace(
            moving=joints,
            joint_names=joints,
            couplings=Couplings({}),
            limits=np.tile([-np.inf, np.inf], (len(joints), 1)),
            tips=tips,
            Ts_palm_tip=lambda positions: apart,
        ),
        fingers=fingers,
        camera=MountedCamera(intrinsics=K, size=(640, 480)),
        topics=Topics(**(usual | topics)),
    )


class Messages:
    """Messages of ROS 1 or 2 by short names."""

    def __init__(self, ros=2):
        self.ros, self.store = ros, STORES[ros]

    def make(self, kind, **fields):
        return self.store.types[kind](**fields)

    def header(self, stamp, frame=""):
        sec = int(np.floor(stamp))
        time = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=round((stamp - sec) * 1e9))
        extra = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def joints(self, stamp, names=JOINTS, positions=(0.1, 0.2, 0.3)):
        empty = np.zeros(0)
        return self.make(
            "sensor_msgs/msg/JointState",
            header=self.header(stamp),
            name=list(names),
            position=np.array(positions, dtype=np.float64),
            velocity=empty,
            effort=empty,
        )

    def vector(self, xyz, kind="Vector3"):
        x, y, z = map(float, xyz)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def wrench(self, stamp, six):
        body = self.make("geometry_msgs/msg/Wrench", force=self.vector(six[:3]), torque=self.vector(six[3:]))
        return self.make("geometry_msgs/msg/WrenchStamped", header=self.header(stamp, "sensor"), wrench=body)

    def quaternion(self, xyzw):
        x, y, z, w = map(float, xyzw)
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, stamp, T, frame="camera", covariance=None, xyzw=None):
        xyzw = se3.quaternion_from_rotation(T[:3, :3]) if xyzw is None else xyzw
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(T[:3, 3], "Point"),
            orientation=self.quaternion(xyzw),
        )
        kind = "PoseStamped"
        if covariance is not None:
            pose = self.make(
                "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.ravel(covariance)
            )
            kind = "PoseWithCovarianceStamped"
        return self.make(f"geometry_msgs/msg/{kind}", header=self.header(stamp, frame), pose=pose)

    def tf(self, stamp, *links):
        """`links`: (parent, child, T_parent_child)."""
        stamped = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(stamp, parent),
                child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.vector(T[:3, 3]),
                    rotation=self.quaternion(se3.quaternion_from_rotation(T[:3, :3])),
                ),
            )
            for parent, child, T in links
        ]
        return self.make("tf2_msgs/msg/TFMessage", transforms=stamped)

    def image(self, stamp, pixels, encoding, *, step=None, big=False, data=None):
        h, w = pixels.shape[:2]
        raw = np.frombuffer(pixels.tobytes(), dtype=np.uint8) if data is None else data
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp, "camera"),
            height=h,
            width=w,
            encoding=encoding,
            is_bigendian=int(big),
            step=len(raw) // h if step is None else step,
            data=raw,
        )

    def info(self, stamp, K, size, lens=(), model="plumb_bob", **cut):
        """`cut`: x_offset, y_offset, width, height of the part that comes, binning_x, binning_y."""
        roi = {name: cut.get(name, 0) for name in ("x_offset", "y_offset", "height", "width")}
        matrices = {
            "k": np.ravel(K),
            "d": np.array(lens, dtype=float),
            "r": np.eye(3).ravel(),
            "p": np.zeros(12),
        }
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp, "camera"),
            width=size[0],
            height=size[1],
            distortion_model=model,
            **{name.upper() if self.ros == 1 else name: value for name, value in matrices.items()},
            **{name: cut.get(name, 0) for name in ("binning_x", "binning_y")},
            roi=self.make("sensor_msgs/msg/RegionOfInterest", **roi, do_rectify=False),
        )

    def compressed(self, stamp, data, described):
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp, "camera"),
            format=described,
            data=np.frombuffer(data, dtype=np.uint8),
        )


def touched(count=50, *, messages=None, rate=100.0, start=START, fingers=FINGERS):
    """(topic, log, message) of joints and wrenches that change; the first message comes at `start`."""
    messages = messages or Messages()
    rng = np.random.default_rng(0)
    rows = []
    for i in range(count):
        stamp = start + i / rate
        rows += [(f"/{name}/wrench", stamp, messages.wrench(stamp, rng.normal(size=6))) for name in fingers]
        rows.append(("/joint_states", stamp, messages.joints(stamp, positions=rng.normal(size=3))))
    return rows


def everything(messages):
    """A little of everything."""
    rng = np.random.default_rng(0)
    rows = touched(10, messages=messages)
    for i in range(3):
        s = START + i / 30
        depth, color = (
            rng.uniform(1, 2, (4, 5)).astype("<f4"),
            rng.integers(0, 255, (4, 5, 3), dtype=np.uint8),
        )
        rows += [
            ("/vision/object", s, messages.pose(s, np.eye(4), covariance=np.eye(6))),
            ("/tf", s, messages.tf(s, ("world", "palm", np.eye(4)))),
            ("/depth", s, messages.image(s, depth, "32FC1")),
            ("/color", s, messages.image(s, color, "bgr8")),
        ]
    return sorted(rows, key=lambda row: row[1])


def nanoseconds(log):
    """The whole seconds first: 1.7e18 is more than a float holds."""
    return int(log) * 10**9 + round(log % 1 * 1e9)


def raw(topic, log, message):
    """The message as it comes from a robot, or from a file."""
    kind, sec = message.__msgtype__, divmod(nanoseconds(log), 10**9)
    return RawMessage(
        topic, kind, "cdr", sec[0] + sec[1] * 1e-9, bytes(STORES[2].serialize_cdr(message, kind))
    )


def heard(rows, robot=None):
    """Observations of (topic, log [s], message) put in as they come, and the stream after the last."""
    rows = sorted(rows, key=lambda row: row[1])
    stream = ObservationStream(robot or rig(), {topic: message.__msgtype__ for topic, _, message in rows})
    observations = [done for row in rows for done in stream.put(raw(*row))]
    return observations + stream.finish(), stream
