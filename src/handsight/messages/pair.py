"""Measurements to observations: one clock, one order, and what belongs to each joint state.

Stamps are trusted. The clock is that of the joint states; a topic that disagrees is told, and may be given an offset in
the rig. A `ReorderBuffer` sorts a recording's measurements in a window of 0.2 s, and a `PromptBuffer` those of a live
robot within 2 ms. This is the only place that decides whether a clock was set back: the first measurement after that is
marked (`Measurement.restarts`), and everything downstream relies on the mark. An `ObservationStream` joins the
measurements of one joint state into an `Observation`.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from math import inf
from typing import Any

from handsight.camera import Camera
from handsight.checks import Array
from handsight.messages.decode import Measurement, decode
from handsight.messages.definitions import definitions_in
from handsight.messages.read import FastReader
from handsight.messages.report import Report, TopicReport, missing
from handsight.messages.topics import RawMessage, Role, rig_topics
from handsight.messages.transforms import TransformTree
from handsight.messages.wrench_sensor import WrenchSensor
from handsight.observation import MAX_JUMP, Observation
from handsight.rig import Rig
from handsight.rig.coupled_joints import CoupledJoints
from handsight.rig.units import Units

BEGINNING = 1.0
"""Nothing of a recording is released before its joint states last for so long, which shows how late topics are [s]."""
PROMPT_BEGINNING = 0.1
"""The same for a live robot, which shows what comes at all [s]."""
MAX_LATENCY = 2.0
"""A camera's measurements may be late by so much [s]."""
SLOW = "vision", "truth", "color", "depth", "detections", "mask"
"""Roles of a camera's topics."""
REORDER_WINDOW = 0.2
"""A recording's messages are sorted within this [s]."""
MAX_WAIT = 0.002
"""A live robot's joint states wait this long for wrenches and transforms [s]."""
MAX_SILENCE = 0.1
"""But not for a topic that has been silent for longer [s]."""
MAX_WAITING = 50_000
"""Number of measurements that wait at most."""
MAX_WAITING_BYTES = 1 << 28
"""Size of the measurements that wait at most [bytes]."""
MAX_PUBLISHERS = 10_000
"""Names of joints, and pairs of frames, whose last stamps are kept: a broken publisher may make up new ones."""

MAX_AGE_JOINTS = 0.1
"""The greatest age of joint positions at the observation's stamp [s]."""
MAX_AGE_TOUCH = 0.05
"""The greatest age of a wrench, a contact or a tactile array's readings [s]."""
MAX_AGE_VISION = 0.2
"""The greatest age of a pose or an image [s]."""


