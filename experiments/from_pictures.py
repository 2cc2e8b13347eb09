"""Section III with poses from pictures in place of drawn ones, the camera 8 cm off; and what touch adds to vision.

The simulated Shadow hand grasps can and box before a structured-light camera whose depth has such a camera's errors,
and whose calibration is wrong by 8 cm in the table's plane on average, 64 mm in height and 6 degrees. Only the first
row draws poses. Errors are those at the end of the grasp, against the exact truth, modulo symmetry. Everything is
SYNTHETIC (MuJoCo); the model of the object is exact.

  drawn + touch      the former way: a pose drawn with the camera's error, and contacts
  pictures           the object tracked in the depth images, the camera's pose as calibrated
  pictures + touch   those poses, and contacts
  seen hand          the camera's pose is estimated from the hand in the same images; contacts are not used
  seen hand + touch  what `Tracker` and `handsight track` do with images

The second table: how touch and vision help each other where part of the object is covered (from the first quarter of a
second on, a share of its pixels on one side has no depth; an object covered from the first image on is never found),
where the depth is noisier by a factor, and where the camera's error is smaller.

  touch              contacts alone, without a prior

The third: what touch adds to the error of vision alone in the same grasps, and in those where vision was good.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.objects import nearest
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import Rig
from handsight.simulation import Nuisances, Sample, Scenario, model_of, rig_of, simulate, true_camera
from handsight.tracking import TrackerSettings
from handsight.vision import DepthTracker, hand_mask
from shared import figures, report, scenes
from testbed.report import Array, Row, Rows

OBJECTS = ("can", "box")
RATE = 20.0
WAYS = ("drawn + touch", "pictures", "pictures + touch", "seen hand", "seen hand + touch")
SHORT = ("touch", "pictures + touch", "seen hand", "seen hand + touch")
FREE = 0.25
"""How long nothing is covered [s]."""
GOOD = 5.0
"""Sight that is nearer than this is good [mm]."""
COVERED, NOISIER, CAMERA = (0.5, 0.8, 0.95), (2.0, 4.0), (0.0, 0.02, 0.04)
INSIDE = 12.59
"""χ² of six numbers that one in twenty exceeds."""


@lru_cache(maxsize=2)
def grasped(scenario: Scenario) -> tuple[Sample, ...] | None:
    """Returns a grasp with its images; None where the hand drops the object."""
    samples = tuple(simulate(scenario))
    return None if samples[-1].dropped else samples


def covered(samples: tuple[Sample, ...], scenario: Scenario, share: float) -> tuple[Sample, ...]:
    """Returns the samples without depth on a share of the object's pixels, those at one side, after the first image."""
    if not share:
        return samples
    rig, model = rig_of(scenario), model_of(scenario)
    camera, out = Camera.of(rig.camera), []
    T_camera_world = true_camera(scenario)
    way = np.random.default_rng(int(scenario.seed)).uniform(0, 2 * np.pi)
    for sample in samples:
        depth = sample.observation.depth
        if depth is not None and sample.observation.stamp > samples[0].observation.stamp + FREE:
            T = T_camera_world @ sample.T_world_object
            drawn = camera.draw(se3.apply(T, model.vertices), model.faces).depth
            rows, columns = np.nonzero(np.isfinite(drawn))
            side = columns * np.cos(way) + rows * np.sin(way)
            hidden = side <= np.quantile(side, share)
            depth = depth.copy()
            depth[rows[hidden], columns[hidden]] = np.nan
            sample = replace(sample, observation=replace(sample.observation, depth=depth))
        out.append(sample)
    return tuple(out)


