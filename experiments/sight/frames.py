"""Known objects found in real depth images, without a guess: how often right, how certain, which object, how fast.

Without options: the real frames of YCB-Video in the data folder. `--scenes` names any other folder of such frames, or a
scene or split of a BOP data set with its `scene_gt.json` (LM-O, T-LESS, ...; `testbed/real_frames.py`).

  told       one object is looked for: anywhere in the image, in a 2-D box 8 pixels wider than it, in a mask 4 pixels
             wider; or several are explained together (`locate_all`): those that are there, or all that are known
  right      ADD-S (mean distance of the surface from the true one) or MSSD (largest distance of a surface point, modulo
             symmetry) below 10 % of the diameter
  answered   with at least the probability at which `locate` answers; refused: below it, whatever the pose
  any mode   one of the poses is right, whatever their order and probability
  AR         BOP's average recall of what was answered (`testbed/bop.py`), the mean of VSD, MSSD and MSPD; ungated: of
             the first pose whatever its probability, as BOP scores it
  inside     the truth lies in the 95 % region of a right first pose; with the truth's own error: of 2 mm
  absent     all other known objects, each looked for in the whole image or all together: the share that is claimed

The true poses of YCB-Video are good to 2 to 5 mm. Times are of the search (segments and pose), on one thread.
"""

import functools
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.vision import recognise
from handsight.vision.object.first_pose import ObjectDetection, first_pose
from handsight.vision.object.locate import MAX_PLANE, MIN_PROBABILITY, region_log_odds
from handsight.vision.object.locate_all import locate_all
from handsight.vision.object.region import scene_of
from testbed import bop, figures, real_frames, report
from testbed.real_frames import TOLD, Instance, RealFrame
from testbed.report import Array, Row, Rows

TOGETHER = ("those there, together", "all known, together")
WAYS = (*TOLD, *TOGETHER)
RIGHT = 0.1
"""The largest error of a right pose [diameters]."""
SIGMA_TRUTH = 0.002
"""Standard deviation of the true poses along each axis, the least of the 2 to 5 mm that they are good to [m]."""
EDGES = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0)
"""Of probabilities that are compared with how often the pose is right."""
STORED = ("scene", "frame", "object", "told", "answered", "right_s", "right_m", "ar")
"""Columns of `--store`, before those of the pose: a test scores the stored poses again."""
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
COLUMNS = (
    ("answered right, ADD-S", "right_s"),
    ("MSSD", "right_m"),
    ("wrong", "wrong"),
    ("right, refused", "refused"),
    ("any mode, ADD-S", "any_s"),
    ("any, MSSD", "any_m"),
)


def search(model: hs.ObjectModel, frame: RealFrame, wanted: Array | None) -> tuple[ObjectDetection, float]:
    """Returns the poses that an object may have, also improbable ones, and the milliseconds that the search took."""
    begin = time.perf_counter()
    scene = scene_of(frame.camera, frame.depth, wanted=wanted, extent=MAX_PLANE * model.diameter)
    prior = region_log_odds(model, frame.camera, frame.depth, wanted)
    found = first_pose(model, scene, prior=prior)
    return found, 1e3 * (time.perf_counter() - begin)


