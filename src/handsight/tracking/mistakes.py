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
from itertools import combinations, pairwise, permutations, product
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.rig.save import pose_text
from handsight.tracking.consistency import MEASURES, Change, Excerpt, Reading


class MistakeOptions(NamedTuple):
    """`MistakeOptions` say when a mistake is named."""

    fits: float = 0.1  # where no measure costs more, no mistake is searched
    noisy: float = 0.3  # the same of the measures that are larger in right recordings too
    balance: float = 0.25  # share of the balance in the sum
    margin: float = 0.15  # the sum of the measures must be lower by so much
    errors: float = 2.0  # and by so many standard errors of the samples' differences
    blocks: int = 8  # of samples that follow each other, which share errors: so many count as independent
    tie: float = 0.02  # changes whose sums differ by less fit as well
    coarse: int = 3  # a mistake is tried on one of so many instants first
    compared: int = 12  # so many of each kind, the best, are then tried on all, and compared with the object
    similar: float = 0.05  # of sums that differ by less, the likelier mistakes are compared
    most: int = 3  # mistakes that are named of one recording
    all_orders: int = 5  # of so many sensors all orders are tried; of more, exchanges of two


MISTAKES = MistakeOptions()
LARGE, LONGEST_ARM = 50.0, 0.2
"""A largest force that no fingertip bears [N], and a largest torque by the largest force of no tip [m]."""
NOISY = "balance", "squeeze", "object"
"""Measures that a weight, links that touch as well, and outliers among contacts raise."""
EXACT = "rest", "outward"
"""Measures that are no mean of samples of the recording."""


class Mistake(NamedTuple):
    """A `Mistake` is what may be wrong, and how the recording is read without it."""

    what: str
    """In words."""
    fix: str
    """The line of the rig that is to be changed, or what the driver is to do."""
    rig: Rig
    read: Change
    """What its observations are then."""


class Compared:
    """A `Compared` is what a recording costs as it is read without a mistake."""

    def __init__(self, excerpt: Excerpt, mistake: Mistake, step: int = 1) -> None:
        """Takes every `step`-th instant. Raises InvalidInput where the recording cannot be read like that."""
        self.mistake = mistake
        self._reading = Reading(excerpt, mistake.rig, mistake.read, step)
        self.costs = self._reading.costs
        """By measure, the samples' costs; those that are no measure of theirs are NaN."""

    def with_object(self, model: ObjectModel | None) -> "Compared":
        """Returns this, its contacts compared with an object too."""
        if model is not None and "object" not in self.costs:
            self.costs["object"] = self._reading.off_object(model)
        return self

    @property
    def measures(self) -> dict[str, float]:
        """The mean cost of each measure's samples, 0 of none."""
        known = {name: costs[~np.isnan(costs)] for name, costs in self.costs.items()}
        return {name: float(costs.mean()) if len(costs) else 0.0 for name, costs in known.items()}

    @property
    def total(self) -> float:
        """Their sum; the balance has a small share, as links without sensors may bear a part of the forces."""
        return sum(self.measures.values()) - (1 - MISTAKES.balance) * self.measures["balance"]

    @property
    def suspicious(self) -> set[str]:
        """The measures that are not those of a right rig."""
        limits = dict.fromkeys(NOISY, MISTAKES.noisy)
        return {name for name, cost in self.measures.items() if cost > limits.get(name, MISTAKES.fits)}

    def gain(self, other: "Compared") -> float:
        """Returns by how much less this costs than another; 0 where that may be by chance."""
        variance, gain = 0.0, other.total - self.total
        if any(cost > other.measures[name] + MISTAKES.fits for name, cost in self.measures.items()):
            return 0.0  # what is right makes nothing worse
        for name, costs in self.costs.items():
            theirs = other.costs[name]
            if name not in EXACT and len(costs) == len(theirs) > 0:
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
    if not excerpt.observations.kept:
        return []
    found, now = list[Found](), Compared(excerpt, Mistake("", "", excerpt.rig, _as_is)).with_object(model)
    while len(found) < MISTAKES.most and now.suspicious:
        tried = list[Compared]()
        for kind, explained in KINDS.items():
            if not now.suspicious & explained:
                continue
            of_kind = list[Compared]()
            observations = [now.mistake.read(each) for each in excerpt.observations.some()]
            for each in kind(now.mistake.rig, observations):
                mistake = each._replace(read=partial(_then, now.mistake.read, each.read))
                with contextlib.suppress(HandsightError):
                    of_kind.append(Compared(excerpt, mistake, MISTAKES.coarse))
            ranks = [round(each.total / MISTAKES.similar) for each in of_kind]
            best = sorted(sorted(range(len(ranks)), key=ranks.__getitem__)[: MISTAKES.compared])
            compared = [Compared(excerpt, of_kind[k].mistake) for k in best]
            # The object only adds to what a reading costs: it is compared where the rest alone gains enough.
            compared = [each for each in compared if each.gain(now) >= MISTAKES.margin]
            tried += [each for each in compared if each.with_object(model).gain(now) >= MISTAKES.margin]
            if any(not each.suspicious for each in tried):  # nothing is left to explain
                break
        least = min((each.total for each in tried), default=math.inf)
        tied = [each for each in tried if each.total < least + MISTAKES.tie]
        if not tied:
            break
        likeliest, others = tied[0], tuple(each.mistake for each in tied[1:3])
        found.append(Found(now, likeliest, others))
        now = likeliest
    return found


