"""Depth images as measurements: of the object's pose in the camera, and, by the hand, of the camera's own pose."""

from bisect import bisect_left
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.copies import shallow_copy
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import CameraFromPalm, HandView
from handsight.tracking.concurrent_images import ConcurrentImages, image_process
from handsight.tracking.hints import SearchHints
from handsight.tracking.object_in_images import IMAGES, Instant, ObjectInImages, TakenImage
from handsight.tracking.smoother import STILL, Motion
from handsight.vision import FirstPoseSource

STAMP = attrgetter("stamp")


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A `History` is the instants of the last second, and a few older ones, in the order of their stamps."""

    instants: tuple[Instant, ...] = ()

    def after(self, instant: Instant) -> "History":
        """Returns the history with one more instant, which replaces one of the same stamp."""
        kept = self.instants
        if kept and kept[-1].stamp == instant.stamp:
            kept = kept[:-1]
        full = len(kept) >= IMAGES.max_instants
        if full or (kept and kept[0].stamp < instant.stamp - 1.25 * IMAGES.history):
            # Old instants are dropped only now and then, because that takes longer than adding one.
            recent = (old for old in kept if old.stamp >= instant.stamp - IMAGES.history)
            kept = tuple(recent)[1 - IMAGES.max_instants :]
        return History((*kept, instant))

    def at(self, stamp: float | None) -> Instant | None:
        """Returns the instant nearest to a stamp [s]; None where the history does not reach back to it.

        For the stamp None it is the last instant.
        """
        kept = self.instants
        if stamp is None or not kept:
            return kept[-1] if kept else None
        if stamp < max(kept[0].stamp, kept[-1].stamp - IMAGES.history) - IMAGES.history / 10:
            return None
        k = bisect_left(kept, stamp, key=STAMP)
        return min(kept[max(k - 1, 0) : k + 1], key=lambda instant: abs(instant.stamp - stamp))

    def palm_at(self, stamp: float, latency: float) -> tuple[Array, Motion] | None:
        """Returns T_world_palm (4, 4) when vision took what has a stamp, and how it moved; None where unknown.

        It is that of the instant nearest to the stamp less the latency [s]; its motion says how far it is from that.
        """
        then = self.at(stamp - latency)
        if then is None or then.T_world_palm is None:
            return None
        before, after = self.at(then.stamp - IMAGES.palm_twist), self.at(then.stamp + IMAGES.palm_twist)
        ends = [each for each in (before, after) if each is not None and each.T_world_palm is not None]
        twist = STILL.twist
        if len(ends) == 2 and ends[1].stamp > ends[0].stamp:
            moved = se3.difference(*(np.asarray(end.T_world_palm) for end in reversed(ends)))
            twist = moved / (ends[1].stamp - ends[0].stamp)
        return then.T_world_palm, Motion(twist, stamp - then.stamp)


class ImageVision:
    """An `ImageVision` evaluates the images of a rig's depth camera for one object, over time."""

    def __init__(
        self, rig: Rig, model: ObjectModel, source: FirstPoseSource, *, on: bool, concurrent: bool
    ) -> None:
        """`source`: finds the object where nothing else says where it is. `concurrent`: answers later, see
        `TrackerSettings.concurrent_images`.

        Observations are left unchanged if it is not `on`, or if the rig has no camera with intrinsics.
        """
        named = rig.objects.get(model.name)
        self._hints = SearchHints(named.label or model.name if named else model.name, source)
        self._rig, self._model = rig, model
        self.history = History()
        """Joint positions and palm of the last second."""
        self._on = on and rig.camera is not None and rig.camera.intrinsics is not None
        if self._on and concurrent:
            image_process()  # which takes a while to start
        self._follow = ConcurrentImages if concurrent else ObjectInImages
        self._images: ObjectInImages | ConcurrentImages | None = None
        """None before the first depth image."""

    def copied(self) -> "ImageVision":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        if isinstance(copy._images, ObjectInImages):
            copy._images = shallow_copy(copy._images)
            copy._images.tracker = shallow_copy(copy._images.tracker)
        return copy

    @property
    def counts(self) -> dict[str, int]:
        """How many images were evaluated, and with what result; empty before the first image."""
        return {} if self._images is None else dict(self._images.counts)

    def observe(
        self, observation: Observation, from_palm: CameraFromPalm, T_palm_object: Array | None
    ) -> tuple[Observation, HandView | None]:
        """Returns the observation with an image's pose as its vision, and the palm in that image, None: not detected.

        The image is the observation's, or an earlier one. `from_palm`: the camera's error, as earlier images have
        measured it. `T_palm_object` (4, 4): the pose of an object in the hand; None where it is not grasped. Raises
        InvalidInput for an image that cannot be the camera's.
        """
        self.history = self.history.after(
            Instant(observation.stamp, observation.joint_positions, observation.T_world_palm)
        )
        camera, depth, hand = self._rig.camera, observation.depth, None
        if self._on and camera is not None:
            self._hints, taken = self._hints.after(observation), None
            if depth is not None:
                self._images = self._images or self._follow(self._rig, self._model)
                stamp = observation.stamp if observation.image_stamp is None else observation.image_stamp
                if (then := self.history.at(stamp - camera.latency)) is not None:
                    source = self._hints.source()
                    taken = TakenImage(stamp, depth, then, from_palm, T_palm_object, source)
            result = None if self._images is None else self._images.evaluated(taken)
            if result is not None:
                hand, vision = result.hand, observation.vision
                # Where the image does not show the object, a pose from outside may still know where it is.
                if result.vision is not None or vision is None or vision.frame != "camera":
                    return replace(observation, vision=result.vision), hand
        vision, followed = observation.vision, self._images is not None and not self._images.lost
        if followed and depth is None and vision is not None and vision.frame == "camera":
            # This camera's images are the better measurement, so poses that come between them are left out.
            observation = replace(observation, vision=None)
        return observation, hand
