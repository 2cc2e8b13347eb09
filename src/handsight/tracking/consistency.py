"""How well a recording agrees with itself as a rig reads it: by what `handsight rig check` compares ways to read it.

All but the last measure need no object, and none needs a track, so that they say something where nothing can be tracked
yet. Each is from 0, which is right, to 1, and they are added.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PosePrior, correct_pose
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import MountedCamera, Rig
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.skin import NOTHING, SkinContacts, SkinSensors

Change = Callable[[Observation], Observation]
"""What an observation is read as in place of what was recorded."""


class ConsistencyOptions(NamedTuple):
    """`ConsistencyOptions` say which instants of a recording are compared, and how."""

    kept: int = 800  # observations that are kept of a recording, spread over it
    instants: int = 48  # of these, how many are read again with each change
    poses: int = 10  # grasps of which the contacts are compared with the object
    loaded: float = 0.1
    """A tip is loaded above this share of the largest load, and three times its `min_force`."""
    lifted: float = 0.02  # a palm that rose by so much while it grasped has lifted something [m]
    rest: float = 0.1  # a sensor that never reads less beside its bias has another bias [N]
    turn: float = math.radians(40.0)
    """Angle by which vision's pose turns where nothing does, that no noise explains [rad]."""
    arm: float = 0.008  # a joint nearer to a tip's centre does not say where its finger comes from [m]
    beyond: float = 0.2  # so far no joint is beyond its limits [rad]


CONSISTENCY = ConsistencyOptions()
MEASURES = {
    "touch": "loads that no touch on the tip explains",
    "squeeze": "fingers that pull on what they hold",
    "balance": "forces that are not in balance",
    "gravity": "weight in the air that is not along gravity",
    "rest": "readings at rest beside their bias",
    "outward": "tips that point into their fingers",
    "limits": "joints beyond their limits",
    "vision": "vision's pose turning both in the hand and in the world",
    "object": "contacts and vision that do not fit the object",
}
"""The measures, and in words what is 0 where all is right."""


@dataclass(slots=True)
class Thinned:
    """A `Thinned` keeps observations at equal steps of their number, without their images."""

    kept: list[Observation] = field(default_factory=list)
    count: int = 0
    step: int = 1

    def put(self, observation: Observation) -> None:
        """Adds an observation."""
        if self.count % self.step == 0:
            self.kept.append(replace(observation, color=None, depth=None, mask=None, detections=None))
        self.count += 1
        if len(self.kept) > CONSISTENCY.kept:
            self.kept, self.step = self.kept[::2], 2 * self.step

    def some(self) -> list[Observation]:
        """Returns those that are compared."""
        return self.kept[:: max(1, math.ceil(len(self.kept) / CONSISTENCY.instants))]


def outward(rig: Rig) -> dict[str, float]:
    """Returns by finger the cosine between its tip's +z and the way from its last joint to the tip: -1 is wrong."""
    hand = rig.hand.kinematics(dict.fromkeys(rig.hand.moving, 0.0))
    poses, found = dict(zip(rig.hand.tips, hand.Ts_palm_tip, strict=True)), dict[str, float]()
    for k, name in enumerate(rig.hand.tips):
        T = poses[name] @ rig.fingers[name].T_frame_surface
        anchors = hand.axes_palm[hand.chains.starts[k] : hand.chains.starts[k + 1], 1]
        ways = T[:3, 3] - anchors
        far = np.linalg.norm(ways, axis=1)
        far[far < CONSISTENCY.arm] = math.inf
        found[name] = float(T[:3, 2] @ ways[far.argmin()] / far.min()) if np.isfinite(far).any() else 0.0
    return {name: found[name] for name in rig.fingers}


