"""A recording as a stream of Observations."""

import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from handsight.checks import Array
from handsight.errors import InvalidFile
from handsight.messages.assemble import Assembly, TransformTree
from handsight.messages.clocks import Clocks, Order
from handsight.messages.decode import TYPES, WRENCH, CameraIntrinsics, Event, channels, decoded, link
from handsight.messages.fast_cdr import QuickReader
from handsight.messages.images import MessageRejected
from handsight.messages.report import Report, TopicReport
from handsight.observation import Observation
from handsight.recording.chunks import Source
from handsight.recording.source import open_source
from handsight.rig import Rig

MOST_NAMED = 12
"""Topics in a message."""


def open_recording(path: str | Path, rig: Rig) -> "Recording":
    """The recording, as what a rig has measured: `.mcap`, `.bag`, `.db3`, or the folder of a rosbag 2.

    The rig says which topic is what. Raises InvalidFile where there is no recording or none with joint states, and
    MissingExtra without rosbags.
    """
    return Recording(Path(path), rig)


class Recording:
    """A recording, open; what was met so far is in `report`, `truth` and `intrinsics`."""

    report: Report
    """Counts and sentences."""
    truth: list[tuple[float, Array]]
    """Stamps [s] and `T_palm_object` (4, 4) from the rig's topic of the truth; never in an observation."""
    lens: CameraIntrinsics | None
    """What CameraInfo says; None: nothing was heard of it."""

    def __init__(self, path: Path, rig: Rig) -> None:
        """As `open_recording`."""
        self._rig, self._channels = rig, channels(rig)
        self._source: Source = open_source(path)
        self._begin()
        if rig.topics.joint_states not in self._source.topics:
            self.close()
            raise self._without_joints()

    def _begin(self) -> None:
        """Forget what was read."""
        self.truth, self.lens, self._tree, self._joint_names = [], None, TransformTree(), set[str]()
        there = self._source.topics
        self.report = Report(path=str(self._source.path), truncated=self._source.truncated)
        for topic, channel in self._channels.items():
            if topic in there:
                self.report.topics[topic] = TopicReport(channel.topic, there[topic])
        self.report.others = {topic: kind for topic, kind in there.items() if topic not in self._channels}
        self.report.unknown_wrenches = tuple(
            sorted(topic for topic, kind in self.report.others.items() if kind == WRENCH)
        )

    @property
    def intrinsics(self) -> Array | None:
        """(3, 3) of the camera's images [pixels]; None where no CameraInfo was met."""
        return None if self.lens is None else self.lens.intrinsics

    def observations(self) -> Iterator[Observation]:
        """What was measured, in order of stamp, one observation for each joint state message.

        Read as it is asked for, in bounded memory. Each call begins again, and so do `report` and `truth`. Raises
        InvalidFile at the end if there were no joint states.
        """
        self._begin()
        report, clocks = self.report, Clocks(self.report.topics)
        order = Order(report.topics, clocks)
        assembly = Assembly(self._rig, report, self._tree, self.truth)
        for event in order.ordered(clocks.aligned(self._events())):
            report.backwards = order.backwards
            done = assembly.take(event)
            if done is not None:
                yield done
        report.backwards = order.backwards
        done = assembly.finish()
        if done is not None:
            yield done
        report.ended = True
        if not report.topics[self._rig.topics.joint_states].messages:
            raise self._without_joints()

    def _events(self) -> Iterator[Event]:
        """What the messages say, as they lie in the file; those that say nothing are counted."""
        wanted, quick = frozenset(self._channels), QuickReader()
        for raw in self._source.messages(wanted):
            report = self.report.topics.get(raw.topic)
            if report is None:  # a damaged file may name a topic only where its messages are
                report = self.report.topics[raw.topic] = TopicReport(raw.topic, raw.type)
            channel = self._channels[raw.topic]
            try:
                events = decoded(raw, channel, self._rig.frames, quick)
            except MessageRejected as rejected:
                report.messages += 1
                report.refuse(str(rejected), nan=rejected.nan)
                continue
            for event in events:
                report.messages += 1
                if self._timed(event, report):
                    yield event
        self._note_damage()

    def _timed(self, event: Event, report: TopicReport) -> bool:
        """Whether the event has a time; what has none is taken at once."""
        role = event.channel.role
        if role == "joints":
            self._joint_names.update(event.value)
        elif role in ("tf", "tf_static"):
            try:
                event.value = link(event.value)
            except MessageRejected as rejected:
                report.refuse(str(rejected), nan=rejected.nan)
                return False
        if role == "tf_static":
            self._tree.put(event.value, float("inf"))
        elif role == "info":
            self.lens = event.value
        else:
            return True
        report.used += 1
        return False

    def _note_damage(self) -> None:
        self.report.truncated = self._source.truncated
        if len(self._source.damage) != len(self.report.damage):
            self.report.damage = tuple(said for _, said in sorted(self._source.damage.items()))

    def lacks(self) -> list[str]:
        """What the rig needs and this recording has not, a sentence each; empty: nothing.

        Of what was read so far: topics are known from the beginning, joints and frames once `observations` has run.
        """
        topics, lacking = self._rig.topics, []
        for finger, topic in topics.wrenches.items():
            lacking += self._missing(topic, f"finger {finger}: no wrench")
        if topics.vision is not None:
            lacking += self._missing(topics.vision, "no vision")
        known = self._rig.camera is not None and self._rig.camera.intrinsics is not None
        for what, name in (
            ("color images", topics.color),
            ("depth images", topics.depth),
            ("camera info", None if known else topics.camera_info),
        ):
            lacking += [] if name is None else self._missing(name, f"no {what}")
        if self._rig.world_from == "tf" and topics.tf is not None:
            lacking += self._missing_frames()
        if self.report.observations:
            for joint in self._rig.hand.moving:
                if joint not in self._joint_names:
                    near = _nearest(joint, self._joint_names)
                    lacking.append(f"joint {joint!r}: never on {topics.joint_states}{near}")
        return lacking

    def _missing(self, topic: str, what: str) -> list[str]:
        there = self._source.topics
        if topic not in there:
            free = [name for name in there if name not in self._channels]
            return [f"{what} on {topic}{_nearest(topic, free)}"]
        expected = TYPES[self._channels[topic].role]
        if there[topic] not in expected:
            return [f"{what} on {topic}: expected {' or '.join(expected)}, got {there[topic] or 'no type'}"]
        report = self.report.topics.get(topic)
        silent = report is None or not report.messages
        return [f"{what} on {topic}: no message"] if self.report.ended and silent else []

    def _missing_frames(self) -> list[str]:
        topic = str(self._rig.topics.tf)
        if topic not in self._source.topics and f"{topic}_static" not in self._source.topics:
            return self._missing(topic, "no transforms")
        if not self.report.ended:
            return []
        world, palm = (self._rig.frames[role].lstrip("/") for role in ("world", "palm"))
        frames = self._tree.frames
        unknown = [name for name in (world, palm) if name not in frames]
        if unknown:
            near = "".join(_nearest(name, frames) for name in unknown[:1])
            return [f"no transform of {' and '.join(map(repr, unknown))} on {topic}{near}"]
        missing = self.report.observations - self.report.placed
        if self.report.placed:
            said = f"no transform from {world!r} to {palm!r} in {missing} of {self.report.observations} observations"
            return [said] if missing else []
        return [f"no transforms that lead from {world!r} to {palm!r} on {topic}"]

    def _without_joints(self) -> InvalidFile:
        topic, there = self._rig.topics.joint_states, sorted(self._source.topics)
        named = ", ".join(there[:MOST_NAMED]) + (
            f" and {len(there) - MOST_NAMED} more" if len(there) > MOST_NAMED else ""
        )
        cut = f" ({self._source.truncated})" if self._source.truncated else ""
        return InvalidFile(
            f"{self._source.path}: expected joint states on {topic}, got none; "
            f"topics there: {named or 'none'}{cut}"
        )

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the file."""
        self.close()


def _nearest(name: str, there: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, sorted(there), n=1, cutoff=0.5)
    return f"; the nearest is {near[0]!r}" if near else ""
