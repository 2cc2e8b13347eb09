"""Raw messages to Observations, one at a time: what recordings and live robots have in common."""

from collections.abc import Iterable, Mapping

from handsight.checks import Array
from handsight.messages.assemble import ObservationAssembler
from handsight.messages.clocks import Clocks, ReorderBuffer
from handsight.messages.decode import CameraIntrinsics, Decoder, Measurement
from handsight.messages.missing import missing
from handsight.messages.report import Report, TopicReport
from handsight.messages.topics import RawMessage, channels
from handsight.messages.transforms import TransformTree
from handsight.observation import Observation
from handsight.rig import Rig


class ObservationStream:
    """Observations from a robot's messages, which are put in as they come; see the package for what may be relied on.

    ```
    stream = ObservationStream(rig)
    for message in messages:
        for observation in stream.put(message): ...
    for observation in stream.finish(): ...
    ```
    """

    def __init__(
        self, rig: Rig, topics: Mapping[str, str] | None = None, *, report: Report | None = None
    ) -> None:
        """`topics`: type by topic, of all that are known to be there; others are taken in as they are heard.

        `report`: a new one that is to be filled.
        """
        self._rig, self._channels = rig, channels(rig)
        self.report = Report(rig.topics.joint_states) if report is None else report
        """Counts and sentences."""
        self.intrinsics: CameraIntrinsics | None = None
        """What CameraInfo says; None: nothing was heard of it."""
        for topic in self._channels:
            if topics is not None and topic in topics:
                self.report.topics[topic] = TopicReport(topic, topics[topic])
        self.report.others |= {
            topic: kind for topic, kind in (topics or {}).items() if topic not in self._channels
        }
        self._tree, self._joint_names = TransformTree(), set[str]()
        self._decoder, self._clocks = Decoder(rig.frames), Clocks()
        self._order = ReorderBuffer(self.report, self._clocks)
        self._assembler = ObservationAssembler(rig, self.report, self._tree)

    @property
    def truth(self) -> list[tuple[float, Array]]:
        """Stamps [s] and `T_palm_object` (4, 4) from the rig's topic of the truth; never in an observation."""
        return self._assembler.truth

    @property
    def topics(self) -> frozenset[str]:
        """Those that the rig listens to; what is put in of others is passed over."""
        return frozenset(self._channels)

    def put(self, message: RawMessage) -> list[Observation]:
        """The observations that are complete with this message, in order of stamp; raises MissingExtra."""
        channel = self._channels.get(message.topic)
        if channel is None:
            self.report.others.setdefault(message.topic, message.type)
            return []
        report = self.report.topics.get(message.topic)
        if report is None:
            report = self.report.topics[message.topic] = TopicReport(message.topic)
        report.type = message.type  # rather than what was said beforehand: a damaged file contradicts itself
        found = []
        for measurement in self._decoder.decode(message, channel, report):
            if channel.role == "tf_static":
                self._tree.put(measurement.value, float("inf"))
                report.used += 1
            elif channel.role == "info":
                self.intrinsics = measurement.value
                report.used += 1
            else:
                if channel.role == "joints":
                    self._joint_names.update(measurement.value)
                found += self._observations(self._clocks.put(measurement))
        return found

    def finish(self) -> list[Observation]:
        """The last observations: no message comes any more."""
        found = self._observations(self._clocks.finish())
        found += self._assembled(self._order.finish())
        last = self._assembler.finish()
        self.report.ended = True
        return found if last is None else [*found, last]

    def _observations(self, aligned: Iterable[Measurement]) -> list[Observation]:
        return [done for each in aligned for done in self._assembled(self._order.put(each))]

    def _assembled(self, ordered: Iterable[Measurement]) -> list[Observation]:
        return [done for each in ordered if (done := self._assembler.put(each)) is not None]

    def lacks(self) -> list[str]:
        """What the rig needs and was not heard, a sentence each; empty: nothing.

        Topics are known from the beginning where they were given, joints and frames after the first observations.
        """
        return missing(self._rig, self.report, self._tree.frames, self._joint_names)