class Excerpt:
    """An `Excerpt` is some hundred observations of a recording, and what its tactile surfaces read at rest."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.baselines = rig, NOTHING
        self.observations, self.views, self._skin = Thinned(), Thinned(), SkinSensors(rig)
        """Observations of all kinds, and those with a pose of vision."""

    def put(self, observation: Observation, *, touched: bool) -> None:
        """Adds an observation; `touched`: whether the wrench of any fingertip is that of a contact."""
        if not observation.joint_positions:
            return
        if observation.skin:
            self.baselines = self._skin.observed(observation, self.baselines, touched=touched)
        self.observations.put(observation)
        if observation.vision is not None:
            self.views.put(observation)


class Reading:
    """A `Reading` is an excerpt of a recording as a rig reads it, each observation changed first."""

    def __init__(self, excerpt: Excerpt, rig: Rig, change: Change, step: int = 1) -> None:
        """Takes every `step`-th instant. Raises InvalidInput where the changed observations cannot be that rig's."""
        self.rig, self._change, self._excerpt, self._step = rig, change, excerpt, step
        self.observations = [change(each) for each in excerpt.observations.some()[::step]]
        shape = len(self.observations), len(rig.fingers), 3
        self._sensors, self._skin = FingertipSensors(rig), SkinSensors(rig)
        self.touches = list[FingertipContacts]()
        """What the fingertips measure at each of n observations."""
        self.forces, self.places = np.zeros(shape), np.zeros(shape)
        """(n, f, 3) the load on each tip [N] and its centre [m] in the palm."""
        tips = [list(rig.hand.tips).index(name) for name in rig.fingers]
        for k, each in enumerate(self.observations):
            self.touches.append(self._touch(each))
            self._put_loads(k, each, rig.hand.Ts_palm_tip(each.joint_positions or {})[tips])
        self.forces[np.isnan(self.forces)] = 0.0
        self.sizes = np.linalg.norm(self.forces, axis=2)

    def _touch(self, observation: Observation) -> FingertipContacts:
        at_rest = SkinContacts(watched=self._excerpt.baselines.watched)
        skin = self._skin.observed(observation, at_rest, touched=True) if observation.skin else NOTHING
        return self._sensors.contacts(observation, None, skin)

    def _put_loads(self, k: int, observation: Observation, Ts_palm_tip: Array) -> None:
        """Fills in the loads of an observation, by its wrenches, else by its contacts."""
        touch, T_world_palm = self.touches[k], observation.T_world_palm
        gravity = np.zeros(3) if T_world_palm is None else T_world_palm[:3, :3].T @ self.rig.gravity
        for i, (name, finger) in enumerate(self.rig.fingers.items()):
            T, known = Ts_palm_tip[i] @ finger.T_frame_surface, finger.calibration
            T_sensor = finger.tip.T_surface_sensor
            self.places[k, i] = T[:3, 3]
            if name in observation.wrenches:
                R = T[:3, :3] if T_sensor is None else T[:3, :3] @ T_sensor[:3, :3]
                sign = 1.0 if known.reading == "on_sensor" else -1.0
                read = np.asarray(observation.wrenches[name])[:3] - known.bias_force
                self.forces[k, i] = sign * R @ read - known.mass * gravity
            elif name in touch.fingers and touch.contacts is not None and touch.loads is not None:
                at = touch.fingers.index(name)
                normal, load = touch.contacts.normals_palm[at], touch.loads[at]
                self.forces[k, i] = (
                    np.nan_to_num(load[:3]) + (1.0 if math.isnan(load[3]) else load[3]) * normal
                )

    @cached_property
    def rows(self) -> Array:
        """(n, 4) touch, squeeze, balance and gravity of each observation; NaN where no finger is loaded."""
        least = CONSISTENCY.loaded * float(self.sizes.max(initial=0.0))
        loaded = self.sizes > np.maximum([3 * f.tip.min_force for f in self.rig.fingers.values()], least)
        rows, lowest = np.full((len(loaded), 4), np.nan), math.inf
        for k, (each, touch) in enumerate(zip(self.observations, self.touches, strict=True)):
            height = math.nan if each.T_world_palm is None else float(each.T_world_palm[2, 3])
            if not loaded[k].any():
                lowest = math.inf
                continue
            by_wrench = [n for n, is_loaded in zip(self.rig.fingers, loaded[k], strict=True) if is_loaded]
            rows[k] = 0
            rows[k, 0] = np.mean([n in touch.reasons and n in each.wrenches for n in by_wrench])
            if len(by_wrench) < 2:
                continue
            lowest = min(lowest, height)
            forces, arms = self.forces[k, loaded[k]], self.places[k, loaded[k]]
            arms = arms - arms.mean(axis=0)
            push = (forces * arms).sum() / np.linalg.norm(forces) / np.linalg.norm(arms)
            rows[k, 1] = np.clip(0.5 - push, 0, 1)
            if touch.loads is not None and np.isnan(touch.loads[:, :4]).any():  # sensed without friction
                continue
            total = self.forces[k].sum(axis=0)
            rows[k, 2] = np.linalg.norm(total) / self.sizes[k].sum()
            if each.T_world_palm is not None and height > lowest + CONSISTENCY.lifted:
                down = each.T_world_palm[:3, :3].T @ self.rig.gravity
                rows[k, 3] = 0.5 - 0.5 * (total @ down) / np.linalg.norm(total) / np.linalg.norm(down)
        return rows

    @cached_property
    def costs(self) -> dict[str, Array]:
        """By measure, what its samples cost: those that the recording has."""
        found = dict(zip(("touch", "squeeze", "balance", "gravity"), self.rows.T, strict=True))
        hand, names = self.rig.hand, list(self.rig.fingers)
        sensed = [i for i, name in enumerate(names) if any(name in o.wrenches for o in self.observations)]
        least = self.sizes[:, sensed].min(axis=0, initial=math.inf)
        found["rest"] = np.clip(least - CONSISTENCY.rest, 0, 1)
        limits = {n: each for n, each in zip(hand.joint_names, hand.limits, strict=True) if n in hand.moving}
        read = [[(each.joint_positions or {})[name] for name in limits] for each in self.observations]
        low, high = np.array(list(limits.values())).T + CONSISTENCY.beyond * np.array([[-1], [1]])
        found["limits"] = ((read < low) | (read > high)).mean(axis=1)
        found["outward"] = np.clip(-np.array(list(outward(self.rig).values())), 0, 1)
        found["vision"] = self._turns()
        return found

    @cached_property
    def views(self) -> list[tuple[Observation, Array, Array | None]]:
        """Observations with the object's pose by vision in the palm and, where it is known, in the world."""
        found, camera = [], self.rig.camera or MountedCamera()
        for each in map(self._change, self._excerpt.views.some()[:: self._step]):
            if (vision := each.vision) is None:
                continue
            T, T_world_palm = vision.T_frame_object, each.T_world_palm
            frame = camera.on if vision.frame == "camera" else vision.frame
            T = camera.T_mount_camera @ T if vision.frame == "camera" else T
            if frame == "palm":
                found.append((each, T, None if T_world_palm is None else T_world_palm @ T))
            elif T_world_palm is not None:
                found.append((each, se3.inverse(T_world_palm) @ T, T))
        return found

    def _turns(self) -> Array:
        """Returns how far vision's pose turns both in the palm and in the world; in one of them the object is still."""
        views = [(T, T_world) for _, T, T_world in self.views if T_world is not None]
        R = np.array(views).reshape(-1, 2, 4, 4)[:, :, :3, :3]
        later = R[len(R) // 10 or 1 :]
        cosines = 0.5 * (R[: len(later)] * later).sum(axis=(2, 3)) - 0.5  # of the turn between two poses
        turns = np.arccos(np.clip(cosines, -1, 1)).min(axis=1)
        return np.asarray(np.clip(turns / CONSISTENCY.turn, 0, 1) ** 2)

    def off_object(self, model: ObjectModel) -> Array:
        """Returns for some grasps the share of the contacts that do not fit the object; 1 where vision does not."""
        camera, costs = self.rig.camera or MountedCamera(), list[float]()
        sigmas = [[camera.sigma_position, camera.sigma_rotation]]
        sigmas += [[camera.sigma_position_constant, camera.sigma_rotation_constant]]
        prior = np.diag(np.repeat(np.square(sigmas).sum(axis=0) + camera.drift[:2], 3))
        grasps: list[tuple[FingertipContacts, PosePrior | None]]
        grasps = [(self._touch(each), PosePrior(T, prior)) for each, T, _ in self.views]
        grasps = grasps or [(touch, None) for touch in self.touches]
        grasps = [each for each in grasps if len(each[0].fingers) > 2]
        for touch, vision in grasps[:: max(1, math.ceil(len(grasps) / CONSISTENCY.poses))]:
            if touch.contacts is not None:
                found = correct_pose(model, touch.contacts, vision=vision)
                wrong = any(each.evidence == "vision" for each in found.conflicts)
                share = len(found.outliers) / len(touch.fingers)
                costs.append(1.0 if wrong or not found.consistent else share)
        return np.array(costs)
