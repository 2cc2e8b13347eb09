"""Objects followed on real frames, behind drawn occluders, and until they are lost: how far off, and what is said.

Real: the twenty consecutive frames (30 Hz) of YCB-Video's scene in the data folder, which does not move but for the
camera; each object is followed from its true pose and from where `locate` finds it. Real with a drawn occluder: the
same depth, before it a Shadow hand whose pixels are known by its joints (told, each wrong by 1 degree) or not, or a
board; from the true pose. The true poses are good to 2 to 5 mm. Drawn: two other objects touch the one that is
followed, on a table, and something happens to it:
{kinds}

  hidden     share of the silhouette
  ADD-S, MSSD  mean distance of the surface from the true one [mm], largest distance of a surface point [diameters]
  right      MSSD below 10 % of the diameter
  inside     of `tracking` poses, those with the truth in their 95 % region, the truth's own error being 2 mm
  ms         process CPU time of a step, median and 99th percentile, searches of the whole image included
  off        the object is not there, or its ADD-S is above 10 %; images in which a body hides all of where it is or
             was (> 90 %) are left out, as nobody can know. A lost image counts with the pose that was tried
  recall     share of the images that are off that are `lost`; with `uncertain` added; precision: of `lost`, those off
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.vision import DepthTracker
from testbed import losing, real_frames, report, sight
from testbed import sight_scenes as scenes
from testbed.report import Row, Rows
from testbed.sequences import timed

__doc__ = __doc__.format(kinds="\n".join(f"  {kind:<10} {what}" for kind, what in losing.KINDS.items()))

SCENE = "0000"
OCCLUDERS = ("hand, told", "hand, not told", "board")
SHARES = (0.2, 0.4, 0.6, 0.8)
BINS = (0.01, 0.3, 0.6, 0.8, 1.0)
RIGHT, COVERED, SIGMA_TRUTH = 0.1, 0.9, 0.002
"""Errors of a right pose [diameters]; the hidden share beyond which nobody can know; of the true poses [m]."""


def followed(
    model: hs.ObjectModel, camera: Camera, images: Iterable[losing.Instant], start: Any, key: Row
) -> Rows:
    """Returns a row for each image of an object that is followed from a pose (4, 4), or from where it is found."""
    tracker, rows = DepthTracker(model, camera, start=start), list[Row]()
    for k, image in enumerate(images):
        sighting, seconds = timed(lambda: tracker.update(image.stamp, image.depth, hand=image.hand))  # noqa: B023
        pose, T_true = sighting.candidate["pose"][0], image.T_camera_object
        row = key | {"image": k, "state": sighting.state, "hidden": image.hidden, "ms": 1e3 * seconds}
        row |= {"there": T_true is not None, "add_s": np.inf, "mssd": np.inf, "inside": np.nan}
        T = se3.compose(pose["rotation"], pose["position"])
        if T_true is not None and np.linalg.det(T[:3, :3]) > 0.9:  # 0 before anything was tried
            row["add_s"] = real_frames.add_s(model, T_true, T)
            row["mssd"] = float(scenes.mssd(model, T_true, T[None])[0])
            row["mm"] = 1e3 * model.diameter * row["add_s"]
        if T_true is not None and sighting.covariance is not None and sighting.state == "tracking":
            squared, freedom = real_frames.squared_error(model, T_true, T, sighting.covariance, SIGMA_TRUTH)
            row["inside"] = float(squared < chdtri(freedom, 0.05))
        rows.append(row)
    return rows


def real_rows(seed: int) -> Rows:
    """Returns the rows of the real frames, without and with drawn occluders."""
    frames = real_frames.open_folder(real_frames.default_folder())
    images = [read() for read in frames.scenes[SCENE]]
    camera, rows = images[0].camera, list[Row]()
    for number, instance in enumerate(images[0].instances):
        name, model = instance.name, frames.models[instance.name]
        plain = [
            losing.Instant(k / losing.RATE, np.nan_to_num(frame.depth), None, T, 0.0)
            for k, frame in enumerate(images)
            for T in [next(i.T_camera_object for i in frame.instances if i.name == name)]
        ]
        for begin, start in (("true pose", instance.T_camera_object), ("locate", None)):
            rows += followed(
                model, camera, plain, start, {"object": name, "occluder": "none", "begin": begin}
            )
        for share in report.progress(SHARES, f"following {name}"):
            for occluder in OCCLUDERS:
                rng = np.random.default_rng([seed, number, round(100 * share), occluder == "board"])
                body = losing.Occluder.drawn(rng, hand=occluder != "board")
                hidden = losing.occluded(model, images, name, body, share, told=occluder == "hand, told")
                key: Row = {"object": name, "occluder": occluder, "begin": "true pose"}
                rows += followed(model, camera, hidden, instance.T_camera_object, key)
    return rows


def lost_rows(trials: int, options: report.Options) -> Rows:
    """Returns the rows of so many drawn sequences."""
    models, rows = sight.objects(), list[Row]()
    for k in report.progress(range(trials), "losing"):
        rng, kind = options.rng(k), list(losing.KINDS)[k % len(losing.KINDS)]
        name = list(models)[k // len(losing.KINDS) % len(models)]
        others = rng.choice([other for other in models if other != name], 3, replace=False)
        images = list(losing.lost(kind, [models[name], *(models[other] for other in others)], rng))
        key: Row = {"kind": kind, "sequence": k, "object": name}
        rows += followed(models[name], scenes.WIDE, images, images[0].T_camera_object, key)
    return rows


def show_real(rows: Rows) -> None:
    """Prints how well objects are followed, by occluder and hidden share, and how far they drift."""
    cells: dict[str, report.Cell] = {"images": report.count}
    cells |= {"ADD-S mm": report.of("mm", ".1f", np.median), "MSSD": report.of("mssd", ".3f", np.median)}
    cells["right"] = report.of("right")
    for state in ("tracking", "uncertain", "lost"):
        cells[state] = report.of(state)
    cells |= {"inside": report.of("inside"), "ms": report.of("ms", ".2f", np.median)}
    cells["99 %"] = report.of("ms", ".1f", report.quantile(0.99))
    binned = [row | {"hidden share": bin_of(row), row["state"]: 1.0} for row in rows]
    states = dict.fromkeys(("tracking", "uncertain", "lost"), 0.0)
    binned = [states | row | {"right": row["mssd"] < RIGHT} for row in binned]
    shown = [
        row for row in binned if row["occluder"] == "none" or row["hidden share"] != "0 %"
    ]  # 0 %: before it comes
    shown.sort(key=lambda row: (("none", *OCCLUDERS).index(row["occluder"]), row["hidden"]))
    report.print_by(
        "Objects followed on real frames", shown, "occluder, hidden share", cells, report.machine()
    )

    plain = report.chosen(rows, occluder="none")
    drift: dict[str, report.Cell] = {
        "MSSD at first": report.where(report.of("mssd", ".3f"), image=0),
        "in the end": lambda rows: report.of("mssd", ".3f", np.median)(rows[-5:]),
        "ADD-S mm at first": report.where(report.of("mm", ".1f"), image=0),
        "then": lambda rows: report.of("mm", ".1f", np.median)(rows[-5:]),
    }
    report.print_by("Drift over the twenty real frames", plain, "object, begin", drift, detail=True)


def bin_of(row: Row) -> str:
    """Returns the range of the hidden share."""
    if row["hidden"] <= BINS[0]:
        return "0 %"
    return next(f"{low:.0%} to {high:.0%}" for low, high in pairwise(BINS) if row["hidden"] <= high)


def show_lost(rows: Rows) -> None:
    """Prints what is said of objects that are lost, and of those that are not."""
    table = []
    for kind in (*losing.KINDS, "all"):
        mine = [r for r in rows if kind in (r["kind"], "all") and r["hidden"] <= COVERED]
        off = [r for r in mine if not r["there"] or r["add_s"] > RIGHT]
        good = [r for r in mine if r["there"] and not r["add_s"] > RIGHT]
        counts = [
            [len(report.chosen(some, state=s)) for s in ("lost", "uncertain", "tracking")]
            for some in (off, good)
        ]
        (lost, unsure, _), (wrong, _, kept) = counts
        recall = f"{lost / len(off):.3f} {(lost + unsure) / len(off):.3f}" if off else ""
        precision = f"{lost / (lost + wrong):.3f}" if lost + wrong else ""
        table.append([kind, len(off), *counts[0], recall, precision, len(good), kept, wrong])
    columns = " | off | lost | uncertain | tracking | recall | precision | not off | tracking | lost"
    report.print_table("Objects that are lost (synthetic)", columns, table)
    hidden = [r for r in rows if r["there"] and 0.6 < r["hidden"] <= 0.8]
    if hidden:
        right = np.mean(report.values(hidden, "mssd") < RIGHT)
        report.say(f"At 60 to 80 % hidden MSSD is below 10 % in {right:.2f} of {len(hidden)} drawn images.")
    inside = report.values(rows, "inside")
    report.say(f"95 % regions of drawn `tracking` poses hold the truth in {np.nanmean(inside):.3f}.")


@report.or_skip
def main() -> None:
    """Follows, prints."""
    options = report.options(f"{__doc__}\nA trial is a drawn sequence.", trials=210, quick_trials=7)
    real_frames.default_folder()  # says so, and ends, where the frames are not here
    rows = real_rows(options.seed)
    show_real(rows)
    report.write_csv(options.output / "sight_following.csv", rows)
    rows = lost_rows(options.trials, options)
    show_lost(rows)
    report.write_csv(options.output / "sight_losing.csv", rows)


if __name__ == "__main__":
    main()
