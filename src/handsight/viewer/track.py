"""A tracked recording as figure 8 of the paper: where vision saw the object, where it was tracked, where it was."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.evaluation import Truths, base_center
from handsight.objects import ObjectModel
from handsight.tracking.propagation import point_covariance
from handsight.tracking.replay import Step
from handsight.viewer.corrections import require_matplotlib, save

VISION, TRACKED, TRUTH = "0.6", "#c2185b", "black"
MOST_POINTS = 2000
STATES = {"tracking": "#2e7d32", "uncertain": "#e0a100", "lost": "#b71c1c"}


def draw_track(name: str, model: ObjectModel, steps: Sequence[Step], truths: Truths, path: Path) -> None:
    """Writes x, y and z of the base's centre over time to an image file; raises MissingExtra, HandsightError."""
    plt = require_matplotlib()
    times, tracked, seen, true, sigma = _curves(model, steps, truths)
    figure, axes = plt.subplots(
        4, 1, figsize=(9, 9), sharex=True, height_ratios=[3, 3, 3, 0.5], layout="constrained"
    )
    for k, axis in enumerate("xyz"):
        _coordinate(axes[k], times, tracked[:, k], seen[:, k], true[:, k], sigma[:, k])
        axes[k].set_ylabel(f"{axis} [cm]")
    _states(axes[3], steps)
    axes[3].set_xlabel("time [s]")
    world = any(step.T_world_palm is not None for step in steps)
    axes[0].set_title(f"{name}: centre of the base in the {'world' if world else 'palm'}'s frame")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    save(figure, path)


def _curves(
    model: ObjectModel, all_steps: Sequence[Step], truths: Truths
) -> tuple[Array, Array, Array, Array, Array]:
    """Times (n,) [s], and (n, 3) [cm] each: base tracked, seen and true (NaN where not known), sigma of the tracked."""
    every = max(1, len(all_steps) // MOST_POINTS)
    steps = [
        step for k, step in enumerate(all_steps) if k % every == 0 or step.T_palm_object_vision is not None
    ]
    first = steps[0].stamp if steps else 0.0
    tracked, seen, true, sigma = (np.full((len(steps), 3), np.nan) for _ in range(4))
    for i, step in enumerate(steps):
        T_world_palm = np.eye(4) if step.T_world_palm is None else step.T_world_palm
        truth = truths.at(step.stamp)
        base = base_center(model, T_world_palm @ (step.estimate.T_palm_object if truth is None else truth))
        for row, T in (
            (tracked, step.estimate.T_palm_object),
            (seen, step.T_palm_object_vision),
            (true, truth),
        ):
            if T is not None:
                row[i] = 100 * se3.apply(T_world_palm @ T, base[None])[0]
        sigma[i] = 100 * _sigma_of(step, model, T_world_palm[:3, :3], base)
    return np.array([step.stamp - first for step in steps]), tracked, seen, true, sigma


def _sigma_of(step: Step, model: ObjectModel, R_world_palm: Array, point: Array) -> Array:
    """(3,) standard deviations [m] of a point of the object along the world's axes."""
    covariance = R_world_palm @ point_covariance(step.estimate, model, point) @ R_world_palm.T
    return np.asarray(np.sqrt(covariance.diagonal().clip(min=0.0)))


def _coordinate(axes: Any, times: Array, tracked: Array, seen: Array, true: Array, sigma: Array) -> None:
    axes.fill_between(
        times, tracked - sigma, tracked + sigma, color=TRACKED, alpha=0.15, lw=0, label="tracked, ± 1 σ"
    )
    axes.plot(times, seen, "o", mfc="none", mec=VISION, ms=4, label="vision")
    axes.plot(times, tracked, color=TRACKED, lw=1.5, label="tracked")
    known = np.flatnonzero(np.isfinite(true))
    axes.plot(times[known][::10], true[known][::10], ".", color=TRUTH, ms=4, label="truth")
    # A σ of vision alone would flatten everything else.
    all_there = np.concatenate([tracked, seen, true])
    low, high = np.nanmin(all_there), np.nanmax(all_there)
    axes.set_ylim(low - 0.1 * (high - low) - 0.5, high + 0.1 * (high - low) + 0.5)
    axes.grid(alpha=0.3)


def _states(axes: Any, steps: Sequence[Step]) -> None:
    """A strip in the state's colour."""
    if not steps:
        return
    first = steps[0].stamp
    begin, state = first, steps[0].state
    for step in [*steps[1:], None]:
        if step is None or step.state != state:
            end = steps[-1].stamp if step is None else step.stamp
            axes.axvspan(begin - first, end - first, color=STATES[state], lw=0)
            begin, state = end, state if step is None else step.state
    axes.set_yticks([])
    axes.set_ylabel("state", rotation=0, ha="right", va="center")
    for k, (name, color) in enumerate(STATES.items()):
        axes.text(0.01 + 0.12 * k, -1.6, name, color=color, transform=axes.transAxes, fontsize=9)
