"""The robot as one value: hand, fingertips with their sensors, camera, table, and where each is heard."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from handsight.checks import Array
from handsight.hand import Hand
from handsight.rig.load import load
from handsight.rig.parts import Camera, Finger, ObjectEntry, Table, Topics


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rig:
    """A robot hand that feels and is seen."""

    hand: Hand
    """Its palm frame is what poses are estimated in."""
    fingers: Mapping[str, Finger]
    """By name."""
    sigma_joint_offset: float = np.deg2rad(1.0)
    """Constant error of each joint angle [rad]."""
    sigma_joint: float = np.deg2rad(0.1)
    """Noise of each joint angle [rad]."""
    camera: Camera | None = None
    table: Table | None = None
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    """(3,) in the world [m/s²]."""
    world_from: Literal["tf", "joints"] | None = "tf"
    """Where `T_world_palm` comes from: /tf between `world_frame` and `palm_frame`, the hand's own file with the arm in
    it, or nowhere."""
    frames: Mapping[str, str] = field(
        default_factory=lambda: {"world": "world", "palm": "palm", "camera": "camera"}
    )
    """What messages call world, palm and camera in their frame_id."""
    topics: Topics = field(default_factory=Topics)
    objects: Mapping[str, ObjectEntry] = field(default_factory=dict)
    """By name."""

    @classmethod
    def from_file(cls, path: str | Path) -> "Rig":
        """The rig that a YAML file describes; docs/robots.md shows one.

        Raises InvalidFile with file, line, and the nearest valid name where there is one.
        """
        return load(Path(path), cls)
