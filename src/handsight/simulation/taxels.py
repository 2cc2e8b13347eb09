"""The simulated elastic skin of palm and fingertips, what its taxels read, and the messages of their drivers.

The skin is a bed of springs (an elastic foundation; Johnson 1985, chapter 4.3): a body that presses on it sinks in
until the springs below it hold its force. A physics engine's contact points would not do: they are at a face's corners.

Products' counts are published, places on this hand's fingertips are not: they are spread over each tip, a pitch from
each other. A reading has the errors of elastic skin and of its electronics, in this order: crosstalk between
neighbours, hysteresis, noise, a constant offset, rounding to counts.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array, Indices
from handsight.contact.taxels import TactileSurface
from handsight.messages.encode import Message, header, parts
from handsight.simulation.scenario import Scenario, SensorKind
from handsight.simulation.scene import BOX_SIZE, CAN_SIZE, FINGERS, PALM, SCENE, convex_hull, tip_shape
from handsight.simulation.world import World


class SkinOptions(NamedTuple):
    """`SkinOptions` are the constants of a simulated tactile array."""

    foam: float = 1e7  # stiffness of a skin of 5 mm of foam [N/m per m²]
    rubber: float = 6e7
    """Stiffness of 1.5 mm of soft rubber, as on the simulated hand [N/m per m²]. The hand is hard in the physics
    engine, so a softer skin would contradict the object's pose."""
    springs: int = 3  # of a taxel of a flat array, each way
    tip_springs: int = 3000  # of a fingertip, evenly distributed
    cell: float = 0.85  # distance from a taxel to the springs that it measures, in pitches
    least_cosine: float = 0.3  # between a body's push and the inward normal of skin that it can press
    sigma: float = 0.002  # noise of a taxel without contact [N]
    circle_sides: int = 128  # of the polygon that approximates a circle: a can's within 0.01 mm


SKIN = SkinOptions()

T_PALM_GRID = np.array([[1.0, 0, 0, 0.011], [0, 0, -1, -0.0111], [0, 1, 0, 0.045], [0, 0, 0, 1]])
"""On the face of the palm's collision box that is towards -y."""
PALM_SKIN = TactileSurface.grid(
    frame=PALM, T_frame_grid=T_PALM_GRID, rows=20, columns=15, pitch=0.004, threshold=0.015, full_scale=5.0
)
"""The array of 60 x 80 mm on the simulated palm: its x is towards the thumb, its y towards the fingers."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A `Solid` is a convex body, described by the planes of its faces."""

    normals: Array  # (k, 3) outward
    offsets: Array  # (k,) distances of the planes from the origin along their normals [m]

    @classmethod
    def cylinder(cls, radius: float, height: float) -> "Solid":
        """Returns a cylinder about the origin and z."""
        angle = 2 * np.pi * np.arange(SKIN.circle_sides) / SKIN.circle_sides
        sides = np.stack([np.cos(angle), np.sin(angle), np.zeros(SKIN.circle_sides)], axis=1)
        ends = np.array([[0.0, 0, 1], [0, 0, -1]])
        return cls(np.vstack([sides, ends]), np.repeat([radius, height / 2], [SKIN.circle_sides, 2]))

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
        if name == "box":
            return cls(np.vstack([np.eye(3), -np.eye(3)]), np.tile(np.array(BOX_SIZE) / 2, 2))
        return cls.hull(convex_hull(name)[0])

    def distances(self, points: Array, direction: Array) -> Array:
        """Returns the distances (n,) from points (n, 3) along a unit direction to the body's nearer surface [m].

        They are infinite where the line misses the body, and negative where that surface is behind the point.
        """
        rate = self.normals @ direction
        enters, leaves, beside = rate < -1e-12, rate > 1e-12, np.abs(rate) <= 1e-12
        along = np.where(beside, 1.0, rate)
        at = self.offsets / along - points @ (self.normals / along[:, None]).T
        begin = at[:, enters].max(axis=1, initial=-np.inf)
        end = at[:, leaves].min(axis=1, initial=np.inf)
        misses = (at[:, beside] < 0).any(axis=1) | (end < begin)
        return np.asarray(np.where(misses, np.inf, begin))


