"""What every node does, whatever carries its messages: it is made from parameters, works, and says what it is at."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple, Protocol

from handsight.errors import HandsightError
from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker
from handsight.live.requests import ASKED, model_named
from handsight.messages import RawMessage
from handsight.rig import Rig
from handsight.tracking import Tracker, TrackerSettings


class NodeOptions(NamedTuple):
    """`NodeOptions` are what waits in a node, and for how long."""

    max_answers: int = 10  # answers kept for a slow reader
    max_answers_all: int = 2000  # the same where all count: entire seconds of them come at once
    request_timeout: float = 60.0  # how long a request waits for the worker [s]


NODE = NodeOptions()


class Stepped(Protocol):
    """A `Stepped` is a `LiveTracker`, or what hears for it in the same thread."""

    @property
    def tracker(self) -> Tracker:
        """Of the object that is followed now."""

    def step(self, timeout: float) -> list[Answer]:
        """Returns what is to be published now; waits at most so long [s]."""


def live_tracker(
    rig: str | Path,
    name: str | None,
    *,
    encoding: str,
    rate: float | None = None,
    images: bool = True,
    equal: bool = False,
) -> LiveTracker:
    """Returns what a node's parameters describe.

    `name`: the object's, in the rig or the library, or a mesh file; None or empty: the rig's only one. `rate`:
    corrections a second; None or 0: when something has changed. Raises a HandsightError.
    """
    known = Rig.from_file(rig)
    if not name and len(known.objects) == 1:
        name = next(iter(known.objects))
    model, settings = model_named(name or "", known), TrackerSettings(rate=rate or None, images=images)
    return LiveTracker(known, model, encoding=encoding, settings=settings, equal=equal)


def work(
    live: Stepped, publish: Callable[[Answer], None], say: Callable[[str], None], ended: threading.Event
) -> None:
    """Publishes what is answered until it is the end, and says each change of state; the end is told if it fails."""
    state = ""
    try:
        while not ended.is_set():
            for answer in live.step(0.05):
                publish(answer)
            if live.tracker.state != state:
                state = live.tracker.state
                say(f"{state} {live.tracker.reason}".rstrip())
    finally:
        ended.set()


def done(ask: Callable[[], "Future[str]"]) -> tuple[bool, str]:
    """Returns whether what is asked for was done, and a sentence of it."""
    try:
        return True, ask().result(NODE.request_timeout)
    except (HandsightError, TimeoutError) as error:
        return False, str(error) or "the worker does not answer"


class PublishedTypes:
    """Has types named that are published but not expected, where a transport keeps their messages to itself."""

    def __init__(self, live: LiveTracker) -> None:
        self._live, self._reported = live, set[tuple[str, str]]()

    def on_topic(self, topic: str, kind: str) -> None:
        """Takes note that messages of that type, `package/msg/Name`, are published on the topic."""
        expected = self._live.subscriptions.get(topic)
        if expected is None or topic in ASKED or kind in expected or (topic, kind) in self._reported:
            return
        self._reported.add((topic, kind))
        self._live.put(RawMessage(topic, kind, "cdr", time.time(), b""))
