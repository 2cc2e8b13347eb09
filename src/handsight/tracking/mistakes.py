"""Which likely mistake in a rig, or in what a driver publishes, explains that a recording contradicts itself.

A recording is read as its rig says, and again as if each mistake had been made; `consistency` measures both. A mistake
is named where it lowers the measure by `MARGIN` and makes no check worse. Mistakes of single fingers are added up.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Finger, Rig
from handsight.rig.save import pose_text
from handsight.tracking.consistency import CHECKS, GRAVITY, OBJECT, TURNS, WEIGHT, Change, Excerpt, Reading

MARGIN = 0.15  # the measure must be lower by so much: right rigs differ by less from seed to seed
UNWEIGHED = 0.35
"""The same where nothing is weighed in the air. Forces of an unfinished rig are not in balance, as other links push
too, and a finger of the other sign lowered it by 0.3; planted mistakes lower it by 0.5 and more."""
LIKELIER = 0.02  # of mistakes whose measures differ by less, the first one is the likelier
MOST = 3  # mistakes of different kinds that are named
G = 9.80665e-3  # a gram-force [N]
UNITS = {
    "forces in gram-force": (G, 1),
    "forces in gram-force, torques in gram-force metres": (G, G),
    "forces in millinewtons, torques in mN m": (1e-3, 1e-3),
    "torques in N mm": (1, 1e-3),
}
"""By mistake, the units of forces [N] and torques [N m]."""
T_BODY_OPTICAL = se3.compose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))
"""A camera's optical frame (z ahead) in its body's frame (x ahead, z up)."""
T_TURNED_OVER = se3.compose(np.diag([1.0, -1, -1]), np.zeros(3))
"""What takes a tip's +z to its -z."""
OTHER_READINGS = "the other sign of the taxels' readings", "scale: -1 times what it is"
TURNED_TABLES = "the taxels' tables turned by 180°", "its taxels in the opposite order"
SHEARS = {
    "the other sign of the taxels' shear": (((-1, 0), (0, -1)), "scale: [-1, -1, 1] times what it is"),
    "the other sign of the taxels' shear along x": (((-1, 0), (0, 1)), "scale: [-1, 1, 1] times what it is"),
    "the other sign of the taxels' shear along y": (((1, 0), (0, -1)), "scale: [1, -1, 1] times what it is"),
    "the taxels' x turned by 90°": (
        ((0, -1), (1, 0)),
        "each taxel's own x (the last three numbers of its row), which is the y that it has now",
    ),
    "the taxels' x turned by -90°": (
        ((0, 1), (-1, 0)),
        "each taxel's own x (the last three numbers of its row), which is the -y that it has now",
    ),
    "the taxels' x and y exchanged": (((0, 1), (1, 0)), "x and y in the other order, by the driver"),
}
"""By mistake, the shear that is meant by that which is read, and what to set under `skin`."""
CALIBRATE = "calibrate the camera, or is this another object?"


@dataclass(frozen=True, slots=True)
class Mistake:
    """What may be wrong, and how a recording is read without it."""

    what: str
    """In words, without the fingers."""
    fix: str
    """The line of the rig that is to be changed, or what a driver is to do."""
    rig: Rig
    """The rig without the mistake."""
    read: Change = lambda observation: observation
    """What an observation is without the mistake."""
    fixes: Mapping[str, str] = field(default_factory=dict)
    """Of a mistake that single fingers may have, the line by finger."""
    shear: bool = False
    """Whether it is of the taxels' shear alone: contacts stay where they are, and the loads must say so."""


