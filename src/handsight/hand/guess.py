"""What a hand's file alone says of a hand: which link is its palm, which are its fingertips, and how large these are.

These are guesses, for a person who writes the first rig of a hand to check.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidFile
from handsight.hand.chains import ancestors, body_joints
from handsight.hand.description import read
from handsight.hand.hand import Hand

NAMES = {
    "thumb": r"thumb|(^|[^a-z])th(_|d|t|p|$)",
    "index": r"index|fore|(^|[^a-z])(ff|if)",
    "ring": r"ring|(^|[^a-z])rf",
    "little": r"little|pinky|(^|[^a-z])lf",
    "middle": r"middle|(^|[^a-z])mf",  # the last one, as links of other fingers are called that too
}
"""Patterns by which the name of a link, in small letters, says which finger's it is."""
RADIUS, LEAST, MOST = 0.01, 0.004, 0.02
"""Radius of a tip of unknown shape, and the least and the largest that are taken from a mesh [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class GuessedTip:
    """A `GuessedTip` is a link that may be a fingertip, and the sphere at its end."""

    link: str
    T_link_surface: Array  # (4, 4) pose of the sphere's centre, its +z out of the finger
    radius: float  # of the sphere [m]


def guess_hand(path: Path) -> tuple[str, dict[str, GuessedTip]]:
    """Returns the palm's link, and by finger its tip; raises InvalidFile for a file without two fingers.

    Fingers end in the links behind which no joint follows; the palm is the last link that all of them hang on. A link
    that is fixed on a finger's last one, and is called a tip, is the tip.
    """
    model, _ = read(path)
    moving = [body for body in range(1, model.nbody) if len(body_joints(model, body))]
    behind = {parent for body in moving for parent in ancestors(model, body)[1:]}
    ends = [body for body in moving if body not in behind]
    shared = [body for end in ends[:1] for body in ancestors(model, end)]
    shared = [body for body in shared if all(body in ancestors(model, end) for end in ends)]
    if len(ends) < 2 or not shared:
        expected = "expected a hand of two fingers or more that hang on one link"
        raise InvalidFile(f"{path}: {expected}, got {len(ends)} fingers")
    links = [str(model.body(body).name) for body in range(model.nbody)]
    tips, palm = dict[str, tuple[int, int]](), links[shared[0]]
    for end in ends:
        named = [body for body in range(end + 1, model.nbody) if "tip" in links[body].lower()]
        fixed = [body for body in named if end in ancestors(model, body)]
        chain = [links[body] for body in ancestors(model, end)[: ancestors(model, end).index(shared[0])]]
        tips[finger_name([links[b] for b in fixed[:1]] + chain, tips)] = end, (fixed or [end])[0]
    hand = Hand.from_file(path, palm=palm, tips={name: links[tip] for name, (_, tip) in tips.items()})
    zero = dict.fromkeys(hand.joint_names, 0.0)
    poses, meshes = hand.link_poses(zero), hand.link_meshes()
    found = dict[str, GuessedTip]()
    for name, (end, tip) in tips.items():
        T_tip, own = se3.inverse(poses[links[tip]]), {links[end], links[tip]} & meshes.keys()
        parts = [se3.apply(T_tip @ poses[link], meshes[link].vertices) for link in own]
        anchor = (T_tip @ poses[links[end]])[:3, 3]
        found[name] = _tip(links[tip], np.concatenate([np.zeros((0, 3)), *parts]), anchor)
    return palm, found


def finger_name(texts: list[str], taken: Collection[str] = ()) -> str:
    """Returns the finger that the first of some texts names that names any, else a number that is not taken."""
    for text, (name, pattern) in product(texts, NAMES.items()):
        if re.search(pattern, text.lower()) and name not in taken:
            return name
    return next(name for name in map("finger{}".format, count(1)) if name not in taken)


def _tip(link: str, vertices: Array, anchor: Array) -> GuessedTip:
    """Returns a sphere at the end of a link that hangs on a joint at `anchor` (3,), all in the link's axes."""
    if not len(vertices):
        return GuessedTip(link, np.eye(4), RADIUS)
    away = vertices.mean(axis=0) - anchor
    k = int(np.abs(away).argmax())
    out = np.eye(3)[k] * np.sign(away[k])
    heights = vertices @ out
    near = vertices[heights > heights.max() - 2 * RADIUS]
    low, high = near.min(axis=0), near.max(axis=0)
    across = np.delete(high - low, k)
    radius = float(np.clip(across.mean() / 2, LEAST, MOST))
    center = (low + high) / 2
    center[k] = out[k] * (heights.max() - radius)
    turn = np.cross([0, 0, 1.0], out)
    R = se3.rotation_exp(turn * np.pi / 2) if turn.any() else np.diag([1.0, out[2], out[2]])
    return GuessedTip(link, se3.compose(R, center.round(4)), round(radius, 4))
