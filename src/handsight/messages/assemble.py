"""Measurements in order of stamp to Observations."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import MAX_DISTANCE, Array
from handsight.messages.clocks import CLOCKS
from handsight.messages.decode import Measurement
from handsight.messages.report import Report
from handsight.messages.units import Units
from handsight.observation import ContactMeasurement, Observation
from handsight.rig import Rig


class AssemblyOptions(NamedTuple):
    """`AssemblyOptions` say how old messages may be to be put together, and how many are kept."""

    max_age_joints: float = 0.1  # oldest joint positions that still count as now [s]
    max_age_transform: float = 0.1  # the same of a transform [s]
    max_age_wrench: float = 0.05  # the same of a wrench [s]
    max_age_vision: float = 0.2  # the same of a pose or an image [s]
    stuck: float = 0.5  # a sensor that reads the same for longer, while another's changes, is dead [s]
    min_stuck_readings: int = 5  # a slow topic says little about itself
    full_scale_share: float = 0.999  # share of a sensor's full scale from which on a reading is none
    max_depth: int = 64  # transforms from world to palm; beyond it the tree is a circle
    max_frames: int = 10_000  # frames of /tf that are kept
    max_publishers: int = 1000  # sets of joints published together that are kept


ASSEMBLY = AssemblyOptions()

IDENTITY = np.eye(4)
IDENTITY.setflags(write=False)


class ObservationAssembler:
    """An `ObservationAssembler` is what the next observation is made of; what is left out is counted in the report."""

    def __init__(self, rig: Rig, report: Report) -> None:
        self._rig, self._report = rig, report
        self._units = report.units = Units(rig)
        self.tree = TransformTree()
        self.truth: list[tuple[float, Array]] = []
        self._begin()

    def _begin(self) -> None:
        """Starts as if nothing was heard but what holds for ever."""
        self._joints: dict[tuple[str, ...], Measurement] = {}  # of each publisher, by its names
        self._sensors: dict[str, WrenchSensor] = {}
        self._contacts: dict[str, Measurement] = {}
        self._skin: dict[str, Measurement] = {}
        self._vision: dict[str, Measurement] = {}  # vision, color, depth since the last observation
        self.due: float | None = None
        """Stamp of joint states without an observation."""
        self._newest = -float("inf")
        self.tree.keep_static()

    def put(self, measurement: Measurement) -> Observation | None:
        """Returns the observation of the joint states before this measurement, if it completes it."""
        again = (
            measurement.stamp < self._newest - CLOCKS.max_jump
        )  # in order as they are: the clock went back
        done = self.finish() if self.due is not None and (again or measurement.stamp > self.due) else None
        if again:
            self._begin()
        self._newest = max(self._newest, measurement.stamp)
        role = measurement.topic.role
        if role == "joints":
            if len(self._joints) >= ASSEMBLY.max_publishers:
                self._joints.clear()
            self._joints[tuple(measurement.value)] = measurement
            self.due = measurement.stamp
        elif role == "wrench":
            self._take_wrench(measurement)
        elif role == "contact":
            self._contacts[measurement.topic.finger] = measurement
        elif role == "skin":
            self._skin[measurement.topic.finger] = measurement
        elif role == "tf":
            self.tree.put(measurement.value, measurement.stamp)
        elif role == "truth":
            self.truth.append((measurement.stamp, measurement.value))
        else:
            self._vision[role] = measurement
        return done

    def finish(self) -> Observation | None:
        """Returns the observation of the newest joint states, if they have none yet."""
        if self.due is None:
            return None
        stamp, self.due = self.due, None
        self._joints = {
            names: each
            for names, each in self._joints.items()
            if stamp - each.stamp <= ASSEMBLY.max_age_joints
        }
        positions: dict[str, float] = {}
        for joints in sorted(self._joints.values(), key=lambda each: each.stamp):
            positions.update(joints.value)
        fresh = {role: each for role, each in self._vision.items() if self._is_fresh(each, stamp)}
        vision = {role: each.value for role, each in fresh.items()}
        if "vision" in fresh:
            vision["vision"] = replace(vision["vision"], stamp=fresh["vision"].stamp)
        image = fresh.get("depth", fresh.get("color"))
        self._vision.clear()
        world, palm = (self._rig.frames[role].lstrip("/") for role in ("world", "palm"))
        T_world_palm = self.tree.lookup(world, palm, stamp)
        self._report.observations += 1
        self._report.placed += T_world_palm is not None
        observation = Observation(
            stamp,
            positions,
            wrenches=self._wrenches(stamp),
            T_world_palm=T_world_palm,
            image_stamp=None if image is None else image.stamp,
            contacts=self._contacts_at(stamp),
            skin=self._skin_at(stamp),
            **vision,
        )
        self._units.put(observation)
        return observation

    def _is_fresh(self, measurement: Measurement, stamp: float) -> bool:
        stale = stamp - measurement.stamp > ASSEMBLY.max_age_vision
        measurement.topic.used -= stale
        measurement.topic.stale += stale
        return not stale

    def _wrenches(self, stamp: float) -> dict[str, Array]:
        found = {}
        for finger in self._rig.topics.wrenches:
            sensor = self._sensors.get(finger)
            if (
                sensor is not None
                and sensor.wrench is not None
                and stamp - sensor.stamp <= ASSEMBLY.max_age_wrench
            ):
                found[finger] = sensor.wrench
            else:
                self._report.without[finger] += 1
        return found

    def _contacts_at(self, stamp: float) -> dict[str, ContactMeasurement | None]:
        found = {}
        for finger in self._rig.topics.contacts:
            latest = self._contacts.get(finger)
            if latest is not None and stamp - latest.stamp <= ASSEMBLY.max_age_wrench:
                found[finger] = latest.value
            else:
                self._report.without[finger] += 1
        return found

    def _skin_at(self, stamp: float) -> dict[str, Array]:
        found = {}
        for array in self._rig.topics.skin:
            latest = self._skin.get(array)
            if latest is not None and stamp - latest.stamp <= ASSEMBLY.max_age_wrench:
                found[array] = latest.value
            else:
                self._report.without_skin[array] += 1
        return found

    def _take_wrench(self, measurement: Measurement) -> None:
        """Keeps a wrench, unless its sensor is at full scale or stuck."""
        finger, stamp = measurement.topic.finger, measurement.stamp
        sensor = self._sensors.setdefault(finger, WrenchSensor())
        sensor.read(measurement.value, stamp)
        full = self._rig.fingers[finger].full_scale if finger in self._rig.fingers else None
        fault = sensor.fault(full, self._sensors.values())
        if fault is not None:
            sensor.wrench = None
            self._report.fingers[finger] = f"{fault}: a dead sensor? left out"
            measurement.topic.used -= 1
            measurement.topic.stuck += 1


@dataclass(slots=True)
class WrenchSensor:
    """A `WrenchSensor` is what is known of a finger's sensor."""

    wrench: Array | None = None
    """(6,) the newest; None: it cannot be used."""
    stamp: float = -float("inf")
    """Of the newest reading [s]."""
    reading: tuple[float, ...] = ()
    changed: float = -float("inf")
    """When the reading was last another [s]."""
    repeated: int = 0
    stuck: int = 0
    saturated: int = 0

    def read(self, wrench: Array, stamp: float) -> None:
        """Takes in a reading."""
        self.wrench, self.stamp, reading = wrench, stamp, tuple(wrench.tolist())
        if reading != self.reading:
            self.reading, self.changed, self.repeated = reading, stamp, 0
        self.repeated += 1

    def fault(self, full_scale: tuple[float, float] | None, sensors: Iterable["WrenchSensor"]) -> str | None:
        """Returns why the newest reading cannot be used; None: it can. `sensors`: all of the hand."""
        if full_scale is not None:
            force, torque = max(map(abs, self.reading[:3])), max(map(abs, self.reading[3:]))
            if (
                force >= ASSEMBLY.full_scale_share * full_scale[0]
                or torque >= ASSEMBLY.full_scale_share * full_scale[1]
            ):
                self.saturated += 1
                force_scale, torque_scale = full_scale
                return (
                    f"reads full scale ({force_scale:g} N, {torque_scale:g} N m) in {self.saturated} messages"
                )
        constant = self.repeated >= ASSEMBLY.min_stuck_readings and self.stamp - self.changed > ASSEMBLY.stuck
        if constant and any(other.changed >= self.stamp - ASSEMBLY.stuck for other in sensors):
            self.stuck += 1
            return f"reads the same six numbers beyond {ASSEMBLY.stuck} s while others change, in {self.stuck} messages"
        return None