def judged(
    model: hs.ObjectModel,
    frame: RealFrame,
    truths: list[Instance],
    found: ObjectDetection,
    told: str,
    probability: float,
) -> Row:
    """Returns how good the poses are of one search, for the truth of several equal objects that is nearest.

    probability: of the first; from `MIN_PROBABILITY` on it is an answer.
    """
    Ts = found.Ts_camera_object
    errors = [[(bop.mssd(model, truth.T_camera_object, T), k) for k, truth in enumerate(truths)] for T in Ts]
    best = [min(error) for error in errors]
    of = truths[best[0][1] if best else 0]
    mssd = np.array([error for error, _ in best])
    add_s = np.array(
        [real_frames.add_s(model, truths[k].T_camera_object, T) for T, (_, k) in zip(Ts, best, strict=True)]
    )
    answered = bool(len(Ts)) and probability >= MIN_PROBABILITY
    first = add_s[:1] < RIGHT, mssd[:1] < RIGHT
    row: Row = {"scene": frame.scene, "frame": frame.name, "object": of.name, "told": told}
    row |= {"visible": of.share, "probability": probability, "answered": int(answered)}
    row |= {"right_s": int(answered and first[0].all()), "right_m": int(answered and first[1].all())}
    row |= {"wrong": int(answered and not first[0].all())}
    row |= {"refused": int(bool(len(Ts)) and not answered and first[0].all())}
    row |= {"any_s": int((add_s < RIGHT).any()), "any_m": int((mssd < RIGHT).any()), "modes": len(Ts)}
    row |= {
        "first_s": int(bool(len(Ts)) and first[0].all()),
        "first_m": int(bool(len(Ts)) and first[1].all()),
    }
    recalls = 0.0, 0.0, 0.0
    if len(Ts):
        T, T_true = Ts[0], of.T_camera_object
        recalls = bop.pose_errors(model, frame.camera, frame.depth, T_true, T).recalls
        row |= {"add_s_mm": 1e3 * model.diameter * add_s[0], "mssd_mm": 1e3 * model.diameter * mssd[0]}
        if first[1].all():
            for name, sigma in (("inside", 0.0), ("inside_truth", SIGMA_TRUTH)):
                squared, free = real_frames.squared_error(model, T_true, T, found.covariances[0], sigma)
                row[name] = int(squared < chdtri(free, 0.05))
        quaternion_xyzw = se3.quaternion_from_rotation(T[:3, :3])
        row |= dict(zip(POSE, (float(x) for x in (*T[:3, 3], *quaternion_xyzw)), strict=True))
    row |= dict(zip(("ar_vsd", "ar_mssd", "ar_mspd"), recalls, strict=True)) | {"ar": float(np.mean(recalls))}
    return row


def of_frame(models: dict[str, hs.ObjectModel], frame: RealFrame, *, recognition: bool) -> Rows:
    """Returns all answers in one image."""
    rows = []
    by_name = {name: [one for one in frame.instances if one.name == name] for name in models}
    for name, truths in by_name.items():
        model = models[name]
        if not truths:
            found, ms = search(model, frame, None)
            claimed = len(found.weights) > 0 and found.probability >= MIN_PROBABILITY
            rows.append(absent_row(frame, name, "absent", found.probability, claimed) | {"ms": ms})
            continue
        for told in TOLD:
            # Anywhere in the image each of several equal objects is an answer; a box or a mask is of one.
            for group in [truths] if told == "whole image" else [[one] for one in truths]:
                wanted = frame.wanted(group[0], told)
                found, ms = search(model, frame, wanted)
                rows.append(judged(model, frame, group, found, told, found.probability) | {"ms": ms})
                if recognition and told != "whole image":
                    begin = time.perf_counter()
                    answer = recognise(models, frame.depth, frame.camera, mask=wanted)
                    likeliest = next(iter(answer.scores))
                    rows[-1] |= {
                        "likeliest_right": likeliest == group[0].name,
                        "named": answer.name or "none",
                    }
                    rows[-1]["named_right"] = answer.name == group[0].name
                    rows[-1]["recognition_ms"] = 1e3 * (time.perf_counter() - begin)
    return rows


def absent_row(frame: RealFrame, name: str, told: str, probability: float, claimed: bool) -> Row:
    """Returns the row of an object that is not in the image."""
    row: Row = {"scene": frame.scene, "frame": frame.name, "object": name, "told": told}
    return row | {"probability": probability, "answered": int(claimed)}


