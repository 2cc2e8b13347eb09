"""Which likely mistake in a rig, or in what a driver publishes, explains that a recording contradicts itself.

Each mistake is tried: the recording is read again as if it had been made, by the measures of `consistency`. One is
named only where it lowers their sum by `MISTAKES.margin`, and by two standard errors of the samples' differences;
then the next one is searched on top of it.
"""

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, permutations, product
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import TactileSurface
from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Finger, Rig
from handsight.rig.save import pose_text
from handsight.tracking.consistency import MEASURES, Change, Excerpt, Reading


class MistakeOptions(NamedTuple):
    """`MistakeOptions` say when a mistake is named."""

    fits: float = 0.1  # where no measure costs more, no mistake is searched
    unbalanced: float = 0.3  # the same of balance and squeeze
    margin: float = 0.1  # the sum of the measures must be lower by so much
    errors: float = 2.0  # and by so many standard errors of the samples' differences
    blocks: int = 8  # of samples that follow each other, which share errors: so many count as independent
    tie: float = 0.02  # changes whose sums differ by less fit as well
    compared: int = 8  # of the best changes of each kind without the object, so many are compared with it
    most: int = 3  # mistakes that are named of one recording
    all_orders: int = 5  # of so many sensors all orders are tried; of more, exchanges of two


MISTAKES = MistakeOptions()
LARGE, LONGEST_ARM = 50.0, 0.2
"""A largest force that no fingertip bears [N], and a largest torque by the largest force of no tip [m]."""
EXACT = "rest", "outward"
"""Measures that are no mean of samples of the recording."""


class Mistake(NamedTuple):
    """A `Mistake` is what may be wrong, and how the recording is read without it."""

    what: str
    """In words."""
    fix: str
    """The line of the rig that is to be changed, or what the driver is to do."""
    rig: Rig
    read: Change = lambda observation: observation


class Compared:
    """A `Compared` is what a recording costs as it is read without a mistake."""

    def __init__(self, excerpt: Excerpt, mistake: Mistake) -> None:
        """Raises InvalidInput where the recording cannot be read like that."""
        self.mistake = mistake
        self._reading = Reading(excerpt, mistake.rig, mistake.read)
        self.costs = self._reading.costs
        """By measure, the samples' costs; those that are no measure of theirs are NaN."""

    def with_object(self, model: ObjectModel | None) -> "Compared":
        """Returns this, its contacts compared with an object too."""
        if model is not None and "object" not in self.costs:
            self.costs["object"] = self._reading.off_object(model)
        return self

    @property
    def measures(self) -> dict[str, float]:
        """The mean cost of each measure's samples."""
        return {name: _mean(costs) for name, costs in self.costs.items()}

    @property
    def total(self) -> float:
        """Their sum."""
        return sum(self.measures.values())

    @property
    def suspicious(self) -> set[str]:
        """The measures that are not those of a right rig; a weight and links that touch unbalance right ones too."""
        limits = {"balance": MISTAKES.unbalanced, "squeeze": MISTAKES.unbalanced}
        return {name for name, cost in self.measures.items() if cost > limits.get(name, MISTAKES.fits)}

    def gain(self, other: "Compared") -> float:
        """Returns by how much less this costs than another; 0 where that may be by chance."""
        gain, variance = 0.0, 0.0
        for name, costs in self.costs.items():
            theirs = other.costs[name]
            gain += _mean(theirs) - _mean(costs)
            if name not in EXACT and len(costs) == len(theirs):
                blocks = np.array_split(np.nan_to_num(theirs) - np.nan_to_num(costs), MISTAKES.blocks)
                means = [float(block.mean()) for block in blocks if len(block)]
                variance += float(np.var(means)) / max(len(means) - 1, 1)
        return gain if gain > MISTAKES.errors * math.sqrt(variance) else 0.0


class Found(NamedTuple):
    """A `Found` is a mistake that explains a recording better than the rig as it is."""

    before: Compared
    after: Compared
    others: tuple[Mistake, ...]
    """Mistakes that explain it as well."""

    def __str__(self) -> str:
        """Returns the mistake, what to change, and how much better the recording then fits."""
        before, after, mistake = self.before.measures, self.after.measures, self.after.mistake
        names = sorted((n for n in before if before[n] - after[n] > 0.02), key=lambda n: after[n] - before[n])
        numbers = [f"{MEASURES[name]} {before[name]:.2f} -> {after[name]:.2f}" for name in names[:3]]
        text = f"{mistake.what} fits better ({', '.join(numbers)}): {mistake.fix}"
        return text + (f" (or: {'; or: '.join(each.fix for each in self.others)})" if self.others else "")