@dataclass
class Explanation:
    """A mistake, or the same one of some fingers, that explains what does not fit; `str` is a sentence."""

    what: str
    """The mistake in words, without the fingers."""
    fix: str
    """What is to be changed."""
    fixes: dict[str, str]
    """By finger, the line of the rig that is to be changed; empty for what is no finger's."""
    every: bool
    """Whether all fingers have it."""
    before: Array
    """(8,) the measures of `CHECKS` with the mistake, and without it."""
    after: Array

    def __str__(self) -> str:
        gains = np.nan_to_num(self.before - self.after)
        most = np.argsort(-gains)[:2].tolist()
        changes = [
            f"{CHECKS[k]} {self.before[k]:.2f} -> {self.after[k]:.2f}" for k in most if gains[k] > LIKELIER
        ]
        fingers = "all fingers" if self.every else ", ".join(self.fixes)
        of = f" of {fingers}" if self.fixes else ""
        fix = f"set {', '.join(self.fixes.values())}" if self.fixes else self.fix
        return f"{self.what}{of} fits better ({', '.join(changes)}): {fix}"

    def may_join(self, mistake: Mistake) -> bool:
        """Returns whether a mistake is the same one of other fingers; shear that is turned twice is another one."""
        again = mistake.fixes.keys() & self.fixes.keys()
        return mistake.what == self.what and not (mistake.shear and again)

    def joined(self, mistake: Mistake, after: Reading) -> None:
        """Adds the same mistake of other fingers; one that is made twice is none."""
        for name, line in mistake.fixes.items():
            if self.fixes.pop(name, None) is None:
                self.fixes[name] = line
        fingers = after.excerpt.rig.fingers
        self.fixes = {name: self.fixes[name] for name in fingers if name in self.fixes}
        self.every = len(self.fixes) == len(fingers)
        self.after = after.measures


def find_mistakes(excerpt: Excerpt, model: ObjectModel | None = None) -> tuple[list[Explanation], str]:
    """Returns each mistake that explains why a recording contradicts itself, at most three kinds, and a sentence of
    what no mistake explains, empty where nothing is left.

    `model`: the object in the hand, where it is known: contacts and vision's poses are then compared with it.
    """
    found = list[Explanation]()
    if not excerpt.observations:
        return found, ""
    now = Reading(excerpt)
    if model is not None:
        now.compare(model)
    while now.doubtful:
        mistakes = list(likely_mistakes(now))
        best = None
        if found and found[-1].fixes:
            best = _explained(now, model, [each for each in mistakes if found[-1].may_join(each)])
        if best is not None:
            mistake, now = best
            found[-1].joined(mistake, now)
            continue
        if len(found) == MOST:
            break
        known = [each.what for each in found]
        best = _explained(now, model, [each for each in mistakes if each.what not in known])
        if best is None:
            break
        mistake, after = best
        every = len(mistake.fixes) == len(after.excerpt.rig.fingers)
        fixes = dict(mistake.fixes)
        found.append(Explanation(mistake.what, mistake.fix, fixes, every, now.measures, after.measures))
        now = after
    return found, _unexplained(now)


def _unexplained(now: Reading) -> str:
    doubtful = now.doubtful
    if not doubtful:
        return ""
    checks = ", ".join(f"{name} {value:.2f}" for name, value in doubtful.items())
    of_vision = now.excerpt.views and doubtful.keys() <= {OBJECT, TURNS}
    return f"{checks}: no mistake explains it{f'; {CALIBRATE}' if of_vision else ''}"


def _explained(
    now: Reading, model: ObjectModel | None, mistakes: Iterable[Mistake]
) -> tuple[Mistake, Reading] | None:
    """Returns the mistake that explains most, and the reading without it; None where none explains anything."""
    best = None
    most = MARGIN if now.costs[GRAVITY] else UNWEIGHED
    at_most = np.nan_to_num(now.measures[CHECKS.index(OBJECT)])
    for mistake in mistakes:
        with contextlib.suppress(HandsightError):
            reading = Reading(now.excerpt.changed(mistake.rig, mistake.read))
            if mistake.shear:
                reading.costs[OBJECT] = now.costs[OBJECT]
                weighed = reading.gains(now)[CHECKS.index(WEIGHT)]
                if now.costs[WEIGHT] and weighed < MARGIN:
                    continue
            elif model is not None:
                if reading.worse(now) or reading.gains(now).sum() + at_most <= most:
                    continue
                reading.compare(model)
            gain = reading.gains(now).sum()
            if gain > most and not reading.worse(now):
                best = mistake, reading
                most = gain + LIKELIER
    return best


