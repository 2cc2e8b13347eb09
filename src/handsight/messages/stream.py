"""The stream from raw messages to observations, for recordings and live robots."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from math import inf
from typing import Any

from handsight.camera import Camera
from handsight.checks import Array
from handsight.messages.clocks import ReorderBuffer
from handsight.messages.decode import Measurement, decode
from handsight.messages.definitions import definitions_in
from handsight.messages.fast import FastReader
from handsight.messages.report import Report, missing
from handsight.messages.topics import RawMessage, Role, TopicReport, rig_topics
from handsight.messages.transforms import TransformTree
from handsight.messages.wrench_sensor import WrenchSensor
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.rig.coupled_joints import CoupledJoints
from handsight.rig.units import Units

MAX_AGE_JOINTS = 0.1
"""The greatest age of joint positions at the observation's stamp [s]."""
MAX_AGE_TOUCH = 0.05
"""The greatest age of a wrench, a contact or a tactile array's readings [s]."""
MAX_AGE_VISION = 0.2
"""The greatest age of a pose or an image [s]."""


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
        self.report = Report(rig.topics.joint_states)
        """The counts of the messages until now, and what is wrong with them."""
        self.intrinsics: Camera | None = None  # the camera of the last CameraInfo; None: none has come
        for name, kind in (topics or {}).items():
            self._know(name, kind)
        self._definitions = definitions_in(rig.topics.messages)
        self._joint_names = set[str]()
        self._sizes = dict[Role, tuple[int, int]]()
        self._fast = {"cdr": FastReader("cdr"), "ros1": FastReader("ros1")}
        self.order = order(self.report)
        self._units = self.report.units = Units(rig)
        self._coupled = self.report.coupled = CoupledJoints(rig)
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
        topic.type = kind
        self.report.topics[name] = topic
        return topic

    def put(self, message: RawMessage) -> list[Observation]:
        """Returns the observations that are complete with this message, in order of stamp; raises MissingExtra."""
        # The message's type counts, not the one known in advance: a damaged file may contradict itself.
        topic = self._know(message.topic, message.type)
        if topic is None:
            return []
        if not message.definition:
            message = message._replace(definition=self._definitions.get(message.type, ""))
        found = list[Observation]()
        for measurement in decode(message, topic, self._rig.frames, self._fast):
            if topic.role == "tf_static":
                self._tree.put(measurement.value, inf)
                topic.used += 1
                continue
            if topic.role == "info":
                self.intrinsics = measurement.value
                topic.used += 1
                continue
            if topic.role in ("depth", "mask"):
                height, width = measurement.value.shape
                self._sizes[topic.role] = width, height
            if measurement.role == "joints":
                if self._rig.joint_names:
                    measurement = replace(measurement, value=self._named(measurement.value))
                self._joint_names.update(measurement.value)
            found += self._paired(self.order.put(measurement))
        return found

    def _named(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Returns joint positions by the names that the hand's file has."""
        return {self._rig.joint_names.get(name, name): value for name, value in positions.items()}

    def declare(self, name: str, kind: str) -> None:
        """Notes the type of a topic's messages that do not come, as a transport passes on expected types only."""
        topic = self.topics.get(name)
        if topic is not None and kind not in topic.expected and not topic.messages:
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
            measurement.topic.take_back(fault)
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
        recent = {k: each for k, each in self._joints.items() if stamp - each.stamp <= MAX_AGE_JOINTS}
        self._joints = recent
        positions: dict[str, float] = {}
        for joints in sorted(recent.values(), key=lambda each: each.stamp):
            positions.update(joints.value)
        self._coupled.put(positions)
        seen = dict[str, Any]()
        for role, each in self._vision.items():
            if stamp - each.stamp > MAX_AGE_VISION:
                each.topic.used -= 1
                each.topic.stale += 1
                continue
            seen[role] = each.value
            if role == "vision":
                seen[role] = replace(each.value, stamp=each.stamp)
            elif role == "depth" or (role == "color" and "depth" not in seen):
                seen["image_stamp"] = each.stamp
        self._vision.clear()
        world, palm = (self._rig.frames[role].lstrip("/") for role in ("world", "palm"))
        T_world_palm = self._tree.lookup(world, palm, stamp)
        topics = self._rig.topics
        report = self.report
        report.observations += 1
        report.placed += T_world_palm is not None
        observation = Observation(
            stamp,
            self._rig.hand.couplings.completed(positions),
            wrenches=self._fresh("wrench", stamp, topics.wrenches, "finger {}: no wrench"),
            T_world_palm=T_world_palm,
            contacts=self._fresh("contact", stamp, topics.contacts, "finger {}: no contact"),
            skin=self._fresh("skin", stamp, topics.skin, "skin {}: no reading"),
            **seen,
        )
        self._units.put(observation)
        yield observation

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