def find_mistakes(excerpt: Excerpt, model: ObjectModel | None = None) -> list[Found]:
    """Returns the mistakes that explain why a recording contradicts itself, the worst first; none where it does not.

    `model`: the object in the hand, where it is known: contacts and vision's poses are then compared with it.
    """
    found, now = list[Found](), Compared(excerpt, Mistake("", "", excerpt.rig)).with_object(model)
    while len(found) < MISTAKES.most and now.suspicious:
        tried = list[Compared]()
        for kind, explained in KINDS.items():
            if not now.suspicious & explained:
                continue
            of_kind = list[Compared]()
            for mistake in mistakes(excerpt, now.mistake, kind):
                with contextlib.suppress(HandsightError):
                    of_kind.append(Compared(excerpt, mistake))
            of_kind = sorted(of_kind, key=lambda each: each.total)[: MISTAKES.compared]
            tried += [each.with_object(model) for each in of_kind]
            tried.sort(key=lambda each: each.total)
            if tried and not tried[0].suspicious:  # nothing is left to explain
                break
        if not tried or tried[0].gain(now) < MISTAKES.margin:
            break
        best, *others = (each for each in tried if each.total < tried[0].total + MISTAKES.tie)
        found.append(Found(now, best, tuple(each.mistake for each in others[:2])))
        now = best
    return found


def _mean(costs: Array) -> float:
    """Returns the mean of those that are numbers; 0 of none."""
    known = costs[~np.isnan(costs)]
    return float(known.mean()) if len(known) else 0.0


def mistakes(excerpt: Excerpt, now: Mistake, kind: "Kind") -> Iterator[Mistake]:
    """Yields mistakes of a kind that may have been made beside one that was found already."""
    for what, fix, changed, read in kind(now.rig, [now.read(each) for each in excerpt.observations.some()]):
        yield Mistake(what, fix, changed, partial(_both, now.read, read))


def _both(first: Change, second: Change, observation: Observation) -> Observation:
    return second(first(observation))


def _as_is(observation: Observation) -> Observation:
    return observation


Kind = Callable[[Rig, Sequence[Observation]], "Tried"]
Tried = Iterator[tuple[str, str, Rig, Change]]
"""What is wrong, what to change, the rig without that, and what an observation is then."""


def _with(rig: Rig, names: Iterable[str], change: Callable[[Finger], Finger]) -> Rig:
    """Returns a rig with some of its fingers changed."""
    return replace(rig, fingers=dict(rig.fingers) | {name: change(rig.fingers[name]) for name in names})


