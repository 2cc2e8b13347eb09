"""A tracked recording as figure 8 of the paper: where vision saw the object, where it was tracked, where it was."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.evaluation import Truths, base_center
from handsight.objects import ObjectModel
from handsight.tracking.replay import Step
from handsight.tracking.track_state import point_uncertainty
from handsight.viewer.correction_figures import require_matplotlib, save
from handsight.viewer.curves import slips_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


VISION, TRACKED, TRUTH = "0.6", "#c2185b", "black"
MOST_POINTS = 2000
SLIP = "#6a1b9a"
STATES = {"tracking": "#2e7d32", "uncertain": "#e0a100", "lost": "#b71c1c"}


def draw_track(name: str, model: ObjectModel, steps: Sequence[Step], truths: Truths, path: Path) -> None:
    """Writes x, y and z of the base's centre over time to an image file; raises MissingExtra, HandsightError."""
    plt = require_matplotlib()
    every = max(1, len(steps) // MOST_POINTS)
    shown = [step for k, step in enumerate(steps) if k % every == 0 or step.T_palm_object_vision is not None]
    times = np.array([step.stamp - steps[0].stamp for step in shown])
    curves = _curves(model, shown, truths)
    figure, axes = plt.subplots(
        4, 1, figsize=(9, 9), sharex=True, height_ratios=[3, 3, 3, 0.5], layout="constrained"
    )
    for k, axis in enumerate("xyz"):
        _coordinate(axes[k], times, *curves[:, :, k])
        axes[k].set_ylabel(f"{axis} [cm]")
    _states(axes[3], steps)
    _slips(axes, steps)
    axes[3].set_xlabel("time [s]")
    world = any(step.T_world_palm is not None for step in steps)
    axes[0].set_title(f"{name}: centre of the base in the {'world' if world else 'palm'}'s frame")
    save(figure, path)


def _curves(model: ObjectModel, steps: Sequence[Step], truths: Truths) -> Array:
    """Returns (4, n, 3) [cm]: the base tracked, seen and true (NaN where not known), and sigma of the tracked."""
    curves = np.full((4, len(steps), 3), np.nan)
    for i, step in enumerate(steps):
        T_world_palm = np.eye(4) if step.T_world_palm is None else step.T_world_palm
        tracked, truth = step.estimate.T_palm_object, truths.at(step.stamp)
        base = base_center(model, T_world_palm @ (tracked if truth is None else truth))
        for k, T in enumerate((tracked, step.T_palm_object_vision, truth)):
            if T is not None:
                curves[k, i] = 100 * se3.apply(T_world_palm @ T, base[None])[0]
        R = T_world_palm[:3, :3]
        variance = (R @ point_uncertainty(step.estimate, model, base)[0] @ R.T).diagonal()
        curves[3, i] = 100 * np.sqrt(variance.clip(min=0.0))
    return curves


def _coordinate(axes: "Axes", times: Array, tracked: Array, vision: Array, true: Array, sigma: Array) -> None:
    axes.fill_between(
        times, tracked - sigma, tracked + sigma, color=TRACKED, alpha=0.15, lw=0, label="tracked, ± 1 σ"
    )
    axes.plot(times, vision, "o", mfc="none", mec=VISION, ms=4, label="vision")
    axes.plot(times, tracked, color=TRACKED, lw=1.5, label="tracked")
    known = np.flatnonzero(np.isfinite(true))
    axes.plot(times[known][::10], true[known][::10], ".", color=TRUTH, ms=4, label="truth")
    # A σ of vision alone would flatten everything else.
    all_there = np.concatenate([tracked, vision, true])
    low, high = np.nanmin(all_there), np.nanmax(all_there)
    axes.set_ylim(low - 0.1 * (high - low) - 0.5, high + 0.1 * (high - low) + 0.5)
    axes.grid(alpha=0.3)


def _slips(axes: "Sequence[Axes]", steps: Sequence[Step]) -> None:
    """Draws a mark over every plot while the object slips."""
    for k, (first, last) in enumerate(slips_of((step.stamp, step.slip) for step in steps)):
        for axis in axes:
            axis.axvspan(first - steps[0].stamp, last - steps[0].stamp, color=SLIP, alpha=0.25, lw=0)
        if k == 0:
            axes[3].text(0.5, -1.6, "slips", color=SLIP, transform=axes[3].transAxes, fontsize=9)


def _states(axes: "Axes", steps: Sequence[Step]) -> None:
    """Draws a strip in the state's colour."""
    from matplotlib.colors import ListedColormap

    # Each state lasts to the next stamp.
    edges = np.array([step.stamp for step in (*steps, steps[-1])]) - steps[0].stamp
    strip = [[list(STATES).index(step.state) for step in steps]]
    axes.pcolormesh(edges, [0, 1], strip, cmap=ListedColormap(list(STATES.values())), vmin=0, vmax=2)
    axes.set_yticks([])
    axes.set_ylabel("state", rotation=0, ha="right", va="center")
    for k, (name, color) in enumerate(STATES.items()):
        axes.text(0.01 + 0.12 * k, -1.6, name, color=color, transform=axes.transAxes, fontsize=9)
