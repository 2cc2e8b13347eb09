"""Depth images evaluated by one thread beside the tracker's, so that touch never waits for one.

Kernels, which take most of an image's time, release the interpreter.
"""

from concurrent.futures import Future, ThreadPoolExecutor

from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking.images import ImageResult, ObjectInImages, TakenImage


class ConcurrentImages:
    """Follows the object in images as `ObjectInImages` does, but answers later.

    While one image is evaluated, only the newest of the others waits.
    """

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """`rig`: its camera must have intrinsics."""
        self._followed = rig, model
        self._camera = Camera.of(rig.camera)
        self._images = ObjectInImages(rig, model)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="handsight-images")
        self._waiting: TakenImage | None = None
        self._running: Future[ImageResult | None] | None = None
        self.lost = True
        """Whether the last image that was answered did not show the object."""
        self.counts = dict(self._images.counts)
        """Those of `ObjectInImages`, of the images that were answered."""

    def __reduce__(self) -> tuple[object, ...]:
        """Returns how a copy starts anew: an image that is being evaluated is not copied."""
        return ConcurrentImages, self._followed

    def close(self) -> None:
        """Ends the thread after the image that it evaluates, of which no answer comes any more."""
        self._waiting = None
        self._running = None
        self._worker.shutdown(wait=False)

    def evaluated(self, image: TakenImage | None) -> ImageResult | None:
        """Takes the next image, if there is one; returns the result of an earlier one, None: none is ready.

        Raises InvalidInput for an image, this or an earlier one, that cannot be used; the next one is evaluated.
        """
        if image is not None:
            self._camera.check_depth(image.depth, "observation.depth")
            self._waiting = image
        running = self._running
        if running is not None and not running.done():
            return None
        self._running = None
        if running is not None:
            self.lost, self.counts = self._images.lost, self._images.counts
        if self._waiting is not None:
            self._running = self._worker.submit(self._images.evaluated, self._waiting)
            self._waiting = None
        return None if running is None else _answer(running)


def _answer(evaluated: Future[ImageResult | None]) -> ImageResult | None:
    """Returns the result of an image; raises InvalidInput for an error of any kind, such as a user's own source's."""
    try:
        return evaluated.result()
    except InvalidInput:
        raise
    except Exception as error:
        expected = "expected an image that can be evaluated"
        raise InvalidInput(f"observation.depth: {expected}, got {error!r}") from error
