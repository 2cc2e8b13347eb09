"""One angle that trades rotation against place; the inner problem of `symmetry.nearest`."""

import numpy as np

from handsight.checks import Array

SAMPLES = 33
STEPS = 6


def best_angle(by_rotation: Array, share: Array, by_place: Array, pull: Array) -> Array:
    """The angles φ [rad] that minimise θ(φ)² - 2 pull cos(φ - by_place), elementwise.

    θ is the rotation left over: cos(θ / 2) = |share cos((φ - by_rotation) / 2)|. Each part alone falls
    towards its own best angle, so the minimum lies on the shorter arc between the two: the best of samples
    there, then Newton.
    """
    arc = np.mod(by_place - by_rotation + np.pi, 2 * np.pi) - np.pi
    # From here on φ is counted from `by_rotation`, and the place wants `arc`.
    fractions = np.linspace(0.0, 1.0, SAMPLES)
    trial = arc[..., None] * fractions
    cost = _left_over(trial, share[..., None]) ** 2 - 2 * pull[..., None] * np.cos(trial - arc[..., None])
    angle = np.take_along_axis(trial, cost.argmin(axis=-1)[..., None], axis=-1)[..., 0]
    low, high = np.minimum(arc, 0.0), np.maximum(arc, 0.0)
    for _ in range(STEPS):
        slope, bend = _derivatives(angle, share, arc, pull)
        step = np.where(bend > 0, -slope / np.where(bend > 0, bend, 1.0), 0.0)
        widest = np.abs(arc) / (SAMPLES - 1)
        angle = np.clip(angle + np.clip(step, -widest, widest), low, high)
    return np.asarray(by_rotation + angle)


def _left_over(angle: Array, share: Array) -> Array:
    """θ in [0, π]; by the sine, which does not lose half the digits near 0."""
    half = angle / 2
    sine = np.sqrt(np.maximum(1 - share**2, 0.0) + (share * np.sin(half)) ** 2)
    return np.asarray(2 * np.arctan2(sine, np.abs(share * np.cos(half))))


def _derivatives(angle: Array, share: Array, arc: Array, pull: Array) -> tuple[Array, Array]:
    """Half the first and second derivative of the cost by the angle."""
    theta = _left_over(angle, share)
    sine = np.sin(theta / 2)
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    # θ θ' = θ / sin(θ/2) * share sin(φ/2) * share cos(φ/2) / cos(θ/2), and cos(θ/2) = share cos(φ/2).
    ratio = np.where(small, 2.0, theta / safe)
    along = share * np.sin(angle / 2)
    slope = ratio * along
    rate = np.where(small, 1.0, along / safe)
    by_ratio = np.where(small, 0.0, (1 - theta / 2 * np.cos(theta / 2) / safe) / safe) * rate
    bend = by_ratio * along + ratio * share * np.cos(angle / 2) / 2
    return slope + pull * np.sin(angle - arc), bend + pull * np.cos(angle - arc)