class TransformTree:
    """A `TransformTree` is the newest transform to each frame of /tf."""

    def __init__(self) -> None:
        self._to_child: dict[str, tuple[str, Array, float]] = {}

    def put(self, transform: tuple[str, str, Array], stamp: float) -> None:
        """Takes in parent, child and `T_parent_child` (4, 4); what is static is of infinite stamp."""
        parent, child, T_parent_child = transform
        if child in self._to_child or len(self._to_child) < ASSEMBLY.max_frames:
            self._to_child[child] = parent, T_parent_child, stamp

    def keep_static(self) -> None:
        """Forgets all transforms that are of a time."""
        self._to_child = {child: each for child, each in self._to_child.items() if each[2] == float("inf")}

    @property
    def frames(self) -> set[str]:
        """All that were named."""
        return {parent for parent, _, _ in self._to_child.values()} | self._to_child.keys()

    def lookup(self, target: str, source: str, stamp: float) -> Array | None:
        """Returns `T_target_source` (4, 4) at that time; None where the frames are not connected, or by old
        transforms."""
        above_source, above_target = self._ancestors(source, stamp), self._ancestors(target, stamp)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            return None
        T = above_source[common]
        T = T if common == target else se3.inverse(above_target[common]) @ T
        x, y, z = T[:3, 3].tolist()
        return T if max(abs(x), abs(y), abs(z)) <= MAX_DISTANCE else None  # many of them may lead anywhere

    def _ancestors(self, frame: str, stamp: float) -> dict[str, Array]:
        """Yields `T_ancestor_frame` for the frame itself and its ancestors, nearest first."""
        T, found = IDENTITY, {frame: IDENTITY}
        while frame in self._to_child and len(found) < ASSEMBLY.max_depth:
            parent, T_parent_frame, measured = self._to_child[frame]
            if stamp - measured > ASSEMBLY.max_age_transform or parent in found:
                break
            frame, T = parent, T_parent_frame if T is IDENTITY else T_parent_frame @ T
            found[frame] = T
        return found
