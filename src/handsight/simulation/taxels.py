"""The simulated elastic skin of palm and fingertips, and what its taxels read.

The skin is a bed of springs (an elastic foundation; Johnson 1985, chapter 4.3): a body that presses on it sinks in
until the springs below it hold its force. A physics engine's contact points would not do: they are at a face's corners.

Products' counts are published, places on this hand's fingertips are not: they are spread over each tip, a pitch from
each other. A reading has the errors of elastic skin and of its electronics, in this order: crosstalk between
neighbours, hysteresis, noise, a constant offset.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array, Indices
from handsight.contact.taxels import TactileSurface
from handsight.simulation.scenario import FINGERS, Scenario, SensorKind
from handsight.simulation.scene import CAN_SIZE, PALM, SENSOR_Z, convex_hull, tip_shape
from handsight.simulation.tables import tables
from handsight.simulation.world import World

FOAM = 1e7
"""Stiffness of a skin of 5 mm of foam [N/m per m²]."""
RUBBER = 6e7
"""Stiffness of 1.5 mm of soft rubber, as on the simulated hand [N/m per m²]. The hand is hard in the physics engine, so
a softer skin would contradict the object's pose."""
SIGMA_UNLOADED = 0.002
"""Noise of a taxel without contact [N]."""
T_PALM_GRID = np.array([[1.0, 0, 0, 0.011], [0, 0, -1, -0.0111], [0, 1, 0, 0.045], [0, 0, 0, 1]])
"""On the face of the palm's collision box that is towards -y."""
PALM_SKIN = TactileSurface.grid(
    frame=PALM, T_frame_grid=T_PALM_GRID, rows=20, columns=15, pitch=0.004, threshold=0.015, full_scale=5.0
)
"""The array of 60 x 80 mm on the simulated palm: its x is towards the thumb, its y towards the fingers."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A convex body, described by the planes of its faces."""

    normals: Array  # (k, 3) outward
    offsets: Array  # (k,) distances of the planes from the origin along their normals [m]

    @classmethod
    def cylinder(cls, radius: float, height: float) -> "Solid":
        """Returns a cylinder about the origin and z; 128 sides are within 0.01 mm of a can's circle."""
        angle = 2 * np.pi * np.arange(128) / 128
        sides = np.stack([np.cos(angle), np.sin(angle), np.zeros(128)], axis=1)
        normals = np.vstack([sides, np.outer([1.0, -1.0], [0.0, 0.0, 1.0])])
        return cls(normals, np.repeat([radius, height / 2], [128, 2]))

    @classmethod
    def hull(cls, vertices: Array) -> "Solid":
        """Returns the convex hull of vertices (k, 3) [m]."""
        planes = ConvexHull(vertices).equations
        return cls(planes[:, :3], -planes[:, 3])

    @classmethod
    def of(cls, name: str) -> "Solid":
        """Returns a scenario's object in its own frame."""
        if name == "can":
            return cls.cylinder(*CAN_SIZE)
        return cls.hull(convex_hull(name)[0])

    def distances(self, points: Array, direction: Array) -> Array:
        """Returns the distances (n,) from points (n, 3) along a unit direction to the body's nearer surface [m].

        They are infinite where the line misses the body, and negative where that surface is behind the point.
        """
        rate = self.normals @ direction
        beside = np.abs(rate) <= 1e-12
        along = np.where(beside, 1.0, rate)
        at = self.offsets / along - points @ (self.normals / along[:, None]).T
        begin = at[:, rate < -1e-12].max(axis=1, initial=-np.inf)
        end = at[:, rate > 1e-12].min(axis=1, initial=np.inf)
        misses = (at[:, beside] < 0).any(axis=1) | (end < begin)
        return np.where(misses, np.inf, begin)


