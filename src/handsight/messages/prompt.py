"""The order of messages of a live robot: a joint state goes on once all that is due has come, or 2 ms later."""

from collections import deque

from handsight.messages.assemble import ASSEMBLY
from handsight.messages.clocks import ReorderBuffer, publisher_of
from handsight.messages.decode import Measurement
from handsight.messages.report import Report

WAIT = 0.002
"""The longest that joint states wait [s]."""
WAITED_FOR = ("wrench", "contact", "tf")
"""Roles that come as often as joint states do. An image comes late in any case: it counts with the next."""


class PromptBuffer(ReorderBuffer):
    """A `PromptBuffer` puts measurements in order of stamp as far as 2 ms allow; later ones count if they are newest.

    A joint state waits until each wrench and transform that is due has reached its stamp. One is due that has come
    within the last 0.1 s and, by the time between its last two, should have come again.
    """

    def __init__(self, report: Report) -> None:
        """`now` must be set with each message and before `ready`."""
        super().__init__(report)
        self.now = -float("inf")
        """When the message came that is put; else now, by the same clock [s]."""
        self._begin()

    def _begin(self) -> None:
        self.complete = -float("inf")
        self._pending = deque[tuple[float, float]]()  # joint states' stamps, and until when they wait
        # By topic: the newest stamp, and half of the time since the one before.
        self._reached: dict[str, tuple[float, float]] = {}
        self._newest_of: dict[tuple[str, tuple[str, ...]], float] = {}

    @property
    def waits_until(self) -> float:
        """When the next joint states have waited long enough, by the clock of `now`; infinite: none wait."""
        return self._pending[0][1] if self._pending else float("inf")

    def finish(self) -> list[Measurement]:
        """Returns the measurements that wait: no more come, or none for long."""
        found = super().finish()
        if self._pending:
            self.complete = max(stamp for stamp, _ in self._pending)
            self._pending.clear()
        return found

    def _forget(self) -> None:
        super()._forget()
        self._begin()

    def _edge(self) -> float:
        while self._pending:
            stamp, until = self._pending[0]
            if self.now < until and any(
                newest + half < stamp <= newest + ASSEMBLY.max_age_transform
                for newest, half in self._reached.values()
            ):
                break
            self.complete = max(self.complete, stamp)
            self._pending.popleft()
        return self.complete

    def _push(self, measurement: Measurement) -> None:
        topic, stamp, key = measurement.topic, measurement.stamp, publisher_of(measurement)
        newest = self._newest_of.get(key, -float("inf"))
        if stamp < newest or (topic.role == "joints" and stamp < self.complete):
            topic.late += 1
            return
        self._newest_of[key] = stamp
        if topic.role == "joints":
            self._pending.append((stamp, self.now + WAIT))
        elif topic.role in WAITED_FOR:
            before, half = self._reached.get(topic.name, (stamp, 0.0))
            self._reached[topic.name] = max(stamp, before), (stamp - before) / 2 if stamp > before else half
        self._keep(measurement)