def together(models: dict[str, hs.ObjectModel], frame: RealFrame, told: str) -> Rows:
    """Returns the answers where objects are explained together; one more than there are is one that is absent."""
    there = Counter(one.name for one in frame.instances)
    asked = {name: models[name] for name in there} if told == TOGETHER[0] else models
    begin = time.perf_counter()
    counts = there if told == TOGETHER[0] else None
    answer = locate_all(asked, frame.depth, frame.camera, counts=counts)
    ms = 1e3 * (time.perf_counter() - begin) / len(asked)
    rows, left = list[Row](), list(frame.instances)
    for instance in answer.instances:
        model, T = models[instance.name], instance.detection.Ts_camera_object[0]
        equal = [one for one in left if one.name == instance.name]
        if equal:
            truth = min(equal, key=lambda one: bop.mssd(model, one.T_camera_object, T))
            left.remove(truth)
            rows.append(
                judged(model, frame, [truth], instance.detection, told, instance.detection.probability)
            )
        else:
            rows.append(
                absent_row(frame, instance.name, f"absent, {told}", instance.detection.probability, True)
            )
    for one in left:
        rows.append(judged(models[one.name], frame, [one], ObjectDetection.nowhere(""), told, 0.0))
    claimed = {instance.name for instance in answer.instances}
    rows += [
        absent_row(frame, name, f"absent, {told}", 0.0, False)
        for name in asked
        if name not in there and name not in claimed
    ]
    return [row | {"ms": ms} for row in rows]


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(f"{__doc__}\nTrials: the most frames of each scene.")
    where = "folder of frames, or of BOP's scenes (default: the data folder's ycbv_frames)"
    arguments.add_argument("--scenes", type=Path, metavar="DIR", help=where)
    arguments.add_argument("--no-recognition", action="store_true", help="only one object at a time")
    arguments.add_argument("--store", type=Path, metavar="FILE", help="file for the poses alone, for a test")
    options, given = report.parsed(arguments, trials=1000, quick_trials=2)
    try:
        frames = real_frames.open_folder(given.scenes or real_frames.default_folder())
    except ValueError as error:
        arguments.error(str(error))
    chosen = frames.some(options.trials)
    for model in frames.models.values():  # what is computed and compiled once is no image's time
        search(model, chosen[0](), None)
    rows: Rows = []
    for read in report.progress(chosen, "looking for objects"):
        frame = read()
        rows += of_frame(frames.models, frame, recognition=not given.no_recognition)
        if not given.no_recognition:
            for told in TOGETHER:
                rows += together(frames.models, frame, told)
    report.write_csv(options.output / "sight_frames.csv", rows)
    if given.store:
        poses = [{name: row[name] for name in (*STORED, *POSE)} for row in rows if "qx" in row]
        report.write_csv(given.store, poses)
    show(rows)
    report.say(f"The truth scored as an answer: AR {truth_recall(frames.models, chosen):.3f}.")
    report.say(report.machine())
    draw(frames.models, chosen, rows, options.output / "sight_frames.png")


def truth_recall(models: dict[str, hs.ObjectModel], chosen: list[Any]) -> float:
    """Returns the AR of the true poses scored as answers, which is 1 where scoring is right."""
    recalls = []
    for read in chosen:
        frame = read()
        for one in frame.instances:
            at = one.T_camera_object
            errors = bop.pose_errors(models[one.name], frame.camera, frame.depth, at, at)
            recalls.append(np.mean(errors.recalls))
    return float(np.mean(recalls))


def gated(name: str) -> report.Cell:
    """Returns the cell of the mean of a recall, which is 0 where it was not answered."""
    return lambda rows: f"{np.mean([row[name] * row['answered'] for row in rows]):.3f}"


ANSWERS: dict[str, report.Cell] = {"n": report.count}
ANSWERS |= {title: report.of(name, ".3f" if name == "wrong" else ".2f") for title, name in COLUMNS}
ANSWERS |= {"ADD-S, mm": report.where(report.of("add_s_mm", ".1f", np.median), right_s=1)}
RECALLS: dict[str, report.Cell] = {
    "VSD": gated("ar_vsd"),
    "MSSD": gated("ar_mssd"),
    "MSPD": gated("ar_mspd"),
    "AR": gated("ar"),
    "ungated": report.of("ar", ".3f"),
    "inside": report.of("inside"),
    "and truth's": report.of("inside_truth"),
    "ms": report.of("ms", ".1f", np.median),
    "p95": report.of("ms", ".1f", report.quantile(0.95)),
}
ABSENT = {"n": report.count, "claimed": report.of("answered", ".3f"), "above .5": report.of("sure", ".3f")}
WHICH = {
    "n": report.count,
    "right one likeliest": report.of("likeliest_right"),
    "and claimed": report.of("named_right"),
    "ms": report.of("recognition_ms", ".0f", np.median),
}
BY_OBJECT: dict[str, report.Cell] = {
    "n": report.count, "ADD-S": report.of("right_s"), "MSSD": report.of("right_m"), "AR": gated("ar"),
}  # fmt: skip


def show(rows: Rows) -> None:
    """Prints all tables."""
    there = [row for told in WAYS for row in report.chosen(rows, told=told)]
    every = [row | {"scene": "all"} for row in there]
    several = there if len(report.distinct(there, "scene")) > 1 else []
    report.print_by(
        "First poses in real depth images", several + every, "told, scene", ANSWERS, "wrong: by ADD-S."
    )
    note = f"inside: of 95 % regions; truth's: with its own error of {1e3 * SIGMA_TRUTH:g} mm."
    report.print_by(
        "BOP's average recall, regions, times", several + every, "told, scene", RECALLS, note, detail=True
    )
    by_object = sorted(there, key=lambda row: str(row["object"]))
    report.print_by("By object", by_object, "object, told", BY_OBJECT, detail=True)
    absent = [row | {"sure": row["probability"] > 0.5} for row in rows if row["told"].startswith("absent")]
    report.print_by("Absent objects", absent, "told", ABSENT)
    named = [row for row in there if "named_right" in row]
    report.print_by("Which of all objects", named, "told", WHICH, detail=True)
    cells = [[f"{p:.2f}", f"{right:.2f}", n] for p, right, n in reliability(rows)]
    note = "Present and absent objects count half each."
    report.print_table("Probabilities", "mean | right | n", cells, note, detail=True)


