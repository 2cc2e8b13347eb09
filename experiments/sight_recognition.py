"""Which of ten objects a depth image shows, or none of them: how often right, what is claimed where it is not there.

The pictures of `experiments/sight_first_pose.py`, on other seeds than `experiments/sight_fit.py` fitted on. Right: the
likeliest of ten is the one, whatever the probability of none. Claimed: and likelier than none; another claimed: another
one is the likeliest, and likelier than none. Absent: the object itself is left out, and nine others are looked for.
Alone: one object is looked for (`locate`), which is there, or is not and another is. Kept, claimed: its probability is
above a threshold; the curve is over thresholds.
"""

from pathlib import Path

import numpy as np
from scipy.special import logit

from handsight.vision import recognise
from handsight.vision.object.first_pose import probabilities
from handsight.vision.object.locate import LOCATE
from shared import figures, report, sight, ycb
from shared import sight_scenes as scenes
from testbed.report import Array

RIGHT = 0.1
THRESHOLDS = sorted({0.02, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, LOCATE.min_probability})


def trial(name: str, k: int, seed: int) -> report.Row:
    """Returns the log odds of each of ten objects in one picture."""
    of, picture = sight.picture(name, k, seed)
    models, image = sight.objects(), (picture.depth, scenes.WIDE)
    answer = recognise(models, *image, mask=picture.wanted, hand=picture.hand)
    # Of an absent object nothing else changes than that it is not compared.
    others = {each: found for each, found in answer.found.items() if each != of}
    absent = recognise(models, *image, found=others, mask=picture.wanted, hand=picture.hand)
    odds = {
        each: float(logit(np.clip(found.probability, 1e-12, 1 - 1e-12)))
        for each, found in answer.found.items()
    }
    Ts = answer.found[of].Ts_camera_object[:1]
    add_s = float(scenes.adds(picture.model, picture.T_camera_object, Ts)[0]) if len(Ts) else 9.0
    return {
        "bin": name,
        "object": of,
        "seed": seed,
        "k": k,
        "named": answer.name or "none",
        "absent": absent.name or "none",
        "likeliest": next(iter(answer.scores)),
        "add_s": add_s,
    } | odds


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=30, quick_trials=2)
    ycb.data_or_goodbye()
    if options.seed in sight.FITTED_ON:
        report.say("These seeds are those that numbers were fitted on: others judge.")
    rows: report.Rows = ycb.in_parallel(trial, sight.tasks(options.trials, [options.seed]), "recognising")
    report.write_csv(options.output / "sight_recognition.csv", rows)
    show(rows)
    show_thresholds(rows)
    draw(rows, options.output / "sight_recognition.png")


def odds_of(rows: report.Rows) -> tuple[Array, Array]:
    """Returns the log odds of each object, (n, 10), and whether it is the right one, (n, 10)."""
    names = list(sight.objects())
    odds = np.array([[row[name] for name in names] for row in rows])
    return odds, np.array([[row["object"] == name for name in names] for row in rows])


def show(rows: report.Rows) -> None:
    """Prints a line a bin."""
    cells = []
    for name in report.distinct(rows, "bin"):
        pictures = report.chosen(rows, bin=name)
        right = np.array([row["likeliest"] == row["object"] for row in pictures])
        named = np.array([row["named"] == row["object"] for row in pictures])
        wrong = np.array([row["named"] not in (row["object"], "none") for row in pictures])
        absent = np.array([row["absent"] != "none" for row in pictures])
        shares = (f"{share.mean():.2f}" for share in (right, named, wrong, absent))
        cells.append([name, len(pictures), *shares])
    columns = ("hidden", "pictures", "right of ten", "and claimed", "another claimed", "another, absent")
    report.print_table("Recognition among ten (synthetic)", columns, cells)


def kept_and_claimed(rows: report.Rows, threshold: float) -> tuple[float, float]:
    """Returns the shares of correctly found and of absent objects that are reported, each searched alone."""
    odds, true = odds_of(rows)
    found = np.array([row["add_s"] < RIGHT for row in rows])
    claimed = np.vectorize(lambda x: probabilities(np.array([x]))[0])(odds) > threshold
    return float(claimed[true][found].mean()), float(claimed[~true].mean())


def show_thresholds(rows: report.Rows) -> None:
    """Prints which objects `locate` reports."""
    cells = []
    for threshold in THRESHOLDS:
        mine = "default" if threshold == LOCATE.min_probability else ""
        cells.append([threshold, *(f"{share:.3f}" for share in kept_and_claimed(rows, threshold)), mine])
    columns = ("probability", "kept, there", "claimed, another there", "")
    report.print_table("One object looked for: there, or another kind in its place", columns, cells)


def draw(rows: report.Rows, path: Path) -> None:
    """The operating curve, by bins."""
    plt = figures.pyplot()
    figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
    levels = np.concatenate([np.linspace(0.001, 0.999, 120), 1 - np.geomspace(1e-3, 1e-6, 20)])
    for name in report.distinct(rows, "bin"):
        curve = np.array([kept_and_claimed(report.chosen(rows, bin=name), level) for level in levels])
        axes.plot(100 * curve[:, 1], 100 * curve[:, 0], label=name)
    axes.set(xlabel="another object claimed as it [%]", ylabel="kept where it is there [%]", xlim=(0, 30))
    axes.legend(fontsize=7)
    figures.save(figure, path)


if __name__ == "__main__":
    main()
