"""Places at which an object would be touched where it was touched."""

import numpy as np

from handsight.checks import Array, Indices
from handsight.contact import Contacts
from handsight.objects import ObjectModel
from handsight.search.area import Area

TRIED = 20_000
"""Places of the tip about the object that are looked at, for each way to stand."""
SHELL = 0.003
"""How far off the object's skin, as far away as the tip is thick, they may be [m]."""
WIDER = 1.5
"""How much wider than a contact's errors places are drawn about it."""


def tip_middle(contact_world: Contacts, radius: float) -> Array:
    """(3,) the middle of a ball that touches where one contact is [m].

    Unlike the contact it does not lie on the surface: about an edge, distance and normal change smoothly there.
    """
    return np.asarray(contact_world.points_palm[0] + radius * contact_world.normals_palm[0])


def places_about(
    model: ObjectModel, area: Area, contact_world: Contacts, radius: float, n: int, rng: np.random.Generator
) -> Array:
    """(n, 4) places whose surface is at a contact, turned as its normal says: uniform along the outline there.

    For one turn, a place is where the tip is less where it is on the object, so what is uniform in the one is so in
    the other. `radius` of the tip [m]. None (0, 4) where the object is nowhere as high.
    """
    normal, covariance = contact_world.normals_palm[0], contact_world.covariance[0]
    middle = tip_middle(contact_world, radius)
    arms, outward, rest = _around(model, area, float(middle[2]), radius, rng)
    if not len(arms):
        return np.empty((0, 4))
    chosen = rng.integers(len(arms), size=n)
    arm, out = arms[chosen], outward[chosen]
    # Of a normal that is nearly vertical the turn is hardly known.
    spread = WIDER * np.sqrt(np.trace(covariance[3:, 3:]) / 2) / max(float(np.hypot(*normal[:2])), 1e-3)
    turn = np.arctan2(normal[1], normal[0]) - np.arctan2(out[:, 1], out[:, 0]) + spread * rng.normal(size=n)
    c, s = np.cos(turn), np.sin(turn)
    shift = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    noise = WIDER * np.sqrt(np.trace(covariance[:3, :3]) / 3) * rng.normal(size=(n, 2))
    turn = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    return np.column_stack([middle[:2] + noise - shift, turn, rest[chosen]])


def _around(
    model: ObjectModel, area: Area, height: float, radius: float, rng: np.random.Generator
) -> tuple[Array, Array, Indices]:
    """Where a tip at a height in the world touches the object, from its middle and along the world's axes at no turn.

    (m, 3) arms [m], (m, 3) outward normals, (m,) which way to stand.
    """
    Rs, reach = area.Rs_world_object, model.radius + radius
    arms = rng.uniform(-reach, reach, (len(Rs), TRIED, 3))
    arms[:, :, 2] = height - area.middles(model)[:, None]
    arms[:, :, 2] += area.table.sigma_height * rng.normal(size=arms.shape[:2])
    points = (arms @ Rs).reshape(-1, 3) + model.center_object  # Rᵀ arm
    values = model.evaluate(points)
    touching = np.abs(values.distance - radius) < SHELL
    rest = np.repeat(np.arange(len(Rs), dtype=np.int64), TRIED)[touching]
    outward: Array = np.einsum("nij,nj->ni", Rs[rest], values.gradient[touching])
    return arms.reshape(-1, 3)[touching], outward, rest