def likely_mistakes(now: Reading) -> Iterator[Mistake]:
    """Yields the mistakes that people make with rigs and drivers, as far as a recording can show them."""
    excerpt = now.excerpt
    rig = excerpt.rig
    fingers = list(rig.fingers)
    groups = [fingers, *([name] for name in fingers)]
    if 1 < len(now.suspects) < len(fingers):
        groups.append(now.suspects)
    down = -rig.gravity
    if down[2] < 0:  # a world's z is up
        fix = f"set world.gravity: {down.tolist()}"
        yield Mistake("gravity the other way", fix, replace(rig, gravity=down))
    if any(each.wrenches for each in excerpt.observations):
        yield from _of_wrenches(rig, groups)
    if any(each.skin for each in excerpt.observations):
        yield from _of_taxels(rig, groups)
    if excerpt.views:
        fix = f"have {rig.topics.vision} publish its orientation as x, y, z, w"
        yield Mistake("vision's quaternion as w, x, y, z", fix, rig, _as_wxyz)
        if rig.camera is not None:
            T = rig.camera.T_mount_camera
            poses = {"inverse pose": se3.inverse(T), "body's frame, not the optical one": T @ T_BODY_OPTICAL}
            for what, pose in poses.items():
                other = replace(rig, camera=replace(rig.camera, T_mount_camera=pose))
                yield Mistake(f"the camera in its {what}", f"set camera.pose: {pose_text(pose)}", other)
    names = list(excerpt.observations[0].joint_positions or {})
    orders = {
        "in reverse": names[::-1],
        "in the alphabet's order": sorted(names),
        "in the order of the hand's file": sorted(names, key=[*rig.hand.joint_names, *names].index),
    }
    fix = f"give names and positions on {rig.topics.joint_states} one order"
    for what, order in orders.items():
        read = _exchanged("joint_positions", dict(zip(order, names, strict=True)))
        yield Mistake(f"positions of joints {what}", fix, rig, read)
    fix = f"have the driver of {rig.topics.joint_states} publish radians"
    yield Mistake("joints in degrees", fix, rig, _each("joint_positions", np.deg2rad))


def _of_wrenches(rig: Rig, groups: list[list[str]]) -> Iterator[Mistake]:
    """Yields mistakes of force/torque sensors: sign, topics, units, order, and tips along another axis."""
    for group in groups:
        yield _of_fingers(rig, group, "the other sign of the forces", _other_sign)
        yield _of_fingers(rig, group, "the other direction of the tip", _turned_over)
    topics = rig.topics.wrenches
    for a, b in combinations(topics, 2):
        fix = f"set topics.wrenches.{a}: {topics[b]}, topics.wrenches.{b}: {topics[a]}"
        yield Mistake(f"exchanged topics of {a}, {b}", fix, rig, _exchanged("wrenches", {a: b, b: a}))
    for what, units in UNITS.items():
        read = _each("wrenches", partial(np.multiply, np.repeat(units, 3)))
        yield Mistake(what, "have the sensors' driver publish N and N m", rig, read)
    fix = "have the sensors' driver publish the force before the torque"
    yield Mistake("forces behind the torques", fix, rig, _each("wrenches", partial(np.roll, shift=3)))


def _of_fingers(
    rig: Rig, names: list[str], what: str, change: Callable[[Finger], tuple[Finger, str]]
) -> Mistake:
    """Returns the mistake that some fingers are others."""
    fingers = dict(rig.fingers)
    fixes = dict[str, str]()
    for name in names:
        fingers[name], line = change(fingers[name])
        fixes[name] = f"fingers.{name}.{line}"
    return Mistake(what, "", replace(rig, fingers=fingers), fixes=fixes)


def _other_sign(finger: Finger) -> tuple[Finger, str]:
    """Returns a finger whose sensor reads forces of the other sign, and the line of the rig that says so."""
    known = finger.calibration
    other = replace(known, reading="on_tip" if known.reading == "on_sensor" else "on_sensor")
    return replace(finger, calibration=other), f"sensor.reading: {other.reading}"


def _turned_over(finger: Finger) -> tuple[Finger, str]:
    """Returns a finger whose tip points the other way, and its line in the rig; its sensor stays where it is."""
    T_sensor = np.eye(4) if finger.tip.T_surface_sensor is None else finger.tip.T_surface_sensor
    tip = finger.tip.with_sensor(T_TURNED_OVER @ T_sensor)
    T = finger.T_frame_surface @ T_TURNED_OVER
    return replace(finger, T_frame_surface=T, tip=tip), f"surface: {pose_text(T)}"


