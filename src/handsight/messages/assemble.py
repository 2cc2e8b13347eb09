"""Assembly of observations from measurements in order of stamp."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import MAX_DISTANCE, Array
from handsight.messages.decode import Measurement
from handsight.messages.report import Report
from handsight.messages.topics import Role
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.rig.units import Units


class AssemblyOptions(NamedTuple):
    """`AssemblyOptions` are the limits on the age of an observation's messages, and on how many are kept."""

    max_age_joints: float = 0.1  # of joint positions at the observation's stamp [s]
    max_age_transform: float = 0.1  # of a transform of /tf [s]
    max_age_wrench: float = 0.05  # of a wrench, a contact or a tactile array's readings [s]
    max_age_vision: float = 0.2  # of a pose or an image [s]
    stuck: float = 0.5  # a sensor that reads the same for longer, while another's changes, is dead [s]
    min_stuck_readings: int = 5  # with fewer equal readings, a slow sensor is not called stuck
    full_scale_share: float = 0.999  # a reading above this share of a sensor's full scale is rejected
    max_frames: int = 10_000  # number of /tf frames that are kept


ASSEMBLY = AssemblyOptions()


class ObservationAssembler:
    """An `ObservationAssembler` collects the parts of the next observation, and counts what it leaves out."""

    def __init__(self, rig: Rig, report: Report) -> None:
        self._rig, self._report = rig, report
        self._units = report.units = Units(rig)
        self.tree = TransformTree()
        self.truth: list[tuple[float, Array]] = []
        self._restart()

    def _restart(self) -> None:
        """Forgets everything but the static transforms."""
        # The newest joint states of each publisher, by its joint names.
        self._joints: dict[tuple[str, ...], Measurement] = {}
        self._sensors: dict[str, WrenchSensor] = {}
        # The newest wrenches, contacts and readings with their stamps [s], by finger or array.
        self._touch: dict[Role, dict[str, tuple[float, Any]]] = {"wrench": {}, "contact": {}, "skin": {}}
        # By role: vision, color, depth, detections and mask since the last observation.
        self._vision: dict[str, Measurement] = {}
        self.due: float | None = None
        """Stamp of the joint states whose observation was not returned yet [s]; None: there are none."""
        self.tree.keep_static()

    def put(self, measurement: Measurement) -> Observation | None:
        """Adds the next measurement in order; returns the observation that it completes, or None."""
        stamp, topic = measurement.stamp, measurement.topic
        over = self.due is not None and (measurement.restarts or stamp > self.due)
        done = self.finish() if over else None
        if measurement.restarts:
            self._restart()
        if topic.role == "joints":
            self._joints[tuple(measurement.value)] = measurement
            self.due = stamp
        elif topic.role == "wrench":
            finger = measurement.part
            sensor = self._sensors.setdefault(finger, WrenchSensor())
            full = self._rig.fingers[finger].full_scale if finger in self._rig.fingers else None
            fault = sensor.read(measurement.value, stamp, full, self._sensors.values())
            if fault is None:
                self._touch["wrench"][finger] = stamp, measurement.value
            else:
                self._touch["wrench"].pop(finger, None)
                self._report.fingers[finger] = f"{fault}: a dead sensor? left out"
                topic.used, topic.stuck = topic.used - 1, topic.stuck + 1
        elif topic.role in self._touch:
            self._touch[topic.role][measurement.part] = stamp, measurement.value
        elif topic.role == "tf":
            self.tree.put(measurement.value, stamp)
        elif topic.role == "truth":
            self.truth.append((stamp, measurement.value))
        else:
            self._vision[topic.role] = measurement
        return done

    def finish(self) -> Observation | None:
        """Returns the observation of the newest joint states; None: it was returned already."""
        if self.due is None:
            return None
        stamp, self.due = self.due, None
        oldest = ASSEMBLY.max_age_joints
        self._joints = {names: each for names, each in self._joints.items() if stamp - each.stamp <= oldest}
        positions: dict[str, float] = {}
        for joints in sorted(self._joints.values(), key=lambda each: each.stamp):
            positions.update(joints.value)
        vision, image_stamps = dict[str, Any](), dict[str, float]()
        for role, each in self._vision.items():
            if stamp - each.stamp > ASSEMBLY.max_age_vision:
                each.topic.used, each.topic.stale = each.topic.used - 1, each.topic.stale + 1
            elif role == "vision":
                vision[role] = replace(each.value, stamp=each.stamp)
            else:
                vision[role], image_stamps[role] = each.value, each.stamp
        self._vision.clear()
        world, palm = (self._rig.frames[role].lstrip("/") for role in ("world", "palm"))
        T_world_palm = self.tree.lookup(world, palm, stamp)
        topics, report = self._rig.topics, self._report
        report.observations += 1
        report.placed += T_world_palm is not None
        observation = Observation(
            stamp,
            positions,
            wrenches=self._fresh("wrench", stamp, topics.wrenches, report.without),
            T_world_palm=T_world_palm,
            image_stamp=image_stamps.get("depth", image_stamps.get("color")),
            contacts=self._fresh("contact", stamp, topics.contacts, report.without),
            skin=self._fresh("skin", stamp, topics.skin, report.without_skin),
            **vision,
        )
        self._units.put(observation)
        return observation

    def _fresh(self, role: Role, stamp: float, names: Iterable[str], without: Counter[str]) -> dict[str, Any]:
        """Returns the recent enough values at a stamp [s], by name; names without one are counted in `without`."""
        found, newest = dict[str, Any](), self._touch[role]
        for name in names:
            if name in newest and stamp - newest[name][0] <= ASSEMBLY.max_age_wrench:
                found[name] = newest[name][1]
            else:
                without[name] += 1
        return found