def calibrated(samples: tuple[Sample, ...], rig: Rig, model: hs.ObjectModel) -> Iterator[Observation]:
    """Yields observations with the pose of their images; hand and object are searched where the calibration puts them.

    Raises InvalidInput where the rig has no camera.
    """
    camera, shape = Camera.of(rig.camera), rig.hand.shape()
    T_world_camera = np.eye(4) if rig.camera is None else rig.camera.T_mount_camera
    follower, T_camera_world = DepthTracker(model, camera), se3.inverse(T_world_camera)
    for sample in samples:
        seen = sample.observation
        pose = None
        if seen.depth is not None:
            T_camera_palm = T_camera_world @ np.asarray(seen.T_world_palm)
            vertices = shape.vertices_palm(seen.joint_positions or {})
            hand = hand_mask(camera, seen.depth, vertices, shape.faces, T_camera_palm)
            found = follower.update(seen.stamp, seen.depth, hand=hand, T_camera_palm=T_camera_palm)
            if found.T_camera_object is not None:
                pose = PoseMeasurement(found.T_camera_object, "camera", found.covariance)
        yield replace(seen, vision=pose, depth=None, color=None)


def answers(samples: tuple[Sample, ...], scenario: Scenario, ways: tuple[str, ...]) -> dict[str, Any]:
    """Returns the last estimate of each way; None where there is none."""
    rig, model = rig_of(scenario), model_of(scenario)
    seen = list(calibrated(samples, rig, model)) if {"pictures", "pictures + touch"} & {*ways} else []
    found: dict[str, Any] = {}
    for way in ways:
        if way == "touch":
            continue
        observations = seen if way.startswith("pictures") else [sample.observation for sample in samples]
        if not way.startswith("drawn"):
            observations = [one if one in seen else replace(one, vision=None) for one in observations]
        if "touch" not in way:
            observations = [replace(one, wrenches={}) for one in observations]
        tracker = hs.Tracker(rig, model, settings=TrackerSettings(images=way.startswith("seen")))
        for observation in observations:
            tracker.update(observation)
        found[way] = tracker.estimate
        if "touch" in way and "touch" in ways:
            touched = tracker.fingertips.contacts
            found["touch"] = None if touched is None else hs.correct_pose(model, touched)
    return found


def errors(model: hs.ObjectModel, estimate: Any, T: Array) -> Row:
    """Returns errors of an estimate: middle [mm], rotation [deg], and whether the truth is in its 95 % region."""
    if estimate is None:
        return {"middle": np.nan, "turn": np.nan, "inside": np.nan}
    near = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
    middle = model.center_object[None]
    off = se3.apply(estimate.T_palm_object, middle) - se3.apply(near, middle)
    turn = se3.rotation_log(estimate.T_palm_object[:3, :3] @ near[:3, :3].T)
    squared, _ = scenes.chi2(model, estimate.T_palm_object, estimate.information, T)
    return {
        "middle": 1e3 * float(np.linalg.norm(off)),
        "turn": float(np.rad2deg(np.linalg.norm(turn))),
        "inside": float(squared < INSIDE),
    }


def rows_of(scenario: Scenario, share: float, ways: tuple[str, ...]) -> Rows:
    """Returns a row for each way; none where the hand drops the object."""
    samples = grasped(scenario)
    if samples is None:
        return []
    model, T = model_of(scenario), samples[-1].T_palm_object
    found = answers(covered(samples, scenario, share), scenario, ways)
    return [{"way": way, **errors(model, estimate, T)} for way, estimate in found.items()]


def settings() -> Iterator[tuple[str, float, dict[str, float]]]:
    """Yields settings: name, covered share, and nuisances."""
    yield "as it is", 0.0, {}
    for share in COVERED:
        yield f"{100 * share:.0f} % covered", share, {}
    for times in NOISIER:
        yield f"depth noise x {times:g}", 0.0, {"depth_noise": times}
    for size in CAMERA:
        part = size / 0.08
        yield (
            f"camera off by {100 * size:g} cm",
            0.0,
            {
                "camera_position": size,
                "camera_height": 0.064 * part,
                "camera_rotation": float(np.deg2rad(6) * part),
            },
        )


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=12, quick_trials=2)
    rows = []
    chosen = list(settings())[: 1 if options.quick else None]
    for k in report.progress(range(options.trials), "grasps"):
        for object_name in OBJECTS:
            seed = options.first_seed + 500 + k
            for name, share, wrong in chosen:
                scenario = Scenario(
                    object=object_name, seed=seed, rate=RATE, images=True, nuisances=Nuisances(**wrong)
                )
                ways = (*WAYS, "touch") if name == "as it is" else SHORT
                found = rows_of(scenario, share, ways)
                rows += [{"setting": name, "object": object_name, "seed": seed, **row} for row in found]
    report.write_csv(options.output / "from_pictures.csv", rows)
    print_ways(report.chosen(rows, setting="as it is"))
    if not options.quick:
        print_settings(rows)
    print_gains(rows)
    draw_figure(rows, options.output / "from_pictures.png")


