"""Real vision errors, corrected by a few touches: CosyPose, PoseCNN, AAE and PoseCNN+ICP on YCB-Video.

2666 views of seven objects in six recorded sequences, as each of four published estimators saw them, with
true poses: real images, real estimators, real truth. The touches are SYNTHETIC: three or five points drawn
over the object's surface (samples made by others), put at the true pose, with 1 mm and 5° of noise per axis.
All estimators get the same touches in the same frame. An object that was not detected is skipped and counted.

How far an estimator may be wrong is learnt from its errors on the other objects, never on the one corrected,
by one rule for all four: along the axes of the viewing ray, since a camera knows depth worst, four sigmas
(shift across the ray and along it, turn across it and about it), each the 68 % quantile of the size of the
errors: what one standard deviation means, and what a few flipped poses leave alone. Every object counts the
same. Errors are taken modulo the symmetries of the object's shape.

  ADD-S   mean distance [mm] from the object's points at the answer to the object's surface at the truth
  AUC     area under the share of ADD-S below a threshold, from 0 to 10 cm [%]
  worse   share of poses whose ADD-S touch made larger by more than 1 mm
  flips   poses turned by more than 90° from the truth, modulo symmetry, before and after
"""

from functools import partial
from pathlib import Path

import numpy as np

import handsight as hs
from handsight import se3
from testbed import report, scenes, ycb
from testbed.report import Array, Row, Rows

COUNTS = (3, 5)
NOISE = (1e-3, float(np.deg2rad(5)))
"""Of a contact, per axis: point [m] and normal [rad]; the contacts say the same."""
ONE_SIGMA = 0.6827
"""Share of a Gaussian's draws within one standard deviation."""
DIRECTIONS = {"across": [0, 1], "along": [2], "tilt": [3, 4], "roll": [5]}
"""Components of an error along the axes of the viewing ray: shift [m] and turn [rad] across and along it."""
Sigmas = dict[str, float]
"""By direction."""
AUC_LIMIT, WORSE, FLIP = 0.10, 1.0, 90.0


def ray_axes(Ts_camera_object: Array) -> Array:
    """Rotations (..., 3, 3) whose third column points from the camera to the object's origin."""
    z = Ts_camera_object[..., :3, 3] / np.linalg.norm(Ts_camera_object[..., :3, 3], axis=-1, keepdims=True)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def errors_along_ray(model: hs.ObjectModel, Ts_vision: Array, Ts_true: Array) -> Array:
    """(n, 6) shift [m] and turn [rad] from vision to the truth, modulo symmetry, along the ray's axes."""
    delta = se3.difference(scenes.nearest_truth(model, Ts_true, Ts_vision), Ts_vision)
    R = ray_axes(Ts_vision)
    return np.concatenate([np.einsum("nji,nj->ni", R, part) for part in np.split(delta, 2, axis=1)], axis=1)


def sigmas_of(errors_by_object: list[Array]) -> Sigmas:
    """The four sigmas, by direction: ONE_SIGMA quantiles of |error|, every object with the same weight."""
    sigmas = {}
    for name, columns in DIRECTIONS.items():
        sizes = [np.abs(errors[:, columns]).ravel() for errors in errors_by_object]
        weights = np.concatenate([np.full(len(s), 1 / len(s)) for s in sizes])
        order = np.argsort(np.concatenate(sizes))
        below = np.cumsum(weights[order]) / weights.sum()
        sigmas[name] = float(np.concatenate(sizes)[order][np.searchsorted(below, ONE_SIGMA)])
    return sigmas


def prior(T_vision: Array, sigmas: Sigmas) -> hs.PosePrior:
    """Vision's pose with the covariance that the sigmas make, along the camera's axes."""
    variance = np.array([sigmas[name] ** 2 for name, columns in DIRECTIONS.items() for _ in columns])
    return hs.PosePrior(T_vision, se3.rotate_covariance(ray_axes(T_vision), np.diag(variance)))


