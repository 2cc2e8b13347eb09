"""A tracked recording as figure 8 of the paper: the object's position as seen by vision, tracked, and true."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.estimate import point_uncertainty
from handsight.evaluation import Truths, base_center
from handsight.objects import ObjectModel
from handsight.tracking.replay import Step
from handsight.viewer.correction_figures import new_figure, save
from handsight.viewer.timeline import slips_of


def draw_track(name: str, model: ObjectModel, steps: Sequence[Step], truths: Truths, path: Path) -> None:
    """Writes x, y and z of the base's centre over time to an image file; raises MissingExtra, HandsightError."""
    figure = new_figure(9, 9)
    from matplotlib.colors import ListedColormap

    times = np.array([step.stamp - steps[0].stamp for step in steps])
    curves, bases = _curves(model, steps, truths)
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[3, 3, 3, 0.5])
    pink, grey = "#c2185b", "0.6"
    for k, axis in enumerate("xyz"):
        tracked, vision, true, sigma = curves[:, :, k]
        low, high = tracked - sigma, tracked + sigma
        axes[k].fill_between(times, low, high, color=pink, alpha=0.15, lw=0, label="tracked, ± 1 σ")
        axes[k].plot(times, vision, "o", mfc="none", mec=grey, ms=4, label="vision")
        axes[k].plot(times, tracked, color=pink, lw=1.5, label="tracked")
        known = np.flatnonzero(np.isfinite(true))
        axes[k].plot(times[known][::10], true[known][::10], ".", color="black", ms=4, label="truth")
        # The limits ignore sigma: vision's alone would flatten everything else.
        drawn = np.concatenate([tracked, vision, true])
        low, high = np.nanmin(drawn), np.nanmax(drawn)
        axes[k].set_ylim(low - 0.1 * (high - low) - 0.5, high + 0.1 * (high - low) + 0.5)
        axes[k].grid(alpha=0.3)
        axes[k].set_ylabel(f"{axis} [cm]")
    # Where the object is turned, another of its sides faces down, and the base's centre jumps.
    turned = "another side faces down: the base is its middle"
    for jump in times[1:][(np.abs(np.diff(bases, axis=0)) > 1e-6).any(axis=1)]:
        for each in axes[:3]:
            each.axvline(jump, color="0.4", ls=":", lw=1, label=turned)
    # A strip in the colours of the states; a state lasts until the next stamp.
    colors = {"tracking": "#2e7d32", "uncertain": "#e0a100", "lost": "#b71c1c"}
    edges = np.array([step.stamp for step in (*steps, steps[-1])]) - steps[0].stamp
    strip = [[list(colors).index(step.state) for step in steps]]
    axes[3].pcolormesh(edges, [0, 1], strip, cmap=ListedColormap(list(colors.values())), vmin=0, vmax=2)
    axes[3].set_yticks([])
    axes[3].set_ylabel("state", rotation=0, ha="right", va="center")
    for k, (state, color) in enumerate(colors.items()):
        axes[3].text(0.01 + 0.12 * k, -1.6, state, color=color, transform=axes[3].transAxes, fontsize=9)
    # A mark over every plot while the object slips.
    purple, slips = "#6a1b9a", slips_of((step.stamp, step.slip) for step in steps)
    for first, last in slips:
        for each in axes:
            each.axvspan(first - steps[0].stamp, last - steps[0].stamp, color=purple, alpha=0.25, lw=0)
    if slips:
        axes[3].text(0.5, -1.6, "slips", color=purple, transform=axes[3].transAxes, fontsize=9)
    axes[3].set_xlabel("time [s]")
    world = any(step.T_world_palm is not None for step in steps)
    axes[0].set_title(f"{name}: centre of the base in the {'world' if world else 'palm'}'s frame")
    save(figure, path)


def _curves(model: ObjectModel, steps: Sequence[Step], truths: Truths) -> tuple[Array, Array]:
    """Returns (4, n, 3) [cm]: the base's position as tracked, by vision and true, and sigma of the tracked one. What is
    not known is NaN. And the base's centres (n, 3) in the object [m]."""
    curves, bases = np.full((4, len(steps), 3), np.nan), np.empty((len(steps), 3))
    for i, step in enumerate(steps):
        T_world_palm = np.eye(4) if step.T_world_palm is None else step.T_world_palm
        tracked, truth = step.estimate.T_palm_object, truths.at(step.stamp)
        base = bases[i] = base_center(model, T_world_palm @ (tracked if truth is None else truth))
        for k, T in enumerate((tracked, step.T_palm_object_vision, truth)):
            if T is not None:
                curves[k, i] = 100 * se3.apply(T_world_palm @ T, base[None])[0]
        R = T_world_palm[:3, :3]
        variance = (R @ point_uncertainty(step.estimate, model, base)[0] @ R.T).diagonal()
        curves[3, i] = 100 * np.sqrt(variance.clip(min=0.0))
    return curves, bases