def spring_forces(gaps: Array, force: float, stiffness: Array | float) -> Array:
    """Returns the forces (n,) of springs that a body compresses until together they hold `force` [N].

    `gaps` (n,): from the unloaded springs to the body [m], infinite beside it; `stiffness`: of each or of all [N/m].
    """
    order = np.argsort(gaps)[: np.isfinite(gaps).sum()]
    if force <= 0 or not len(order):
        return np.zeros(len(gaps))
    near, k = gaps[order], np.broadcast_to(stiffness, gaps.shape)[order]
    # The depth at which the nearest springs hold the force; the right number of them reaches no further spring.
    depth = (force + np.cumsum(k * near)) / np.cumsum(k)
    last = int(np.argmax(np.append(depth[:-1] <= near[1:], True)))
    return np.asarray(stiffness * np.maximum(depth[last] - gaps, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ElasticSkin:
    """An `ElasticSkin` is a bed of springs on a link, each below one of its taxels or below none."""

    points: Array  # (m, 3) ends of the unloaded springs in the link [m]
    normals: Array  # (m, 3) outward
    areas: Array  # (m,) that each represents [m²]
    taxels: Indices  # (m,) the taxel that measures each spring; the number of taxels where none does
    places: Array  # (n, 3) of the taxels in the link [m]

    @classmethod
    def flat(cls, array: TactileSurface) -> "ElasticSkin":
        """Returns the skin of a flat grid of taxels, with springs below these alone."""
        fine = array.pitch / SKIN.springs
        steps = fine * (np.arange(SKIN.springs) - (SKIN.springs - 1) / 2)
        within = np.stack(np.meshgrid(steps, steps, 0.0), axis=-1).reshape(-1, 3)
        n, each, axes = len(array.points), len(within), array.taxels["axes"]
        points = array.points[:, None] + within @ axes.swapaxes(1, 2)
        normals, taxels = np.repeat(axes[:, :, 2], each, axis=0), np.repeat(np.arange(n), each)
        return cls(points.reshape(-1, 3), normals, np.full(n * each, fine**2), taxels, array.points)

    @classmethod
    def ellipsoid(cls, semi_axes: Array, T_link_tip: Array, places: Array, reach: Array) -> "ElasticSkin":
        """Returns the skin all over a fingertip, an ellipsoid (3,) [m] with that pose (4, 4). `places` (n, 3) are its
        taxels in the link, `reach` (n,) how far each one's cell extends at most [m]."""
        unit = se3.directions(SKIN.tip_springs)
        out = unit / semi_axes
        length = np.linalg.norm(out, axis=1)
        areas = semi_axes.prod() * length * 4 * np.pi / len(unit)
        points = se3.apply(T_link_tip, semi_axes * unit)
        distances = np.linalg.norm(points[:, None] - places, axis=2)
        taxels = distances.argmin(axis=1)
        taxels[distances.min(axis=1) > reach[taxels]] = len(places)
        return cls(points, out / length[:, None] @ T_link_tip[:3, :3].T, areas, taxels, places)

    def forces(
        self,
        solid: Solid,
        T_link_solid: Array,
        force: Array,
        push: Array,
        uneven: Array | float = 0.0,
        stiffness: float = SKIN.rubber,
        torque: float = 0.0,
    ) -> Array:
        """Returns the forces (n + 1, 3) of a solid on the taxels in the link, and on skin without one in the last row.

        Their sum is `force` (3,) [N]. `push` (3,) is the unit direction in which the solid presses into the skin:
        along it springs are compressed, each of which presses back along its own normal. The rest of the force is
        shared in proportion to the pressure, and so is `torque` about `push` [N m], in proportion to the distance from
        the centre of pressure too. `uneven` (n,): each taxel's distance below its place [m].
        """
        found = np.zeros((len(self.places) + 1, 3))
        cosines = -self.normals @ push
        near = np.flatnonzero(cosines > SKIN.least_cosine)
        cosines, normals, taxels = cosines[near], self.normals[near], self.taxels[near]
        R = T_link_solid[:3, :3]
        gaps = solid.distances((self.points[near] - T_link_solid[:3, 3]) @ R, -push @ R)
        gaps = gaps + np.append(np.broadcast_to(uneven, len(self.places)), 0.0)[taxels]
        borne = spring_forces(gaps, float(force @ push), stiffness * self.areas[near] * cosines**2)
        if not borne.any():
            return found
        pressed = -(borne / cosines)[:, None] * normals
        share = borne / borne.sum()
        arms = np.cross(push, self.points[near] - share @ self.points[near])
        turn = torque / max(share @ (arms**2).sum(axis=1), 1e-9)
        np.add.at(found, taxels, pressed + share[:, None] * (force - pressed.sum(axis=0) + turn * arms))
        return found


class Pad(NamedTuple):
    """A `Pad` is a group of taxels on a fingertip."""

    name: str  # behind the finger's; empty for a tip's only one
    number: int
    pitch: float  # [m]
    up: float
    """Height of its middle above the ellipsoid's, in parts of the semi-axis along the finger; 1: at its end."""


class Product(NamedTuple):
    """A `Product` is a maker's kind of tactile sensor."""

    pads: tuple[Pad, ...] = ()
    palm: tuple[int, int, float] = (20, 15, 0.004)  # rows, columns and pitch [m] of the array on the palm
    components: int = 3
    rate: float = 1000.0  # readings per second, at most one an observation
    newtons: float = 0.0  # force of one count of a reading [N]; 0: readings are in newtons


PRODUCTS: dict[SensorKind, Product] = {
    "wrench": Product(components=1),
    "xela": Product((Pad("", 30, 0.0047, 0.45),), (4, 6, 0.0047)),
    "paxini": Product((Pad("", 116, 0.0028, 0.45),), (7, 11, 0.0042)),
    "inspire": Product(
        (Pad("_tip", 9, 0.0028, 1.0), Pad("_pad", 80, 0.0023, 0.15)), (8, 14, 0.0042),
        components=1, rate=50.0, newtons=0.001,
    ),
}  # fmt: skip
"""XELA: uSkin's curved fingertip, and one module of the palm's. PaXini: as many points as PX-6AX DP-S2716-Core and
CP-M3025-Core have. Inspire: RH56DFTP; a finger's nail is not simulated. Pitches but XELA's are assumed."""
FULL_SCALE, COUNTS = 5.0, 4095  # of a three-axis taxel [N]; the largest count
PADS = {"th": np.array([-0.8, 0.6, 0.0])}
"""The direction across the finger in which a tip's taxels face, where that is not -y: the thumb's, to the fingers."""
T_FEWER = se3.compose(np.eye(3), np.array([-0.004, 0.009, 0.0]))
"""Pose of a smaller array than `PALM_SKIN` in its grid: where the hand presses the can on its palm."""
INSPIRE_FINGERS = {"lf": "little", "rf": "ring", "mf": "middle", "ff": "index", "th": "thumb"}
XELA, INSPIRE = "xela_server_ros2/msg/SensStream", "inspire_hand_ros2/msg/InspireHandTouch"
XELA_TOPIC, INSPIRE_TOPIC = "/xServTopic", "/inspire_hand/touch"
RAW = 30000, 1000  # a raw reading of XELA's without load, and counts per newton


@lru_cache(maxsize=8)
def surfaces(kind: SensorKind, palm: bool) -> dict[str, TactileSurface]:
    """Returns the hand's tactile surfaces by name, those of the fingertips and, with `palm`, that of the palm."""
    product, found = PRODUCTS[kind], dict[str, TactileSurface]()
    fields: dict[str, Any] = {"components": product.components, "threshold": 0.03, "full_scale": FULL_SCALE}
    if product.newtons:
        fields |= {"scale": product.newtons, "full_scale": product.newtons * COUNTS}
    for finger in FINGERS if product.pads else ():
        semi_axes, _ = tip_shape(finger)
        T, chosen = _tip_pose(finger), np.zeros((0, 3))
        for pad in product.pads:
            places = _places(finger, pad, chosen)
            chosen = np.vstack([chosen, places])
            found[f"{finger}{pad.name}"] = TactileSurface(
                frame=f"robot0:{finger}distal",
                points=se3.apply(T, places),
                normals=places / semi_axes**2 @ T[:3, :3].T,
                pitch=pad.pitch,
                nominal=True,
                **fields,
            )
    if palm and kind == "wrench":
        found["palm"] = PALM_SKIN
    elif palm:
        rows, columns, pitch = product.palm
        size: dict[str, Any] = {"rows": rows, "columns": columns, "pitch": pitch}
        found["palm"] = TactileSurface.grid(frame=PALM, T_frame_grid=T_PALM_GRID @ T_FEWER, **size, **fields)
    return found


def _tip_pose(finger: str) -> Array:
    """Returns the pose (4, 4) of a tip's ellipsoid in its link."""
    return se3.compose(np.eye(3), np.array([0.0, 0.0, SCENE.sensor_z + tip_shape(finger)[1]]))


def _places(finger: str, pad: Pad, others: Array) -> Array:
    """Returns places (n, 3) on a tip's ellipsoid, in its frame: the nearest to the pad's middle that are a pitch from
    each other and from `others` (k, 3)."""
    semi_axes, _ = tip_shape(finger)
    facing = PADS.get(finger, np.array([0.0, -1.0, 0.0]))
    middle = semi_axes * (np.sqrt(1 - pad.up**2) * facing + [0.0, 0.0, pad.up])
    many = semi_axes * se3.directions(20000)
    many = many[np.argsort(np.linalg.norm(many - middle, axis=1))]
    chosen = list(others)
    for place in many:
        if len(chosen) == len(others) + pad.number:
            break
        if not chosen or np.linalg.norm(np.array(chosen) - place, axis=1).min() > 0.97 * pad.pitch:
            chosen.append(place)
    return np.array(chosen[len(others) :])


class TaxelSensors:
    """`TaxelSensors` are all taxels of the hand: constant errors are drawn at the start, noise at every reading."""

    def __init__(self, scenario: Scenario) -> None:
        """Draws by the scenario's seed."""
        self._solid, self._nuisances = Solid.of(scenario.object), scenario.nuisances
        seed, n = int(scenario.seed), scenario.nuisances
        constant, faulty = (np.random.default_rng((seed, k)) for k in (11, 19))
        self._noise = np.random.default_rng((seed, 12))
        self.surfaces = surfaces(scenario.sensors, scenario.skin)
        self.product, self._last = PRODUCTS[scenario.sensors], dict[str, Array]()
        self._plain = not self.product.pads  # the palm's array beside wrenches has noise and offsets alone
        self._uneven, self._offset, self._dead = dict[str, Array](), dict[str, Array](), dict[str, Any]()
        self._links = dict[str, tuple[str, ElasticSkin, list[str]]]()
        for name, surface in self.surfaces.items():
            places = len(surface.points)
            self._uneven[name] = n.skin_uneven * constant.normal(size=places)
            self._offset[name] = n.skin_offset * constant.normal(size=(places, surface.components))
            dead = n.taxel_dead if n.taxel_dead >= 1 else n.taxel_dead * places
            self._dead[name] = faulty.permutation(places)[: 0 if self._plain else round(dead)]
        for finger in FINGERS if self.product.pads else ():
            names = [f"{finger}{pad.name}" for pad in self.product.pads]
            mine = [self.surfaces[name] for name in names]
            reach = np.concatenate([np.full(len(each.points), SKIN.cell * each.pitch) for each in mine])
            points = np.concatenate([each.points for each in mine])
            skin = ElasticSkin.ellipsoid(tip_shape(finger)[0], _tip_pose(finger), points, reach)
            self._links[finger] = mine[0].frame, skin, names
        if "palm" in self.surfaces:
            self._links["palm"] = PALM, ElasticSkin.flat(self.surfaces["palm"]), ["palm"]

    def readings(self, world: World) -> dict[str, Array]:
        """Returns the readings of all surfaces, by name, in their shape and in the driver's unit."""
        return {name: self.read(name, forces) for name, forces in self.forces(world).items()}

    def forces(self, world: World) -> dict[str, Array]:
        """Returns the true forces (n, 3) on the taxels in their links, by surface [N].

        The table, and other links, press as planes that touch the tip where the simulator's contact is.
        """
        found = {name: np.zeros((len(surface.points), 3)) for name, surface in self.surfaces.items()}
        T_palm_object, contacts = world.T_palm_object(), world.link_contacts()
        for link, (frame, skin, names) in self._links.items():
            uneven = np.concatenate([self._uneven[name] for name in names])
            total = np.zeros((len(uneven) + 1, 3))
            T_frame_palm = se3.inverse(world.pose(frame)) @ world.pose(PALM)
            for other in {contact.other for contact in contacts if contact.finger == link}:
                mine = [each for each in contacts if (each.finger, each.other) == (link, other)]
                force = T_frame_palm[:3, :3] @ np.sum([each.force_palm for each in mine], axis=0)
                weights = [np.linalg.norm(each.force_palm) + 1e-12 for each in mine]
                push = T_frame_palm[:3, :3] @ np.average([each.normal_palm for each in mine], 0, weights)
                push /= np.linalg.norm(push)
                if other == "object":
                    solid, T = self._solid, T_frame_palm @ T_palm_object
                else:
                    point = se3.apply(T_frame_palm, mine[0].point_palm[None])[0]
                    solid, T = Solid(-push[None], np.array([-push @ point])), np.eye(4)
                torque = sum(each.torque for each in mine)
                total += skin.forces(solid, T, force, push, uneven, torque=torque)
            ends = np.cumsum([len(self._uneven[name]) for name in names])
            found |= dict(zip(names, np.split(total, ends)[:-1], strict=True))
        return found

    def read(self, name: str, forces: Array) -> Array:
        """Returns a surface's reading of true forces (n, 3) in its link."""
        surface, n = self.surfaces[name], self._nuisances
        axes, near = surface.taxels["axes"], surface.taxels["near"]
        true = np.einsum("nik,ni->nk", axes, forces)[:, -surface.components :]
        true[:, -1] *= -1  # into the skin
        share = n.skin_noise if self._plain else n.taxel_noise
        if not self._plain:
            padded = np.vstack([true, np.zeros(surface.components)])
            own = (near < len(true)).sum(axis=1)[:, None]
            true = true + n.taxel_crosstalk * (padded[near].sum(axis=1) - own * true)
            play = n.taxel_hysteresis * np.abs(true)
            true = np.clip(self._last.get(name, true), true - play, true + play)
            self._last[name] = true
        drawn, floor = self._noise.normal(size=(2, *true.shape))
        read = true * (1 + share * drawn) + (SKIN.sigma * floor if share else 0.0) + self._offset[name]
        read[self._dead[name]] = self._offset[name][self._dead[name]]
        read = np.minimum(read, surface.full_scale or np.inf)
        if self.product.newtons:
            read = np.clip(np.rint(read / self.product.newtons), 0, COUNTS)
        return np.asarray(read.reshape(surface.shape))


def topics(kind: SensorKind, palm: bool) -> tuple[dict[str, str], dict[str, str]]:
    """Returns the topic of each tactile surface, and the paths to their readings in messages that they share."""
    names = list(surfaces(kind, palm))
    if kind == "xela":
        paths = {name: f"sensors[sensor_pos={k}].forces" for k, name in enumerate(names, start=1)}
        return dict.fromkeys(names, XELA_TOPIC), paths
    if kind == "inspire":
        paths = {name: f"{INSPIRE_FINGERS[name[:2]]}.{name[3:]}" for name in names if name != "palm"}
        return dict.fromkeys(names, INSPIRE_TOPIC), paths | ({"palm": "palm"} if palm else {})
    return {name: f"/{name}/taxels" for name in names}, {}


def messages(
    kind: SensorKind, readings: Mapping[str, Array], stamp: float
) -> Iterator[tuple[str, str, dict[str, object]]]:
    """Yields topic, type and fields of a driver's messages of one instant.

    XELA's server sends all sensors, with raw counts beside newtons, and its time in place of a header; Inspire's sends
    the whole hand. PaXini has no published ROS message: a TactileState a finger has the points and their resultant.
    """
    if kind == "xela":
        sensors = []
        for k, values in enumerate(readings.values(), start=1):
            raw = np.clip(np.rint(RAW[0] + RAW[1] * values), 0, 65535).astype(np.uint16).reshape(-1, 3)
            rows: Any = raw, values.astype(np.float32).reshape(-1, 3)
            counts, newtons = ([parts("xyz", each) for each in table] for table in rows)
            model = "uSPa46" if len(raw) == 24 else "uSCu"
            top = {"message": round(stamp * 100) % 2**16, "time": stamp, "model": model, "sensor_pos": k}
            sensors.append(Message(**top, taxels=counts, forces=newtons))
        yield XELA_TOPIC, XELA, {"sensors": sensors}
    elif kind == "inspire":
        regions = {name: values.ravel().astype(np.int16) for name, values in readings.items()}
        fields: dict[str, object] = {"header": header(stamp)}
        touching = 0
        for name, finger in INSPIRE_FINGERS.items():
            tip, pad = (regions[f"{name}{region}"] for region in ("_tip", "_pad"))
            most = float(max(tip.max(), pad.max()))
            touching += most > 100
            middle = np.zeros(9 if name == "th" else 0, np.int16)
            total, count = float(tip.sum() + pad.sum()), int((tip > 100).sum() + (pad > 100).sum())
            fields[finger] = Message(
                name=finger, tip=tip, nail=np.zeros(96, np.int16), pad=pad, middle_section=middle,
                total_pressure=total, max_pressure=most, contact_count=count,
            )  # fmt: skip
        total = float(sum(each.sum() for each in regions.values()))
        state = {"total_contact": total, "fingers_in_contact": touching, "stable_contact": touching > 1}
        yield INSPIRE_TOPIC, INSPIRE, fields | {"palm": regions.get("palm", np.zeros(112, np.int16))} | state
    else:
        for name, values in readings.items():
            rows = values.reshape(-1, 3).astype(np.float32)
            channels = {name: rows.ravel(), f"{name}_resultant": rows.sum(axis=0)}
            sensors = [Message(name=key, values=each) for key, each in channels.items()]
            fields = {"header": header(stamp), "sensors": sensors}
            yield f"/{name}/taxels", "tactile_msgs/msg/TactileState", fields
