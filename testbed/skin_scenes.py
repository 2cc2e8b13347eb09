"""Tactile skin that presses on an object: curved fingertips, sampled finely, and the palm's array. Synthetic.

The skin is a bed of springs (an elastic foundation; Johnson 1985, chapter 4.3), so that the pressure under a round body
is a paraboloid, near Hertz's. Each taxel measures the force on its cell, one component or three; readings have noise, a
constant offset, and a share that leaks to the neighbours.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.checks import Array
from handsight.contact import TactileSurface
from handsight.contact.taxels import SkinTouch
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.simulation.taxels import FOAM, RUBBER, SIGMA_UNLOADED, ElasticSkin, Solid
from handsight.tracking import FingertipSensors
from testbed import scenes

Rng = np.random.Generator
STIFFNESS = (1e7, 6e7)
"""Of the skin, from and to [N/m per m²]: 5 mm of foam, 1.5 mm of rubber."""
FORCE = (0.5, 5.0)
"""Of a contact, from and to [N]."""
FRICTION = 0.5
"""The largest tangential force, as a share of the normal one; torsion is this times a quarter of the patch's radius."""
CROSSTALK = 0.03
"""Share of a taxel's force that each neighbour reads."""
NOISE, FLOOR = 0.05, 2e-3
"""Of a reading, as a share and in newtons."""
UNEVEN = 1.5e-4
"""Of each taxel's height [m]."""
STEP = 5e-4
"""Between samples of the skin [m]."""


@dataclass(frozen=True)
class Shape:
    """The shape of a tip: an ellipsoid, whose half towards -y may be drawn out to a cylinder."""

    axes: tuple[float, float, float]
    """Half sizes along x (across the finger), y (along it), z (out of its pad) [m]."""
    drawn_out: bool

    def value(self, points: Array) -> tuple[Array, Array]:
        """Zero on the surface, negative inside, and its gradient."""
        scaled = points / np.square(self.axes)
        if self.drawn_out:
            scaled = np.where(points[..., 1:2] < 0, scaled * [1, 0, 1], scaled)
        return (points * scaled).sum(axis=-1) - 1, 2 * scaled

    def on_surface(self, points: Array, direction: Array) -> tuple[Array, Array]:
        """Points moved along a direction to the surface, and their normals; NaN where the line misses it."""
        for _ in range(20):
            value, gradient = self.value(points)
            slope = gradient @ direction
            points = points - np.where(np.abs(slope) > 20, value / slope, np.nan)[..., None] * direction
        gradient = self.value(points)[1]
        return points, gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


SHAPES = {
    "capsule": Shape((0.011, 0.011, 0.011), drawn_out=True),
    "ball": Shape((0.013, 0.013, 0.013), drawn_out=False),
    "finger": Shape((0.010, 0.014, 0.012), drawn_out=True),
    "egg": Shape((0.012, 0.017, 0.013), drawn_out=False),
}
HELD_OUT = ("finger", "egg")
"""Shapes that no constant was chosen on."""


