"""Depth images evaluated by a process of their own, so that touch never waits for one.

A thread would not do: between its kernels it holds Python's interpreter lock, for which each update would wait.
"""

import contextlib
import itertools
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from functools import cache
from typing import IO, NamedTuple, cast

from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking.images import ImageResult, ObjectInImages, TakenImage

MAX_TRACKS = 4
"""Number of tracks whose object the process follows; of more, the oldest are forgotten."""
_tracks = itertools.count()


class Outcome(NamedTuple):
    """An `Outcome` is the process's answer to an image: what it has measured, or why it cannot be used."""

    result: ImageResult | InvalidInput | None
    counts: dict[str, int]
    lost: bool


class ConcurrentImages:
    """A `ConcurrentImages` follows the object in images as `ObjectInImages` does, but answers later.

    While one image is evaluated, only the newest of the others waits.
    """

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """`rig`: its camera must have intrinsics."""
        self._camera, self.followed, self.track = Camera.of(rig.camera), (rig, model), next(_tracks)
        self.waiting: TakenImage | None = None
        self.done = deque[Outcome]()
        self.lost, self.counts = True, dict[str, int]()

    def __reduce__(self) -> tuple[object, ...]:
        """Returns how a copy starts anew: what the process knows is not copied."""
        return ConcurrentImages, self.followed

    def evaluated(self, image: TakenImage | None) -> ImageResult | None:
        """Takes the next image, if there is one; returns the result of an earlier one, None: none is ready.

        Raises InvalidInput for an image, this or an earlier one, that cannot be used.
        """
        if image is not None:
            self._camera.check_depth(image.depth, "observation.depth")
            image_process().put(self, image)
        if not self.done:
            return None
        result, self.counts, self.lost = self.done.popleft()
        if isinstance(result, InvalidInput):
            raise result
        return result


class ImageProcess:
    """An `ImageProcess` is the process that evaluates images, and the thread that talks to it."""

    def __init__(self) -> None:
        self._waiting, self._filled = deque[ConcurrentImages](), threading.Condition()
        self.ready = threading.Event()
        """Set once the process has loaded what it needs."""
        threading.Thread(target=self._talk, name="handsight-images", daemon=True).start()

    def put(self, images: ConcurrentImages, image: TakenImage) -> None:
        """Gives the process an image, in place of one of that track that waits."""
        with self._filled:
            if images.waiting is None:
                self._waiting.append(images)
            images.waiting = image
            self._filled.notify()

    def _talk(self) -> None:
        """Starts the process, and another one when it dies."""
        # One core stays free for touch.
        threads, places = str(max((os.cpu_count() or 2) - 1, 1)), os.pathsep.join(filter(None, sys.path))
        environment = {**os.environ, "NUMBA_NUM_THREADS": threads, "PYTHONPATH": places}
        command = [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"]
        pipe = subprocess.PIPE
        while True:
            with (
                contextlib.suppress(EOFError, OSError, pickle.UnpicklingError),
                subprocess.Popen(command, stdin=pipe, stdout=pipe, env=environment) as self.child,
            ):
                self._converse(cast(IO[bytes], self.child.stdin), cast(IO[bytes], self.child.stdout))
            time.sleep(1.0)

    def _converse(self, questions: IO[bytes], answers: IO[bytes]) -> None:
        pickle.load(answers)
        self.ready.set()
        known = deque[int](maxlen=MAX_TRACKS)
        while True:
            with self._filled:
                self._filled.wait_for(lambda: self._waiting)
                images = self._waiting.popleft()
                image, images.waiting = images.waiting, None
            new = images.track not in known
            try:
                question = pickle.dumps((images.track, images.followed if new else None, image), protocol=5)
            except Exception as error:  # of any kind: a user's source of first poses may be anything
                images.done.append(Outcome(_refused(error), images.counts, images.lost))
                continue
            _send(question, questions)
            known.extend([images.track] if new else [])
            images.done.append(pickle.load(answers))


@cache
def image_process() -> ImageProcess:
    """Returns this program's process for images, which starts with the first call."""
    return ImageProcess()


def serve() -> None:
    """Evaluates images from standard input until it ends; for a process of its own."""
    from handsight.tracking.warm import find_hand, find_object

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers, tracks = os.fdopen(os.dup(1), "wb"), dict[int, ObjectInImages]()
    os.dup2(2, 1)  # a library's prints must not get between the answers
    find_object()
    find_hand()
    _send("ready", answers)
    with contextlib.suppress(EOFError):
        while True:
            question = pickle.load(sys.stdin.buffer)
            try:
                track, followed, image = pickle.loads(question)
                if followed is not None:
                    tracks[track] = ObjectInImages(*followed)
                    if len(tracks) > MAX_TRACKS:
                        del tracks[next(iter(tracks))]
                result, images = tracks[track].evaluated(image), tracks[track]
                outcome = Outcome(result, images.counts, images.lost)
            except Exception as error:  # of any kind: the tracker raises it
                outcome = Outcome(_refused(error), {}, lost=True)
            _send(outcome, answers)


def _send(value: object, stream: IO[bytes]) -> None:
    pickle.dump(value, stream, protocol=5)
    stream.flush()


def _refused(error: Exception) -> InvalidInput:
    """Returns an error that names the image, for whatever went wrong with it."""
    expected = "observation.depth: expected that the process for images can use it"
    return error if isinstance(error, InvalidInput) else InvalidInput(f"{expected}, got {error!r}")
