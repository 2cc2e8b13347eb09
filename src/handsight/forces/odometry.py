"""How an object moves in the palm between two instants, told from how the fingertips that hold it move.

Where a tip neither slips nor loses it, the object goes with what the tip is made of at the contact, however it rolls.
And it creeps: slowly, along the tangential force of the object on the tip, as rubber lets it and as MuJoCo's friction
does. How fast for a newton is not known beforehand, and the same for all tips.
"""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.forces.loads import LoadSum

ARM = 0.002
"""A turn that contacts hardly tell, such as about the line through two of them, stays small: contacts count as at least
so far from any axis [m]."""
FEWEST = 2
"""Contacts that hold an object; of fewer nothing is told."""


def moved_with_tips(then: LoadSum, now: LoadSum) -> tuple[Array, Array] | None:
    """Returns T_now_then (4, 4): what was at p in the palm then is at T p now; and the creep (6,) since, for each
    m/(N s).

    The latter as a small motion (v, ω): p creeps by v + ω × p. None where too few tips touch at both.
    """
    gripping = [tip for tip in then.touched if tip in now.touched]
    if len(gripping) < FEWEST:
        return None
    points = np.array([then.touched[tip][0] for tip in gripping])
    steps = now.Ts_palm_tip[gripping] @ se3.inverse(then.Ts_palm_tip[gripping])
    moved = (steps[:, :3, :3] @ points[:, :, None])[..., 0] + steps[:, :3, 3]
    v, w = small_motion(points, moved - points)
    tangential = np.array([then.tangential(tip) for tip in gripping])
    creep = small_motion(points, tangential * (now.stamp - then.stamp))
    return se3.compose(se3.rotation_exp(w), v), np.concatenate(creep)


def small_motion(points: Array, displacements: Array) -> tuple[Array, Array]:
    """Returns v, ω (3,) such that v + ω × p is nearest to what points p (n, 3) have moved by (n, 3)."""
    middle = points.mean(axis=0)
    arms, shift = points - middle, displacements.mean(axis=0)
    A = se3.skew(arms)
    inertia = -(A @ A).sum(axis=0) + ARM**2 * np.eye(3)
    turn = np.linalg.solve(inertia, (A @ displacements[:, :, None]).sum(axis=0)[:, 0])
    return shift - se3.skew(turn) @ middle, turn