def tip(
    shape: Shape, rng: Rng, *, taxels: int = 30, pitch: float = 0.0047, components: int = 3,
    middle: Array | None = None, **fields: Any,
) -> TactileSurface:  # fmt: skip
    """A tip's surface: places among many, a pitch apart, around a `middle` (3,), its pad's without one."""
    many = rng.normal(size=(4000, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    places = many * shape.axes
    if shape.drawn_out:
        places[:, 1] -= np.where(many[:, 1] < 0, 0.02 * rng.random(len(many)), 0)
        places = np.where(places[:, 1:2] < 0, np.column_stack([
            places[:, 0] / np.hypot(many[:, 0], many[:, 2]), places[:, 1],
            places[:, 2] / np.hypot(many[:, 0], many[:, 2])]), places)  # fmt: skip
    order = np.argsort(np.linalg.norm(places - ([0, 0, shape.axes[2]] if middle is None else middle), axis=1))
    chosen: list[Array] = []
    for place in places[order]:
        if len(chosen) < taxels and all(np.linalg.norm(place - other) > 0.93 * pitch for other in chosen):
            chosen.append(place)
    gradient = shape.value(np.array(chosen))[1]
    given: Any = {"frame": "tip", "threshold": 0.03, "components": components, "pitch": pitch} | fields
    return TactileSurface(points=np.array(chosen), normals=gradient, **given)


@dataclass(frozen=True)
class Press:
    """One contact of a tip with a round or flat body."""

    readings: np.ndarray
    """(n,) or (n, 3) [N]"""
    point: np.ndarray
    """(3,) where the body touches first [m]."""
    normal: np.ndarray
    """(3,) the body's outward normal there."""
    force: np.ndarray
    """(3,) of the body on the tip [N]."""
    torque: float
    """About `normal`, at the point [N m]."""
    center: np.ndarray
    """(3,) centre of pressure, on the chord [m]."""
    depth: float
    """Of the body's surface below `point` [m]."""


def pressed(
    shape: Shape,
    surface: TactileSurface,
    rng: Rng,
    *,
    force: float | None = None,
    round_by: float | None = None,
    dead: int = 1,
    place: Array | None = None,
    load: tuple[Array, float] | None = None,
    step: float = STEP,
    reach: float = 0.85,
    springs: float | None = None,
) -> Press:
    """A press at a random place within the layout; `round_by` is the body's curvature, -20 to 80 /m without one.

    `load`: the tangential force (3,) [N] and the torque about the contact's normal [N m]; random without it. What
    presses farther than `reach` pitches from all taxels is not measured.

    On a tip that is drawn out to a cylinder it is 15 /m or more: a flat body touches it along a line, which has no
    point that is touched first.
    """
    if place is None:
        inner = np.flatnonzero((surface.taxels["near"] < len(surface.points)).sum(axis=1) >= 5)
        place = surface.points[rng.choice(inner)] + rng.uniform(-0.5, 0.5, 3) * surface.pitch
    _, gradient = shape.value(place)
    out = gradient / np.linalg.norm(gradient)
    point, out = shape.on_surface(place, out)
    _, gradient = shape.value(point)
    out = gradient / np.linalg.norm(gradient)
    drawn = np.exp(rng.uniform(*np.log(STIFFNESS)))
    stiffness = drawn if springs is None else springs
    newtons = np.exp(rng.uniform(*np.log(FORCE))) if force is None else force
    least = 15 if shape.drawn_out else -20
    curvature = rng.uniform(least, 80) if round_by is None else round_by
    x = np.cross(out, [1.0, 0, 0] if abs(out[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(out, x)
    grid = np.arange(-0.01, 0.01 + step / 2, step)
    u, v = np.meshgrid(grid, grid)
    fine, normals = shape.on_surface(point + u[..., None] * x + v[..., None] * y, out)
    fine, normals = fine.reshape(-1, 3), normals.reshape(-1, 3)
    # Of the side that is pressed; where a line only touches the tip, its end is not on it.
    known = (np.abs(shape.value(fine)[0]) < 1e-6) & (normals @ out > 0)
    fine, normals = fine[known], normals[known]
    arms = fine - point
    r2 = (arms**2).sum(axis=1) - (arms @ out) ** 2
    # The skin's own height errors are those of the nearest taxel.
    distance = np.linalg.norm(fine[:, None] - surface.points, axis=2)
    nearest, far = distance.argmin(axis=1), distance.min(axis=1) > reach * surface.pitch
    gap = 0.5 * curvature * r2 - arms @ out + (UNEVEN * rng.normal(size=len(surface.points)))[nearest]
    cosine = normals @ out
    area = step**2 / cosine.clip(0.2)
    low, high = 0.0, 0.01
    for _ in range(50):  # the depth at which the springs bear the force
        depth = (low + high) / 2
        push = stiffness * np.maximum(depth - gap, 0) * cosine**2 * area
        low, high = (depth, high) if push.sum() < newtons else (low, depth)
    pressure = stiffness * np.maximum(depth - gap, 0) * cosine * area
    side = rng.uniform(0, 2 * np.pi)
    share = FRICTION * rng.random()
    spin = FRICTION * rng.uniform(-1, 1) / np.sqrt(r2[pressure > 0].max(initial=1e-6))
    drag = share * (np.cos(side) * x + np.sin(side) * y) + 0.25 * spin * np.cross(out, arms)
    if load is not None:
        spin = -load[1] / max((pressure * r2).sum(), 1e-12)
        drag = load[0] / pressure.sum() + spin * np.cross(out, arms)
    pushed = -pressure[:, None] * normals + pressure[:, None] * drag
    cells = np.zeros((len(surface.points), 3))
    np.add.at(cells, nearest[~far], pushed[~far])
    total, moment = pushed.sum(axis=0), np.cross(arms, pushed).sum(axis=0)
    own = np.einsum("nik,ni->nk", surface.taxels["axes"], cells) * [1, 1, -1]
    leaked = own.copy()
    for i, row in enumerate(surface.taxels["near"]):
        near = row[row < len(own)]
        leaked[near] += CROSSTALK * own[i]
        leaked[i] -= CROSSTALK * len(near) * own[i]
    read = leaked * (1 + NOISE * rng.normal(size=leaked.shape)) + FLOOR * rng.normal(size=leaked.shape)
    strong = np.argsort(-read[:, 2])[:7]
    if dead:
        read[rng.choice(strong if rng.random() < 0.5 else len(read))] = np.nan
    values = read if surface.components == 3 else read[:, 2]
    middle = (fine * pressure[:, None]).sum(axis=0) / pressure.sum()
    return Press(values, point, -out, total, float(-moment @ out), middle, depth)


def height_error(patch: np.void, truth: Press) -> tuple[float, float]:
    """How far a patch's point is above the body's surface where it has sunk into the skin [mm], and the squared error
    by its covariance."""
    n = patch["normal"]
    error = (patch["point"] - truth.point) @ truth.normal - truth.depth
    return 1e3 * float(error), float(error**2 / (n @ patch["covariance"][:3, :3] @ n))


def errors(patch: np.void, truth: Press) -> dict[str, float]:
    """Errors of a patch: point [mm], normal [deg], force [share], and the squared one per degree of freedom."""
    n, error = patch["normal"], patch["point"] - truth.point
    tangent = np.linalg.svd(n[None])[2][1:]
    change = np.concatenate([error, tangent @ (n - truth.normal)])
    to_five = np.zeros((5, 6))
    to_five[:3, :3], to_five[3:, 3:] = np.eye(3), tangent
    squared = change @ np.linalg.solve(to_five @ patch["covariance"] @ to_five.T, change) / 5
    return {
        "point": 1e3 * np.linalg.norm(error),
        "normal": np.degrees(np.arccos(np.clip(n @ truth.normal, -1, 1))),
        "force": np.linalg.norm(patch["force"] - truth.force) / np.linalg.norm(truth.force),
        "nees": squared,
    }


R_FINGER_PAD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From a shape's axes to those of a simulated finger: it points along z, its pad faces -y."""


def with_taxels(
    rig: Rig, rng: Rng, *, components: Any = 3, middles: Mapping[str, Array] | None = None, **layout: Any
) -> tuple[Rig, dict[str, Shape]]:
    """A rig of the simulated hand with 30 taxels on each tip, or another `layout` of `tip`, and the tips' shapes.

    `middles`: by finger, the middle of its taxels in its shape's frame, see `places`; without one its pad's.
    """
    skin, shapes = dict(rig.skin), {}
    for name, finger in rig.fingers.items():
        x, y, z = finger.tip.semi_axes
        shapes[name] = Shape((x, z, y), drawn_out=False)
        found = tip(shapes[name], rng, components=components, middle=(middles or {}).get(name), **layout)
        T = finger.T_frame_surface
        R = T[:3, :3] @ R_FINGER_PAD
        skin[name] = TactileSurface(
            frame=finger.frame, points=found.points @ R.T + T[:3, 3], normals=found.normals @ R.T,
            threshold=0.03, components=components, pitch=found.pitch,
        )  # fmt: skip
    return replace(rig, skin=skin), shapes


def places(rig: Rig, observations: Iterable[Observation]) -> dict[str, Array]:
    """By finger that touches, the median place where it does by its wrench, in its shape's frame [m]."""
    sensors, found = FingertipSensors(rig), dict[str, list[Array]]()
    for observation in observations:
        touch = sensors.contacts(observation)
        Ts = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(observation.joint_positions or {}), strict=True))
        points = np.empty((0, 3)) if touch.contacts is None else touch.contacts.points_palm
        for name, point in zip(touch.fingers, points, strict=True):
            T = se3.inverse(Ts[name] @ rig.fingers[name].T_frame_surface)
            found.setdefault(name, []).append(R_FINGER_PAD.T @ se3.apply(T, point[None])[0])
    return {name: np.median(each, axis=0) for name, each in found.items()}


def taxel_observations(
    rig: Rig,
    shapes: dict[str, Shape],
    observations: Iterable[Observation],
    seed: int,
    *,
    wrenches: bool = False,
) -> Iterator[Observation]:
    """Observations in which taxels read what the fingertips' wrenches say; without these unless `wrenches`."""
    sensors, surfaces = FingertipSensors(rig), dict[str, TactileSurface]()
    for name in shapes:
        T, surface = rig.fingers[name].T_frame_surface, rig.skin[name]
        R = T[:3, :3] @ R_FINGER_PAD
        surfaces[name] = TactileSurface(
            frame="tip", points=(surface.points - T[:3, 3]) @ R, normals=surface.normals @ R,
            x_axes=surface.taxels["axes"][:, :, 0] @ R, threshold=0.03, components=surface.components,
            pitch=surface.pitch,
        )  # fmt: skip
    for k, observation in enumerate(observations):
        rng = np.random.default_rng([seed, k])
        found, readings = sensors.contacts(observation), dict(observation.skin)
        Ts = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(observation.joint_positions or {}), strict=True))
        for name, shape in shapes.items():
            readings[name] = FLOOR * rng.normal(size=rig.skin[name].shape)
            if name not in found.fingers or found.contacts is None or found.loads is None:
                continue
            i = found.fingers.index(name)
            T = Ts[name] @ rig.fingers[name].T_frame_surface
            place = R_FINGER_PAD.T @ se3.apply(se3.inverse(T), found.contacts.points_palm[i : i + 1])[0]
            tangential = R_FINGER_PAD.T @ T[:3, :3].T @ found.loads[i, :3]
            given: Any = {"force": found.loads[i, 3], "round_by": 30.0, "dead": 0, "place": place}
            given |= {"load": (tangential, found.loads[i, 4]), "step": 1e-3, "reach": 1.2}
            readings[name] = np.nan_to_num(pressed(shape, surfaces[name], rng, **given).readings)
        wrench = observation.wrenches if wrenches else {}
        yield replace(observation, skin=readings, wrenches=wrench)


# A box or a can held against a palm's tactile array by three fingertips, its edge on the array

VISION = (0.03 * np.sqrt(3), np.deg2rad(6) * np.sqrt(3))
"""Root mean square length and angle of vision's error: 30 mm and 6° per axis."""
MOUNT = 5e-4
"""Of the array's height: what its rig is wrong by, per grasp [m]."""
ARRAY_UNEVEN = 1e-4
"""Of each taxel's height [m]."""
ARRAY_NOISE = 0.1
"""Of a taxel, in parts of what it feels."""
ARRAY_FORCE = (3.0, 8.0)
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
    springs: float = RUBBER,
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


def box_on_skin(rng: np.random.Generator, array: TactileSurface, *, springs: float = FOAM) -> SkinScene:
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
    springs: float = FOAM,
) -> SkinScene:
    contacts = scenes.touched(T, tips, (1.2e-3, np.deg2rad(2)), rng)
    sigma = np.repeat(np.asarray(VISION) / np.sqrt(3), 3)
    vision = hs.PosePrior(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2))
    true = taxel_forces(
        array, solid, T, rng.uniform(*ARRAY_FORCE), ARRAY_UNEVEN * rng.normal(size=array.shape), springs
    )
    readings = true * (1 + ARRAY_NOISE * rng.normal(size=true.shape)) + SIGMA_UNLOADED * rng.normal(
        size=true.shape
    )
    # The rig has the array elsewhere: as if all else were off.
    wrong = se3.compose(np.eye(3), np.array([0.0, 0, MOUNT * rng.normal()]))
    moved = hs.PosePrior(wrong @ vision.T_palm_object, vision.covariance)
    return SkinScene(model, wrong @ T, contacts.moved(wrong), moved, readings, across)
