"""Pads that measure no more than that they are touched somewhere: switches, pressure cells, magnetic skins.

The place of the touch is then as uncertain as the pad is large, and so is the normal. The contact has the moments of
the pad's surface: its covariance along the surface is twice that of a point anywhere on it, as a tilted face or an edge
touches a pad at its rim, and the second moment of a disc's rim is twice that of the disc. A pad that is not pressed
says nothing: an object may rest on it with less force than its threshold.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from handsight import checks
from handsight._kernels.touch.taxel_records import FAR, PATCH, PRESSED, UNKNOWN
from handsight.checks import Array
from handsight.contact.taxels import MOST_TAXELS, SkinTouch, TactileSurface


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Pad(TactileSurface):
    """Surface, given by points spread over it evenly, that is touched somewhere or not at all."""

    kind: ClassVar[str] = "binary"

    channels: int = 1
    """Numbers of a reading; of several, such as the axes of magnetometers, the change's length counts."""
    sigma_normal: float | None = math.radians(45)
    """Standard deviation of a contact's normal about the pad's, in addition to how much that turns over the pad."""

    def __post_init__(self) -> None:
        TactileSurface.__post_init__(self)
        checks.integer(self.channels, "channels", MOST_TAXELS, 1)

    @property
    def places(self) -> tuple[int, ...]:
        """The shape of a reading."""
        return (self.channels,)

    def cells(self, values: Array) -> Array:
        """Returns a checked reading as (channels, 1)."""
        return values.reshape(-1, 1)

    def sensed(self, values: Array, baseline: Array) -> SkinTouch:
        """Returns whether the pad is pressed, by a reading and its baseline (channels, 1)."""
        rise = self.record["scale"][0, 0] * (values - self.record["offset"][0, 0]) - baseline
        size = float(np.linalg.norm(rise) if self.channels > 1 else rise[0, 0])
        pressed = size >= self.threshold
        n = self.channels
        states = np.full((2, n + 1), -1)
        states[0] = UNKNOWN
        if pressed:
            states[:, :n] = [[PRESSED], [0]]
        elif math.isfinite(size):
            states[0, :n] = FAR
        patches = np.zeros(int(pressed), dtype=PATCH)
        for patch in patches:  # the contact that is anywhere on the pad
            record = self.record[0]
            middle = self.points.mean(axis=0)
            normal = self.normals.mean(axis=0)
            arms = self.points - middle
            turns = self.normals - normal
            normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
            own_cell = self.pitch**2 / 12 * (np.eye(3) - np.outer(normal, normal))
            C = np.zeros((6, 6))
            C[:3, :3] = 2 * (arms.T @ arms / len(arms) + own_cell) + record["variance_point"] * np.eye(3)
            C[3:, 3:] = turns.T @ turns / len(turns) + record["variance_normal"] * np.eye(3)
            patch["point"] = middle
            patch["normal"] = -normal
            patch["covariance"] = C
            patch["force"] = patch["wrench"] = patch["torque"] = np.nan
            patch["total"] = size
            patch["contacts"] = 1.0
        return SkinTouch(self, np.append(np.full(n, size if pressed else 0.0), 0.0)[:, None], states, patches)