def touched(samples: scenes.Surface, T_true: Array, rng: np.random.Generator) -> hs.Contacts:
    """Five synthetic contacts at the true pose."""
    points, normals = samples
    chosen = rng.choice(len(points), max(COUNTS), replace=False)
    return scenes.touched(T_true, (points[chosen], normals[chosen]), NOISE, rng)


def correct_file(folder: Path, seed: int, file: str, frames: list[int], sigmas: dict[str, Sigmas]) -> Rows:
    """Rows of one sequence and object: one per estimator, detected frame and number of contacts."""
    sequence, name = file.split("_", 1)
    thing, samples = ycb.load(folder, name), ycb.surface_samples(folder, name)
    true = ycb.read_poses(folder / "ycbv_vision_poses" / "ground_truth" / f"{file}.txt")[0]
    rows = []
    for label, method in ycb.ESTIMATORS.items():
        Ts, detected = ycb.read_poses(folder / "ycbv_vision_poses" / method / f"{file}.txt")
        for frame in frames:
            key = {"estimator": label, "object": name, "sequence": sequence, "frame": frame}
            if not detected[frame]:
                rows.append(key | {"contacts": 0})
                continue
            contacts = touched(samples, true[frame], np.random.default_rng([seed, *file.encode(), frame]))
            vision = prior(Ts[frame], sigmas[label])
            rows += [key | row for row in corrections(thing, contacts, vision, true[frame])]
    return rows


def corrections(thing: ycb.YcbObject, contacts: hs.Contacts, vision: hs.PosePrior, T_true: Array) -> Rows:
    """A row per number of contacts: errors before and after."""
    rows = []
    before = judged(thing, vision.T_palm_object, T_true, "before")
    for n in COUNTS:
        some = contacts.select(range(n))
        estimate, seconds = report.timed(partial(hs.correct_pose, thing.model, some, vision=vision))
        after = judged(thing, estimate.T_palm_object, T_true, "after")
        flags = {"converged": int(estimate.converged), "consistent": int(estimate.consistent)}
        rows.append({"contacts": n, **before, **after, **flags, "seconds": seconds})
    return rows


def judged(thing: ycb.YcbObject, T_hat: Array, T_true: Array, when: str) -> Row:
    """ADD-S [mm] and turn [°] of a pose."""
    turn = np.rad2deg(thing.turn(T_hat, T_true))
    return {f"{when}_mm": 1000 * thing.closest_point_error(T_hat, T_true), f"{when}_deg": float(turn)}


def learnt_sigmas(folder: Path, files: list[str]) -> dict[str, dict[str, Sigmas]]:
    """Sigmas by object and estimator, each from the errors on all the other objects."""
    names = sorted({file.split("_", 1)[1] for file in files})
    found: dict[str, dict[str, Sigmas]] = {}
    for label, method in ycb.ESTIMATORS.items():
        errors: dict[str, list[Array]] = {name: [] for name in names}
        for file in files:
            name = file.split("_", 1)[1]
            Ts, detected = ycb.read_poses(folder / "ycbv_vision_poses" / method / f"{file}.txt")
            true = ycb.read_poses(folder / "ycbv_vision_poses" / "ground_truth" / f"{file}.txt")[0]
            model = ycb.load(folder, name).model
            errors[name].append(errors_along_ray(model, Ts[detected], true[detected]))
        for name in names:
            others = [np.concatenate(errors[other]) for other in names if other != name]
            found.setdefault(name, {})[label] = sigmas_of(others)
    return found


def print_sigmas(sigmas: dict[str, dict[str, Sigmas]]) -> None:
    """The priors: the range of each sigma over the objects left out."""
    lines = []
    for label in ycb.ESTIMATORS:
        cells = []
        for name, scale in zip(DIRECTIONS, (1000, 1000, 180 / np.pi, 180 / np.pi), strict=True):
            found = [scale * by_estimator[label][name] for by_estimator in sigmas.values()]
            cells.append(f"{min(found):.1f}-{max(found):.1f}")
        lines.append([label, *cells])
    report.print_table(
        "Prior sigmas per axis, learnt on the other objects (range over the object left out)",
        ["estimator", "across the ray, mm", "along it, mm", "tilt, °", "roll, °"],
        lines,
        f"One rule for all: the {100 * ONE_SIGMA:.0f} % quantile of |error|; every object counts the same.",
        detail=True,
    )