class ReorderBuffer:
    """Measurements on one clock and, within a window behind the newest joint states, in order.

    What is more than a second ahead of the newest joint states waits for the next ones: those either agree, or it is
    left out. When the joint states themselves went back so, the clock was set back: all that wait are released, and
    the order begins again.
    """

    complete = -inf
    """Joint states up to this stamp wait for no other message, so they become observations at once [s]."""
    now = -inf
    """The time at which a live robot's message came, by `time.monotonic` [s]; to be set before `put` and `ready`."""
    waits_until = inf
    """When the oldest waiting joint states will have waited enough, on the clock of `now`; infinite: none wait."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._waiting: list[tuple[float, int, Measurement]] = []
        self._held = deque[Measurement]()
        """What waits for the next joint states, in the order in which it came."""
        self._bytes = 0
        self._count = itertools.count()
        self._offset = 0.0
        """Log time minus stamp of the last joint states [s]."""
        self._latest = 0.0
        """How far a camera's measurements have been behind the joint states [s]."""
        # By topic and part: several nodes may publish joint states or /tf.
        self._last_stamps = dict[tuple[str, str], float]()
        self._newest = -inf
        self._restart()

    def _restart(self) -> None:
        """Forgets the stamps that were released, as they are of the clock before it was set back."""
        self._released = -inf
        self._begun = -inf  # the first joint states
        self._restarted = True
        self._last_stamps.clear()

    def arrived(self, stamp: float) -> float | None:
        """Returns when the joint states of that stamp came, on the clock of `now`, once; None: it is not known."""
        return None

    def put(self, measurement: Measurement) -> list[Measurement]:
        """Adds a measurement, and returns all whose order is now known, without those that are late or repeated."""
        self._time(measurement)
        found = list[Measurement]()
        if measurement.role == "joints":
            found = self._put_joints(measurement)
        elif self._held or measurement.stamp > self._newest + MAX_JUMP:
            self._hold(measurement)
        else:
            self._push(measurement)
        return found + self.ready()

    def ready(self) -> list[Measurement]:
        """Returns the measurements whose order is known by the time `now`, without another message."""
        return self._pop(self._edge())

    def finish(self) -> list[Measurement]:
        """Returns all measurements that wait; for when no more messages come, or none have come for long."""
        for each in self._taken_from_held():
            self._push(each)
        return self._pop(inf)

    def _time(self, measurement: Measurement) -> None:
        """Sets the stamp on the clock of the joint states, and notes how far off it the topic is.

        Without a stamp of its own, a measurement is as long after the last joint states as it was logged after them.
        """
        report = measurement.report
        of_joints = report.topic.role == "joints"
        stamped = measurement.stamp != 0 or measurement.log_time == 0  # a simulator's first
        if not stamped:
            report.unstamped += 1
            measurement.stamp = measurement.log_time - (0.0 if of_joints else self._offset)
        measurement.stamp += report.topic.offset
        if stamped and not of_joints and self._newest > -inf:
            report.differences.append(measurement.log_time - measurement.stamp - self._offset)

    def _put_joints(self, joints: Measurement) -> list[Measurement]:
        """Adds joint states, and what has waited for them; returns all that waited before a clock that was set back."""
        found = list[Measurement]()
        held = self._taken_from_held()
        newest = self._newest
        is_first = newest == -inf
        if held and held[0].role == "joints":
            jumped = held.pop(0)
            if abs(joints.stamp - jumped.stamp) >= abs(joints.stamp - newest):
                jumped.report.reject("stamp far from those before and after")
            else:
                found = self._set_back(jumped.stamp) if jumped.stamp < newest else found
                self._push(jumped)
                newest = jumped.stamp
        if not is_first and abs(joints.stamp - newest) > MAX_JUMP:
            self._newest = newest
            for each in (joints, *held):
                self._hold(each)
            return found
        newest = max(newest, joints.stamp)
        for each in held:
            if each.stamp > newest + MAX_JUMP:
                each.report.reject("stamp more than a second ahead of the joint states")
            else:
                self._push(each)
        self._push(joints)
        if is_first:
            self._begun = newest
        self._newest = newest
        self._offset = joints.log_time - joints.stamp
        return found

    def _set_back(self, stamp: float) -> list[Measurement]:
        """Begins the order again with a clock that was set back to a stamp [s]; returns all that waited before."""
        count, far, first = self._report.backwards or (0, 0.0, self._newest)
        self._report.backwards = count + 1, max(far, self._newest - stamp), first
        found = self._pop(inf)
        self._restart()
        self._newest = stamp
        return found

    def _hold(self, measurement: Measurement) -> None:
        """Keeps a measurement until the next joint states; of too many, the oldest are left out."""
        self._held.append(measurement)
        self._bytes += measurement.size
        while self._is_full(len(self._held)):
            oldest = self._held.popleft()
            self._bytes -= oldest.size
            oldest.report.stale += 1

    def _taken_from_held(self) -> list[Measurement]:
        held = [*self._held]
        self._held.clear()
        self._bytes -= sum(each.size for each in held)
        return held

    def _edge(self) -> float:
        """Returns the stamp up to which the order is known [s]."""
        if self._newest - self._begun < BEGINNING:
            return -inf
        return self._newest - REORDER_WINDOW - self._latest

    def _push(self, measurement: Measurement) -> None:
        """Keeps the measurement until it is in order, or counts it as late."""
        behind = self._newest - measurement.stamp
        if measurement.role in SLOW and self._latest < behind <= MAX_LATENCY:
            self._latest = behind
        if measurement.stamp < max(self._released, self._edge()):
            measurement.report.late += 1
        else:
            self._keep(measurement)

    def _keep(self, measurement: Measurement) -> None:
        heapq.heappush(self._waiting, (measurement.stamp, next(self._count), measurement))
        self._bytes += measurement.size

    def _is_full(self, count: int) -> bool:
        return count > MAX_WAITING or (count > 0 and self._bytes > MAX_WAITING_BYTES)

    def _pop(self, edge: float) -> list[Measurement]:
        """Returns the measurements up to the edge [s], and more if too many wait; of repeated ones, the first."""
        found = list[Measurement]()
        waiting = self._waiting
        while waiting:
            if waiting[0][0] > edge and not self._is_full(len(waiting)):
                break
            self._released, _, measurement = heapq.heappop(waiting)
            self._bytes -= measurement.size
            if measurement.role != "tf" and self._came_twice(measurement):
                measurement.report.duplicated += 1
                continue
            measurement.report.use(self._released)
            measurement.restarts = self._restarted
            self._restarted = False
            found.append(measurement)
        return found

    def _came_twice(self, measurement: Measurement) -> bool:
        """Returns whether the last measurement of the same publisher had the same stamp."""
        publisher = measurement.report.topic.name, measurement.part
        if self._last_stamps.get(publisher) == measurement.stamp:
            return True
        if len(self._last_stamps) > MAX_PUBLISHERS:
            self._last_stamps.clear()
        self._last_stamps[publisher] = measurement.stamp
        return False


