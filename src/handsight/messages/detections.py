"""Where another detector has objects in an image: from a Detection2DArray of vision_msgs of ROS 1, Foxy, or later."""

from math import cos, hypot, isfinite, sin

from handsight.messages.topics import MessageRejected, RosMessage
from handsight.observation import Detection2D

MAX_DETECTIONS = 1000  # detections of a message that are used


def _layout(package: str, hypothesis: str, center: str, last: str) -> dict[str, str]:
    """Returns the definitions of the types of a Detection2DArray, by name in a package."""
    return {
        f"{package}/msg/ObjectHypothesisWithPose": f"{hypothesis}\ngeometry_msgs/PoseWithCovariance pose",
        f"{package}/msg/BoundingBox2D": f"{center} center\nfloat64 size_x\nfloat64 size_y",
        f"{package}/msg/Detection2D": f"std_msgs/Header header\n{package}/ObjectHypothesisWithPose[] results\n"
        f"{package}/BoundingBox2D bbox\n{last}",
        f"{package}/msg/Detection2DArray": f"std_msgs/Header header\n{package}/Detection2D[] detections",
    }


_FLAT, _IMAGE = "geometry_msgs/Pose2D", "sensor_msgs/Image source_img"
_SCORED, _TRACKED = "vision_msgs/ObjectHypothesis", "bool is_tracking\nstring tracking_id"
DEFINITIONS = {
    "cdr": {
        "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
        "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
        "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
        **_layout("vision_msgs", f"{_SCORED} hypothesis", "vision_msgs/Pose2D", "string id"),
        **_layout("vision_msgs_foxy", "string id\nfloat64 score", _FLAT, f"{_IMAGE}\n{_TRACKED}"),
    },
    "ros1": _layout("vision_msgs", "int64 id\nfloat64 score", _FLAT, _IMAGE),
}
"""Definitions by name, for each encoding. The type has one name in all versions, and a live message brings no
definition; but only one layout is as long as the message."""
KINDS = {
    encoding: tuple(kind for kind in definitions if kind.endswith("/Detection2DArray"))
    for encoding, definitions in DEFINITIONS.items()
}
"""The layouts to try, in this order."""


def detections(message: RosMessage) -> tuple[Detection2D, ...]:
    """Returns the detections of a Detection2DArray: one for each hypothesis of what is in a box. A turned box is
    replaced by the upright one around it. Raises MessageRejected, InvalidInput."""
    found = list[Detection2D]()
    for k, each in enumerate(message.detections[:MAX_DETECTIONS]):
        center = getattr(each.bbox.center, "position", each.bbox.center)
        c, s = abs(cos(each.bbox.center.theta)), abs(sin(each.bbox.center.theta))
        width, height = each.bbox.size_x, each.bbox.size_y
        half_u, half_v = (c * width + s * height) / 2, (s * width + c * height) / 2
        if not isfinite(hypot(center.x, center.y, half_u, half_v)):
            raise MessageRejected(f"box of detection {k} is not finite", nan=True)
        if width < 0 or height < 0:
            raise MessageRejected(f"detection {k}: expected a size of at least 0, got {width:g} x {height:g}")
        box = center.x - half_u, center.y - half_v, center.x + half_u, center.y + half_v
        for result in each.results:
            hypothesis = getattr(result, "hypothesis", result)
            label = hypothesis.class_id if hypothesis is not result else hypothesis.id
            if not 0 <= (score := float(hypothesis.score)) <= 1:
                raise MessageRejected(f"detection {k}: expected a score from 0 to 1, got {score:g}")
            found.append(Detection2D(str(label), max(score, 1e-6), box))
        if not len(each.results):
            found.append(Detection2D("", None, box))
    return tuple(found)
