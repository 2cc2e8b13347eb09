"""Which of ten objects a depth image shows, or none of them: how often right, what is claimed where it is not there.

Drawn pictures, on other seeds than the weights were fitted on. Right: the
likeliest of ten is the one, whatever the probability of none. Claimed: and likelier than none; another claimed: another
one is the likeliest, and likelier than none. Absent: the object itself is left out, and nine others are looked for.
Alone: one object is looked for (`locate`), which is there, or is not and another is. Kept, claimed: its probability is
above a threshold; the curve is over thresholds.
"""

import numpy as np
from scipy.special import logit

from handsight.vision import recognise
from handsight.vision.object.first_pose import probabilities
from handsight.vision.object.locate import MIN_PROBABILITY
from testbed import report, sight, ycb
from testbed import sight_scenes as scenes
from testbed.report import Array

RIGHT = 0.1
THRESHOLDS = sorted({0.02, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, MIN_PROBABILITY})


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
    named, likeliest = answer.name or "none", next(iter(answer.scores))
    row = {"hidden": name, "object": of, "seed": seed, "k": k, "named": named, "likeliest": likeliest}
    row |= {"right": likeliest == of, "claimed": named == of, "another": named not in (of, "none")}
    return row | {"another absent": absent.name is not None, "add_s": add_s} | odds


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=30, quick_trials=2)
    ycb.data_or_goodbye()
    if options.seed in sight.FITTED_ON:
        report.say("These seeds are those that numbers were fitted on: others judge.")
    rows: report.Rows = ycb.in_parallel(trial, sight.tasks(options.trials, [options.seed]), "recognising")
    report.write_csv(options.output / "sight_recognition.csv", rows)
    cells = {
        "pictures": report.count,
        "right of ten": report.of("right"),
        "and claimed": report.of("claimed"),
        "another claimed": report.of("another"),
        "another, absent": report.of("another absent"),
    }
    report.print_by("Recognition among ten (synthetic)", rows, "hidden", cells)
    show_thresholds(rows)


def odds_of(rows: report.Rows) -> tuple[Array, Array]:
    """Returns the log odds of each object, (n, 10), and whether it is the right one, (n, 10)."""
    names = list(sight.objects())
    odds = np.array([[row[name] for name in names] for row in rows])
    return odds, np.array([[row["object"] == name for name in names] for row in rows])


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
        mine = "default" if threshold == MIN_PROBABILITY else ""
        cells.append([threshold, *(f"{share:.3f}" for share in kept_and_claimed(rows, threshold)), mine])
    columns = ("probability", "kept, there", "claimed, another there", "")
    report.print_table("One object looked for: there, or another kind in its place", columns, cells)


if __name__ == "__main__":
    main()
