"""How consistent a recording is, as its rig reads it.

One measure: the mean share of what is read that contradicts the rest, summed over `CHECKS`, each from 0 (right) to 1.
None needs a track, so they say something where nothing can be tracked yet.
"""

import copy
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts, SkinTouch
from handsight.contact.kernels.taxels import TAXELS
from handsight.correction import PosePrior, correct_pose
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import MountedCamera, Rig
from handsight.rig.outward import outward
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.skin import NOTHING, SURE_THRESHOLDS, SkinContacts, SkinSensors

INSTANTS = 64  # observations that are read again
VIEWS = 16  # poses of vision that are compared
LARGE = 50  # no fingertip bears such a force [N]
NOT_ON_TIP = "off_cap", "beyond_friction"  # why a load is none of a touch on the tip
UNEXPLAINED = 2 / 3
"""Cost of shear that no weight explains. A third of right taxels' may be such, as the skin beside them bears some."""
LEAST_SHEAR = 0.1  # of all loads: less shear on taxels is their noise
LIFTED = 0.02  # a palm that rose by so much while fingers touched has lifted something [m]
TURN = math.radians(23)  # by which vision's pose turns where nothing does, that no noise explains [rad]
FAR = 3.0
"""Sigmas that vision's pose may be away from the contacts; at two more it surely contradicts them."""
LIMIT = 0.3
"""A check above it is one of a wrong rig; below, links that touch too, noise and outliers explain it."""
WORSE = 0.1  # what is right makes no check worse by more
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
        """Adds an observation; `touched`: whether the wrench of any fingertip is that of a contact.

        The first readings of a surface are those at rest: of a sensor of the other sign, later ones never say so.
        """
        if not observation.joint_positions:
            return
        known = self.skin.watched
        if any(n not in known or known[n].count < TAXELS.min_rest for n in observation.skin):
            self.skin = self._sensors.observed(observation, self.skin, touched=touched)
        self.observations.put(observation)
        if observation.vision is not None:
            self.views.put(observation)

    def changed(self, rig: Rig, read: Change) -> "Excerpt":
        """Returns the excerpt as another rig has it, of observations after a change of each."""
        other = copy.copy(self)
        other.rig = rig
        other.observations = self.observations.changed(read)
        other.views = self.views.changed(read)
        known = self.skin.watched
        at_rest = {n: each.baseline.reshape(self.rig.skin[n].shape) for n, each in known.items()}
        changed = read(Observation(0.0, skin=at_rest)).skin
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
        self.costs: dict[str, list[float]] = {name: [] for name in CHECKS}
        """By check, the cost of each instant, from 0 to 1."""
        self._rig = excerpt.rig
        self._tips = FingertipSensors(self._rig)
        self._skin = SkinSensors(self._rig)
        self._at_rest = SkinContacts(watched=excerpt.skin.watched)
        by_frame = {finger.frame: name for name, finger in self._rig.fingers.items()}
        self._finger_of = {name: by_frame.get(surface.frame) for name, surface in self._rig.skin.items()}
        self._loaded = Counter[str | None]()
        self._wrong = Counter[str | None]()
        self._lowest = math.inf
        self._hanging: list[tuple[Array, Array]] = []
        beside_tips = False
        for observation in excerpt.observations:
            beside_tips |= self._touched(observation)
        if beside_tips:  # the fingers push the object onto a palm, whose force is in no sum over them
            self._hanging.clear()
            for name in (SQUEEZE, BALANCE, GRAVITY):
                self.costs[name].clear()
        if self._rig.skin and not self.costs[POSSIBLE]:
            self.costs[POSSIBLE].append(1.0)  # taxels of which none is ever pressed
        inward = -min(outward(self._rig).values())
        self.costs[OUTWARD].append(max(0.0, inward))
        self._turns()
        self._weigh()

    @property
    def measures(self) -> Array:
        """(8,) the mean of each check; NaN where the recording does not have what it compares."""
        means = [float(np.mean(costs)) if costs else math.nan for costs in self.costs.values()]
        return np.array(means)

    @property
    def suspects(self) -> list[str]:
        """The fingers of which most loads are none of a touch on a tip."""
        return [name for name in self._rig.fingers if 2 * self._wrong[name] > self._loaded[name]]

    @property
    def doubtful(self) -> dict[str, float]:
        """The checks that are not those of a right rig, with their measures; empty for a right one."""
        checks = zip(CHECKS, self.measures.tolist(), strict=True)
        return {name: value for name, value in checks if value > LIMIT}

    def gains(self, other: "Reading") -> Array:
        """Returns (8,) how much better each check is than in another reading; 0 where one has none of it."""
        return np.nan_to_num(other.measures - self.measures)

    def worse(self, other: "Reading") -> bool:
        """Returns whether a check is worse than in another reading; one that that has none of, than in a right one."""
        theirs = other.measures
        most = np.where(np.isnan(theirs), LIMIT, theirs + WORSE)
        return bool((self.measures > most).any())

    def compare(self, model: ObjectModel) -> None:
        """Adds, of some grasps, the share of contacts that do not fit the object; 1 where vision does not."""
        camera = self._rig.camera or MountedCamera()
        noise = np.array([camera.sigma_position, camera.sigma_rotation])
        constant = np.array([camera.sigma_position_constant, camera.sigma_rotation_constant])
        variances = noise**2 + constant**2 + camera.drift[:2]
        covariance = np.diag(np.repeat(variances, 3))
        every = INSTANTS // VIEWS
        for observation in self.excerpt.views or self.excerpt.observations[::every]:
            skin = self._surfaces(observation)
            touch = self._tips.contacts(observation, None, skin)
            if len(touch.fingers) < 3 or touch.contacts is None:
                continue
            T = seen_in_palm(self._rig, observation)
            vision = None if T is None else PosePrior(T, covariance)
            found = correct_pose(model, touch.contacts, vision=vision)
            contradicts = any(each.evidence == "vision" for each in found.conflicts)
            cost = len(found.outliers) / len(touch.fingers)
            if contradicts or not found.consistent:
                cost = 1.0
            elif T is not None:
                points = se3.apply(se3.inverse(T), touch.contacts.points_palm)
                away = float(np.abs(model.evaluate(points).distance).mean() / math.sqrt(variances[0]))
                cost = float(np.clip((away - FAR) / 2, cost, 1.0))
            self.costs[OBJECT].append(cost)

    def _surfaces(self, observation: Observation) -> SkinContacts:
        if not observation.skin:
            return NOTHING
        return self._skin.observed(observation, self._at_rest, touched=True)

    def _touched(self, observation: Observation) -> bool:
        """Adds the costs of an observation's touches; returns whether a surface beside the tips is pressed."""
        skin = self._surfaces(observation)
        touch = self._tips.contacts(observation, None, skin)
        wrong = {finger for finger, reason in touch.reasons.items() if reason in NOT_ON_TIP}
        pulled = {self._finger_of[name] for name, (surface, _) in skin.touches.items() if _pulled(surface)}
        if not wrong and not pulled and touch.contacts is None:
            self._lowest = math.inf  # a new grasp
            return False
        self._wrong.update(wrong | pulled)
        self._loaded.update({*touch.fingers} | wrong | pulled)
        cost = 1.0 if pulled else len(wrong) / (len(wrong) + len(touch.fingers))
        for name, wrench in observation.wrenches.items():
            if math.dist(wrench[:3], self._rig.fingers[name].calibration.bias_force) > LARGE:
                cost = 1.0
        self.costs[POSSIBLE].append(cost)
        if not cost and touch.contacts is not None and touch.loads is not None and len(touch.fingers) > 1:
            by_taxels = {*touch.fingers} <= {*touch.by_taxels}
            self._forces(observation, touch.contacts, touch.loads, by_taxels=by_taxels)
        pressed = (name for name, (surface, _) in skin.touches.items() if len(surface.patches))
        return any(self._finger_of[name] is None for name in pressed)

    def _forces(self, observation: Observation, contacts: Contacts, loads: Array, *, by_taxels: bool) -> None:
        """Adds the costs of forces on the object; `loads` (n, 5) as `FingertipContacts` has them."""
        pushes = np.nan_to_num(loads[:, 3:4], nan=1.0)
        forces = np.nan_to_num(loads[:, :3]) + pushes * contacts.normals_palm
        arms = contacts.points_palm - contacts.points_palm.mean(axis=0)
        pull = (forces * arms).sum() / np.linalg.norm(forces) / np.linalg.norm(arms)
        self.costs[SQUEEZE].append(float(np.clip(0.5 - pull, 0.0, 1.0)))
        if np.isnan(loads[:, :4]).any():
            return  # sensed without friction, so there is no sum of forces
        total = forces.sum(axis=0)
        size = np.linalg.norm(total)
        sizes = float(np.linalg.norm(forces, axis=1).sum())
        self.costs[BALANCE].append(float(0.5 * size / sizes))
        T = observation.T_world_palm
        if T is None:
            return
        self._lowest = min(self._lowest, float(T[2, 3]))
        if T[2, 3] <= self._lowest + LIFTED:
            return
        gravity = self._rig.gravity @ T[:3, :3]
        cosine = total @ gravity / size / np.linalg.norm(gravity)
        self.costs[GRAVITY].append(float(0.5 - 0.5 * cosine))
        if by_taxels:
            shear = float(np.linalg.norm(np.nan_to_num(loads[:, :3]), axis=1).sum())
            torsions = np.nan_to_num(loads[:, 4:5]) * contacts.normals_palm
            torque = (np.cross(contacts.points_palm, forces) + torsions).sum(axis=0)
            arm = float(np.linalg.norm(arms, axis=1).mean())
            self._hang(gravity, np.concatenate([total, torque]), max(shear, LEAST_SHEAR * sizes), arm)

    def _hang(self, gravity: Array, load: Array, shear: float, arm: float) -> None:
        """Keeps what an object must weigh, and where, for the load (6,) of an instant; all in the palm's axes.

        The unknowns are its mass and the mass times its middle. Forces are shares of the shear of all tips, torques of
        that times the tips' distance from their middle: what presses from all sides tells nothing of the shear's axes.
        """
        scales = np.repeat([1 / shear, 1 / shear / arm], 3)
        rows = np.zeros((6, 4))
        rows[:3, 0] = gravity
        rows[3:, 1:] = -se3.skew(gravity)
        self._hanging.append((scales[:, None] * rows, scales * load))

    def _weigh(self) -> None:
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
        self.costs[WEIGHT] = (UNEXPLAINED * shares).clip(max=1.0).tolist()

    def _turns(self) -> None:
        """Adds how far vision's pose turns both in the palm and in the world: in one of them the object is still."""
        rotations = list[tuple[Array, Array]]()
        for observation in self.excerpt.views:
            T = seen_in_palm(self._rig, observation)
            if T is not None and observation.T_world_palm is not None:
                rotations.append((T[:3, :3], observation.T_world_palm[:3, :3] @ T[:3, :3]))
        for now, then in pairwise(rotations):
            turn = min(np.linalg.norm(se3.rotation_log(b.T @ a)) for a, b in zip(now, then, strict=True))
            self.costs[TURNS].append(min(1.0, float(turn / TURN)) ** 2)


def _pulled(touch: SkinTouch) -> bool:
    """Returns whether a surface is pulled more than it is pressed, which nothing does."""
    rise = np.nan_to_num(touch.rise[:-1, -1])
    most = max(float(rise.max()), SURE_THRESHOLDS * touch.surface.threshold)
    return bool(-rise.min() > most)


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
