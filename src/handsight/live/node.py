"""What the nodes of all transports share: parameters, the worker's loop, and queue lengths."""

import gc
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from handsight.checks import brief, suggestion
from handsight.errors import HandsightError, InvalidInput, printable
from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker
from handsight.live.requests import REQUESTS, requested_model
from handsight.messages import RawMessage
from handsight.messages.clocks import CLOCKS
from handsight.rig import Rig
from handsight.tracking import TrackerSettings
from handsight.tracking.concurrent_images import image_process
from handsight.tracking.warm import find_hand, find_object

PARAMETERS = {"rig": "", "object": "", "rate": 0.0, "images": True, "equal": False, "view": 0}
"""The parameters of a node with their defaults: those of `live_tracker`, and the port of a page in the browser."""

IMAGES_READY = 600.0
"""How long the process for images may take until it is ready [s]: kernels may have to be compiled."""


def parameters(given: Mapping[str, object]) -> dict[str, Any]:
    """Returns a node's parameters from those that a user gave, by name; the others have their defaults.

    Raises InvalidInput for an unknown name, a value of another type, and where the rig is missing.
    """
    types = {str: "a text", float: "a number of 0 or more", bool: "true or false", int: "a port or 0"}
    values: dict[str, Any] = {**PARAMETERS}
    for name, value in given.items():
        if name not in PARAMETERS:
            raise InvalidInput(f"parameter {printable(name)}: unknown{suggestion(name, PARAMETERS)}")
        kind: type = type(PARAMETERS[name])
        # A number, or a name of digits alone, may have come as an integer.
        fits = type(value) is kind or (type(value) is int and kind in (str, float))
        most = {float: math.inf, int: 65536}.get(kind)
        if not fits or (most is not None and not 0 <= float(str(value)) < most):
            raise InvalidInput(f"parameter {name}: expected {types[kind]}, got {brief(repr(value))}")
        values[name] = kind(value)
    if not values["rig"]:
        raise InvalidInput("parameter rig: expected the rig file, got nothing")
    return values


def live_tracker(
    rig: str | Path,
    name: str | None,
    *,
    encoding: str,
    rate: float | None = None,
    images: bool = True,
    equal: bool = False,
) -> LiveTracker:
    """Returns the tracker that a node's parameters describe, with all that it calls loaded or compiled.

    `rig`: the rig file. `name`: the object, in the rig or the library, or a mesh file; None or empty: the rig's only
    one. `rate`: corrections per second; None or 0: whenever a contact has changed. `images`: whether to use depth
    images. `equal`: answer exactly as `handsight track` would. Raises a HandsightError.
    """
    known = Rig.from_file(rig)
    if not name and len(known.objects) == 1:
        name = next(iter(known.objects))
    model, concurrent = requested_model(name or "", known), images and not equal
    settings = TrackerSettings(rate=rate or None, images=images, concurrent_images=concurrent)
    live = LiveTracker(known, model, encoding=encoding, settings=settings, equal=equal)
    if concurrent and known.topics.depth is not None:
        if not image_process().ready.wait(IMAGES_READY):
            reason = f"is not ready after {IMAGES_READY:.0f} s"
            raise HandsightError(f"images: the process that evaluates them {reason}")
    elif images and known.topics.depth is not None:
        find_object()
        find_hand()
    # To search all that lives for garbage takes a tenth of a second, for which an update would wait.
    gc.collect()
    gc.freeze()
    return live


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
    live: LiveTracker,
    step: Callable[[float], list[Answer]],
    publish: Callable[[Answer], None],
    say: Callable[[str], None],
    ended: threading.Event,
) -> None:
    """Publishes the answers of `step` until `ended` is set, and reports each change of state to `say`.

    `step`: that of `live`, or of a transport that also receives its messages within it. Sets `ended` if it fails.
    """
    state = ""
    try:
        while not ended.is_set():
            for answer in step(0.05):
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
