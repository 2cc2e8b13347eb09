"""Which of a recording's topics are what in a rig, by the types of their messages and by their names."""

import re
from collections.abc import Mapping, Sequence

from handsight.hand.guess import finger_name
from handsight.messages.definitions import CONTACTS
from handsight.messages.topics import RosType
from handsight.rig import Topics

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
        named = {t: finger_name([t]) for t, kind in types.items() if kind in kinds}
        found = {finger: t for t, finger in named.items() if finger in fingers}
        found |= {finger: t for finger in fingers for t in named if f"/{finger.lower()}/" in t.lower()}
        numbers = {t: [int(n) for n in re.findall(r"\d+", t)] or [0] for t in named}
        rest = sorted(named.keys() - found.values(), key=numbers.__getitem__)
        found |= dict(zip((f for f in fingers if f not in found), rest, strict=False))
        used.update({t: f"{what} of {finger}" for finger, t in found.items()})
        return {finger: found[finger] for finger in fingers if finger in found}

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