def print_estimators(rows: Rows) -> None:
    """The main table: a line per estimator and moment."""
    lines = []
    for label in ycb.ESTIMATORS:
        mine = report.chosen(rows, estimator=label)
        seen, missed = (report.chosen(mine, contacts=n) for n in (COUNTS[0], 0))
        flips = (report.values(seen, "before_deg") > FLIP).sum()
        before = scores(report.values(seen, "before_mm"))
        poses = f"{len(seen)} ({len(missed)} not detected)"
        lines.append([f"{label}: vision alone", *before, "", flips, poses])
        for n in COUNTS:
            some = report.chosen(mine, contacts=n)
            flips = (report.values(some, "after_deg") > FLIP).sum()
            worse = f"{100 * worsened(some).mean():.1f} %"
            lines.append([f"  and {n} touches", *scores(report.values(some, "after_mm")), worse, flips, ""])
    report.print_table(
        "ADD-S in mm: real vision, SYNTHETIC touches",
        ["", "median (quartiles)", "mean", "90 %", "AUC", f"worse by > {WORSE:.0f} mm", "flips", "poses"],
        lines,
    )


def scores(add_s: Array) -> tuple[str, ...]:
    """Median (quartiles), mean, 90 % quantile and AUC, as text."""
    low, middle, high, most = np.quantile(add_s, [0.25, 0.5, 0.75, 0.9])
    area = ycb.area_under_curve(add_s / 1000, AUC_LIMIT)
    return f"{middle:.2f} ({low:.2f}-{high:.2f})", f"{add_s.mean():.2f}", f"{most:.1f}", f"{area:.1f} %"


def worsened(rows: Rows) -> Array:
    """(n,) bool: touch made ADD-S larger by more than WORSE."""
    return report.values(rows, "after_mm") > report.values(rows, "before_mm") + WORSE


def print_objects(rows: Rows) -> None:
    """Where touch helps and where not: medians before and after, by object, and the share that got worse."""

    def cell(rows: Rows) -> str:
        before, after = (np.median(report.values(rows, f"{when}_mm")) for when in ("before", "after"))
        return f"{before:.1f} -> {after:.1f} ({100 * worsened(rows).mean():.0f} %)"

    def of(label: str) -> report.Cell:
        return lambda rows: cell(mine) if (mine := report.chosen(rows, estimator=label)) else "-"

    rows = sorted((row for row in rows if row["contacts"]), key=lambda row: (row["object"], row["contacts"]))
    title = f"By object: median ADD-S in mm, before -> after (share of poses worse by > {WORSE:.0f} mm)"
    report.print_by(
        title, rows, "object, contacts", {label: of(label) for label in ycb.ESTIMATORS}, detail=True
    )


def main() -> None:
    """Runs the experiment."""
    about = f"{__doc__}\nA trial is one frame of each file; there are 167 to 394."
    options = report.options(about, trials=400, quick_trials=8)
    folder = ycb.data_or_goodbye()
    true = sorted((folder / "ycbv_vision_poses" / "ground_truth").glob("*.txt"))
    sigmas = learnt_sigmas(folder, [path.stem for path in true])
    print_sigmas(sigmas)
    tasks = []
    for path in true:
        total = len(ycb.read_poses(path)[0])
        frames = np.unique(np.linspace(0, total - 1, min(options.trials, total)).astype(int)).tolist()
        for part in np.array_split(frames, max(1, len(frames) // 25)):
            tasks.append((folder, options.seed, path.stem, part.tolist(), sigmas[path.stem.split("_", 1)[1]]))
    rows = [row for part in ycb.in_parallel(correct_file, tasks, "vision errors") for row in part]
    print_estimators(rows)
    print_objects(rows)
    report.write_csv(options.output / "vision_errors.csv", rows)


if __name__ == "__main__":
    main()
