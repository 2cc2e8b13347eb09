"""Which way an object slips: loads at their limit say how it moves along each fingertip, a rigid motion joins them."""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.forces.friction import FRICTION

LENGTH = 0.03
"""What a radian counts as where motions are compared [m]."""
STILL = 0.1
"""Of the speeds that the loads say, one by one: what they must leave together to be a motion."""


def slip_twist(contacts: Contacts, loads: Array, origin: Array) -> Array | None:
    """Returns (6,) how the object moves while it slips: of its point `origin` (3,), and its turn, along the palm's
    axes.

    For a metre of motion: of slip along the contacts, root mean square, and `LENGTH` times the turn, together; unitless
    and [rad/m]. None where the loads agree on no motion. `loads` (n, 5) as `FingertipContacts` has them.

    What slips loses as much energy as it can, so it moves along the normal of the limit surface: with the tangential
    force on the tip, and with a turn about the contact's normal of τ / e² to f_t (Goyal, Ruina and Papadopoulos 1991).
    That is a velocity (v, e ω_n) along (f_t, τ / e); along the normal there is none. The twist is fitted to these by
    least squares.
    """
    towards = np.column_stack([loads[:, :3], loads[:, 4] / FRICTION.torsion])
    sizes = np.linalg.norm(towards, axis=1)
    usable = (sizes > 0) & np.isfinite(sizes)
    if not usable.any():
        return None
    directions = towards[usable] / sizes[usable, None]
    rows = _rows(contacts.points_palm[usable] - origin, contacts.normals_palm[usable])
    scale = np.repeat([1.0, 1.0 / LENGTH], 3)
    twist = scale * np.linalg.lstsq(rows.reshape(-1, 6) * scale, directions.ravel(), rcond=1e-3)[0]
    speed = float(np.sqrt(np.mean(np.sum((rows @ twist) ** 2, axis=1))))
    return twist / np.hypot(speed, LENGTH * np.linalg.norm(twist[3:])) if speed > STILL else None


def _rows(levers: Array, normals: Array) -> Array:
    """Returns (n, 4, 6) by a twist: the object's velocity at each contact, and e times its turn about the normal."""
    rows = np.zeros((len(levers), 4, 6))
    rows[:, :3, :3] = np.eye(3)
    rows[:, :3, 3:] = -se3.skew(levers)
    rows[:, 3, 3:] = FRICTION.torsion * normals
    return rows
