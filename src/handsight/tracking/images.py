"""Depth images as measurements of vision: where the object is in the camera, and where the camera is, by the hand."""

from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.copies import shallow_copy
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import MountedCamera, Rig
from handsight.tracking.camera_from_palm import CameraFromPalm, HandView
from handsight.tracking.history import History, Instant
from handsight.vision import PalmDetection
from handsight.vision.depth_noise import PRESETS
from handsight.vision.object.depth_tracker import HIDDEN, DepthTracker, Sighting
from handsight.vision.palm.hand_in_image import HandInImage

ERR_TOGETHER = 1.0
"""Images so far apart err each by itself; nearer ones share what smoothing, bias and the side they show do [s]."""
SEARCH_AGAIN = 0.5
"""Between looks for a hand that was seen [s]: its joints go on telling where it is."""
FOUND_SIGMAS = 0.01, float(np.deg2rad(3.0))
"""How far the palm may be off in the next image, once it was seen [m, rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageResult:
    """An `ImageResult` is what an observation says once its depth image was looked at."""

    observation: Observation
    """With the pose that the image gives as its vision; with none where the object is not seen."""
    hand: HandView | None
    """The hand in the image; None where it was not looked for, or is hardly seen."""
    then: Instant | None
    """Joints and palm when what vision says was seen."""


class ImageVision:
    """An `ImageVision` is a rig's depth camera: follows one object, finds the hand, and leaves it out of what may be
    the object."""

    def __init__(self, rig: Rig, model: ObjectModel, *, on: bool) -> None:
        """Whether it is `on`: else, and without the camera's intrinsics, observations stay as they are."""
        self._rig, self._model, self._history = rig, model, History()
        self._on = on and rig.camera is not None and rig.camera.intrinsics is not None
        self.eye: Eye | None = None
        """What looks, from the first depth image on."""

    def copied(self) -> "ImageVision":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.eye = None if self.eye is None else self.eye.copied()
        return copy

    @property
    def counts(self) -> dict[str, int]:
        """What has become of the images so far; empty where none was looked at."""
        eye = self.eye
        if eye is None:
            return {}
        return {
            "looked_at": eye.images,
            "object_seen": eye.poses,
            "hand_sought": eye.searches,
            "palm_detected": eye.hands,
        }

    def observe(
        self, observation: Observation, from_palm: CameraFromPalm, T_palm_object: Array | None
    ) -> ImageResult:
        """Returns what an observation says; `from_palm`: what earlier images have said of the camera.

        T_palm_object: (4, 4) of an object that rides in the hand; None where nothing holds it. Raises InvalidInput for
        images that are none of the camera's.
        """
        self._history = self._history.after(
            Instant(observation.stamp, observation.joint_positions, observation.T_world_palm)
        )
        camera, hand = self._rig.camera, None
        if self._on and camera is not None and observation.depth is not None:
            self.eye = self.eye or Eye(self._rig, camera, self._model)
            stamp = observation.stamp if observation.image_stamp is None else observation.image_stamp
            then = self._history.at(stamp)
            if then is not None:
                vision, hand = self.eye.observe(stamp, observation.depth, then, from_palm, T_palm_object)
                observation = replace(observation, vision=vision)
        elif self.eye is not None and observation.vision is not None and observation.vision.frame == "camera":
            observation = replace(observation, vision=None)  # the same camera says more in its images
        vision = observation.vision
        return ImageResult(observation, hand, None if vision is None else self._history.at(vision.stamp))


class Eye:
    """Looks at depth images."""

    def __init__(self, rig: Rig, camera: MountedCamera, model: ObjectModel) -> None:
        """The rig's camera must have intrinsics."""
        self._mounted = camera
        self._camera = Camera.of(camera)
        self.tracker = DepthTracker(model, self._camera, noise=PRESETS[camera.depth_camera])
        self._hand = HandInImage(rig)
        sizes = camera.sigma_position_constant, camera.sigma_rotation_constant
        self._sigmas = max(sizes[0], FOUND_SIGMAS[0]), max(sizes[1], FOUND_SIGMAS[1])
        self._posed = self._searched = -np.inf
        self.sighting: Sighting | None = None
        """The last one."""
        self.images = self.poses = self.searches = self.hands = 0
        """How many images were looked at and in how many the object was seen; how often the hand was looked for, and
        seen."""

    def copied(self) -> "Eye":
        """Returns a copy that evolves apart from this one; both share the room that an image is worked on in."""
        copy = shallow_copy(self)
        copy.tracker = shallow_copy(self.tracker)
        return copy

    def observe(
        self,
        stamp: float,
        depth: Depth,
        then: Instant,
        from_palm: CameraFromPalm,
        T_palm_object: Array | None,
    ) -> tuple[PoseMeasurement | None, HandView | None]:
        """Returns where the object is in the camera, and the hand, each if it is seen."""
        image = self._camera.check_depth(depth, "observation.depth")
        self.images += 1
        view, mask, T_camera_palm = self._see_hand(stamp, image, then, from_palm)
        # What touch says is where to look for what was lost, and no more: a look that began there each time would say
        # again what touch has said, as if the camera had seen it.
        expected = None if T_palm_object is None or T_camera_palm is None else T_camera_palm @ T_palm_object
        lost = self.sighting is None or self.sighting.T_camera_object is None
        self.sighting = sighting = self.tracker.update(
            stamp,
            image,
            hand=mask,
            T_camera_palm=T_camera_palm,
            gripped=expected is not None,
            expected=expected if lost else None,
        )
        # Where hardly anything of it is seen, the pose is what was expected: nothing that the image says.
        if sighting.T_camera_object is None or sighting.covariance is None or sighting.reason == HIDDEN:
            return None, view
        self.poses += 1
        # So many images tell no more than one.
        alike = max(1.0, ERR_TOGETHER / max(stamp - self._posed, 1e-3))
        self._posed = stamp
        return PoseMeasurement(sighting.T_camera_object, "camera", alike * sighting.covariance, stamp), view

    def _see_hand(
        self, stamp: float, depth: Depth, then: Instant, from_palm: CameraFromPalm
    ) -> tuple[HandView | None, Mask | None, Array | None]:
        """Returns the palm's view, the hand's pixels and T_camera_palm, each as far as it can be told."""
        joints, camera = then.joint_positions, self._mounted
        T_mount_palm = np.eye(4) if camera.on == "palm" else then.T_world_palm
        if T_mount_palm is None:
            return None, None, None
        T_camera_mount = se3.inverse(camera.T_mount_camera)
        believed, sigmas, known = T_camera_mount @ T_mount_palm, self._sigmas, len(from_palm.believed) > 0
        if known:
            believed, sigmas = T_camera_mount @ from_palm.believed[-1].expected(T_mount_palm), FOUND_SIGMAS
        found = None
        if not known or abs(stamp - self._searched) >= SEARCH_AGAIN:
            self._searched, self.searches = stamp, self.searches + 1
            found = self._hand.detected(self._camera, depth, joints, believed, sigmas, follow=known)
        if isinstance(found, PalmDetection):
            self.hands += 1
            covariance = se3.rotate_covariance(camera.T_mount_camera[:3, :3], found.covariance)
            view = HandView(T_mount_palm, camera.T_mount_camera @ found.T_camera_palm, covariance)
            mask = self._hand.mask(self._camera, depth, joints, found.T_camera_palm)
            return view, mask, found.T_camera_palm
        if not known:
            return None, None, None
        return None, self._hand.mask(self._camera, depth, joints, believed), believed
