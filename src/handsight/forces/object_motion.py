"""How an object in the hand moves in the palm, by its contacts: carried along by the fingertips, or slipping.

Where a tip neither slips nor lifts off, the object moves with the tip's surface at the contact, even while it rolls. It
also creeps slowly along the tangential force of the object on the tip, as on rubber and with MuJoCo's friction. The
speed for each newton is unknown, and assumed to be the same for all tips.
"""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.forces.kernels.slip_records import FRICTION
from handsight.forces.loads import LoadSum
from handsight.observation import seconds

LENGTH = 0.03  # a rotation by a radian counts as a translation by this length [m]


def moved_with_tips(then: LoadSum, now: LoadSum) -> tuple[Array, Array] | None:
    """Returns T_now_then (4, 4), the motion of the object with the tips, and its creep (6,) since then.

    A point of the object that was at p in the palm is now at T p. The creep is a small motion (v, ω) for each m/(N s):
    p creeps by v + ω × p. None where fewer than two tips touch at both instants: one contact does not hold an object.
    """
    gripping = [tip for tip in then.touched if tip in now.touched]
    if len(gripping) < 2:
        return None
    points = np.array([then.touched[tip][0] for tip in gripping])
    steps = now.Ts_palm_tip[gripping] @ se3.inverse(then.Ts_palm_tip[gripping])
    moved = (steps[:, :3, :3] @ points[:, :, None])[..., 0] + steps[:, :3, 3]
    forces = then.forces[gripping]
    normals = np.array([then.touched[tip][1] for tip in gripping])
    tangential = forces - (forces * normals).sum(axis=1, keepdims=True) * normals
    crept = tangential * seconds(now.stamp, then.stamp)
    (v, creep), (w, turn) = small_motion(points, np.array([moved - points, crept]))
    return se3.compose(se3.rotation_exp(w), v), np.concatenate([creep, turn])


def small_motion(points: Array, displacements: Array) -> tuple[Array, Array]:
    """Returns v, ω (..., 3) with v + ω × p nearest to displacements (..., n, 3) of points p (n, 3), by least squares.

    A rotation that the points hardly determine, such as that about the line through two of them, stays small, because
    every axis is taken to be at least 2 mm away from them.
    """
    middle = points.mean(axis=0)
    shift = displacements.mean(axis=-2)
    A = se3.skew(points - middle)
    inertia = -(A @ A).sum(axis=0) + 0.002**2 * np.eye(3)
    turn = np.linalg.solve(inertia, (A @ displacements[..., None]).sum(axis=-3))[..., 0]
    return shift - se3.skew(turn) @ middle, turn


def slip_twist(contacts: Contacts, loads: Array, origin: Array) -> Array | None:
    """Returns (6,) the direction in which an object slips: translation of its point `origin` (3,), and rotation.

    It is along the palm's axes, unitless and [rad/m], scaled to one metre of motion: the root mean square of the slip
    at the contacts, together with `LENGTH` times the rotation. None where the loads do not agree on a motion. `loads`
    (n, 5) are those of `FingertipContacts`.

    A slip dissipates as much energy as possible, so it is along the normal of the limit surface: along the tangential
    force on the tip, with a rotation about the contact's normal in the ratio of τ / e² to f_t (Goyal, Ruina and
    Papadopoulos 1991). That is a velocity (v, e ω_n) along (f_t, τ / e), and none along the normal. The twist is fitted
    to these velocities by least squares.
    """
    towards = loads[:, [0, 1, 2, 4]] / [1.0, 1.0, 1.0, FRICTION.torsion]
    sizes = np.sqrt((towards * towards).sum(axis=1))
    usable = (sizes > 0) & np.isfinite(sizes)
    if not usable.any():
        return None
    directions = towards[usable] / sizes[usable, None]
    # Derivative, by the twist, of each contact's velocity (3) and of e times the rotation about its normal.
    rows = np.zeros((usable.sum(), 4, 6))
    rows[:, :3, :3] = np.eye(3)
    rows[:, :3, 3:] = -se3.skew(contacts.points_palm[usable] - origin)
    rows[:, 3, 3:] = FRICTION.torsion * contacts.normals_palm[usable]
    scale = np.repeat([1.0, 1.0 / LENGTH], 3)
    twist = scale * np.linalg.lstsq(rows.reshape(-1, 6) * scale, directions.ravel(), rcond=1e-3)[0]
    speed = float(np.sqrt(np.mean(np.sum((rows @ twist) ** 2, axis=1))))
    # Directions that contradict each other leave only a slow twist, which is not a slip.
    return twist / np.hypot(speed, LENGTH * np.linalg.norm(twist[3:])) if speed > 0.1 else None