def _then(first: Change, second: Change, observation: Observation) -> Observation:
    return second(first(observation))


def _as_is(observation: Observation) -> Observation:
    return observation


def _topics(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Topics of fingers exchanged: of wrenches, contacts, and surfaces of one shape on tips."""
    tips = {finger.frame for finger in rig.fingers.values()}
    groups = [("wrenches", list(rig.topics.wrenches)), ("contacts", list(rig.topics.contacts))]
    on_tips = [name for name, surface in rig.skin.items() if surface.frame in tips]
    for shape in {rig.skin[name].shape for name in on_tips}:
        groups.append(("skin", [name for name in on_tips if rig.skin[name].shape == shape]))
    for kind, names in groups:
        topics: Mapping[str, str] = getattr(rig.topics, kind)
        paths = rig.topics.skin_fields if kind == "skin" else {}
        orders: Iterable[Sequence[str]] = permutations(names)
        if len(names) > MISTAKES.all_orders:
            orders = [[{a: b, b: a}.get(n, n) for n in names] for a, b in combinations(names, 2)]
        for order in sorted(orders, key=lambda order: sum(map(str.__ne__, order, names))):
            if changed := {a: b for a, b in zip(names, order, strict=True) if a != b}:
                fixes = [
                    f"skin.{a}.field: {paths[b]}" if b in paths else f"topics.{kind}.{a}: {topics[b]}"
                    for a, b in changed.items()
                ]
                what = f"another order of the topics of {', '.join(changed)}"
                yield Mistake(what, f"set {', '.join(fixes)}", rig, partial(_exchanged, kind, changed))


def _exchanged(field: str, sources: Mapping[str, str], observation: Observation) -> Observation:
    """Returns an observation in which some entries of a mapping are those of other names."""
    values = dict(getattr(observation, field))
    given = {to: values[source] for to, source in sources.items() if source in values}
    changed: Any = {field: {n: v for n, v in values.items() if n not in sources} | given}
    return replace(observation, **changed)


def _turns() -> Iterator[tuple[str, Array]]:
    """Yields the 23 turns (3, 3) of axes onto axes, with their names, those about one axis first."""
    axes = product(permutations(range(3)), product((1, -1), repeat=3))
    turns = [np.eye(3)[list(order)] * signs for order, signs in axes]
    for R in sorted((R for R in turns if np.linalg.det(R) > 0), key=lambda R: -np.abs(np.diag(R)).max())[1:]:
        w = se3.rotation_log(R)
        axis = w / np.linalg.norm(w)
        name = "[" + ", ".join(f"{x:.2g}" for x in axis) + "]"
        if np.abs(axis).max() > 0.99:
            name = ("-" if axis.sum() < 0 else "") + "xyz"[int(np.abs(axis).argmax())]
        yield f"{math.degrees(np.linalg.norm(w)):.0f}° about {name}", R


TURNS = tuple(_turns())


def _turned(T: Array, R: Array) -> Array:
    """Returns a pose (4, 4) turned by R (3, 3) in its own axes."""
    return np.asarray(T @ se3.compose(R, np.zeros(3)))


def _linear(matrix: Array, offsets: Mapping[str, Array], observation: Observation) -> Observation:
    """Returns an observation whose wrenches are multiplied by a matrix (6, 6), each about its offset (6,)."""
    given = observation.wrenches
    new = {name: b + matrix @ (given[name] - b) for name, b in offsets.items() if name in given}
    return replace(observation, wrenches={**given, **new})


def _each_and_all(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Returns all fingers together, for what is wrong with one type of sensor, then each."""
    every = tuple(names)
    return [every] * (len(every) > 1) + [(name,) for name in every]


def _sensors(rig: Rig, observations: Sequence[Observation], bias: bool = False) -> Iterator[Mistake]:
    """Forces with the other sign, and sensors turned; `bias`: their declared biases are along the right axes."""
    sensed = [name for name in rig.fingers if any(name in each.wrenches for each in observations)]
    for names, (turn, R) in product(_each_and_all(sensed), [("", -np.eye(3)), *TURNS]):
        offsets, fixes = dict[str, Array](), list[str]()
        for name in names:
            finger, known = rig.fingers[name], rig.fingers[name].calibration
            offsets[name] = np.zeros(6) if bias else np.concatenate([known.bias_force, known.bias_torque])
            T = finger.tip.T_surface_sensor
            T_frame_sensor = finger.T_frame_surface @ (np.eye(4) if T is None else T)
            other = "on_tip" if known.reading == "on_sensor" else "on_sensor"
            key = f"pose: {pose_text(_turned(T_frame_sensor, R))}" if turn else f"reading: {other}"
            fixes.append(f"fingers.{name}.sensor.{key}")
        of = f"of {names[0]}" if len(names) == 1 else "of all fingers"
        what = f"the sensor {of} turned by {turn}" if turn else f"the other sign of the forces {of}"
        fix = f"set {', '.join(fixes)}" + ", and its bias along its axes now" * bias
        yield Mistake(what, fix, rig, partial(_linear, np.kron(np.eye(2), R), offsets))


def _units(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Forces, torques and joints in other units, where they are too large for the usual ones."""
    read = np.array([wrench for each in observations for wrench in each.wrenches.values()]).reshape(-1, 6)
    read = np.nan_to_num(np.abs(read))
    force, torque = (float(part.max(initial=0.0)) for part in (read[:, :3], read[:, 3:]))
    for what, factors, possible in (
        ("torques in N mm", (1.0, 1e-3), torque > LONGEST_ARM * force),
        ("forces in millinewtons", (1e-3, 1.0), force > LARGE),
        ("forces in millinewtons, torques in mN m", (1e-3, 1e-3), force > LARGE),
    ):
        if possible:
            change = partial(_linear, np.diag(np.repeat(factors, 3)), dict.fromkeys(rig.fingers, np.zeros(6)))
            yield Mistake(what, "have the sensors' driver publish N and N m", rig, change)
    angles = (abs(x) for each in observations for x in (each.joint_positions or {}).values())
    if max(angles, default=0.0) > 2 * math.pi:
        fix = f"have the driver of {rig.topics.joint_states} publish radians"
        yield Mistake("joints in degrees", fix, rig, _in_radians)


def _in_radians(observation: Observation) -> Observation:
    positions = {name: math.radians(x) for name, x in (observation.joint_positions or {}).items()}
    return replace(observation, joint_positions=positions)


def _tips(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Tips that point along another axis of theirs."""
    pads = {surface.frame for surface in rig.skin.values()}  # whose places do not depend on the tip
    tips = [name for name, finger in rig.fingers.items() if finger.frame not in pads]
    for names, axis in product(_each_and_all(tips) if tips else (), ("-z", "x", "-x", "y", "-y")):
        z = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
        R = next(R for _, R in TURNS if np.array_equal(R[:, 2], z))
        fixes, fingers = list[str](), dict(rig.fingers)
        for name in names:
            finger, T = fingers[name], _turned(fingers[name].T_frame_surface, R)
            sensor = np.eye(4) if finger.tip.T_surface_sensor is None else finger.tip.T_surface_sensor
            tip = finger.tip.with_sensor(se3.inverse(T) @ finger.T_frame_surface @ sensor)
            fingers[name] = replace(finger, T_frame_surface=T, tip=tip)
            fixes.append(f"fingers.{name}.surface: {pose_text(T)}")
        what = f"the tip of {names[0] if len(names) == 1 else 'each finger'} pointing along its {axis}"
        yield Mistake(what, f"set {', '.join(fixes)}", replace(rig, fingers=fingers), _as_is)


def _cameras(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Vision's quaternion as w, x, y, z, and a camera on the other mount."""
    fix = f"have {rig.topics.vision} publish its orientation as x, y, z, w"
    yield Mistake("vision's quaternion as w, x, y, z", fix, rig, _as_wxyz)
    if (camera := rig.camera) is not None:
        other = replace(camera, on="palm" if camera.on == "world" else "world")
        fix = f"set camera.fixed_to: {other.on}"
        yield Mistake(f"a camera on the {other.on}", fix, replace(rig, camera=other), _as_is)


def _camera_poses(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """A camera whose pose is inverted, or that of another of its frames, such as the body's in place of the optical."""
    if (camera := rig.camera) is None:
        return
    T = camera.T_mount_camera
    turned = ((f"turned by {turn}", _turned(T, R)) for turn, R in TURNS)
    for what, pose in (("in its inverse pose", se3.inverse(T)), *turned):
        other = replace(rig, camera=replace(camera, T_mount_camera=pose))
        yield Mistake(f"the camera {what}", f"set camera.pose: {pose_text(pose)}", other, _as_is)


def _as_wxyz(observation: Observation) -> Observation:
    """Returns an observation whose vision was read as x, y, z, w, and was w, x, y, z."""
    if (vision := observation.vision) is None:
        return observation
    T = vision.T_frame_object
    quaternion = se3.quaternion_from_rotation(T[:3, :3])[[1, 2, 3, 0]]
    T = se3.from_position_quaternion(T[:3, 3], quaternion)
    return replace(observation, vision=replace(vision, T_frame_object=T))


def _palms(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Gravity the other way, and a palm in the world that is another link, or turned."""

    def moved(T_palm_true: Array, observation: Observation) -> Observation:
        T = observation.T_world_palm
        return observation if T is None else replace(observation, T_world_palm=T @ T_palm_true)

    def from_link(link: str, observation: Observation) -> Observation:
        if observation.T_world_palm is None:
            return observation
        return moved(se3.inverse(rig.hand.link_poses(observation.joint_positions or {})[link]), observation)

    fix = f"set world.gravity: {(-rig.gravity).tolist()}"
    yield Mistake("gravity the other way", fix, replace(rig, gravity=-rig.gravity), _as_is)
    for link in rig.hand.link_poses(observations[0].joint_positions or {}) if rig.world_from == "tf" else ():
        if link != rig.hand.palm:
            fix = f"set hand.palm: {link}, or as frames.palm the frame of {rig.hand.palm}"
            what = f"{rig.frames['palm']!r} on {rig.topics.tf} as {link}"
            yield Mistake(what, fix, rig, partial(from_link, link))
    for turn, R in TURNS:
        fix = f"frames.palm ({rig.frames['palm']!r}) must be the frame of hand.palm ({rig.hand.palm!r})"
        change = partial(moved, se3.compose(R, np.zeros(3)))
        yield Mistake(f"the palm in the world turned by {turn}", fix, rig, change)


def _joints(rig: Rig, observations: Sequence[Observation]) -> Iterator[Mistake]:
    """Positions of joints in another order than their names."""
    names, chains = list(observations[0].joint_positions or {}), rig.hand.chains
    fingers = [chains.steps["value"][start:end] for start, end in pairwise(chains.starts)]
    orders = {
        "in reverse": names[::-1],
        "in the alphabet's order": sorted(names),
        "in the order of the hand's file": sorted(names, key=[*rig.hand.joint_names, *names].index),
        "shifted by one": [*names[1:], *names[:1]],
        "shifted back by one": [*names[-1:], *names[:-1]],
    }
    sources = {what: dict(zip(names, order, strict=True)) for what, order in orders.items()}
    for (a, one), (b, other) in combinations(zip(rig.hand.tips, fingers, strict=True), 2):
        if len(one) == len(other):
            pairs = [(chains.joints[i], chains.joints[k]) for i, k in zip(one, other, strict=True)]
            sources[f"of {a} and {b} exchanged"] = dict([*pairs, *((k, i) for i, k in pairs)])
    sources |= {f"{a} and {b} exchanged": {a: b, b: a} for a, b in combinations(chains.joints, 2)}
    fix = f"give names and positions on {rig.topics.joint_states} one order"
    for what, source in sources.items():
        yield Mistake(f"positions of joints {what}", fix, rig, partial(_exchanged, "joint_positions", source))


BY_LOAD = {"touch", "squeeze", "balance", "gravity", "rest", "object"}
KINDS: dict[Callable[[Rig, Sequence[Observation]], Iterator[Mistake]], set[str]] = {
    _topics: BY_LOAD,
    _sensors: BY_LOAD,
    partial(_sensors, bias=True): {"rest"},
    _units: {"touch", "squeeze", "balance", "limits", "object"},
    _tips: {"touch", "squeeze", "outward", "object"},
    _cameras: {"vision", "object"},
    # Without the object, turns about an axis of the palm's motion cannot be told apart.
    _camera_poses: {"object"},
    _palms: {"gravity", "vision", "object"},
    _joints: {"squeeze", "balance", "gravity", "limits", "object"},
}
"""The kinds of mistakes, the likeliest first, and the measures that each can explain."""
