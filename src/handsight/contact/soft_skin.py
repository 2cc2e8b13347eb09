"""How far a body sinks into curved skin, by the force on it and the skin's stiffness.

Skin is an elastic foundation (Johnson 1985, chapter 4.3): of stiffness k, pressure by depth, a body sinks in by
δ = √(F √(κ₁ κ₂) / (π k)) under a force F, where κ₁ and κ₂ are the principal curvatures of skin and body together.
"""

import math
from typing import Any

import numpy as np

from handsight.checks import Array

OBJECT_CURVATURE = 30.0
SIGMA_CURVATURE = 25.0
"""Of what a hand holds, from flat to a can's and a pen's: mean and standard deviation [1/m]."""


def sinks_in(force: float, bend: Array, normal: Array, stiffness: float) -> tuple[float, float]:
    """Returns how deep a body sinks into skin [m], and by what share that is uncertain as its curvature is unknown.

    `bend` (3, 3): the change of the skin's normal by the place [1/m]; `normal` (3,): its unit normal; `stiffness`: of
    the skin [N/m³].
    """
    across = np.eye(3) - np.outer(normal, normal)
    both = across @ (bend + bend.T) @ across / 2 + OBJECT_CURVATURE * across
    # The least eigenvalue is that along the normal, unless the skin is hollow there.
    curvatures = np.linalg.eigvalsh(both)[1:].clip(min=OBJECT_CURVATURE / 2)
    depth = math.sqrt(force * math.sqrt(float(curvatures.prod())) / (math.pi * stiffness))
    return depth, float((1 / curvatures).sum()) / 4 * SIGMA_CURVATURE


def sink(patches: Any, surface: Any, gives: float) -> None:
    """Moves curved patches into the skin by the depth that their force gives, and widens their covariance.

    A surface without a stiffness is only widened, by the depth in skin that gives way by `gives` [m/Pa].
    """
    for patch in patches:
        force = patch["total"]
        if surface.components == 3:
            force = float(patch["force"] @ patch["normal"])
        declared = surface.stiffness is not None
        known = declared or surface.components == 3
        if patch["flat"] or not known or not force > 0:
            continue
        normal = patch["normal"]
        nearest = int(np.linalg.norm(surface.points - patch["point"], axis=1).argmin())
        bend = surface.taxels["bend"][nearest]
        depth, share = sinks_in(force, bend, normal, surface.stiffness if declared else 1 / gives)
        sigma = depth
        if declared:
            patch["point"] += depth * normal
            # Depth is as the root of stiffness.
            sigma = depth * math.hypot(share, surface.sigma_stiffness / surface.stiffness / 2)
        patch["covariance"][:3, :3] += sigma**2 * np.outer(normal, normal)
