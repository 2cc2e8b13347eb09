"""Where another detector has objects in an image: from a Detection2DArray of vision_msgs of ROS 1, Foxy, or later."""

from math import cos, hypot, isfinite, sin

from handsight.messages.topics import MessageRejected, RosMessage
from handsight.observation import Detection2D

MAX_DETECTIONS = 1000  # detections of a message that are used


KINDS = {
    "cdr": ("vision_msgs/msg/Detection2DArray", "vision_msgs_foxy/msg/Detection2DArray"),
    "ros1": ("vision_msgs/msg/Detection2DArray",),
}
"""The layouts of a Detection2DArray to try, in this order, by encoding. The type has one name in all versions, and a
live message brings no definition; but only one layout is as long as the message."""


def detections(message: RosMessage) -> tuple[Detection2D, ...]:
    """Returns the detections of a Detection2DArray: one for each hypothesis of what is in a box. A turned box is
    replaced by the upright one around it. Raises MessageRejected, InvalidInput."""
    found = list[Detection2D]()
    for k, each in enumerate(message.detections[:MAX_DETECTIONS]):
        center = getattr(each.bbox.center, "position", each.bbox.center)
        turn = each.bbox.center.theta
        c = abs(cos(turn))
        s = abs(sin(turn))
        width = each.bbox.size_x
        height = each.bbox.size_y
        half_u = (c * width + s * height) / 2
        half_v = (s * width + c * height) / 2
        finite = isfinite(hypot(center.x, center.y, half_u, half_v))
        if not finite or min(width, height) < 0:
            came = f"{width:g} x {height:g} at {center.x:g}, {center.y:g}"
            raise MessageRejected(f"detection {k}: expected a finite box, got {came}", nan=not finite)
        box = center.x - half_u, center.y - half_v, center.x + half_u, center.y + half_v
        if not len(each.results):
            found.append(Detection2D("", None, box))
        for result in each.results:
            hypothesis = getattr(result, "hypothesis", result)
            label = result.id if hypothesis is result else hypothesis.class_id
            score = float(hypothesis.score)
            if not 0 <= score <= 1:
                raise MessageRejected(f"detection {k}: expected a score from 0 to 1, got {score:g}")
            least = 1e-6  # some detectors round a score to 0
            found.append(Detection2D(str(label), max(score, least), box))
    return tuple(found)