def cells(rows: Rows) -> list[str]:
    """Median errors, the worst tenth's, regions, and how many have no answer."""
    middle, turn, inside = (report.values(rows, name) for name in ("middle", "turn", "inside"))
    there = np.isfinite(middle)
    if not there.any():
        return ["-", "-", "-", "-", f"{len(rows)} of {len(rows)}"]
    return [
        f"{np.median(middle[there]):.1f}",
        f"{np.quantile(middle[there], 0.9):.1f}",
        f"{np.median(turn[there]):.1f}",
        f"{100 * inside[there].mean():.0f} %",
        f"{(~there).sum()} of {len(rows)}",
    ]


COLUMNS = ["middle mm", "nine in ten", "turn °", "inside", "no pose"]
NOTE = "Medians over grasps; inside: truths in the 95 % region."


def print_ways(rows: Rows) -> None:
    """Each way's errors, by object."""
    table = [
        [name, way, *cells(report.chosen(rows, object=name, way=way))] for name in OBJECTS for way in WAYS
    ]
    report.print_table(
        "The end of a grasp, the camera 8 cm off (synthetic)", ["object", "by", *COLUMNS], table, NOTE
    )


def print_settings(rows: Rows) -> None:
    """Errors in each setting, both objects."""
    table = [
        [name, way, *cells(report.chosen(rows, setting=name, way=way))]
        for name, _, _ in settings()
        for way in SHORT
    ]
    report.print_table("What touch adds to sight (synthetic)", ["", "by", *COLUMNS], table, NOTE)


def print_gains(rows: Rows) -> None:
    """Prints how touch changes vision's error, grasp by grasp."""
    table = []
    for name in report.distinct(rows, "setting"):
        # The rows of both ways are of the same grasps, in the same order.
        sight, both = (
            report.values(rows, "middle", setting=name, way=way) for way in ("seen hand", "seen hand + touch")
        )
        good = sight < GOOD
        added = [both - sight, (both - sight)[good]]
        medians = [f"{np.nanmedian(some):+.1f}" if np.isfinite(some).any() else "-" for some in added]
        worst = f"{np.nanmax(added[1]):+.1f}" if good.any() else "-"
        table.append([name, *medians, worst, f"{good.sum()} of {len(sight)}"])
    columns = ["", "median mm", f"of those below {GOOD:g} mm", "worst of them", "below"]
    report.print_table(
        "What touch adds to the error of the seen hand (synthetic)", columns, table, "Negative: touch gains."
    )


def draw_figure(rows: Rows, path: Any) -> None:
    """Errors of each way in each setting."""
    names = report.distinct(rows, "setting")
    figure, axes = figures.pyplot().subplots(figsize=(7.4, 3.6), layout="constrained")
    for k, way in enumerate(SHORT):
        medians = [np.nanmedian(report.values(rows, "middle", setting=name, way=way)) for name in names]
        axes.plot(range(len(names)), medians, marker="os^d"[k], linestyle=":", label=way)
    axes.set_xticks(range(len(names)), names, rotation=25, ha="right")
    axes.set(ylabel="median error of the middle [mm]", yscale="log")
    axes.legend()
    figures.save(figure, path)


if __name__ == "__main__":
    main()
