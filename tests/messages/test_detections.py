"""Boxes and masks of other detectors: read in each layout that vision_msgs has had; what is none is counted."""

from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handsight.messages import ObservationStream, RawMessage
from handsight.messages.topics import RosType
from messages.ros import START, Messages, heard, nanoseconds, raw, rig, touched

COMMON = {
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
}
POSE = "geometry_msgs/PoseWithCovariance pose"
OLD_BOX = "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y"
OLD = "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox2D bbox\nsensor_msgs/Image source_img"
VERSIONS = {
    "ros2 humble": (
        "cdr",
        {
            "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
            "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
            "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
            "vision_msgs/msg/ObjectHypothesisWithPose": f"vision_msgs/ObjectHypothesis hypothesis\n{POSE}",
            "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
            "vision_msgs/msg/Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
            "vision_msgs/BoundingBox2D bbox\nstring id",
        },
    ),
    "ros2 foxy": (
        "cdr",
        {
            "vision_msgs/msg/ObjectHypothesisWithPose": f"string id\nfloat64 score\n{POSE}",
            "vision_msgs/msg/BoundingBox2D": OLD_BOX,
            "vision_msgs/msg/Detection2D": f"{OLD}\nbool is_tracking\nstring tracking_id",
        },
    ),
    "ros1 noetic": (
        "ros1",
        {
            "vision_msgs/msg/ObjectHypothesisWithPose": f"int64 id\nfloat64 score\n{POSE}",
            "vision_msgs/msg/BoundingBox2D": OLD_BOX,
            "vision_msgs/msg/Detection2D": OLD,
        },
    ),
}
"""The definitions of each release (https://github.com/ros-perception/vision_msgs)."""


def serialized(version, boxes, stamp=START):
    """boxes: (u, v, width, height, turn, [(label, score)])."""
    encoding, definitions = VERSIONS[version]
    store = get_typestore(Stores.ROS2_HUMBLE if encoding == "cdr" else Stores.ROS1_NOETIC)
    for name, definition in (definitions | COMMON).items():
        store.register(get_types_from_msg(definition, name))
    M = Messages(2 if encoding == "cdr" else 1)
    new = SimpleNamespace

    def hypothesis(label, score):
        body = M.make(
            "geometry_msgs/msg/Pose",
            position=M.vector(np.zeros(3), "Point"),
            orientation=M.quaternion([0, 0, 0, 1]),
        )
        pose = M.make("geometry_msgs/msg/PoseWithCovariance", pose=body, covariance=np.zeros(36))
        label = int(label) if version == "ros1 noetic" else label
        known = (
            {"id": label, "score": score}
            if version != "ros2 humble"
            else {"hypothesis": new(class_id=label, score=score)}
        )
        return new(pose=pose, **known)

    def center(u, v, turn):
        return (
            new(position=new(x=u, y=v), theta=turn) if version == "ros2 humble" else new(x=u, y=v, theta=turn)
        )

    image = M.image(stamp, np.zeros((2, 3), np.uint8), "mono8")
    rows = [
        new(
            header=M.header(stamp, "camera"),
            results=[hypothesis(*each) for each in results],
            bbox=new(center=center(u, v, turn), size_x=w, size_y=h),
            source_img=image,
            is_tracking=True,
            tracking_id="seven",
            id="seven",
        )
        for u, v, w, h, turn, results in boxes
    ]
    message = new(header=M.header(stamp, "camera"), detections=rows)
    data = bytes(getattr(store, f"serialize_{encoding}")(message, RosType.DETECTIONS))
    return RawMessage("/found", RosType.DETECTIONS, encoding, stamp, data)


def observed(message, role="detections"):
    """What an observation has of a message among joint states, and the topic's report."""
    stream = ObservationStream(rig(**{role: message.topic}))
    rows = [raw(*row) for row in touched(20)]
    if message.encoding == "ros1":
        M, store = Messages(1), get_typestore(Stores.ROS1_NOETIC)
        rows = []
        for topic, log, one in touched(20, messages=M):
            sec = divmod(nanoseconds(log), 10**9)
            data = bytes(store.serialize_ros1(one, one.__msgtype__))
            rows.append(RawMessage(topic, one.__msgtype__, "ros1", sec[0] + 1e-9 * sec[1], data))
    rows.insert(30, message._replace(log_time=rows[30].log_time))
    done = [one for row in rows for one in stream.put(row)] + stream.finish()
    return [found for one in done if (found := getattr(one, role)) is not None], stream.report.topics[
        message.topic
    ]


