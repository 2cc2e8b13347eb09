"""What a hand's file alone says of a hand: which link is its palm, which are its fingertips, and how large these are.

These are guesses, for a person who writes the first rig of a hand to check.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidFile
from handsight.hand.chains import ancestors, body_joints
from handsight.hand.description import read
from handsight.hand.hand import Hand
from handsight.hand.surface import LinkMesh

if TYPE_CHECKING:
    from mujoco import MjModel

NAMES = {
    "thumb": r"thumb|(^|[^a-z])th(_|d|t|p|$)",
    "index": r"index|forefinger|(^|[^a-z])(ff|if)",
    "ring": r"(^|[^a-z])[lr]?ring(finger|[^a-z]|$)|(^|[^a-z])rf",
    "little": r"little|pinky|(^|[^a-z])lf",
    # The last one, as links of other fingers are called that too.
    "middle": r"(^|[^a-z])[lr]?(middle|medium|mid)(finger|[^a-z]|$)|(^|[^a-z])mf",
}
"""Patterns by which the name of a link, in small letters and words, says which finger's it is."""
NO_FINGERS = re.compile(r"(^|[^a-z])(foot|feet|toe|ankle|sole|heel|leg|wheel|caster|head|neck|camera)")
"""Links of a robot that end a chain of joints and are no fingers."""
NO_TIPS = re.compile(r"(^|[^a-z])(knuckle|driver|coupler|crank|rod|linkage|spring)")
"""Links of a finger's mechanism."""
TIPS = re.compile(r"tip|(^|[^a-z])pad")
"""Names of a link that is fixed on a finger's last one, and is its tip."""
SAME_HAND = 0.15
"""A link on which several fingers hang, and which is nearer than this to another one, is of its hand [m]."""
RADIUS = 0.01
LEAST = 0.004
MOST = 0.02
"""Radius of a tip of unknown shape, and the least and the largest that are taken from a mesh [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class GuessedTip:
    """Link that may be a fingertip, and the sphere at its end."""

    link: str
    T_link_surface: Array  # (4, 4) pose of the sphere's centre, its +z out of the finger
    radius: float  # of the sphere [m]
    of_shape: bool  # whether it is from the link's shape; else it is a usual one


def guess_hand(path: Path, palm: str | None = None) -> tuple[str, dict[str, GuessedTip]]:
    """Returns the palm's link, and by finger its tip.

    Fingers end in the links behind which no joint follows; the palm is the link at which a finger joins the others. Of
    several such links of one finger, as closed chains have them, the one that reaches farthest is its last. A link that
    is fixed on that, and is called a tip or a pad, is the tip. `palm`: the palm's link, where the file is of a robot
    with several hands. Raises InvalidFile where there are several and none is given, and where there is none; and
    InvalidInput for a palm that is no link.
    """
    model = read(path).model
    links = [str(model.body(body).name) for body in range(model.nbody)]
    hands = _hands(model, links)
    if palm is not None:
        above = ancestors(model, links.index(Hand.from_file(path, palm=palm).palm))
        root = next((body for body in above if body_joints(model, body)), above[-1])
        ends = [end for end in _ends(model) if root in ancestors(model, end)[1:]]
    elif len(hands) == 1:
        ((root_body, ends),) = hands.items()
        palm = links[root_body]
    else:
        came = [f"{links[body]} ({', '.join(links[end] for end in ends)})" for body, ends in hands.items()]
        expected = "expected a hand of two fingers or more that hang on one link"
        if hands:
            raise InvalidFile(
                f"{path}: expected --palm LINK, one of several hands: {'; '.join(came)}; got none"
            )
        raise InvalidFile(f"{path}: {expected}, got {len(_ends(model))} links behind which no joint follows")
    hand = Hand.from_file(path, palm=palm)
    above = ancestors(model, links.index(palm))
    poses = hand.link_poses(dict.fromkeys(hand.joint_names, 0.0))
    meshes = hand.link_meshes()
    found = dict[str, GuessedTip]()
    for end in _last_ones(model, links, ends, poses, meshes):
        fixed = [
            b
            for b in range(end + 1, model.nbody)
            if end in ancestors(model, b) and TIPS.search(_words(links[b]))
        ]
        tip = links[(fixed or [end])[0]]
        own_links = [links[body] for body in ancestors(model, end) if body not in above]
        name = finger_name([tip, *own_links], found)
        T_tip = se3.inverse(poses[tip])
        own = {links[end], tip} & meshes.keys()
        parts = [se3.apply(T_tip @ poses[link], meshes[link].vertices) for link in own]
        anchor = (T_tip @ poses[links[end]])[:3, 3]
        found[name] = _tip(tip, np.concatenate([np.zeros((0, 3)), *parts]), anchor)
    return palm, found


def _ends(model: "MjModel") -> list[int]:
    """Returns the bodies that a joint moves and behind which no joint follows."""
    moving = [body for body in range(1, model.nbody) if len(body_joints(model, body))]
    behind = {parent for body in moving for parent in ancestors(model, body)[1:]}
    return [body for body in moving if body not in behind]


def _hands(model: "MjModel", links: list[str]) -> dict[int, list[int]]:
    """Returns the last links of two fingers or more by the body at which they join, each of which may be a palm."""
    ends = [end for end in _ends(model) if not NO_FINGERS.search(_words(links[end]))]
    above = {end: ancestors(model, end)[1:] for end in ends}
    joined = dict[int, list[int]]()
    for end in ends:
        others = {body for other in ends if other != end for body in (other, *above[other])}
        if (palm := next((body for body in above[end] if body in others), None)) is not None:
            joined.setdefault(palm, []).append(end)
    for palm in sorted(joined, reverse=True):  # those of a finger's own branches before those of hands
        way = ancestors(model, palm)
        parent = next((body for body in way[1:] if body in joined), None)
        if parent is not None:
            length = np.linalg.norm(model.body_pos[way[: way.index(parent)]], axis=1).sum()
            if length < SAME_HAND:
                joined[parent] += joined.pop(palm)
    return {palm: ends for palm, ends in sorted(joined.items()) if len(ends) > 1}


def _last_ones(
    model: "MjModel",
    links: list[str],
    ends: list[int],
    poses: Mapping[str, Array],
    meshes: Mapping[str, LinkMesh],
) -> list[int]:
    """Returns the last link of each finger, without those of its mechanism that another one overtakes."""
    named = [end for end in ends if not NO_TIPS.search(_words(links[end]))]
    if len(named) > 1:
        ends = named

    def reach(end: int) -> float:
        """Returns how far from the palm the link is, and what is fixed on it."""
        own = [links[body] for body in range(end, model.nbody) if end in ancestors(model, body)]
        points = [se3.apply(poses[link], meshes[link].vertices) for link in own if link in meshes]
        corners = np.concatenate([[poses[link][:3, 3] for link in own], *points])
        return float(np.linalg.norm(corners, axis=1).max())

    sides = {end: re.search(r"(^|[^a-z])(left|right)([^a-z]|$)", _words(links[end])) for end in ends}
    jaws = {side[2] if side else "" for side in sides.values()} == {"left", "right"}
    farthest = dict[str, int]()
    for end in sorted(ends, key=reach):
        side = sides[end]
        jaw = side[2] if jaws and side else ""
        farthest[named_finger(links[end]) or jaw or links[end]] = end
    return sorted(farthest.values())


def finger_name(texts: list[str], taken: Collection[str] = ()) -> str:
    """Returns the finger that the first of some texts names that names any, else a number that is not taken."""
    named = (name for text in texts if (name := named_finger(text, taken)))
    numbered = (f"finger{k}" for k in count(1) if f"finger{k}" not in taken)
    return next(chain(named, numbered))


def named_finger(text: str, taken: Collection[str] = ()) -> str | None:
    """Returns the finger that a text names and that is not taken; None where it names none."""
    words = _words(text)
    known = (name for name, pattern in NAMES.items() if name not in taken and re.search(pattern, words))
    return next(known, None)


def _words(text: str) -> str:
    """Returns a name in small letters, with a line where a capital one begins a word."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text).lower()


def _tip(link: str, vertices: Array, anchor: Array) -> GuessedTip:
    """Returns a sphere at the end of a link that hangs on a joint at `anchor` (3,), all in the link's axes."""
    if not len(vertices):
        return GuessedTip(link, np.eye(4), RADIUS, of_shape=False)
    away = vertices.mean(axis=0) - anchor
    k = int(np.abs(away).argmax())
    out = np.eye(3)[k] * np.sign(away[k])
    heights = vertices @ out
    near = vertices[heights > heights.max() - 2 * RADIUS]
    low = near.min(axis=0)
    high = near.max(axis=0)
    across = np.delete(high - low, k)
    radius = float(np.clip(across.mean() / 2, LEAST, MOST))
    center = (low + high) / 2
    center[k] = out[k] * (heights.max() - radius)
    turn = np.cross([0, 0, 1.0], out)
    R = se3.rotation_exp(turn * np.pi / 2) if turn.any() else np.diag([1.0, out[2], out[2]])
    return GuessedTip(link, se3.compose(R, center.round(4)), round(radius, 4), of_shape=True)