class PromptBuffer(ReorderBuffer):
    """Measurements in order within 2 ms; one that comes later is used if it is the newest.

    A joint state waits until each topic of wrenches, contacts or transforms that is due has reached its stamp. A topic
    is due if its last message is at most 0.1 s old and, by the interval between its last two, the next should have
    come. Images come late in any case: they are used with the next joint states. `now` must be set before `put` and
    `ready`.
    """

    def _restart(self) -> None:
        super()._restart()
        self.complete = -inf
        # When joint states came that were not asked for, by stamp; those beyond `complete` wait [s].
        self._came: dict[float, float] = {}
        # By topic: the newest stamp, and half of the interval to the stamp before it [s].
        self._reached: dict[str, tuple[float, float]] = {}
        self._newest_of = dict[tuple[str, str], float]()

    def arrived(self, stamp: float) -> float | None:
        came = self._came.get(stamp)
        self._came = {later: at for later, at in self._came.items() if later > stamp}
        return came

    @property
    def waits_until(self) -> float:  # type: ignore[override]
        if self._newest - self._begun < PROMPT_BEGINNING:
            return inf
        waiting = (came for stamp, came in self._came.items() if stamp > self.complete)
        return next(waiting, inf) + MAX_WAIT

    def finish(self) -> list[Measurement]:
        found = super().finish()
        self.complete = max(self._came, default=self.complete)
        return found

    def _edge(self) -> float:
        if self._newest - self._begun < PROMPT_BEGINNING:
            return -inf
        for stamp, came in self._came.items():
            reached = self._reached.values()
            due = (newest + half < stamp <= newest + MAX_SILENCE for newest, half in reached)
            if stamp > self.complete and self.now < came + MAX_WAIT and any(due):
                break
            self.complete = max(self.complete, stamp)
        return self.complete

    def _push(self, measurement: Measurement) -> None:
        report = measurement.report
        name = report.topic.name
        role = measurement.role
        stamp = measurement.stamp
        publisher = name, measurement.part
        newest = self._newest_of.get(publisher, -inf)
        if stamp < newest or (role == "joints" and stamp < self.complete):
            report.late += 1
            return
        if len(self._newest_of) > MAX_PUBLISHERS:
            self._newest_of.clear()
        self._newest_of[publisher] = stamp
        if role == "joints":
            self._came.setdefault(stamp, self.now)
        elif role in ("wrench", "contact", "tf"):
            before, half = self._reached.get(name, (stamp, 0.0))
            if stamp > before:
                half = (stamp - before) / 2
            self._reached[name] = max(stamp, before), half
        self._keep(measurement)


