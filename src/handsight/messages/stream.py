"""The stream from raw messages to observations, for recordings and live robots."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from handsight.camera import Camera
from handsight.messages.assemble import ObservationAssembler
from handsight.messages.clocks import ReorderBuffer
from handsight.messages.decode import Measurement, decode
from handsight.messages.fast import FastReader
from handsight.messages.report import Report, missing
from handsight.messages.topics import RawMessage, rig_topics
from handsight.observation import Observation
from handsight.rig import Rig


class ObservationStream:
    """An `ObservationStream` turns a robot's messages, one at a time, into observations.

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
        report: Report | None = None,
        order: Callable[[Report], ReorderBuffer] = ReorderBuffer,
    ) -> None:
        """`topics`: types of topics that are known in advance, by name; others are added with their first message.
        `report`: an empty report to fill. `order`: creates the buffer that puts measurements in order."""
        self._rig, self.topics, known = rig, rig_topics(rig), topics or {}
        """The topics of the rig, by name; messages on other topics are ignored."""
        self.report = Report(rig.topics.joint_states) if report is None else report
        """The counts of the messages until now, and what is wrong with them."""
        self.intrinsics: Camera | None = None  # the camera of the last CameraInfo; None: none has come
        for name, topic in self.topics.items():
            if name in known:
                topic.type = known[name]
                self.report.topics[name] = topic
        self.report.others |= {name: kind for name, kind in known.items() if name not in self.topics}
        self._joint_names = set[str]()
        self._sizes = dict[str, tuple[int, ...]]()
        self._fast = {"cdr": FastReader("cdr"), "ros1": FastReader("ros1")}
        self.order = order(self.report)
        self._assembler = ObservationAssembler(rig, self.report)
        self.truth = self._assembler.truth
        """Stamps [s] and true poses `T_palm_object` (4, 4) on the rig's topic of the truth; never in an observation."""

    def put(self, message: RawMessage) -> list[Observation]:
        """Returns the observations that are complete with this message, in order of stamp; raises MissingExtra."""
        topic = self.topics.get(message.topic)
        if topic is None:
            self.report.others.setdefault(message.topic, message.type)
            return []
        self.report.topics.setdefault(topic.name, topic)
        # This counts, not the type known in advance: a damaged file may contradict itself.
        topic.type = message.type
        found = []
        for measurement in decode(message, topic, self._rig.frames, self._fast):
            if topic.role == "tf_static":
                self._assembler.tree.put(measurement.value, float("inf"))
                topic.used += 1
            elif topic.role == "info":
                self.intrinsics = measurement.value
                topic.used += 1
            else:
                if topic.role in ("depth", "mask"):
                    self._sizes[topic.role] = measurement.value.shape[1::-1]
                if topic.role == "joints":
                    self._joint_names.update(measurement.value)
                found += self._assembled(self.order.put(measurement))
        return found

    def ready(self) -> list[Observation]:
        """Returns the observations that have waited long enough by the order's `now`, without another message."""
        return self._assembled(self.order.ready())

    def flush(self) -> list[Observation]:
        """Returns all observations that wait, for when nothing has come for long; more messages may come later."""
        found, last = self._assembled(self.order.finish()), self._assembler.finish()
        return found if last is None else [*found, last]

    def finish(self) -> list[Observation]:
        """Returns the last observations; no message may be put after this."""
        found = self.flush()
        self.report.ended = True
        return found

    def _assembled(self, ordered: Iterable[Measurement]) -> list[Observation]:
        found = [done for each in ordered if (done := self._assembler.put(each)) is not None]
        due = self._assembler.due
        if due is not None and due <= self.order.complete and (last := self._assembler.finish()) is not None:
            found.append(last)
        return found

    def camera(self) -> Camera:
        """Returns the images' camera from the CameraInfo, else from the rig; raises InvalidInput if neither has it."""
        return self.intrinsics or Camera.of(self._rig.camera)

    def calibrated(self, rig: Rig) -> Rig:
        """Returns the rig; if it has a topic of depth images but no intrinsics, with those of the CameraInfo."""
        camera, info = rig.camera, self.intrinsics
        if camera is None or camera.intrinsics is not None or info is None or rig.topics.depth is None:
            return rig
        return replace(rig, camera=camera.with_images_of(info))

    def lacks(self) -> list[str]:
        """Returns a sentence for each missing topic, joint and frame of the rig, and each image of a wrong size.

        A missing topic is known from the beginning if `topics` were given; missing joints and frames are known after
        the first observations.
        """
        lacking = missing(self._rig, self.report, self._assembler.tree.frames, self._joint_names)
        topics = self._rig.topics
        of_rig = None if self._rig.camera is None else self._rig.camera.size
        of_info = None if self.intrinsics is None else self.intrinsics.size
        images = {"depth": f"depth images on {topics.depth}", "mask": f"mask images on {topics.mask}"}
        sizes = [(what, self._sizes.get(role)) for role, what in images.items()]
        for what, came, expected, who in (
            *((*each, of_info, "CameraInfo says") for each in sizes),
            *((*each, of_rig if of_info is None else None, "the rig's camera has") for each in sizes),
            (f"camera info on {topics.camera_info}", of_info, of_rig, "the rig's camera has"),
        ):
            if came is not None and expected is not None and tuple(came) != tuple(expected):
                size = f"{expected[0]} x {expected[1]} pixels as {who}"
                lacking.append(f"{what}: expected {size}, got {came[0]} x {came[1]}")
        return lacking
