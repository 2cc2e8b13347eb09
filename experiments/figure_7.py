"""Fig. 7 of the paper: a held can and box, where vision sees them and where touch puts them.

Simulated grasps (MuJoCo), rendered from the robot's own camera's side: the object as it is, as vision sees it (green,
through the fingers), and corrected (pink). Needs EGL or OSMesa; without, it says so and ends.
"""

from collections import Counter

import numpy as np

import report
from grasp_errors import pose_errors
from grasp_methods import corrected
from grasp_trials import OBJECTS, SEEDS_APART, grasps
from handsight.errors import MissingExtra
from handsight.simulation import looking, render

METHODS = {"can": "maximum, table", "box": "mean, outside, table"}
GREEN, PINK = (0.2, 0.75, 0.3, 0.6), (0.95, 0.3, 0.65, 0.6)
AWAY = np.array([-0.16, 0.36, 0.22])
"""Of the eye from the object [m]: the side of the robot's camera, nearer."""
CLOSE = slice(30, 450), slice(70, 570)
"""The part of a picture that is shown."""
CENTRED = 0.06
"""The picture's middle is so far towards the hand from the object's [m]."""


def eye(sample):
    """T_world_camera (4, 4) near the object."""
    at = sample.T_world_object[:3, 3] - [CENTRED, 0, 0]
    return looking(at + AWAY, at)


def pictures(trial, estimate):
    """As it is, as vision sees it, corrected: (h, w, 3) each."""
    shown = [(None, None), (trial.vision.T_palm_object, GREEN), (estimate.T_palm_object, PINK)]
    found = []
    for ghost, colour in shown:
        drawn = {} if ghost is None else {"ghost": ghost, "color": colour, "show_object": False}
        picture = render(trial.scenario, trial.sample, T_world_camera=eye(trial.sample), **drawn)
        found.append(picture[CLOSE])
    return found


def typical(name, options):
    """Of some grasps the one whose vision is wrong by the middle amount."""
    trials = list(grasps(name, options.trials, options.seed * SEEDS_APART, Counter()))
    return sorted(trials, key=lambda t: errors_mm(t, t.vision.T_palm_object))[len(trials) // 2]


def errors_mm(trial, T_palm_object):
    """Of the base's centre, as the paper measures it."""
    return pose_errors(trial.model, T_palm_object, trial.sample)["read"]


def compared(name, options):
    """A grasp's row of errors, and three pictures with their titles."""
    trial = typical(name, options)
    estimate = corrected(trial, METHODS[name])
    vision, ours = (errors_mm(trial, T) for T in (trial.vision.T_palm_object, estimate.T_palm_object))
    row = {"object": name, "seed": trial.scenario.seed, "method": METHODS[name]}
    row |= {"vision_mm": vision, "corrected_mm": ours}
    titles = ["as it is", f"vision: {vision:.0f} mm off", f"corrected: {ours:.1f} mm off"]
    return row, list(zip(titles, pictures(trial, estimate), strict=True))


def main():
    """Chooses a grasp of each object, corrects it, draws."""
    options, _ = report.parsed(report.parser(__doc__), trials=11, quick_trials=3)
    try:
        found = [compared(name, options) for name in OBJECTS]
    except MissingExtra as error:
        report.say(f"skipped: {error}")
        return
    plt = report.pyplot()
    figure, panels = plt.subplots(2, 3, figsize=(11, 6.6), layout="constrained")
    for line, (_, shown) in zip(panels, found, strict=True):
        for axes, (title, picture) in zip(line, shown, strict=True):
            axes.imshow(picture)
            axes.set_title(title)
            axes.axis("off")
    report.write_csv(options.output / "figure_7.csv", [row for row, _ in found])
    report.save_figure(figure, options.output / "figure_7.png")


if __name__ == "__main__":
    main()
