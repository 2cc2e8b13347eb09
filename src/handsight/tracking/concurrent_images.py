"""Depth images evaluated by one thread beside the tracker's, so that touch never waits for one.

Kernels, which take most of an image's time, release the interpreter.
"""

import warnings
from concurrent.futures import Future, ThreadPoolExecutor

from handsight.camera import Camera
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking.images import ImageResult, ObjectInImages, TakenImage
from handsight.vision.object.region import check_metres


class ImageWarning(UserWarning):
    """An image that could not be evaluated, which no longer belongs to any observation."""


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
        self.rivals = self._images.rivals
        """Those of `ObjectInImages`, at the last image that was answered."""
        self.counts = dict(self._images.counts)
        """Those of `ObjectInImages`, of the images that were answered, and how many `failed`, if any did."""

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

        Raises InvalidInput for an image that cannot be the camera's. One that fails later, as where a user's own source
        raises, measures nothing: it is counted as `failed`, and a warning says why.
        """
        if image is not None:
            check_metres(self._camera.check_depth(image.depth, "observation.depth"))
            self._waiting = image
        running = self._running
        if running is not None and not running.done():
            return None
        self._running = None
        result = None if running is None else self._result(running)
        if self._waiting is not None:
            self._running = self._worker.submit(self._images.evaluated, self._waiting)
            self._waiting = None
        return result

    def _result(self, evaluated: Future[ImageResult | None]) -> ImageResult | None:
        """Returns what an image has measured; None for one that failed."""
        self.lost, self.rivals = self._images.lost, self._images.rivals
        error = evaluated.exception()
        if error is None:
            self.counts = self.counts | self._images.counts
            return evaluated.result()
        self.counts = self.counts | self._images.counts | {"failed": self.counts.get("failed", 0) + 1}
        warnings.warn(f"an image was not evaluated: {error!r}", ImageWarning, stacklevel=3)
        return None