BOXES = [(160.0, 120.0, 40.0, 20.0, 0.0, [("3", 0.5), ("7", 0.25)]), (50.0, 60.0, 8.0, 4.0, np.pi / 2, [])]


@pytest.mark.parametrize("version", VERSIONS)
def test_detections_are_read_in_every_layout(version):
    (found,), report = observed(serialized(version, BOXES))
    assert [(each.label, each.score) for each in found] == [("3", 0.5), ("7", 0.25), ("", None)]
    np.testing.assert_allclose(found[0].box, (140, 110, 180, 130))
    np.testing.assert_allclose(found[2].box, (48, 56, 52, 64))
    assert (report.used, report.bad, report.nan) == (1, 0, 0)
    (none,), _ = observed(serialized(version, []))
    assert none == ()


@pytest.mark.parametrize("version", ["ros2 humble", "ros2 foxy"])
def test_names_are_read_of_layouts_that_have_them(version):
    (found,), _ = observed(serialized(version, [(160.0, 120.0, 40.0, 20.0, 0.0, [("mug of tea", 1.0)])]))
    assert (found[0].label, found[0].score) == ("mug of tea", 1.0)


@pytest.mark.parametrize(
    ("box", "reason"),
    [
        ((np.nan, 120.0, 40.0, 20.0, 0.0, []), "detection 0: expected a finite box, got 40 x 20 at nan, 120"),
        ((160.0, 120.0, np.inf, 20.0, 0.0, []), "detection 0: expected a finite box, got inf x 20"),
        ((160.0, 120.0, -40.0, 20.0, 0.0, []), "detection 0: expected a finite box, got -40 x 20"),
        ((1e9, 120.0, 40.0, 20.0, 0.0, []), "detection.box: expected u0 <= u1, v0 <= v1 within 1e+06 pixels"),
        ((160.0, 120.0, 40.0, 20.0, 0.0, [("3", 97.0)]), "detection 0: expected a score from 0 to 1, got 97"),
        ((160.0, 120.0, 40.0, 20.0, 0.0, [("3", np.nan)]), "detection 0: expected a score from 0 to 1, got nan"),
    ],
)  # fmt: skip
def test_detections_that_cannot_be_are_counted_with_a_reason(box, reason):
    found, report = observed(serialized("ros2 humble", [box]))
    assert found == []
    assert report.bad + report.nan == 1
    assert any(reason in each for each in report.reasons), report.reasons


def test_bytes_that_are_no_detections_are_counted():
    whole = serialized("ros2 humble", BOXES)
    for data in (whole.data[:-30], whole.data + bytes(40), b"", b"\x00\x01\x00\x00" + b"\xff" * 50):
        found, report = observed(whole._replace(data=data))
        assert (found, report.bad) == ([], 1)
        (reason,) = report.reasons
        assert reason.startswith(f"expected a {RosType.DETECTIONS}, got {len(data)} bytes that are none")


LABELS = np.array([[0, 3, 3], [0, 0, 255]])


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [("mono8", "u1"), ("8UC1", "u1"), ("mono16", "<u2"), ("16UC1", "<u2"), ("32SC1", "<i4")],
)
def test_mask_images_are_labels(encoding, kind):
    message = Messages().image(START + 0.05, LABELS.astype(kind), encoding)
    found, stream = heard([*touched(20), ("/mask", START + 0.05, message)], rig(mask="/mask"))
    (mask,) = [one.mask for one in found if one.mask is not None]
    np.testing.assert_array_equal(mask, LABELS)


def test_a_colour_image_is_no_mask():
    message = Messages().image(START + 0.05, np.zeros((2, 3, 3), np.uint8), "rgb8")
    _, stream = heard([*touched(20), ("/mask", START + 0.05, message)], rig(mask="/mask"))
    assert list(stream.report.topics["/mask"].reasons) == [
        "expected encoding mono8, 8UC1, mono16, 16UC1, 32SC1, got 'rgb8'"
    ]


def test_a_mask_of_another_size_than_the_camera_is_said():
    message = Messages().image(START + 0.05, LABELS.astype("u1"), "mono8")
    _, stream = heard([*touched(20), ("/mask", START + 0.05, message)], rig(mask="/mask"))
    assert "mask images on /mask: expected 640 x 480 pixels as its camera's, got 3 x 2" in stream.lacks()