class ObservationStream:
    """Conversion of a robot's messages, one at a time, to observations.

    The docstring of `handsight.messages` lists its guarantees.

    ```
    stream = ObservationStream(rig)
    for message in messages:
        for observation in stream.put(message): ...
    for observation in stream.finish(): ...
    ```
    """

    def __init__(
        self,
        rig: Rig,
        topics: Mapping[str, str] | None = None,
        *,
        order: Callable[[Report], ReorderBuffer] = ReorderBuffer,
    ) -> None:
        """`topics`: types of topics that are known in advance, by name; others are added with their first message.
        `order`: creates the buffer that puts measurements in order."""
        self._rig = rig
        self.topics = rig_topics(rig)
        """The topics of the rig, by name; messages on other topics are ignored."""
        self._units = Units(rig)
        self._coupled = CoupledJoints(rig)
        self.report = Report(rig.topics.joint_states, units=self._units, coupled=self._coupled)
        """The counts of the messages until now, and what is wrong with them."""
        self.intrinsics: Camera | None = None  # the camera of the last CameraInfo; None: none has come
        for name, kind in (topics or {}).items():
            self._know(name, kind)
        self._definitions = definitions_in(rig.topics.messages)
        self._joint_names = set[str]()
        self._sizes = dict[Role, tuple[int, int]]()
        self._fast = {"cdr": FastReader("cdr"), "ros1": FastReader("ros1")}
        self.order = order(self.report)
        self._tree = TransformTree()
        self.truth: list[tuple[float, Array]] = []
        """Stamps [s] and true poses `T_palm_object` (4, 4) on the rig's topic of the truth; never in an observation."""
        self._restart()

    def _restart(self) -> None:
        """Forgets all measurements but the static transforms."""
        # The newest joint states of each publisher, by its joint names.
        self._joints = dict[str, Measurement]()
        self._sensors = dict[str, WrenchSensor]()
        # The newest wrenches, contacts and readings, by finger or surface.
        self._touch: dict[Role, dict[str, Measurement]] = {"wrench": {}, "contact": {}, "skin": {}}
        # By role: vision, color, depth, detections and mask since the last observation.
        self._vision = dict[Role, Measurement]()
        # Stamp of the joint states whose observation was not returned yet [s]; None: there are none.
        self._due: float | None = None
        self._tree.keep_static()

    def _know(self, name: str, kind: str) -> TopicReport | None:
        """Notes a topic and the type of its messages; returns its counts, None where the rig has no such topic."""
        topic = self.topics.get(name)
        if topic is None:
            self.report.others.setdefault(name, kind)
            return None
        report = self.report.topics.get(name)
        if report is None:
            report = self.report.topics[name] = TopicReport(topic)
        report.type = kind
        return report

    def put(self, message: RawMessage) -> list[Observation]:
        """Returns the observations that are complete with this message, in order of stamp; raises MissingExtra."""
        # The message's type counts, not the one known in advance: a damaged file may contradict itself.
        report = self._know(message.topic, message.type)
        if report is None:
            return []
        if not message.definition:
            message = message._replace(definition=self._definitions.get(message.type, ""))
        found = list[Observation]()
        for measurement in decode(message, report, self._rig.frames, self._fast):
            role = measurement.role
            if role == "tf_static":
                self._tree.put(measurement.value, inf)
                report.used += 1
                continue
            if role == "info":
                self.intrinsics = measurement.value
                report.used += 1
                continue
            if role == "depth" or role == "mask":
                height, width = measurement.value.shape
                self._sizes[role] = width, height
            elif role == "joints":
                self._name(measurement)
            found += self._paired(self.order.put(measurement))
        return found

    def _name(self, joints: Measurement) -> None:
        """Gives joint positions the names that the hand's file has."""
        names = self._rig.joint_names
        if names:
            joints.value = {names.get(name, name): value for name, value in joints.value.items()}
        if len(self._joint_names) < MAX_PUBLISHERS:
            self._joint_names.update(joints.value)

    def declare(self, name: str, kind: str) -> None:
        """Notes the type of a topic's messages that do not come, as a transport passes on expected types only."""
        topic = self.topics.get(name)
        heard = self.report.topics.get(name)
        silent = heard is None or not heard.messages
        if topic is not None and kind not in topic.expected and silent:
            self._know(name, kind)

    def ready(self) -> list[Observation]:
        """Returns the observations that have waited long enough by the order's `now`, without another message."""
        return self._paired(self.order.ready())

    def flush(self) -> list[Observation]:
        """Returns all observations that wait, for when nothing has come for long; more messages may come later."""
        return [*self._paired(self.order.finish()), *self._observed()]

    def finish(self) -> list[Observation]:
        """Returns the last observations; no message may be put after this."""
        found = self.flush()
        self.report.ended = True
        return found

    def _paired(self, ordered: Iterable[Measurement]) -> list[Observation]:
        """Adds the next measurements in order; returns the observations that are complete."""
        found = list[Observation]()
        for each in ordered:
            if self._due is not None and (each.restarts or each.stamp > self._due):
                found += self._observed()
            if each.restarts:
                self._restart()
            self._keep(each)
        if self._due is not None and self._due <= self.order.complete:
            found += self._observed()
        return found

    def _keep(self, measurement: Measurement) -> None:
        """Keeps a measurement for the next observation."""
        role = measurement.role
        part = measurement.part
        if role == "joints":
            self._joints[part] = measurement
            self._due = measurement.stamp
        elif role == "wrench" and (fault := self._fault(measurement)):
            self._touch["wrench"].pop(part, None)
            measurement.report.take_back(fault)
        elif role in self._touch:
            self._touch[role][part] = measurement
        elif role == "tf":
            self._tree.put(measurement.value, measurement.stamp)
        elif role == "truth":
            self.truth.append((measurement.stamp, measurement.value))
        else:
            self._vision[role] = measurement

    def _fault(self, measurement: Measurement) -> str | None:
        """Returns why a wrench cannot be used; None: it can."""
        name = measurement.part
        sensor = self._sensors.setdefault(name, WrenchSensor())
        finger = self._rig.fingers.get(name)
        full_scale = None if finger is None else finger.full_scale
        return sensor.read(measurement.value, measurement.stamp, full_scale, self._sensors.values())

    def _observed(self) -> Iterator[Observation]:
        """Yields the observation of the newest joint states, unless it was returned already."""
        if self._due is None:
            return
        stamp = self._due
        self._due = None
        world, palm = (self._rig.frames[role].lstrip("/") for role in ("world", "palm"))
        T_world_palm = self._tree.lookup(world, palm, stamp)
        topics = self._rig.topics
        self.report.observations += 1
        self.report.placed += T_world_palm is not None
        observation = Observation(
            stamp,
            self._positions(stamp),
            wrenches=self._fresh("wrench", stamp, topics.wrenches, "finger {}: no wrench"),
            T_world_palm=T_world_palm,
            contacts=self._fresh("contact", stamp, topics.contacts, "finger {}: no contact"),
            skin=self._fresh("skin", stamp, topics.skin, "skin {}: no reading"),
            **self._seen(stamp),
        )
        self._units.put(observation)
        yield observation

    def _positions(self, stamp: float) -> Mapping[str, float]:
        """Returns the positions of the joints, from all publishers, at a stamp [s]."""
        self._joints = {k: each for k, each in self._joints.items() if stamp - each.stamp <= MAX_AGE_JOINTS}
        positions: dict[str, float] = {}
        for joints in sorted(self._joints.values(), key=lambda each: each.stamp):
            positions.update(joints.value)
        self._coupled.put(positions)
        return self._rig.hand.couplings.completed(positions)

    def _seen(self, stamp: float) -> dict[str, Any]:
        """Returns what a camera saw since the last observation, by the observation's field."""
        found = dict[str, Any]()
        for role, each in self._vision.items():
            if stamp - each.stamp > MAX_AGE_VISION:
                each.report.used -= 1
                each.report.stale += 1
                continue
            found[role] = each.value
            if role == "vision":
                found[role] = replace(each.value, stamp=each.stamp)
            elif role == "depth" or (role == "color" and "depth" not in found):
                found["image_stamp"] = each.stamp
        self._vision.clear()
        return found

    def _fresh(self, role: Role, stamp: float, names: Iterable[str], missing: str) -> dict[str, Any]:
        """Returns the recent enough values at a stamp [s], by name; names without one are counted as `missing`."""
        newest = self._touch[role]
        found = dict[str, Any]()
        for name in names:
            if name in newest and stamp - newest[name].stamp <= MAX_AGE_TOUCH:
                found[name] = newest[name].value
            else:
                self.report.without[missing.format(name)] += 1
        return found

    def camera(self) -> Camera:
        """Returns the images' camera from the CameraInfo, else from the rig; raises InvalidInput if neither has it."""
        return self.intrinsics or Camera.of(self._rig.camera)

    def calibrated(self, rig: Rig) -> Rig:
        """Returns the rig; if it has a topic of depth images but no intrinsics, with those of the CameraInfo."""
        camera = rig.camera
        info = self.intrinsics
        if camera is None or camera.intrinsics is not None or info is None or rig.topics.depth is None:
            return rig
        return replace(rig, camera=camera.with_images_of(info))

    def lacks(self) -> list[str]:
        """Returns a sentence for each missing topic, joint and frame of the rig, and each image of a wrong size.

        A missing topic is known from the beginning if `topics` were given; missing joints and frames are known after
        the first observations.
        """
        names = self._tree.frames, self._joint_names
        lacking = missing(self._rig, self.topics.values(), self.report, *names)
        camera = self.intrinsics or self._rig.camera
        for role, size in self._sizes.items():
            if camera is not None and camera.size is not None and size != tuple(camera.size):
                expected, came = ("{} x {}".format(*each) for each in (camera.size, size))
                on = getattr(self._rig.topics, role)
                lacking.append(
                    f"{role} images on {on}: expected {expected} pixels as its camera's, got {came}"
                )
        return lacking
