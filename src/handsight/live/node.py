"""What the nodes of all transports share: creation from parameters, the worker's loop, and queue lengths."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol

from handsight.errors import HandsightError
from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker
from handsight.live.requests import REQUESTS, requested_model
from handsight.messages import RawMessage
from handsight.messages.clocks import CLOCKS
from handsight.rig import Rig
from handsight.tracking import State, TrackerSettings


class Stepped(Protocol):
    """A `Stepped` is a `LiveTracker`, or a transport that also receives its messages within `step`."""

    @property
    def trust(self) -> tuple[State, str]:
        """The state of the track, and why it cannot be trusted further."""

    def step(self, timeout: float) -> list[Answer]:
        """Returns the messages to publish now; waits at most `timeout` [s] for something to do."""


def live_tracker(
    rig: str | Path,
    name: str | None,
    *,
    encoding: str,
    rate: float | None = None,
    images: bool = True,
    equal: bool = False,
) -> LiveTracker:
    """Returns the tracker that a node's parameters describe.

    `rig`: the rig file. `name`: the object, in the rig or the library, or a mesh file; None or empty: the rig's only
    one. `rate`: corrections per second; None or 0: whenever a contact has changed. `images`: whether to use depth
    images. `equal`: answer exactly as `handsight track` would. Raises a HandsightError.
    """
    known = Rig.from_file(rig)
    if not name and len(known.objects) == 1:
        name = next(iter(known.objects))
    model, settings = requested_model(name or "", known), TrackerSettings(rate=rate or None, images=images)
    return LiveTracker(known, model, encoding=encoding, settings=settings, equal=equal)


def queue_lengths(live: LiveTracker) -> tuple[int, int]:
    """Returns the lengths of a topic's receiving queue, and of the queue of answers to a slow subscriber.

    They are long with `equal`, as every message is answered, and seconds of them may come at once.
    """
    return (2000, 2000) if live.equal else (100, 10)


def time_to_wait(timeout: float, received: float) -> float:
    """Returns how long to wait for a message, at most `timeout` [s].

    It is short soon after the last one was `received` (by `time.monotonic`), as joint states may wait for others.
    """
    recently = time.monotonic() - received < 0.1
    return min(timeout, CLOCKS.max_wait) if recently else timeout


def work(
    live: Stepped, publish: Callable[[Answer], None], say: Callable[[str], None], ended: threading.Event
) -> None:
    """Publishes answers until `ended` is set, and reports each change of state to `say`; sets `ended` if it fails."""
    state = ""
    try:
        while not ended.is_set():
            for answer in live.step(0.05):
                publish(answer)
            now, reason = live.trust
            if now != state:
                state = now
                say(f"{state} {reason}".rstrip())
    finally:
        ended.set()


def done(ask: Callable[[], "Future[str]"]) -> tuple[bool, str]:
    """Returns whether a request was fulfilled, and a sentence about the outcome."""
    try:
        return True, ask().result(timeout=60.0)
    except (HandsightError, TimeoutError) as error:
        return False, str(error) or "the worker does not answer"


class PublishedTypes:
    """A `PublishedTypes` reports topics of an unexpected type, for transports that drop such messages silently."""

    def __init__(self, live: LiveTracker) -> None:
        self._live, self._reported = live, set[tuple[str, str]]()

    def on_topic(self, topic: str, kind: str) -> None:
        """Reports an unexpected type `package/msg/Name` of a topic, once, as if one such message had come."""
        expected = self._live.subscriptions.get(topic)
        if expected is None or topic in REQUESTS or kind in expected or (topic, kind) in self._reported:
            return
        self._reported.add((topic, kind))
        self._live.put(RawMessage(topic, kind, "cdr", time.time(), b""))
