"""How a held object moves in the palm, by its contacts: carried along by the fingertips, or slipping along them.

Where a tip neither slips nor lifts off, the object moves with the tip's surface at the contact, however it rolls. It
also creeps: slowly, along the tangential force of the object on the tip, as rubber lets it and as MuJoCo's friction
does. The speed for each newton is unknown beforehand, and the same for all tips.
"""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.forces.friction import FRICTION
from handsight.forces.loads import LoadSum

LENGTH = 0.03
"""A turn by a radian counts as a motion of this length where both are compared [m]."""


def moved_with_tips(then: LoadSum, now: LoadSum) -> tuple[Array, Array] | None:
    """Returns T_now_then (4, 4), which takes what was at p in the palm then to T p, and the creep (6,) since then.

    The creep, for each m/(N s), is a small motion (v, ω): p creeps by v + ω × p. None where fewer than two tips touch
    at both instants, for one contact does not hold an object.
    """
    gripping = [tip for tip in then.touched if tip in now.touched]
    if len(gripping) < 2:
        return None
    points = np.array([then.touched[tip][0] for tip in gripping])
    steps = now.Ts_palm_tip[gripping] @ se3.inverse(then.Ts_palm_tip[gripping])
    moved = (steps[:, :3, :3] @ points[:, :, None])[..., 0] + steps[:, :3, 3]
    v, w = small_motion(points, moved - points)
    tangential = np.array([then.tangential(tip) for tip in gripping])
    creep = small_motion(points, tangential * (now.stamp - then.stamp))
    return se3.compose(se3.rotation_exp(w), v), np.concatenate(creep)


def small_motion(points: Array, displacements: Array) -> tuple[Array, Array]:
    """Returns v, ω (3,) with v + ω × p nearest to the displacements (n, 3) of points p (n, 3), by least squares.

    A turn that the points hardly determine, such as about the line through two of them, stays small: they count as
    2 mm away from any axis, or more.
    """
    middle = points.mean(axis=0)
    arms, shift = points - middle, displacements.mean(axis=0)
    A = se3.skew(arms)
    inertia = -(A @ A).sum(axis=0) + 0.002**2 * np.eye(3)
    turn = np.linalg.solve(inertia, (A @ displacements[:, :, None]).sum(axis=0)[:, 0])
    return shift - se3.skew(turn) @ middle, turn


def slip_twist(contacts: Contacts, loads: Array, origin: Array) -> Array | None:
    """Returns (6,) the motion of a slipping object: of its point `origin` (3,) and its turn, along the palm's axes.

    It is for one metre of motion, that is the root mean square of the slip along the contacts together with `LENGTH`
    times the turn; unitless and [rad/m]. None where the loads do not agree on a motion. `loads` (n, 5) are those of
    `FingertipContacts`.

    What slips dissipates as much energy as it can, so it moves along the normal of the limit surface: with the
    tangential force on the tip, and with a turn about the contact's normal of τ / e² to f_t (Goyal, Ruina and
    Papadopoulos 1991). That is a velocity (v, e ω_n) along (f_t, τ / e), and none along the normal. The twist is fitted
    to these by least squares.
    """
    towards = np.column_stack([loads[:, :3], loads[:, 4] / FRICTION.torsion])
    sizes = np.linalg.norm(towards, axis=1)
    usable = (sizes > 0) & np.isfinite(sizes)
    if not usable.any():
        return None
    directions = towards[usable] / sizes[usable, None]
    # Each contact's velocity (3), and e times the turn about its normal, by the twist.
    rows = np.zeros((usable.sum(), 4, 6))
    rows[:, :3, :3] = np.eye(3)
    rows[:, :3, 3:] = -se3.skew(contacts.points_palm[usable] - origin)
    rows[:, 3, 3:] = FRICTION.torsion * contacts.normals_palm[usable]
    scale = np.repeat([1.0, 1.0 / LENGTH], 3)
    twist = scale * np.linalg.lstsq(rows.reshape(-1, 6) * scale, directions.ravel(), rcond=1e-3)[0]
    speed = float(np.sqrt(np.mean(np.sum((rows @ twist) ** 2, axis=1))))
    # Directions that contradict each other leave a slow twist, which is no motion.
    return twist / np.hypot(speed, LENGTH * np.linalg.norm(twist[3:])) if speed > 0.1 else None