def reliability(rows: Rows) -> list[tuple[float, float, int]]:
    """Returns for each range of probabilities, in the whole image, their mean, the share that is right, how many."""
    groups = [report.chosen(rows, told=told) for told in (TOLD[0], "absent")]
    half = [1 / max(len(group), 1) for group in groups]
    told = [
        (row["probability"], row.get("first_s", 0), weight)
        for group, weight in zip(groups, half, strict=True)
        for row in group
    ]
    p, right, weight = np.array(told).reshape(-1, 3).T
    bins = []
    for low, high in pairwise(EDGES):
        among = (p >= low) & ((p < high) | (high == EDGES[-1]))
        if among.any():
            mean = functools.partial(np.average, weights=weight[among])
            bins.append((float(mean(p[among])), float(mean(right[among])), int(among.sum())))
    return bins


def draw(models: dict[str, hs.ObjectModel], chosen: list[Any], rows: Rows, path: Path) -> None:
    """The worst and the best frame with the answers in the whole image, and how often probabilities are right."""
    plt = figures.pyplot()
    figure, panels = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained", width_ratios=(4, 4, 3))
    whole = report.chosen(rows, told=TOLD[0])
    frames = dict[tuple[str, str], Rows]()
    for row in whole:
        frames.setdefault((row["scene"], row["frame"]), []).append(row)
    order = sorted(frames, key=lambda key: np.mean([row["ar"] * row["answered"] for row in frames[key]]))
    read = {
        key: frame
        for frame in (read() for read in chosen)
        if (key := (frame.scene, frame.name)) in (order[0], order[-1])
    }
    for axes, key, title in zip(panels, (order[0], order[-1]), ("worst", "best"), strict=False):
        overlay(axes, models, read[key], frames[key])
        ar = np.mean([row["ar"] * row["answered"] for row in frames[key]])
        axes.set_title(f"{title} frame, {key[0]}/{key[1]}: AR {ar:.2f}")
    colors = "true green; right yellow, by ADD-S only orange, wrong red; refused dashed"
    panels[0].text(0, -0.06, colors, transform=panels[0].transAxes)
    p, right, _ = np.array(reliability(rows)).T
    panels[2].plot([0, 1], [0, 1], color="0.7", linewidth=1)
    panels[2].plot(p, right, "o-", color="tab:blue")
    panels[2].set(
        xlabel="probability of the first pose",
        ylabel="share that is right",
        title="Probabilities, whole image",
    )
    figures.save(figure, path)


def overlay(axes: Any, models: dict[str, hs.ObjectModel], frame: RealFrame, rows: Rows) -> None:
    """Shows a depth image with the outlines of true and first poses, by colour right or not, dashed where refused."""
    depth = np.where(frame.depth > 0, frame.depth, np.nan)
    middle = np.median([one.T_camera_object[2, 3] for one in frame.instances])
    axes.imshow(depth, cmap="gray_r", vmin=middle - 0.5, vmax=middle + 0.5)
    lines = [(one.name, one.T_camera_object, figures.TRUTH, "solid") for one in frame.instances]
    for row in rows:
        if "qx" in row:
            T = se3.from_position_quaternion([row[k] for k in "xyz"], [row[f"q{k}"] for k in "xyzw"])
            color = figures.RESULT if row["first_m"] else "tab:orange" if row["first_s"] else "tab:red"
            lines.append((row["object"], T, color, "solid" if row["answered"] else "dashed"))
    for name, T, color, style in lines:
        outline = bop.drawn(models[name], frame.camera, T) > 0
        if outline.any():
            axes.contour(outline, levels=[0.5], colors=[color], linewidths=1.2, linestyles=style)
    at = [np.nonzero(one.visible) for one in frame.instances]
    rows_, columns = (np.concatenate([pixels[k] for pixels in at]) for k in (0, 1))
    axes.set(xlim=(columns.min() - 60, columns.max() + 60), ylim=(rows_.max() + 60, rows_.min() - 60))
    axes.axis("off")


if __name__ == "__main__":
    main()
