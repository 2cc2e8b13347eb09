"""Which of a recording's topics are what in a rig, by the types of their messages and by their names."""

import re
from collections.abc import Mapping, Sequence

from handsight.hand.guess import finger_name
from handsight.messages.definitions import CONTACTS
from handsight.messages.topics import RosType
from handsight.rig import Topics

GRID: Mapping[str, object] = {"rows": 4, "columns": 4, "pitch": 0.003, "threshold": 0.1}
TAXELS: Mapping[str, tuple[str, str, Mapping[str, object]]] = {
    "/SensStream": (
        "sensors[sensor_pos={1}].forces",
        "sensors[0].forces",
        {"layout": "xela:fingertip", "threshold": 0.05},
    ),
    "/InspireHandTouch": ("{0}.tip", "index.tip", {"layout": "inspire:tip", "pitch": 0.002, "threshold": 60}),
    "/HandState": ("tactile_{0}", "tactile_index", GRID),
    "/TactileState": ("sensors[name={0}].values", "sensors[0].values", GRID),
    "MultiArray": ("data[{2}:{3}]", "data", GRID),
}
"""By the end of a type's name: the path to a finger's taxels where one topic has all fingers, and where each has its
own; and what a rig says of their places: a product's, or a grid that nobody has counted yet."""
IMAGES = {RosType.IMAGE, RosType.COMPRESSED}
POSES = {RosType.POSE, RosType.POSE_COVARIANCE}


def match_topics(types: Mapping[str, str], fingers: Sequence[str]) -> tuple[Topics, dict[str, str]]:
    """Returns the topics of a rig with these fingers, and by topic what it was taken for.

    `types`: by topic, the type of its messages. A finger's wrenches, or contacts, are on the topic whose name has the
    finger's, or one of its usual names (`finger_name`); topics without such a name are taken in the order of their
    numbers, as the fingers are. The truth is never taken for vision.
    """
    used = dict[str, str]()

    def only(what: str, kinds: set[str], *words: str, default: str | None = None) -> str | None:
        """Returns the topic of one of these types with the first of these words in its name."""
        named = sorted((t for t, kind in types.items() if kind in kinds and t not in used), key=len)
        found = next((t for word in words for t in named if word in t.lower()), None)
        if found is not None:
            used[found] = what
        return found or default

    def by_finger(what: str, kinds: set[str]) -> dict[str, str]:
        found = _by_finger([topic for topic, kind in types.items() if kind in kinds], fingers)
        used.update({t: f"{what} of {finger}" for finger, t in found.items()})
        return found

    joints = only("joint states", {RosType.JOINTS}, "hand", "joint_states", "")
    truth = only("truth, which is only compared with", POSES, "truth")
    return Topics(
        joint_states=joints or "/joint_states",
        wrenches=by_finger("wrenches", {RosType.WRENCH}),
        contacts=by_finger("contacts", set(CONTACTS)),
        truth=truth,
        vision=only("vision", POSES, "object", "vision", "pose"),
        tf=only("transforms", {RosType.TF, RosType.TF_ROS1}, "/tf"),
        color=only("color images", IMAGES, "color", "rgb"),
        depth=only("depth images", IMAGES, "depth"),
        camera_info=only("camera info", {RosType.INFO}, "depth", "color", ""),
    ), used


def match_taxels(types: Mapping[str, str], fingers: Sequence[str]) -> dict[str, Mapping[str, object]]:
    """Returns by finger the keys of a rig's `skin` entry for the taxels on its tip, but not where they are.

    `types`: by topic, the type of its messages. Drivers have one topic for the hand, or one for each finger. Of plain
    arrays, those are taken whose topic's name is about touch.
    """
    for end, (of_hand, of_finger, places) in TAXELS.items():
        about = "tact|taxel|touch|skin|pressure" if end == "MultiArray" else ""
        topics = [t for t, kind in types.items() if kind.endswith(end) and re.search(about, t.lower())]
        if topics:
            path, of = of_hand, dict.fromkeys(fingers, topics[0])
            if len(topics) > 1:
                path, of = of_finger, _by_finger(topics, fingers)
            fields = (path.format(f, n + 1, 16 * n, 16 * n + 16) for n, f in enumerate(of))
            return {f: {**places, "topic": of[f], "field": each} for f, each in zip(of, fields, strict=True)}
    return {}


def _by_finger(topics: Sequence[str], fingers: Sequence[str]) -> dict[str, str]:
    """Returns the topic of each finger: that with its name, or one of its usual names, else in order of numbers."""
    named = {topic: finger_name([topic]) for topic in topics}
    found = {finger: t for t, finger in named.items() if finger in fingers}
    found |= {finger: t for finger in fingers for t in named if f"/{finger.lower()}/" in t.lower()}
    rest = sorted(named.keys() - found.values(), key=lambda t: [int(n) for n in re.findall(r"\d+", t)] or [0])
    found |= dict(zip((f for f in fingers if f not in found), rest, strict=False))
    return {finger: found[finger] for finger in fingers if finger in found}