def spring_forces(gaps: Array, force: float, stiffness: Array) -> Array:
    """Returns the forces (n,) of springs that a body compresses until together they hold `force` [N].

    `gaps` (n,): from the unloaded springs to the body [m], infinite beside it; `stiffness` (n,) of each [N/m].
    """
    order = np.argsort(gaps)[: np.isfinite(gaps).sum()]
    if force <= 0 or not len(order):
        return np.zeros(len(gaps))
    near = gaps[order]
    k = stiffness[order]
    # The depth at which the nearest springs hold the force; the right number of them reaches no further spring.
    depth = (force + np.cumsum(k * near)) / np.cumsum(k)
    enough = np.append(depth[:-1] <= near[1:], True)
    return np.asarray(stiffness * np.maximum(depth[enough.argmax()] - gaps, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ElasticSkin:
    """A bed of springs on a link, each below one of its taxels or below none."""

    points: Array  # (m, 3) ends of the unloaded springs in the link [m]
    normals: Array  # (m, 3) outward
    areas: Array  # (m,) that each represents [m²]
    taxels: Indices  # (m,) the taxel that measures each spring; the number of taxels where none does
    places: Array  # (n, 3) of the taxels in the link [m]

    @classmethod
    def flat(cls, array: TactileSurface) -> "ElasticSkin":
        """Returns the skin of a flat grid of taxels, with springs below these alone."""
        fine = array.pitch / 3
        steps = fine * np.array([-1.0, 0.0, 1.0])
        nine = np.stack(np.meshgrid(steps, steps, 0.0), axis=-1).reshape(-1, 3)  # springs of each taxel
        axes = array.taxels["axes"]
        points = array.points[:, None] + nine @ axes.swapaxes(1, 2)
        return cls(
            points=points.reshape(-1, 3),
            normals=np.repeat(axes[:, :, 2], 9, axis=0),
            areas=np.full(9 * len(axes), fine**2),
            taxels=np.repeat(np.arange(len(axes)), 9),
            places=array.points,
        )

    @classmethod
    def ellipsoid(cls, semi_axes: Array, T_link_tip: Array, places: Array, reach: Array) -> "ElasticSkin":
        """Returns the skin all over a fingertip, an ellipsoid (3,) [m] with that pose (4, 4). `places` (n, 3) are its
        taxels in the link, `reach` (n,) how far each one's cell extends at most [m]."""
        unit = se3.directions(3000)
        out = unit / semi_axes
        length = np.linalg.norm(out, axis=1)
        areas = semi_axes.prod() * length * 4 * np.pi / len(unit)
        points = se3.apply(T_link_tip, semi_axes * unit)
        distances = np.linalg.norm(points[:, None] - places, axis=2)
        taxels = distances.argmin(axis=1)
        taxels[distances.min(axis=1) > reach[taxels]] = len(places)
        normals = out / length[:, None] @ T_link_tip[:3, :3].T
        return cls(points, normals, areas, taxels, places)

    def forces(
        self,
        solid: Solid,
        T_link_solid: Array,
        force: Array,
        push: Array,
        uneven: Array | None = None,
        stiffness: float = RUBBER,
        torque: float = 0.0,
    ) -> Array:
        """Returns the forces (n + 1, 3) of a solid on the taxels in the link, and on skin without one in the last row.

        Their sum is `force` (3,) [N]. `push` (3,) is the unit direction in which the solid presses into the skin:
        along it springs are compressed, each of which presses back along its own normal. The rest of the force is
        shared in proportion to the pressure, and so is `torque` about `push` [N m], in proportion to the distance from
        the centre of pressure too. `uneven` (n,): each taxel's distance below its place [m]; None: 0.
        """
        uneven = np.zeros(len(self.places)) if uneven is None else uneven
        found = np.zeros((len(self.places) + 1, 3))
        cosines = -self.normals @ push
        near = np.flatnonzero(cosines > 0.3)  # a body presses no skin that faces farther away
        cosines = cosines[near]
        normals = self.normals[near]
        taxels = self.taxels[near]
        R = T_link_solid[:3, :3]
        gaps = solid.distances((self.points[near] - T_link_solid[:3, 3]) @ R, -push @ R)
        gaps = gaps + np.append(uneven, 0.0)[taxels]
        borne = spring_forces(gaps, float(force @ push), stiffness * self.areas[near] * cosines**2)
        if not borne.any():
            return found
        pressed = -(borne / cosines)[:, None] * normals
        share = borne / borne.sum()
        points = self.points[near]
        arms = np.cross(push, points - share @ points)
        turn = torque / max(share @ (arms**2).sum(axis=1), 1e-9)
        rest = force - pressed.sum(axis=0) + turn * arms
        np.add.at(found, taxels, pressed + share[:, None] * rest)
        return found


THUMB_FACES = np.array([-0.8, 0.6, 0.0])
"""The direction across the thumb in which its tip's taxels face, to the fingers; a finger's face -y."""
T_GRID_FEWER = se3.translation([-0.004, 0.009, 0.0])
"""Pose of a smaller array than `PALM_SKIN` in its grid: where the hand presses the can on its palm."""


@lru_cache(maxsize=8)
def surfaces(kind: SensorKind, palm: bool) -> dict[str, TactileSurface]:
    """Returns the hand's tactile surfaces by name, those of the fingertips and, with `palm`, that of the palm."""
    if kind == "wrench":
        return {"palm": PALM_SKIN} if palm else {}
    product = tables()["taxels"][kind]
    fields: dict[str, Any] = {"components": product["components"], "threshold": 0.03, "full_scale": 5.0}
    found = dict[str, TactileSurface]()
    for finger in FINGERS:
        semi_axes, height = tip_shape(finger)
        chosen = list[Array]()
        for name, pad in product["pads"].items():
            places = _places(finger, pad, chosen)
            chosen += places
            points = np.array(places)
            found[f"{finger}{name}"] = TactileSurface(
                frame=f"robot0:{finger}distal",
                points=points + np.array([0.0, 0.0, SENSOR_Z + height]),
                normals=points / semi_axes**2,
                pitch=pad["pitch"],
                nominal=True,
                **fields,
            )
    if palm:
        T = T_PALM_GRID @ T_GRID_FEWER
        found["palm"] = TactileSurface.grid(frame=PALM, T_frame_grid=T, **product["palm"], **fields)
    return found


def _places(finger: str, pad: dict[str, Any], others: list[Array]) -> list[Array]:
    """Returns places (3,) on a tip's ellipsoid, in its frame: the nearest to the pad's middle that are a pitch from
    each other and from the `others`."""
    semi_axes, _ = tip_shape(finger)
    facing = THUMB_FACES if finger == "th" else np.array([0.0, -1.0, 0.0])
    middle = semi_axes * (np.sqrt(1 - pad["up"] ** 2) * facing + [0.0, 0.0, pad["up"]])
    many = semi_axes * se3.directions(20000)
    apart = 0.97 * pad["pitch"]
    chosen = list[Array]()
    for place in many[np.argsort(np.linalg.norm(many - middle, axis=1))]:
        if len(chosen) == pad["number"]:
            break
        taken = np.array([*others, *chosen]).reshape(-1, 3)
        if (np.linalg.norm(taken - place, axis=1) > apart).all():
            chosen.append(place)
    return chosen


class TaxelSensors:
    """All taxels of the hand: constant errors are drawn at the start, noise at every reading."""

    def __init__(self, scenario: Scenario) -> None:
        """Draws by the scenario's seed."""
        constant = scenario.stream(11)
        faulty = scenario.stream(19)
        self._noise = scenario.stream(12)
        self._nuisances = n = scenario.nuisances
        self._solid = Solid.of(scenario.object)
        self.surfaces = surfaces(scenario.sensors, scenario.skin)
        self._plain = scenario.sensors == "wrench"  # the palm's array alone has noise and offsets only
        self._uneven = dict[str, Array]()
        self._offset = dict[str, Array]()
        self._dead = dict[str, Indices]()
        self._last = dict[str, Array]()
        self._skins = dict[str, ElasticSkin]()  # by link
        self._names = dict[str, list[str]]()  # of the surfaces on each
        for name, surface in self.surfaces.items():
            places = len(surface.points)
            self._uneven[name] = n.skin_uneven * constant.normal(size=places)
            self._offset[name] = n.skin_offset * constant.normal(size=(places, surface.components))
            dead = n.taxel_dead if n.taxel_dead >= 1 else n.taxel_dead * places
            self._dead[name] = faulty.permutation(places)[: 0 if self._plain else round(dead)]
            link = "palm" if name == "palm" else name[:2]
            self._names.setdefault(link, []).append(name)
        for link, names in self._names.items():
            if link == "palm":
                self._skins[link] = ElasticSkin.flat(self.surfaces[link])
                continue
            mine = [self.surfaces[name] for name in names]
            points = np.concatenate([each.points for each in mine])
            # A taxel measures springs within 0.85 of a pitch.
            reach = np.concatenate([np.full(len(each.points), 0.85 * each.pitch) for each in mine])
            semi_axes, height = tip_shape(link)
            T = se3.translation([0.0, 0.0, SENSOR_Z + height])
            self._skins[link] = ElasticSkin.ellipsoid(semi_axes, T, points, reach)

    def readings(self, world: World) -> dict[str, Array]:
        """Returns the readings of all surfaces [N], by name, in their shape."""
        return {name: self.read(name, forces) for name, forces in self.forces(world).items()}

    def forces(self, world: World) -> dict[str, Array]:
        """Returns the true forces (n, 3) on the taxels in their links, by surface [N].

        The table, and other links, press as planes that touch the tip where the simulator's contact is.
        """
        contacts = world.link_contacts()
        found = dict[str, Array]()
        for link, names in self._names.items():
            T_frame_palm = se3.inverse(world.pose(self.surfaces[names[0]].frame)) @ world.pose(PALM)
            T_frame_object = T_frame_palm @ world.T_palm_object()
            uneven = [self._uneven[name] for name in names]
            total = np.zeros((sum(map(len, uneven)) + 1, 3))
            on_link = [contact for contact in contacts if contact.finger == link]
            for other in {contact.other for contact in on_link}:
                mine = [contact for contact in on_link if contact.other == other]
                R = T_frame_palm[:3, :3]
                force = R @ np.sum([each.force_palm for each in mine], axis=0)
                weights = [np.linalg.norm(each.force_palm) + 1e-12 for each in mine]
                push = R @ np.average([each.normal_palm for each in mine], 0, weights)
                push /= np.linalg.norm(push)
                solid = self._solid
                T = T_frame_object
                if other != "object":
                    point = se3.apply(T_frame_palm, mine[0].point_palm[None])[0]
                    solid = Solid(-push[None], np.array([-push @ point]))
                    T = np.eye(4)
                torque = sum(each.torque for each in mine)
                bed = self._skins[link]
                total += bed.forces(solid, T, force, push, np.concatenate(uneven), torque=torque)
            ends = np.cumsum(list(map(len, uneven)))
            found |= dict(zip(names, np.split(total, ends)[:-1], strict=True))
        return found

    def read(self, name: str, forces: Array) -> Array:
        """Returns a surface's reading of true forces (n, 3) in its link."""
        n = self._nuisances
        surface = self.surfaces[name]
        share = n.skin_noise
        true = np.einsum("nik,ni->nk", surface.taxels["axes"], forces)[:, -surface.components :]
        true[:, -1] *= -1  # into the skin
        if not self._plain:
            share = n.taxel_noise
            near = surface.taxels["near"]
            padded = np.vstack([true, np.zeros(surface.components)])
            own = (near < len(true)).sum(axis=1)[:, None]
            true = true + n.taxel_crosstalk * (padded[near].sum(axis=1) - own * true)
            play = n.taxel_hysteresis * np.abs(true)
            true = np.clip(self._last.get(name, true), true - play, true + play)
            self._last[name] = true
        drawn, floor = self._noise.normal(size=(2, *true.shape))
        unloaded = SIGMA_UNLOADED if share else 0.0
        offset = self._offset[name]
        read = true * (1 + share * drawn) + unloaded * floor + offset
        dead = self._dead[name]
        read[dead] = offset[dead]
        return np.asarray(np.minimum(read, surface.full_scale or np.inf).reshape(surface.shape))
