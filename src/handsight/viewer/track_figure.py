"""A tracked recording as figure 8 of the paper: the object's position as seen by vision, tracked, and true."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.estimate import point_uncertainty
from handsight.evaluation import Truths
from handsight.objects import ObjectModel
from handsight.tracking.replay import Step
from handsight.viewer.correction_figures import new_figure, save
from handsight.viewer.panel import SLIP, STATES
from handsight.viewer.timeline import slips_of


def draw_track(name: str, model: ObjectModel, steps: Sequence[Step], truths: Truths, path: Path) -> None:
    """Writes x, y and z of the object's middle over time to an image file; raises MissingExtra, HandsightError."""
    figure = new_figure(9, 9)
    begin = steps[0].stamp
    times = np.array([step.stamp - begin for step in steps])
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[6, 6, 6, 1])
    pink = "#c2185b"
    curves = _curves(model, steps, truths)
    for plot, axis, (tracked, vision, true, sigma) in zip(axes, "xyz", curves, strict=False):
        plot.fill_between(times, tracked - sigma, tracked + sigma, color="#f0c5d6", label="tracked, ± 1 σ")
        plot.plot(times, vision, "o", mfc="none", mec="grey", ms=4, label="vision")
        plot.plot(times, tracked, color=pink, label="tracked")
        known = np.flatnonzero(np.isfinite(true))[::10]
        plot.plot(times[known], true[known], "k.", ms=4, label="truth")
        # The limits ignore sigma: vision's alone would flatten everything else.
        drawn = np.concatenate([tracked, vision, true])
        plot.set_ylim(np.nanmin(drawn) - 1, np.nanmax(drawn) + 1)
        plot.grid(visible=True)
        plot.set_ylabel(f"{axis} [cm]")
    for state, color in STATES.items():
        here = [step.state == state for step in steps]
        axes[3].plot(times[here], np.zeros(sum(here)), "s", ms=9, color=color, label=state)
    axes[3].set(yticks=[], ylabel="state", xlabel="time [s]")
    for first, last in slips_of((step.stamp, step.slip) for step in steps):
        for plot in axes:
            plot.axvspan(first - begin, last - begin, color=SLIP, alpha=0.25, label="slips")
    world = any(step.T_world_palm is not None for step in steps)
    axes[0].set_title(f"{name}: the object's middle in the {'world' if world else 'palm'}'s frame")
    save(figure, path)


def _curves(model: ObjectModel, steps: Sequence[Step], truths: Truths) -> Array:
    """Returns (3, 4, n) [cm] for x, y, z: the middle as tracked, by vision and true, and the tracked one's sigma; NaN
    where it is not known."""
    curves = np.full((3, 4, len(steps)), np.nan)
    middle = model.center_object
    for i, step in enumerate(steps):
        T_world_palm = np.eye(4) if step.T_world_palm is None else step.T_world_palm
        poses = step.estimate.T_palm_object, step.T_palm_object_vision, truths.at(step.stamp)
        for k, T_palm_object in enumerate(poses):
            if T_palm_object is not None:
                curves[:, k, i] = 100 * se3.apply(T_world_palm @ T_palm_object, middle[None])[0]
        R = T_world_palm[:3, :3]
        variance = (R @ point_uncertainty(step.estimate, model, middle)[0] @ R.T).diagonal()
        curves[:, 3, i] = 100 * np.sqrt(variance.clip(min=0.0))
    return curves