def _each_and_all(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Returns all fingers together, for what is wrong with one type of sensor, then each."""
    return [tuple(names)] * (len(names) > 1) + [(name,) for name in names]


def _of(names: Sequence[str]) -> str:
    return f"of {names[0]}" if len(names) == 1 else "of all fingers"


def _topics(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Topics of fingers exchanged: wrenches, contacts and the surfaces on tips."""
    tips = {finger.frame for finger in rig.fingers.values()}
    shapes = {name: surface.shape for name, surface in rig.skin.items() if surface.frame in tips}
    for kind, names in (
        ("wrenches", [name for name in rig.fingers if name in rig.topics.wrenches]),
        ("contacts", list(rig.topics.contacts)),
        *(
            ("skin", [n for n, each in shapes.items() if each == shape])
            for shape in sorted(set(shapes.values()))
        ),
    ):
        for order in _orders(names):
            given: dict[str, str] = dict(getattr(rig.topics, kind))
            if kind == "skin":
                given = {n: rig.topics.skin_fields.get(n, topic) for n, topic in given.items()}
            changed = [(a, b) for a, b in zip(names, order, strict=True) if a != b]
            where = "skin.{}.field" if kind == "skin" and rig.topics.skin_fields else f"topics.{kind}.{{}}"
            fix = "set " + ", ".join(f"{where.format(a)}: {given[b]}" for a, b in changed)
            what = f"another order of the topics of {', '.join(a for a, _ in changed)}"
            yield what, fix, rig, partial(_exchanged, kind, dict(changed))


def _orders(names: Sequence[str]) -> Iterator[Sequence[str]]:
    """Yields the other orders of some names, exchanges of two first; of many names, those alone."""
    for i, j in combinations(range(len(names)), 2):
        order = list(names)
        order[i], order[j] = order[j], order[i]
        yield order
    if len(names) <= MISTAKES.all_orders:
        yield from (p for p in permutations(names) if sum(a != b for a, b in zip(names, p, strict=True)) > 2)


def _exchanged(field: str, sources: Mapping[str, str], observation: Observation) -> Observation:
    """Returns an observation in which some entries of a mapping are those of other names."""
    values = dict(getattr(observation, field))
    given = {to: values[source] for to, source in sources.items() if source in values}
    kept = {name: value for name, value in values.items() if name not in sources}
    return replace(observation, **{field: kept | given})


TURNS = [
    np.array(
        [[sign * (axis == column) for column in range(3)] for axis, sign in zip(order, signs, strict=True)],
        float,
    )
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
]
TURNS = [turn for turn in TURNS if np.linalg.det(turn) > 0]
TURNS.sort(key=lambda turn: -np.trace(turn @ np.diag([0.9, 0.95, 1.0])))
TURNS = TURNS[1:]
"""The 23 turns (3, 3) of axes onto axes, least first."""


def _turned(T: Array, R: Array) -> Array:
    """Returns a pose (4, 4) turned by R (3, 3) in its own axes."""
    T = np.array(T)
    T[:3, :3] = T[:3, :3] @ R
    return T


def turn_text(R: Array) -> str:
    """Returns a turn (3, 3) in words, such as "90° about z"."""
    w = se3.rotation_log(R)
    angle = float(np.linalg.norm(w))
    axis = w / angle
    if np.abs(axis).max() > 0.99:
        sign = "-" if axis[np.abs(axis).argmax()] < 0 and angle < 3 else ""
        return f"{math.degrees(angle):.0f}° about {sign}{'xyz'[int(np.abs(axis).argmax())]}"
    return f"{math.degrees(angle):.0f}° about [{', '.join(f'{x:.2g}' for x in axis)}]"


def _sensors(rig: Rig, observations: Sequence[Observation], bias: bool = False) -> Tried:
    """Forces with the other sign, and axes of sensors turned; their biases too where `bias` says so."""

    sensed = [name for name in rig.fingers if any(name in each.wrenches for each in observations)]

    def other(finger: Finger) -> Finger:
        known, sign = finger.calibration, -1 if bias else 1
        reading: Any = "on_tip" if known.reading == "on_sensor" else "on_sensor"
        biases = {"bias_force": sign * known.bias_force, "bias_torque": sign * known.bias_torque}
        return replace(finger, calibration=replace(known, reading=reading, **biases))

    def turned(R: Array, finger: Finger) -> Finger:
        T, known = finger.tip.T_surface_sensor, finger.calibration
        tip = finger.tip.with_sensor(_turned(np.eye(4) if T is None else T, R))
        axes = {"center_of_mass": R.T @ known.center_of_mass}
        if bias:
            axes |= {"bias_force": R.T @ known.bias_force, "bias_torque": R.T @ known.bias_torque}
        return replace(finger, tip=tip, calibration=replace(known, **axes))

    for names in _each_and_all(sensed):
        changed = _with(rig, names, other)
        readings = {name: changed.fingers[name].calibration.reading for name in names}
        fix = "set " + ", ".join(
            f"fingers.{name}.sensor.reading: {reading}" for name, reading in readings.items()
        )
        fix += ", and the negative of each bias" if bias else ""
        yield f"the other sign of the forces {_of(names)}", fix, changed, _as_is
    for names, R in product(_each_and_all(sensed), TURNS):
        changed = _with(rig, names, partial(turned, R))
        finger = changed.fingers[names[0]]
        T = finger.T_frame_surface @ (
            np.eye(4) if finger.tip.T_surface_sensor is None else finger.tip.T_surface_sensor
        )
        fix = f"set fingers.{names[0]}.sensor.pose: {pose_text(T)}"
        fix += ", and turn the others' by as much" * (len(names) > 1) + " and turn its bias" * bias
        yield f"the sensor {_of(names)} turned by {turn_text(R)}", fix, changed, _as_is


def _tips(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Tips that point along another axis, and are on the frame's other side."""

    def pointing(R: Array, side: float, finger: Finger) -> Finger:
        T = _turned(finger.T_frame_surface, R)
        T[:3, 3] *= side
        sensor = finger.tip.T_surface_sensor
        T_frame_sensor = finger.T_frame_surface @ (np.eye(4) if sensor is None else sensor)
        return replace(finger, T_frame_surface=T, tip=finger.tip.with_sensor(se3.inverse(T) @ T_frame_sensor))

    axes = [
        next(turn for turn in TURNS if np.allclose(turn[:, 2], axis))
        for axis in (*-np.eye(3)[[2, 0, 1]], *np.eye(3)[:2])
    ]
    for names, (side, R) in product(
        _each_and_all(list(rig.fingers)),
        [(1.0, axes[0]), (-1.0, np.eye(3)), (-1.0, axes[0]), *((1.0, R) for R in axes[1:])],
    ):
        changed = _with(rig, names, partial(pointing, R, side))
        T = changed.fingers[names[0]].T_frame_surface
        more = ", and so of the others" if len(names) > 1 else ""
        along = "xyz"[int(np.abs(R[:, 2]).argmax())]
        what = f"the tip {_of(names)} pointing along its {'-' if R[:, 2].min() < -0.5 else '+'}{along}"
        what += ", on the other side of its frame" if side < 0 else ""
        yield what, f"set fingers.{names[0]}.surface: {pose_text(T)}{more}", changed, _as_is


def _units(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Forces, torques and joints in other units."""

    def scaled(factors: Array, observation: Observation) -> Observation:
        wrenches = {name: factors * wrench for name, wrench in observation.wrenches.items()}
        return replace(observation, wrenches=wrenches)

    read = np.array([wrench for each in observations for wrench in each.wrenches.values()]).reshape(-1, 6)
    force, torque = (
        np.nan_to_num(np.abs(read[:, part])).max(initial=0.0) for part in (slice(3), slice(3, 6))
    )
    tried = [
        ("torques in N mm", 1.0, 1e-3, torque > LONGEST_ARM * force),
        ("forces in millinewtons", 1e-3, 1.0, force > LARGE),
        ("forces in millinewtons and torques in mN m", 1e-3, 1e-3, force > LARGE),
    ]
    for what, force, torque in (row[:3] for row in tried if row[3]):
        factors = np.repeat([force, torque], 3)
        fix = (
            f"have the driver of {next(iter(rig.topics.wrenches.values()), 'the sensors')} publish N and N m"
        )
        yield what, fix, rig, partial(scaled, factors)

    def in_radians(observation: Observation) -> Observation:
        positions = {name: math.radians(x) for name, x in (observation.joint_positions or {}).items()}
        return replace(observation, joint_positions=positions)

    if (
        max((abs(x) for each in observations for x in (each.joint_positions or {}).values()), default=0.0)
        > 2 * math.pi
    ):
        fix = f"have the driver of {rig.topics.joint_states} publish radians"
        yield "joints in degrees", fix, rig, in_radians


def _joints(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Positions of joints in another order than their names."""
    every = list(observations[0].joint_positions or {}) if observations else []
    names = [name for name in every if name in rig.hand.moving]
    chains, steps = rig.hand.kinematics(dict.fromkeys(rig.hand.moving, 0.0)).chains, list[list[str]]()
    for start, end in zip(chains.starts, chains.starts[1:], strict=False):
        steps.append([chains.joints[k] for k in chains.steps["value"][start:end]])
    orders = {
        "in reverse": every[::-1],
        "in the alphabet's order": sorted(every),
        "in the order of the hand's file": sorted(every, key=[*rig.hand.joint_names, *every].index),
        "shifted by one": [*every[1:], *every[:1]],
        "shifted back by one": [*every[-1:], *every[:-1]],
    }
    exchanges = {
        "each finger's in reverse": dict(
            pair for chain in steps for pair in zip(chain, chain[::-1], strict=True)
        )
    }
    for (a, one), (b, other) in combinations(zip(rig.hand.tips, steps, strict=True), 2):
        if len(one) == len(other):
            pairs = zip((*one, *other), (*other, *one), strict=True)
            exchanges[f"those of {a} and {b} exchanged"] = dict(pairs)
    exchanges |= {f"{a} and {b} exchanged": {a: b, b: a} for a, b in combinations(names, 2)}
    exchanges = {what: dict(zip(every, order, strict=True)) for what, order in orders.items()} | exchanges
    fix = f"give names and positions on {rig.topics.joint_states} the same order"
    for what, sources in exchanges.items():
        if any(name != source for name, source in sources.items()):
            change = partial(_exchanged, "joint_positions", sources)
            yield f"positions of joints {what}", fix, rig, change


def _palms(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Another palm in the world than that of the hand, and gravity the other way."""

    def moved(T_moved: Callable[[Observation], Array], observation: Observation) -> Observation:
        T = observation.T_world_palm
        return observation if T is None else replace(observation, T_world_palm=T @ T_moved(observation))

    def at_link(link: str, observation: Observation) -> Array:
        return se3.inverse(rig.hand.link_poses(observation.joint_positions or {})[link])

    if not any(each.T_world_palm is not None for each in observations):
        return
    yield (
        "gravity the other way",
        f"set world.gravity: {(-rig.gravity).tolist()}",
        replace(rig, gravity=-rig.gravity),
        _as_is,
    )
    named = f"frames.palm ({rig.frames['palm']!r}) and hand.palm ({rig.hand.palm!r})"
    for link in rig.hand.link_poses(observations[0].joint_positions or {}) if rig.world_from == "tf" else ():
        if link != rig.hand.palm:
            fix = f"set hand.palm: {link}, or the frame of {rig.hand.palm} as frames.palm in place of {rig.frames['palm']!r}"
            yield (
                f"the pose on {rig.topics.tf} as that of {link}",
                fix,
                rig,
                partial(moved, partial(at_link, link)),
            )
    for R in TURNS:
        T = se3.compose(R, np.zeros(3))
        fix = f"{named} must be one frame: name another, or publish it turned by as much"
        yield (
            f"the palm on {rig.topics.tf} turned by {turn_text(R)}",
            fix,
            rig,
            partial(moved, lambda _, T=T: T),
        )


def _cameras(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Vision's quaternion as w, x, y, z, and the camera elsewhere."""

    def reordered(observation: Observation) -> Observation:
        if (vision := observation.vision) is None:
            return observation
        T = vision.T_frame_object
        quaternion = se3.quaternion_from_rotation(T[:3, :3])[[1, 2, 3, 0]]
        return replace(
            observation,
            vision=replace(vision, T_frame_object=se3.from_position_quaternion(T[:3, 3], quaternion)),
        )

    if rig.topics.vision is None:
        return
    fix = f"have {rig.topics.vision} publish orientation as x, y, z, w"
    yield "vision's quaternion as w, x, y, z", fix, rig, reordered
    if (camera := rig.camera) is None:
        return
    other: Any = "palm" if camera.on == "world" else "world"
    yield (
        f"a camera on the {other}",
        f"set camera.fixed_to: {other}",
        replace(rig, camera=replace(camera, on=other)),
        _as_is,
    )
    for what, T in (
        ("the camera's pose inverted", se3.inverse(camera.T_mount_camera)),
        *((f"the camera turned by {turn_text(R)}", _turned(camera.T_mount_camera, R)) for R in TURNS),
    ):
        yield (
            what,
            f"set camera.pose: {pose_text(T)}",
            replace(rig, camera=replace(camera, T_mount_camera=T)),
            _as_is,
        )


def _skin(rig: Rig, observations: Sequence[Observation]) -> Tried:
    """Tactile surfaces on tips turned about their middle, along the axes of their links."""

    def turned(R: Array, surface: TactileSurface) -> TactileSurface:
        middle = surface.points.mean(axis=0)
        T = se3.compose(R, middle - R @ middle)
        layout = (
            None
            if surface.layout is None
            else surface.layout._replace(T_frame_grid=T @ surface.layout.T_frame_grid)
        )
        axes = surface.taxels["axes"]
        return replace(
            surface,
            points=se3.apply(T, surface.points),
            normals=surface.normals @ R.T,
            x_axes=axes[:, :, 0] @ R.T,
            layout=layout,
        )

    tips = {finger.frame for finger in rig.fingers.values()}
    for names, R in product(
        _each_and_all([name for name, each in rig.skin.items() if each.frame in tips]), TURNS
    ):
        changed = dict(rig.skin) | {name: turned(R, rig.skin[name]) for name in names}
        fix = f"turn the pose, or the places, of skin.{' and skin.'.join(names)} by {turn_text(R)} along the link's axes"
        yield f"the taxels {_of(names)} turned by {turn_text(R)}", fix, replace(rig, skin=changed), _as_is


BY_LOAD = {"touch", "squeeze", "balance", "gravity", "rest", "object"}
KINDS: dict[Kind, set[str]] = {
    _topics: BY_LOAD,
    _sensors: BY_LOAD,
    partial(_sensors, bias=True): {"rest"},
    _units: {"touch", "squeeze", "balance", "limits", "object"},
    _tips: {"touch", "squeeze", "outward", "object"},
    _cameras: {"vision", "object"},
    _palms: {"gravity", "vision", "object"},
    _joints: {"squeeze", "balance", "gravity", "limits", "object"},
    _skin: BY_LOAD,
}
"""The kinds of mistakes, the likeliest first, and the measures that each can explain."""
