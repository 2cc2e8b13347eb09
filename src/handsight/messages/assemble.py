"""Events in order of stamp to Observations."""

from dataclasses import dataclass, field

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.messages.decode import Event, FrameTransform
from handsight.messages.report import Report
from handsight.observation import Observation
from handsight.rig import Rig

FRESH_JOINTS, FRESH_WRENCH, FRESH_LINK, FRESH_SIGHT = 0.1, 0.05, 0.1, 0.2
"""Oldest that is still taken for now [s]."""
STUCK = 0.5
"""A sensor that reads the same for longer, while another's changes, is dead [s]."""
LEAST_STUCK = 5
"""Readings; a slow topic says little about itself."""
AT_FULL_SCALE = 0.999
DEEPEST_TREE = 64
"""Links from world to palm; beyond it the tree is a circle."""
MOST_LINKS = 10_000


class TransformTree:
    """The transforms of /tf."""

    def __init__(self) -> None:
        """Empty."""
        self._links: dict[str, tuple[FrameTransform, float]] = {}

    def put(self, link: FrameTransform, stamp: float) -> None:
        """Take in a link; a static one is of infinite stamp."""
        if link.child in self._links or len(self._links) < MOST_LINKS:
            self._links[link.child] = (link, stamp)

    @property
    def frames(self) -> set[str]:
        """All that were named."""
        return {name for link, _ in self._links.values() for name in (link.parent, link.child)}

    def find(self, outer: str, inner: str, stamp: float) -> Array | None:
        """`T_outer_inner` (4, 4) at that time; None where the frames are not connected, or by old links."""
        up_inner, up_outer = self._up(inner, stamp), self._up(outer, stamp)
        common = next((frame for frame in up_inner if frame in up_outer), None)
        if common is None:
            return None
        T = up_inner[common]
        return T if common == outer else se3.inverse(up_outer[common]) @ T

    def _up(self, frame: str, stamp: float) -> dict[str, Array]:
        """`T_ancestor_frame` for the frame itself and its ancestors, nearest first."""
        T = np.eye(4)
        found = {frame: T}
        while frame in self._links and len(found) < DEEPEST_TREE:
            link, seen = self._links[frame]
            if stamp - seen > FRESH_LINK or link.parent in found:
                break
            T = link.T_parent_child @ T
            frame = link.parent
            found[frame] = T
        return found


@dataclass(slots=True)
class Sensor:
    """What is known of a finger's sensor."""

    reading: tuple[float, ...] = ()
    changed: float = -float("inf")
    """When the reading was last another [s]."""
    repeated: int = 0
    wrench: Array | None = None
    """(6,) the newest that can be used."""
    stamp: float = -float("inf")
    stuck: int = 0
    saturated: int = 0


@dataclass(slots=True)
class Assembly:
    """What the next observation is made of."""

    rig: Rig
    report: Report
    tree: TransformTree
    truth: list[tuple[float, Array]]
    joints: dict[tuple[str, ...], Event] = field(default_factory=dict)
    """The newest positions of each that publishes joint states, by their names."""
    sensors: dict[str, Sensor] = field(default_factory=dict)
    sight: dict[str, Event] = field(default_factory=dict)
    """What was seen since the last observation, by role."""
    due: float | None = None
    """Stamp of joint states that have no observation yet [s]."""

    def take(self, event: Event) -> Observation | None:
        """Take in one event; out comes the observation of joint states before it, once it is complete."""
        done = self.finish() if self.due is not None and event.stamp > self.due else None
        role = event.channel.role
        if role == "joints":
            self.joints[tuple(event.value)] = event
            self.due = event.stamp
        elif role == "wrench":
            self._feel(event)
        elif role == "tf":
            self.tree.put(event.value, event.stamp)
        elif role == "truth":
            self.truth.append((event.stamp, event.value))
        else:
            self.sight[role] = event
        return done

    def finish(self) -> Observation | None:
        """The observation of the newest joint states, if they have none yet."""
        if self.due is None:
            return None
        stamp, self.due = self.due, None
        fresh = {names: e for names, e in self.joints.items() if stamp - e.stamp <= FRESH_JOINTS}
        self.joints = fresh
        positions: dict[str, float] = {}
        for event in sorted(fresh.values(), key=lambda event: event.stamp):
            positions.update(event.value)
        sight = {role: event.value for role, event in self.sight.items() if self._fresh(event, stamp)}
        self.sight.clear()
        world, palm = (self.rig.frames[role].lstrip("/") for role in ("world", "palm"))
        T_world_palm = self.tree.find(world, palm, stamp)
        self.report.observations += 1
        self.report.placed += T_world_palm is not None
        return Observation(
            stamp=stamp,
            joint_positions=positions,
            wrenches=self._wrenches(stamp),
            vision=sight.get("vision"),
            T_world_palm=T_world_palm,
            color=sight.get("color"),
            depth=sight.get("depth"),
        )

    def _fresh(self, event: Event, stamp: float) -> bool:
        if stamp - event.stamp <= FRESH_SIGHT:
            return True
        report = self.report.topics[event.channel.topic]
        report.used, report.stale = report.used - 1, report.stale + 1
        return False

    def _wrenches(self, stamp: float) -> dict[str, Array]:
        found = {}
        for finger in self.rig.topics.wrenches:
            sensor = self.sensors.get(finger)
            if sensor is not None and sensor.wrench is not None and stamp - sensor.stamp <= FRESH_WRENCH:
                found[finger] = sensor.wrench
            else:
                self.report.without[finger] = self.report.without.get(finger, 0) + 1
        return found

    def _feel(self, event: Event) -> None:
        """Take in a wrench, unless its sensor is at full scale or stuck."""
        finger = event.channel.finger
        sensor = self.sensors.setdefault(finger, Sensor())
        reading = tuple(event.value.tolist())
        if reading != sensor.reading:
            sensor.reading, sensor.changed, sensor.repeated = reading, event.stamp, 0
        sensor.repeated += 1
        full = self.rig.fingers[finger].full_scale if finger in self.rig.fingers else None
        if full is not None and _saturated(reading, full):
            sensor.saturated += 1
            what = f"reads full scale ({full[0]:g} N, {full[1]:g} N m) in {sensor.saturated} messages"
        elif self._stuck(sensor, event.stamp):
            sensor.stuck += 1
            what = (
                f"reads the same six numbers beyond {STUCK} s while others change, in {sensor.stuck} messages"
            )
        else:
            sensor.wrench, sensor.stamp = event.value, event.stamp
            return
        sensor.wrench = None
        self.report.fingers[finger] = f"{what}: a dead sensor? left out"
        report = self.report.topics[event.channel.topic]
        report.used, report.stuck = report.used - 1, report.stuck + 1

    def _stuck(self, sensor: Sensor, stamp: float) -> bool:
        if sensor.repeated < LEAST_STUCK or stamp - sensor.changed <= STUCK:
            return False
        return any(other.changed >= stamp - STUCK for other in self.sensors.values() if other is not sensor)


def _saturated(reading: tuple[float, ...], full: tuple[float, float]) -> bool:
    force, torque = max(map(abs, reading[:3])), max(map(abs, reading[3:]))
    return force >= AT_FULL_SCALE * full[0] or torque >= AT_FULL_SCALE * full[1]
