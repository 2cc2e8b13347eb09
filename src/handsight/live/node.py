"""What the nodes of all transports share: parameters, the worker's loop, and queue lengths."""

import gc
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from handsight.errors import HandsightError, InvalidInput
from handsight.live.answers import Answer
from handsight.live.live_tracker import LiveTracker
from handsight.live.requests import requested_model
from handsight.messages.pair import MAX_WAIT
from handsight.msgspec_errors import explain, field_name
from handsight.rig import Rig
from handsight.tracking import TrackerSettings
from handsight.tracking.warm import find_hand, find_object


class Parameters(msgspec.Struct, forbid_unknown_fields=True):
    """The parameters of a node: those of `live_tracker`, and the port of a page in the browser, or 0."""

    rig: str | int
    object: str | int = ""  # a name of digits alone may have come as an integer
    rate: Annotated[float, Meta(ge=0)] = 0.0
    images: bool = True
    equal: bool = False
    view: Annotated[int, Meta(ge=0, lt=65536)] = 0

    def __post_init__(self) -> None:
        if self.rig == "":
            raise ValueError("rig: expected the rig file, got nothing")


SWITCH = 5e-4
"""How long a thread may keep the interpreter while another waits for it [s]. At Python's own 5 ms, touch would wait so
long for the thread that evaluates images."""


def parameters(given: Mapping[str, object]) -> dict[str, Any]:
    """Returns a node's parameters from those that a user gave, by name; the others have their defaults.

    Raises InvalidInput for an unknown name, a value of another type, and where the rig is missing.
    """
    try:
        found = msgspec.structs.asdict(msgspec.convert(given, Parameters))
    except msgspec.ValidationError:
        field, message = explain(Parameters, given)
        raise InvalidInput(f"parameter {field_name(field)}: {message}") from None
    return found | {"rig": str(found["rig"]), "object": str(found["object"])}


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
    model = requested_model(name or "", known)
    concurrent = images and not equal
    settings = TrackerSettings(rate=rate or None, images=images, concurrent_images=concurrent)
    live = LiveTracker(known, model, encoding=encoding, settings=settings, equal=equal)
    if images and known.topics.depth is not None:
        find_object()
        find_hand()
    if concurrent:
        sys.setswitchinterval(SWITCH)
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
    return min(timeout, MAX_WAIT) if recently else timeout


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
