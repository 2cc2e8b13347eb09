"""What vision sees, in the frame its camera is fixed to, laid into the belief."""

from typing import Literal

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import Camera, Rig
from handsight.tracking.belief import Belief

Mount = Literal["world", "palm"]
UNLIKELY = 27.9
"""χ² of six numbers that one in ten thousand exceeds: such a sight is wrong, or the object has moved."""
PATIENCE = 5
"""So many of them in a row say that the object has moved."""
ANYWHERE = np.diag([0.3**2] * 3 + [1.0] * 3)
"""Of a pose before anything is known (δp [m], δθ [rad])."""


class Sight:
    """A rig's camera, and what has become of what it saw."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """`rig.camera` may be None: then poses come in the world or the palm."""
        self._rig, self._model = rig, model
        self.camera = rig.camera or Camera()
        self.mount: Mount | None = None
        """What vision's constant error is constant in; known with the first sight."""
        self.unplaced = self.rejected = 0
        """Sights without a T_world_palm to place them, and those that could not be true."""
        self._in_a_row = 0

    def look(
        self, observation: Observation, belief: Belief | None, T_world_palm: Array | None
    ) -> Belief | None:
        """The belief after what was seen; the same belief (or None) where nothing was, or nothing that can be."""
        seen = observation.vision
        if seen is None:
            return belief
        mount = self._mount_of(seen)
        if self.mount is None:
            self.mount = mount
        T_mount_palm = np.eye(4) if mount == "palm" else T_world_palm
        if mount != self.mount or T_mount_palm is None:
            self.unplaced += 1
            return belief
        T_mount_object, covariance = self._placed(seen)
        if belief is None:
            belief = self.begin(se3.inverse(T_mount_palm) @ T_mount_object, ANYWHERE, T_mount_object[:3, 3])
        return self._taken(belief, T_mount_object, covariance, T_mount_palm)

    def in_palm(self, observation: Observation, T_world_palm: Array | None) -> Array | None:
        """(4, 4) the seen pose in the palm, its error still in it; None where nothing was seen or it has no place."""
        if observation.vision is None:
            return None
        T_mount_palm = np.eye(4) if self._mount_of(observation.vision) == "palm" else T_world_palm
        return (
            None if T_mount_palm is None else se3.inverse(T_mount_palm) @ self._placed(observation.vision)[0]
        )

    def begin(self, T_palm_object: Array, covariance: Array, pivot: Array) -> Belief:
        """A belief whose pose is known so well, and vision's constant error as the camera says."""
        c = self.camera
        # A camera without a constant error has next to none: a covariance must be invertible.
        position, rotation = max(c.sigma_position_constant, 1e-6), max(c.sigma_rotation_constant, 1e-6)
        error = np.diag([position**2] * 3 + [rotation**2] * 3)
        return Belief.begun(T_palm_object, covariance, error, pivot)

    def _mount_of(self, seen: PoseMeasurement) -> Mount:
        if seen.frame == "camera":
            if self._rig.camera is None:
                raise InvalidInput(
                    "vision.frame: expected world or palm (the rig has no camera), got 'camera'"
                )
            return self._rig.camera.on
        return seen.frame

    def _placed(self, seen: PoseMeasurement) -> tuple[Array, Array]:
        """The seen pose in the mount's frame, and its covariance (6, 6) along the mount's axes."""
        T_mount_frame = self.camera.T_mount_camera if seen.frame == "camera" else np.eye(4)
        if seen.covariance is None:
            c = self.camera
            covariance = np.diag([c.sigma_position**2] * 3 + [c.sigma_rotation**2] * 3)
        else:
            covariance = se3.rotate_covariance(T_mount_frame[:3, :3], seen.covariance)
        # Vision that says it knows a pose exactly is taken to know it well.
        return T_mount_frame @ seen.T_frame_object, covariance + 1e-10 * np.eye(6)

    def _taken(self, belief: Belief, T_mount_object: Array, covariance: Array, T_mount_palm: Array) -> Belief:
        """The belief after a sight; one that cannot be true is left out until several in a row say the same."""
        expected = belief.expected(T_mount_palm)
        T = nearest(self._model.symmetries, T_mount_object, expected, self._model.radius)
        if belief.surprise(T, covariance, T_mount_palm) > UNLIKELY:
            self._in_a_row += 1
            self.rejected += 1
            if self._in_a_row < PATIENCE:
                return belief
            belief = belief.settled(belief.now.walked(np.diag(ANYWHERE)))
        self._in_a_row = 0
        return belief.seen(T, covariance, T_mount_palm)