def _of_taxels(rig: Rig, groups: list[list[str]]) -> Iterator[Mistake]:
    """Yields mistakes of tactile surfaces: signs, orders, tables turned, and topics of equal surfaces exchanged."""
    surfaces = {
        finger: [name for name, surface in rig.skin.items() if surface.frame == of.frame]
        for finger, of in rig.fingers.items()
    }
    on_tips = [name for names in surfaces.values() for name in names]
    vectors = [name for name, surface in rig.skin.items() if surface.components == 3]
    for group in groups:
        of_group = {finger: surfaces[finger] for finger in group if surfaces[finger]}
        names = [name for each in of_group.values() for name in each]
        if len(group) == len(groups[0]):
            names = list(rig.skin)
        elif not names:
            continue
        yield _of_surfaces(rig, of_group, names, *OTHER_READINGS, np.negative)
        yield _of_surfaces(rig, of_group, names, *TURNED_TABLES, _turned_table)
        for what, (turn, line) in SHEARS.items() if vectors else ():
            turned = partial(_turned_shear, turn)
            chosen = [name for name in names if name in vectors]
            yield replace(_of_surfaces(rig, of_group, chosen, what, line, turned), shear=True)
    for what, change in (
        ("the taxels' force along the normal before its shear", partial(np.roll, shift=-1, axis=-1)),
        ("the taxels' x of all before y of all", _one_after_the_other),
    ):
        if vectors:
            fix = "have the driver publish x, y and the normal force of each taxel together, in that order"
            yield Mistake(what, fix, rig, _of_names(vectors, change))
    for a, b in combinations(on_tips, 2):
        if rig.skin[a].shape == rig.skin[b].shape:
            fix = f"exchange the topics, or the fields, of skin.{a} and skin.{b}"
            yield Mistake(f"exchanged topics of {a}, {b}", fix, rig, _exchanged("skin", {a: b, b: a}))


def _of_surfaces(
    rig: Rig,
    group: Mapping[str, list[str]],
    names: list[str],
    what: str,
    line: str,
    change: Callable[[Array], Any],
) -> Mistake:
    """Returns the mistake of some surfaces, which are those of a group of fingers, or all."""
    fixes = {finger: f"skin.{' and skin.'.join(of)}: {line}" for finger, of in group.items()}
    fix = f"set skin.{' and skin.'.join(names)}: {line}"
    return Mistake(what, fix, rig, _of_names(names, change), fixes)


def _changed(name: str, change: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> Change:
    """Returns the change of one field of an observation, a mapping by name."""

    def read(observation: Observation) -> Observation:
        fields: dict[str, Any] = {name: change(getattr(observation, name) or {})}
        return replace(observation, **fields)

    return read


def _exchanged(name: str, sources: Mapping[str, str]) -> Change:
    """Returns the change by which some entries of a mapping are those of other names."""

    def exchanged(values: Mapping[str, Any]) -> Mapping[str, Any]:
        names = dict(zip(values, values, strict=True)) | dict(sources)
        return {name: values[source] for name, source in names.items() if source in values}

    return _changed(name, exchanged)


def _each(name: str, change: Callable[[Array], Any]) -> Change:
    """Returns the change by which every value of a mapping is another."""
    return _changed(name, lambda values: {name: change(np.asarray(each)) for name, each in values.items()})


def _of_names(names: list[str], change: Callable[[Array], Any]) -> Change:
    """Returns the change of the readings of some surfaces."""

    def changed(values: Mapping[str, Any]) -> Mapping[str, Any]:
        chosen = {name: change(np.asarray(values[name])) for name in names if name in values}
        return dict(values) | chosen

    return _changed("skin", changed)


def _as_wxyz(observation: Observation) -> Observation:
    """Returns an observation whose vision was read as x, y, z, w, and was w, x, y, z."""
    vision = observation.vision
    if vision is None:
        return observation
    T = vision.T_frame_object
    quaternion = se3.quaternion_from_rotation(T[:3, :3])[[1, 2, 3, 0]]
    T = se3.from_position_quaternion(T[:3, 3], quaternion)
    return replace(observation, vision=replace(vision, T_frame_object=T))


def _turned_table(readings: Array) -> Array:
    """Returns readings in the opposite order of the taxels, each with its components as they are."""
    components = readings.shape[-1] if readings.ndim > 1 and readings.shape[-1] == 3 else 1
    return readings.reshape(-1, components)[::-1].reshape(readings.shape)


def _turned_shear(turn: Any, readings: Array) -> Array:
    """Returns readings of three components whose shear is turned, or mirrored."""
    shear = readings[..., :2] @ np.transpose(turn)
    return np.concatenate([shear, readings[..., 2:]], axis=-1)


def _one_after_the_other(readings: Array) -> Array:
    """Returns readings of three components that were published as all x, all y and all normal forces."""
    return np.moveaxis(readings.reshape(3, -1), 0, 1).reshape(readings.shape)
