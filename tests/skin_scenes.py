"""A box or a can held against a palm's tactile array by three fingertips, its edge on the array: synthetic."""

from dataclasses import dataclass

import numpy as np

import handsight as hs
import scenes
from handsight import se3
from handsight.contact.taxels import SkinTouch, TactileSurface
from handsight.simulation.taxels import SKIN, ElasticSkin, Solid

VISION = (0.03 * np.sqrt(3), np.deg2rad(6) * np.sqrt(3))
"""Root mean square length and angle of vision's error: 30 mm and 6° per axis."""
MOUNT = 5e-4
"""Of the array's height: what its rig is wrong by, per grasp [m]."""
UNEVEN = 1e-4
"""Of each taxel's height [m]."""
NOISE = 0.1
"""Of a taxel, in parts of what it feels."""
FORCE = (3.0, 8.0)
"""With which the object is pressed on the array, from and to [N]."""


@dataclass(frozen=True, eq=False)
class SkinScene:
    """One grasp, in the palm's frame, which is the array's link here."""

    model: hs.ObjectModel
    T_palm_object: np.ndarray
    tips: hs.Contacts
    vision: hs.PosePrior
    readings: np.ndarray
    """(rows, columns) [N]"""
    across: np.ndarray
    """(3,) unit, in the palm: across the object's edge that is on the array."""

    def touch(self, array: TactileSurface) -> SkinTouch:
        """What the array says."""
        return array.touch(self.readings)


def palm_array(pitch: float = 0.004) -> TactileSurface:
    """60 x 80 mm, in the palm's own axes."""
    return TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=round(0.08 / pitch), columns=round(0.06 / pitch), pitch=pitch,
        threshold=0.015,
    )  # fmt: skip


def taxel_forces(
    array: TactileSurface,
    solid: Solid,
    T_palm_object: np.ndarray,
    force: float,
    uneven: np.ndarray | float = 0.0,
    springs: float = SKIN.rubber,
) -> np.ndarray:
    """Forces (rows, columns) on the taxels of a flat array by a solid that presses on it with `force` [N]."""
    into = -array.normals[0]
    skin = ElasticSkin.flat(array)
    heights = np.broadcast_to(uneven, array.shape).ravel()
    found = skin.forces(solid, T_palm_object, force * into, into, heights, springs)
    return np.asarray((found[:-1] @ into).reshape(array.shape))


def box_solid(size: np.ndarray) -> Solid:
    """A box about the origin."""
    return Solid(np.vstack([np.eye(3), -np.eye(3)]), np.tile(np.asarray(size) / 2, 2))


def box_on_skin(rng: np.random.Generator, array: TactileSurface, *, springs: float = SKIN.foam) -> SkinScene:
    """The box lies flat, one of its long edges on the array, the ends of which may be beyond it."""
    size = np.array(scenes.BOX)
    yaw, edge = np.deg2rad(rng.uniform(-25, 25)) + np.pi * rng.integers(2), rng.uniform(-0.015, 0.015)
    half = size / 2
    # The face 90 x 140 lies on the skin, its long side along the array's y.
    R = se3.rotation_exp(np.array([0, 0, yaw])) @ np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    across, along = R[:, 1], R[:, 2]
    T = se3.compose(
        R, (edge - half[1]) * across + rng.uniform(-0.02, 0.02) * along + half[0] * np.array([0.0, 0, 1])
    )
    places = np.column_stack(
        [np.full(3, half[0]), rng.uniform(0.3, 0.9, 3) * half[1], rng.uniform(-0.02, 0.02, 3)]
    )
    tips = places, np.tile([1.0, 0, 0], (3, 1))
    return _measured(scenes.box(), box_solid(size), T, tips, array, across, rng, springs)


def can_on_skin(rng: np.random.Generator, array: TactileSurface, *, end: bool = True) -> SkinScene:
    """The can lies across the array; with one `end` on it, or beyond it with both."""
    radius, height = scenes.CAN["radius"], scenes.CAN["height"]
    yaw = np.deg2rad(rng.uniform(-25, 25)) + np.pi * rng.integers(2)
    spin = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
    R = se3.rotation_exp(np.array([0, 0, yaw])) @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    axis = R[:, 2]
    along = rng.uniform(-0.015, 0.015) - height / 2 if end else rng.uniform(-0.01, 0.01)
    T = se3.compose(
        R @ spin, along * axis + rng.uniform(-0.01, 0.01) * R[:, 0] + radius * np.array([0.0, 0, 1])
    )
    # The tips are on the far side, around it.
    around = np.deg2rad(rng.uniform(-50, 50, 3))
    normals = (np.stack([np.sin(around), -np.cos(around), np.zeros(3)], axis=1)) @ spin
    normals = normals * [1, 1, 0]
    heights = (height / 2 - rng.uniform(0.01, 0.04, 3)) if end else rng.uniform(-0.02, 0.02, 3)
    tips = radius * normals + heights[:, None] * [0, 0, 1.0], normals
    return _measured(scenes.can(), Solid.cylinder(radius, height), T, tips, array, axis, rng)


def _measured(
    model: hs.ObjectModel,
    solid: Solid,
    T: np.ndarray,
    tips: tuple[np.ndarray, np.ndarray],
    array: TactileSurface,
    across: np.ndarray,
    rng: np.random.Generator,
    springs: float = SKIN.foam,
) -> SkinScene:
    contacts = scenes.touched(T, tips, (1.2e-3, np.deg2rad(2)), rng)
    sigma = np.repeat(np.asarray(VISION) / np.sqrt(3), 3)
    vision = hs.PosePrior(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2))
    true = taxel_forces(array, solid, T, rng.uniform(*FORCE), UNEVEN * rng.normal(size=array.shape), springs)
    readings = true * (1 + NOISE * rng.normal(size=true.shape)) + SKIN.sigma * rng.normal(size=true.shape)
    # The rig has the array elsewhere: as if all else were off.
    wrong = se3.compose(np.eye(3), np.array([0.0, 0, MOUNT * rng.normal()]))
    moved = hs.PosePrior(wrong @ vision.T_palm_object, vision.covariance)
    return SkinScene(model, wrong @ T, contacts.moved(wrong), moved, readings, across)
