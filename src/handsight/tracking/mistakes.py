"""Which likely mistake in a rig, or in what a driver publishes, explains that a recording contradicts itself.

A recording is read as its rig says, and again as if each mistake had been made. One measure compares the readings: the
mean share of what is read that contradicts the rest, summed over `CHECKS`, each from 0 (right) to 1.
A mistake is named where it lowers the measure by `MARGIN` and makes no check worse. None needs a track, so they say
something where nothing can be tracked yet.
"""

import contextlib
import copy
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PosePrior, correct_pose
from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Finger, MountedCamera, Rig
from handsight.rig.outward import outward
from handsight.rig.save import pose_text
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.skin import NOTHING, SkinContacts, SkinSensors

MARGIN = 0.15  # the measure must be lower by so much: right rigs differ by less from seed to seed
WORSE = 0.1  # what is right makes no check worse by more
LIKELIER = 0.02  # of mistakes whose measures differ by less, the first one is the likelier
INSTANTS = 64  # observations that are read again
VIEWS = 16  # poses of vision that are compared
LARGE = 50  # no fingertip bears such a force [N]
NOT_ON_TIP = "off_cap", "beyond_friction"  # why a load is none of a touch on the tip
UNEXPLAINED = 2 / 3
"""Cost of shear that no weight explains. A third of right taxels' may be such, as the skin beside them bears some."""
LEAST_SHEAR = 0.1  # of all loads: less shear on taxels is their noise
LIFTED = 0.02  # a palm that rose by so much while fingers touched has lifted something [m]
TURN = math.radians(23)  # by which vision's pose turns where nothing does, that no noise explains [rad]
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
LIMIT = 0.3
"""A check above it is one of a wrong rig; below, links that touch too, noise and outliers explain it."""
CHECKS = (
    "readings that no touch on a tip explains",
    "fingers that pull on what they hold",
    "forces that are not in balance",
    "weight in the air that is not along gravity",
    "tips that point into their fingers",
    "vision's pose turning both in the hand and in the world",
    "contacts and vision that do not fit the object",
    "loads of taxels that no weight in the hand explains",
)
POSSIBLE, SQUEEZE, BALANCE, GRAVITY, OUTWARD, TURNS, OBJECT, WEIGHT = CHECKS
Change = Callable[[Observation], Observation]


class Thinned(list[Observation]):
    """Observations at equal steps of their number, at most so many, without their images."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most = most
        self._count = 0
        self._step = 1

    def put(self, observation: Observation) -> None:
        """Adds an observation; where there are too many, every second one goes."""
        if self._count % self._step == 0:
            self.append(replace(observation, color=None, depth=None, mask=None, detections=None))
        self._count += 1
        if len(self) > self._most:
            del self[1::2]
            self._step *= 2

    def changed(self, change: Change) -> "Thinned":
        """Returns these observations after a change of each."""
        other = copy.copy(self)
        other[:] = map(change, self)
        return other


@dataclass(frozen=True, slots=True)
class Mistake:
    """What may be wrong, and how a recording is read without it."""

    what: str
    """In words."""
    fix: str
    """The line of the rig that is to be changed, or what a driver is to do."""
    rig: Rig
    """The rig without the mistake."""
    read: Change = lambda observation: observation
    """What an observation is without the mistake."""
    shear: bool = False
    """Whether it is of the taxels' shear alone: contacts stay where they are, and the loads must say so."""