@dataclass(slots=True)
class WrenchSensor:
    """A `WrenchSensor` checks the readings of one finger's sensor: is it stuck, or at full scale?"""

    reading: tuple[float, ...] = ()
    changed: float = -float("inf")  # when the reading last changed [s]
    repeated: int = 0  # number of messages in a row with the same reading
    stuck: int = 0  # number of messages that were rejected as stuck
    saturated: int = 0  # number of messages that were rejected at full scale

    def read(
        self,
        wrench: Array,
        stamp: float,
        full_scale: tuple[float, float] | None,
        sensors: Iterable["WrenchSensor"],
    ) -> str | None:
        """Returns why the sensor's next wrench (6,) cannot be used; None: it can. `full_scale`: the largest force [N]
        and torque [N m] that the sensor can measure; None: unknown. `sensors`: those of all fingers."""
        reading = tuple(wrench.tolist())
        if reading != self.reading:
            self.reading, self.changed, self.repeated = reading, stamp, 0
        self.repeated += 1
        if full_scale is not None:
            force, torque = max(map(abs, reading[:3])), max(map(abs, reading[3:]))
            share, (full_force, full_torque) = ASSEMBLY.full_scale_share, full_scale
            if force >= share * full_force or torque >= share * full_torque:
                self.saturated += 1
                full = f"{full_force:g} N, {full_torque:g} N m"
                if force > 2 * full_force or torque > 2 * full_torque:  # no sensor does
                    beyond = f"reads {force:.4g} N, {torque:.4g} N m, beyond its full scale ({full}),"
                    return f"{beyond} in {self.saturated} messages (millinewtons, N mm?)"
                return f"reads full scale ({full}) in {self.saturated} messages"
        constant = self.repeated >= ASSEMBLY.min_stuck_readings and stamp - self.changed > ASSEMBLY.stuck
        if constant and any(other.changed >= stamp - ASSEMBLY.stuck for other in sensors):
            self.stuck += 1
            constant_for = f"reads the same six numbers for more than {ASSEMBLY.stuck} s while others change"
            return f"{constant_for}, in {self.stuck} messages"
        return None


class TransformTree:
    """A `TransformTree` holds the newest transform of each child frame of /tf."""

    def __init__(self) -> None:
        # By child frame: its parent, `T_parent_child` and the stamp [s].
        self._to_child: dict[str, tuple[str, Array, float]] = {}

    def put(self, transform: tuple[str, str, Array], stamp: float) -> None:
        """Adds a parent, a child and `T_parent_child` (4, 4); the stamp of a static transform is infinite [s]."""
        parent, child, T_parent_child = transform
        if child in self._to_child or len(self._to_child) < ASSEMBLY.max_frames:
            self._to_child[child] = parent, T_parent_child, stamp

    def keep_static(self) -> None:
        """Forgets all transforms but the static ones."""
        self._to_child = {child: each for child, each in self._to_child.items() if each[2] == float("inf")}

    @property
    def frames(self) -> set[str]:
        """The names of all frames."""
        return {parent for parent, _, _ in self._to_child.values()} | self._to_child.keys()

    def lookup(self, target: str, source: str, stamp: float) -> Array | None:
        """Returns `T_target_source` (4, 4) at a stamp [s]; None: no recent enough transforms connect the frames."""
        above_source, above_target = self._ancestors(source, stamp), self._ancestors(target, stamp)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            return None
        T = above_source[common]
        T = T if common == target else se3.inverse(above_target[common]) @ T
        x, y, z = T[:3, 3].tolist()
        # Each transform is within bounds, but their product may not be.
        return T if max(abs(x), abs(y), abs(z)) <= MAX_DISTANCE else None

    def _ancestors(self, frame: str, stamp: float) -> dict[str, Array]:
        """Returns `T_ancestor_frame` (4, 4) by ancestor, beginning with the frame itself, nearest first."""
        T = np.eye(4)
        found = {frame: T}
        while frame in self._to_child:
            parent, T_parent_frame, measured = self._to_child[frame]
            if stamp - measured > ASSEMBLY.max_age_transform or parent in found:  # too old, or a cycle
                break
            frame, T = parent, T_parent_frame if len(found) == 1 else T_parent_frame @ T
            found[frame] = T
        return found