class Excerpt:
    """Observations spread over a recording, and what its tactile surfaces read at rest."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.observations = Thinned(INSTANTS)
        self.views = Thinned(VIEWS)
        """Observations with a pose of vision."""
        self.skin = NOTHING
        self._sensors = SkinSensors(rig)

    def put(self, observation: Observation, *, touched: bool) -> None:
        """Adds an observation; `touched`: whether the wrench of any fingertip is that of a contact."""
        if not observation.joint_positions:
            return
        if observation.skin:
            self.skin = self._sensors.observed(observation, self.skin, touched=touched)
        self.observations.put(observation)
        if observation.vision is not None:
            self.views.put(observation)

    def without(self, mistake: Mistake) -> "Excerpt":
        """Returns the excerpt as it would be without a mistake."""
        other = copy.copy(self)
        other.rig = mistake.rig
        other.observations = self.observations.changed(mistake.read)
        other.views = self.views.changed(mistake.read)
        known = self.skin.watched
        at_rest = {n: each.baseline.reshape(self.rig.skin[n].shape) for n, each in known.items()}
        changed = mistake.read(Observation(0.0, skin=at_rest)).skin
        watched = {
            n: replace(each, baseline=changed.get(n, at_rest[n]).reshape(each.baseline.shape))
            for n, each in known.items()
        }
        other.skin = replace(self.skin, watched=watched)
        return other


class Reading:
    """What an excerpt says by its rig: the costs of each check."""

    def __init__(self, excerpt: Excerpt) -> None:
        """Compares nothing with an object yet. Raises InvalidInput where the observations cannot be that rig's."""
        self.excerpt = excerpt
        self._rig = excerpt.rig
        self._sensors = FingertipSensors(self._rig)
        self._skin = SkinSensors(self._rig)
        self._at_rest = SkinContacts(watched=excerpt.skin.watched)
        self._costs: dict[str, list[float]] = {name: [] for name in CHECKS}
        self._lowest = math.inf
        self._beside_tips = False
        self._hanging: list[tuple[Array, Array]] = []
        for observation in excerpt.observations:
            self._touched(observation)
        if self._beside_tips:  # the fingers push the object onto a palm, whose force is in no sum over them
            self._hanging.clear()
            for name in (SQUEEZE, BALANCE, GRAVITY):
                self._costs[name].clear()
        if self._rig.skin and not self._costs[POSSIBLE]:
            self._costs[POSSIBLE].append(1.0)  # taxels of which none is ever pressed
        inward = -min(outward(self._rig).values())
        self._costs[OUTWARD].append(max(0.0, inward))
        self._turns()
        self._weight()

    @property
    def measures(self) -> Array:
        """(8,) the mean of each check; NaN where the recording does not have what it compares."""
        means = [float(np.mean(costs)) if costs else math.nan for costs in self._costs.values()]
        return np.array(means)

    def doubtful(self, limit: float = LIMIT) -> str:
        """Returns the checks that are not those of a right rig, with their measures; empty for a right one."""
        checks = zip(CHECKS, self.measures, strict=True)
        return ", ".join(f"{name} {value:.2f}" for name, value in checks if value > limit)

    def gains(self, other: "Reading") -> Array:
        """Returns (8,) how much better each check is than in another reading; 0 where it cannot be compared here."""
        return np.nan_to_num(np.nan_to_num(other.measures) - self.measures)

    def worse(self, other: "Reading") -> bool:
        """Returns whether a check is worse than in another reading; one that that has none of, than in a right one."""
        theirs = other.measures
        most = np.where(np.isnan(theirs), LIMIT, theirs + WORSE)
        return bool((self.measures > most).any())

    def _touch(self, observation: Observation) -> tuple[FingertipContacts, SkinContacts]:
        skin = NOTHING
        if observation.skin:
            skin = self._skin.observed(observation, self._at_rest, touched=True)
        return self._sensors.contacts(observation, None, skin), skin

    def _touched(self, observation: Observation) -> None:
        """Adds the costs of an observation's touches."""
        touch, skin = self._touch(observation)
        pressed = [name for name, (surface, _) in skin.touches.items() if len(surface.patches)]
        wrong = sum(reason in NOT_ON_TIP for reason in touch.reasons.values())
        if not wrong and touch.contacts is None:
            self._lowest = math.inf  # a new grasp
            return
        tips = {finger.frame for finger in self._rig.fingers.values()}
        self._beside_tips |= any(self._rig.skin[name].frame not in tips for name in pressed)
        share = wrong / (wrong + len(touch.fingers))
        zeros = {name: finger.calibration.bias_force for name, finger in self._rig.fingers.items()}
        too_large = any(math.dist(w[:3], zeros[name]) > LARGE for name, w in observation.wrenches.items())
        self._costs[POSSIBLE].append(1.0 if too_large else share)
        if not wrong and touch.contacts is not None and touch.loads is not None and len(touch.fingers) > 1:
            by_taxels = {*touch.fingers} <= {*touch.by_taxels}
            self._forces(observation, touch.contacts, touch.loads, by_taxels=by_taxels)

    def _forces(self, observation: Observation, contacts: Contacts, loads: Array, *, by_taxels: bool) -> None:
        """Adds the costs of forces on the object."""
        pushes = np.nan_to_num(loads[:, 3:4], nan=1.0)
        forces = np.nan_to_num(loads[:, :3]) + pushes * contacts.normals_palm
        arms = contacts.points_palm - contacts.points_palm.mean(axis=0)
        outward = (forces * arms).sum() / np.linalg.norm(forces) / np.linalg.norm(arms)
        self._costs[SQUEEZE].append(float(np.clip(0.5 - outward, 0.0, 1.0)))
        if np.isnan(loads[:, :4]).any():
            return  # sensed without friction, so there is no sum of forces
        total = forces.sum(axis=0)
        size = np.linalg.norm(total)
        self._costs[BALANCE].append(0.5 * float(size / np.linalg.norm(forces, axis=1).sum()))
        T = observation.T_world_palm
        if T is None:
            return
        self._lowest = min(self._lowest, float(T[2, 3]))
        if T[2, 3] > self._lowest + LIFTED:
            gravity = self._rig.gravity
            cosine = T[:3, :3] @ total @ gravity / size / np.linalg.norm(gravity)
            self._costs[GRAVITY].append(0.5 - 0.5 * float(cosine))
            if by_taxels:
                torsions = np.nan_to_num(loads[:, 4:5]) * contacts.normals_palm
                torque = (np.cross(contacts.points_palm, forces) + torsions).sum(axis=0)
                shear = float(np.linalg.norm(np.nan_to_num(loads[:, :3]), axis=1).sum())
                self._hang(T[:3, :3].T @ gravity, total, torque, arms, forces, shear)

    def _hang(
        self, gravity: Array, force: Array, torque: Array, arms: Array, forces: Array, shear: float
    ) -> None:
        """Keeps what an object must weigh, and where, for the loads of an instant; all in the palm's axes.

        The unknowns are its mass and the mass times its middle. Forces are shares of the shear of all tips, torques of
        that times the tips' distance from their middle: what presses from all sides tells nothing of the shear's axes.
        """
        loads = max(shear, LEAST_SHEAR * np.linalg.norm(forces, axis=1).sum())
        arm = np.linalg.norm(arms, axis=1).mean()
        scales = np.repeat([1 / loads, 1 / loads / arm], 3)
        rows = np.zeros((6, 4))
        rows[:3, 0] = gravity
        rows[3:, 1:] = -se3.skew(gravity)
        self._hanging.append((scales[:, None] * rows, scales * np.concatenate([force, torque])))

    def _weight(self) -> None:
        """Adds how much of the loads of taxels no weight in the hand explains, in all orientations of the hand."""
        if not self._hanging:
            return
        rows = np.array([rows for rows, _ in self._hanging])
        loads = np.array([loads for _, loads in self._hanging])
        weight = np.linalg.lstsq(rows.reshape(-1, 4), loads.ravel(), rcond=None)[0]
        if weight[0] < 0:  # which nothing weighs
            weight = np.zeros(4)
        left = (loads - rows @ weight).reshape(-1, 2, 3)
        shares = np.linalg.norm(left, axis=2).mean(axis=1)
        self._costs[WEIGHT] += (UNEXPLAINED * shares).clip(max=1.0).tolist()

    def _turns(self) -> None:
        """Adds how far vision's pose turns both in the palm and in the world: in one of them the object is still."""
        rotations = list[tuple[Array, Array]]()
        for observation in self.excerpt.views:
            T = seen_in_palm(self._rig, observation)
            if T is not None and observation.T_world_palm is not None:
                rotations.append((T[:3, :3], observation.T_world_palm[:3, :3] @ T[:3, :3]))
        for now, then in pairwise(rotations):
            turn = min(np.linalg.norm(se3.rotation_log(b.T @ a)) for a, b in zip(now, then, strict=True))
            self._costs[TURNS].append(min(1.0, float(turn / TURN)) ** 2)

    @property
    def weighs(self) -> bool:
        """Whether taxels have borne something in the air."""
        return bool(self._costs[WEIGHT])

    def compared_as(self, other: "Reading") -> None:
        """Takes the comparison with the object from another reading, whose contacts are at the same places."""
        self._costs[OBJECT] = other._costs[OBJECT]

    def compare(self, model: ObjectModel) -> None:
        """Adds, of some grasps, the share of contacts that do not fit the object; 1 where vision does not."""
        camera = self._rig.camera or MountedCamera()
        noise = np.array([camera.sigma_position, camera.sigma_rotation])
        constant = np.array([camera.sigma_position_constant, camera.sigma_rotation_constant])
        covariance = np.diag(np.repeat(noise**2 + constant**2 + camera.drift[:2], 3))
        for observation in self.excerpt.views or self.excerpt.observations[:: INSTANTS // VIEWS]:
            touch, _ = self._touch(observation)
            if len(touch.fingers) < 3 or touch.contacts is None:
                continue
            T = seen_in_palm(self._rig, observation)
            vision = None if T is None else PosePrior(T, covariance)
            found = correct_pose(model, touch.contacts, vision=vision)
            wrong = any(each.evidence == "vision" for each in found.conflicts) or not found.consistent
            self._costs[OBJECT].append(1.0 if wrong else len(found.outliers) / len(touch.fingers))


def seen_in_palm(rig: Rig, observation: Observation) -> Array | None:
    """Returns (4, 4) vision's pose of the object in the palm; None where it is unknown."""
    vision = observation.vision
    if vision is None:
        return None
    T = vision.T_frame_object
    frame = vision.frame
    if frame == "camera" and rig.camera is not None:
        T = rig.camera.T_mount_camera @ T
        frame = rig.camera.on
    if frame == "world" and observation.T_world_palm is not None:
        T = se3.inverse(observation.T_world_palm) @ T
        frame = "palm"
    return T if frame == "palm" else None


def find_mistakes(excerpt: Excerpt, model: ObjectModel | None = None) -> tuple[list[str], str]:
    """Returns a sentence for each mistake that explains why a recording contradicts itself, at most three, and one
    that says what no mistake explains, empty where nothing is left.

    `model`: the object in the hand, where it is known: contacts and vision's poses are then compared with it.
    """
    sentences = list[str]()
    if not excerpt.observations:
        return sentences, ""
    now = Reading(excerpt)
    if model is not None:
        now.compare(model)
    limit = LIMIT
    while now.doubtful(limit) and len(sentences) < 3:
        found = _explained(now, model)
        if found is None:
            break
        mistake, after = found
        changes = zip(after.gains(now), CHECKS, now.measures, after.measures, strict=True)
        most = sorted(changes, reverse=True)[:2]
        numbers = [f"{name} {old:.2f} -> {new:.2f}" for gain, name, old, new in most if gain > LIKELIER]
        sentences.append(f"{mistake.what} fits better ({', '.join(numbers)}): {mistake.fix}")
        now = after
        limit = LIMIT + WORSE  # what is left may be of the mistake, too: which taxels were taken for faulty
    doubtful = now.doubtful(limit)
    return sentences, f"{doubtful}: no mistake explains it" if doubtful else ""


def _explained(now: Reading, model: ObjectModel | None) -> tuple[Mistake, Reading] | None:
    """Returns the mistake that explains most, and the reading without it; None where none explains anything."""
    best = None
    most = MARGIN
    for mistake in likely_mistakes(now.excerpt):
        with contextlib.suppress(HandsightError):
            reading = Reading(now.excerpt.without(mistake))
            if mistake.shear:
                reading.compared_as(now)
            elif model is not None and not reading.worse(now):
                reading.compare(model)
            gains = reading.gains(now)
            gain = gains.sum()
            unsaid = mistake.shear and now.weighs and gains[CHECKS.index(WEIGHT)] < MARGIN
            if not (unsaid or reading.worse(now)) and gain > most:
                best = mistake, reading
                most = gain + LIKELIER
    return best


def likely_mistakes(excerpt: Excerpt) -> Iterator[Mistake]:
    """Yields the mistakes that people make with rigs and drivers, as far as a recording can show them."""
    rig = excerpt.rig
    down = -rig.gravity
    gravity = Mistake(
        "gravity the other way", f"set world.gravity: {down.tolist()}", replace(rig, gravity=down)
    )
    if down[2] < 0:
        yield gravity
    if any(each.wrenches for each in excerpt.observations):
        yield from _of_wrenches(rig)
    if any(each.skin for each in excerpt.observations):
        yield from _of_taxels(rig)
    if excerpt.views:
        fix = f"have {rig.topics.vision} publish its orientation as x, y, z, w"
        yield Mistake("vision's quaternion as w, x, y, z", fix, rig, _as_wxyz)
        if rig.camera is not None:
            T = rig.camera.T_mount_camera
            poses = {"inverse pose": se3.inverse(T), "body's frame, not the optical one": T @ T_BODY_OPTICAL}
            for what, pose in poses.items():
                other = replace(rig, camera=replace(rig.camera, T_mount_camera=pose))
                yield Mistake(f"the camera in its {what}", f"set camera.pose: {pose_text(pose)}", other)
    yield gravity
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


def _of_wrenches(rig: Rig) -> Iterator[Mistake]:
    """Yields mistakes of force/torque sensors: sign, topics, units, order, and tips along another axis."""
    groups = {"all fingers": list(rig.fingers)} | {name: [name] for name in rig.fingers}
    for of, names in groups.items():
        yield _of_fingers(rig, names, f"the other sign of the forces of {of}", _other_sign)
        yield _of_fingers(rig, names, f"the tip of {of} pointing along its -z", _turned_over)
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
    fixes = list[str]()
    for name in names:
        fingers[name], fix = change(fingers[name])
        fixes.append(f"fingers.{name}.{fix}")
    return Mistake(what, f"set {', '.join(fixes)}", replace(rig, fingers=fingers))


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
OF_TAXELS = "the other sign of the taxels' readings", "the taxels' tables turned by 180°"


def _of_taxels(rig: Rig) -> Iterator[Mistake]:
    """Yields mistakes of tactile surfaces: signs, orders, tables turned, and topics of equal surfaces exchanged."""
    fix = "mend the surfaces' order or scale under `skin`, or the driver"
    tips = {finger.frame: name for name, finger in rig.fingers.items()}
    on_tips = [name for name, surface in rig.skin.items() if surface.frame in tips]
    groups = {"": list(rig.skin)}
    for name in on_tips:
        groups.setdefault(f" of {tips[rig.skin[name].frame]}", []).append(name)
    if len(groups) == 2:  # the only finger with taxels
        groups = {"": list(rig.skin)}
    for of, names in groups.items():
        for what, change in ((OF_TAXELS[0], np.negative), (OF_TAXELS[1], _turned_table)):
            yield Mistake(what + of, fix, rig, _of_surfaces(names, change))
        vectors = [name for name in names if rig.skin[name].components == 3]
        for what, (turn, line) in SHEARS.items() if vectors else ():
            lines = f"set skin.{' and skin.'.join(vectors)}: {line}"
            read = _of_surfaces(vectors, partial(_turned_shear, turn))
            yield Mistake(what + of, lines, rig, read, shear=True)
    vectors = [name for name, surface in rig.skin.items() if surface.components == 3]
    for what, change in (
        ("the taxels' force along the normal before its shear", partial(np.roll, shift=-1, axis=-1)),
        ("the taxels' x of all before y of all", _one_after_the_other),
    ):
        if vectors:
            fix = "have the driver publish x, y and the normal force of each taxel together, in that order"
            yield Mistake(what, fix, rig, _of_surfaces(vectors, change))
    for a, b in combinations(on_tips, 2):
        if rig.skin[a].shape == rig.skin[b].shape:
            fix = f"exchange the topics, or the fields, of skin.{a} and skin.{b}"
            yield Mistake(f"exchanged topics of {a}, {b}", fix, rig, _exchanged("skin", {a: b, b: a}))


def _changed(field: str, change: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> Change:
    """Returns the change of one field of an observation, a mapping by name."""

    def read(observation: Observation) -> Observation:
        fields: dict[str, Any] = {field: change(getattr(observation, field) or {})}
        return replace(observation, **fields)

    return read


def _exchanged(field: str, sources: Mapping[str, str]) -> Change:
    """Returns the change by which some entries of a mapping are those of other names."""

    def exchanged(values: Mapping[str, Any]) -> Mapping[str, Any]:
        names = dict(zip(values, values, strict=True)) | dict(sources)
        return {name: values[source] for name, source in names.items() if source in values}

    return _changed(field, exchanged)


def _each(field: str, change: Callable[[Array], Any]) -> Change:
    """Returns the change by which every value of a mapping is another."""
    return _changed(field, lambda values: {name: change(np.asarray(each)) for name, each in values.items()})


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


def _of_surfaces(names: list[str], change: Callable[[Array], Any]) -> Change:
    """Returns the change of the readings of some surfaces."""

    def changed(values: Mapping[str, Any]) -> Mapping[str, Any]:
        chosen = {name: change(np.asarray(values[name])) for name in names if name in values}
        return dict(values) | chosen

    return _changed("skin", changed)
