"""Objects reconstructed from depth images, and corrections with what was reconstructed in place of the object.

A can, a box and two YCB objects stand on a table, a camera goes once around them, up and down (all drawn, 320 x 240
pixels from 0.45 m, errors of `vision.depth_noise`'s structured-light camera, constant ones in each trial others).
Poses: given; wrong by 4 mm and 2 degrees each, found by the growing surface; not given at all, views 5 degrees apart,
found by it too. Errors: of the points that were seen, against the object, laid on it as well as they can be where poses
were found. Bias: their median, outward positive. Covered: share of the surface, but for what it stands on, within 4 mm
of a point that was seen. Corrections: as in `scans.py`, contacts anywhere, also where nothing was seen.

Real frames (the data folder's `ycbv_frames`, not with --quick): those scenes of YCB-Video that have ten frames and
more, each object's own pixels fused in its pose as it was annotated, or in that of the first frame and those that the
growing surface finds. Said: at most so much of the closed surface is measured, by the command; covered: how much it is.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import handsight as hs
from experiments.data.scans import Thing, grasp
from handsight import se3
from handsight.objects import Shape, ply_bytes
from handsight.vision.reconstruction.parts import (
    SIGMA,
    SIGMA_FOOT,
    above_table,
    foot,
    parts_of,
    share_observed,
)
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import on_table
from testbed import real_frames, report, scenes, sight_scenes, ycb
from testbed.real_frames import RealFrame
from testbed.report import Array, Row, Rows
from testbed.sight_scenes import CAMERA

YCB = ("006_mustard_bottle", "021_bleach_cleanser")
COVERED = 0.004
MARGIN, BELOW = 0.03, 0.02
"""Around the object, and below the table, of what is fused [m]."""
STANDS = 0.006
"""Height below which the surface is not judged: it is the table's [m]."""
FAR = 20.0
"""Depth of what is behind the object [m]."""
GRASPS = 10
"""With each model."""
LEAST_FRAMES = 10
"""Of a scene that is fused."""
MOTIONS = {"given": 24, "4 mm, 2° off": 24, "not given": 72}
"""Number of views, by what is known of the camera's motion."""


def things(quick: bool) -> dict[str, hs.ObjectModel]:
    """By name."""
    models = {"can": scenes.can(), "box": scenes.box()}
    folder = None if quick else ycb.data_folder()
    for name in YCB if folder else ():
        models[name] = hs.ObjectModel.from_file(f"{folder}/ycb_meshes/{name}.ply")
    return models


def trial(name: str, model: hs.ObjectModel, motion: str, grasps: int, rng: np.random.Generator) -> Row:
    """Returns the row of one reconstruction, and of grasps corrected with it."""
    shape = sight_scenes.standing(model)
    Ts = sight_scenes.path_around(MOTIONS[motion], rng)
    images = sight_scenes.pictures_around(Ts, shape, rng)
    believed = {"given": Ts, "not given": np.repeat(Ts[:1], len(Ts), axis=0)}.get(motion)
    if believed is None:
        believed = sight_scenes.wrong_poses(Ts, rng)
    if motion != "given":  # as the command begins
        seen = on_table(CAMERA, images[0])
        believed = believed @ se3.inverse(believed[0]) @ (Ts[0] if seen is None else seen[0])
    reconstruction = Reconstruction(CAMERA, bounds(model))
    began = time.perf_counter()
    fitted = sum(
        reconstruction.grow(View(depth, T), estimate=motion != "given") is not None
        for depth, T in zip(images, believed, strict=True)
    )
    taken = time.perf_counter() - began
    volume = reconstruction.volume
    found = above_table(volume)
    below = foot(found, volume.grid.cell).points
    T_object_table = se3.compose(np.eye(3), np.array(model.vertices)[0] - shape[0][0])
    if motion != "given":
        T_object_table = T_object_table @ laid(model, T_object_table, found.points)
    points = se3.apply(T_object_table, found.points)
    row: Row = {"object": name, "motion": motion, "fitted": fitted / len(Ts), "ms": 1e3 * taken / len(Ts)}
    row |= judged(model, points, found.points[:, 2])
    thing, own = Thing(model, scenes.anywhere_on(model)), as_a_file(points, se3.apply(T_object_table, below))
    corrected = [grasp(thing, own, rng) for _ in range(grasps)]
    for key in ("exact mm", "scan mm", "exact in 95%", "scan in 95%"):
        row[key] = float(report.values(corrected, key).mean())
    return row


def as_a_file(points: Array, below: Array) -> hs.ObjectModel:
    """Returns the model of the file that `handsight reconstruct` writes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.ply"
        sigmas = np.repeat([SIGMA, SIGMA_FOOT], [len(points), len(below)])
        path.write_bytes(ply_bytes(Shape(np.concatenate([points, below]), sigmas=sigmas), 1.0))
        return hs.ObjectModel.from_file(path)


def bounds(model: hs.ObjectModel) -> Array:
    """Returns the bounds (2, 3) of the fused surface on the table [m]."""
    x, y, height = np.ptp(model.bounds_object, axis=0)
    side = max(x, y) / 2 + MARGIN
    return np.array([[-side, -side, -BELOW], [side, side, height + MARGIN]])


def laid(model: hs.ObjectModel, T_object_table: Array, points: Array) -> Array:
    """Returns the transform (4, 4) that aligns points of a surface in an unknown frame with a model, robustly."""

    def T(x: Array) -> Array:
        return se3.compose(se3.rotation_exp(x[3:]), x[:3])

    def distances(x: Array) -> Array:
        return model.evaluate(se3.apply(T_object_table @ T(x), points[::10])).distance

    scale = np.repeat([1e-3, 1e-2], 3)
    return T(least_squares(distances, np.zeros(6), x_scale=scale, loss="soft_l1", f_scale=1e-3).x)


def judged(model: hs.ObjectModel, points: Array, heights: Array) -> Row:
    """Returns the distances of reconstructed points (n, 3) from the object, and the share of it that they cover."""
    off = model.evaluate(points[heights > STANDS]).distance
    truth, normals = model.sample(4000)
    low = model.bounds_object[0, 2]
    standing = (truth[:, 2] < low + STANDS) & (normals[:, 2] < -0.7)
    covered = cKDTree(points).query(truth[~standing])[0] < COVERED
    return {
        "mean mm": 1e3 * float(np.abs(off).mean()),
        "p95 mm": 1e3 * float(np.quantile(np.abs(off), 0.95)),
        "bias mm": 1e3 * float(np.median(off)),
        "covered": float(covered.mean()),
    }


def of_real_frames(frames: list[RealFrame], models: dict[str, hs.ObjectModel]) -> Rows:
    """Returns a row of each object in real images of one scene, by what is known of its poses."""
    rows = Rows()
    for name in [instance.name for instance in frames[0].instances]:
        model = models[name]
        for motion in ("given", "not given"):
            margin = 0.02 * np.array([[-1.0], [1.0]])
            rec = Reconstruction(frames[0].camera, model.bounds_object + margin, min_motion=(0.0, 0.0))
            fitted, first = 0, None
            for frame in frames:
                mine = [each for each in frame.instances if each.name == name]
                others = np.any([each.visible for each in frame.instances if each.name != name], axis=0)
                if not mine:
                    continue
                # What is neither is behind the object.
                depth = np.where(mine[0].visible, frame.depth, np.where(others, 0.0, FAR)).astype(np.float32)
                first = mine[0].T_camera_object if first is None or motion == "given" else first
                view = View(np.where(frame.depth > 0, depth, 0).astype(np.float32), first)
                fitted += rec.grow(view, estimate=motion != "given") is not None
            surface = next(parts_of(rec.volume.surface(), rec.volume))
            T = laid(model, np.eye(4), surface.points)
            off, laid_off = (
                np.abs(model.evaluate(P).distance) for P in (surface.points, se3.apply(T, surface.points))
            )
            covered = cKDTree(se3.apply(T, surface.points)).query(model.sample(4000)[0])[0] < COVERED
            rows.append(
                {
                    "object": name,
                    "motion": motion,
                    "views": float(fitted),
                    "median mm": 1e3 * float(np.median(off)),
                    "p95 mm": 1e3 * float(np.quantile(off, 0.95)),
                    "laid median mm": 1e3 * float(np.median(laid_off)),
                    "laid p95 mm": 1e3 * float(np.quantile(laid_off, 0.95)),
                    "covered": float(covered.mean()),
                    "said": share_observed(surface, rec.volume),
                }
            )
    return rows


NUMBERS = {name: report.of(name) for name in ("mean mm", "p95 mm", "bias mm", "covered", "fitted")}
SHAPES = NUMBERS | {"ms/view": report.of("ms", ".0f")}
CORRECTIONS: dict[str, report.Cell] = {
    "exact mm": report.of("exact mm"),
    "reconstructed mm": report.of("scan mm"),
    "ratio": report.ratio("scan mm", "exact mm"),
    "95 %": report.of("scan in 95%", ".0%"),
    "exact 95 %": report.of("exact in 95%", ".0%"),
}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=3, quick_trials=2)
    folder = (ycb.data_folder() or Path()) / "ycbv_frames"
    if folder.is_dir() and not options.quick:
        real = real_frames.open_folder(folder)
        scenes_ = [scene for scene in real.scenes.values() if len(scene) >= LEAST_FRAMES]
        rows = [row for scene in scenes_ for row in of_real_frames([read() for read in scene], real.models)]
        cells = {name: report.of(name) for name in rows[0] if name not in ("object", "motion")}
        note = "Distances of points from the given mesh; laid: on it as well as they can be."
        report.print_by("Fused from real frames", rows, "object, motion", cells, note)
    grasps = 1 if options.quick else GRASPS
    motions = [motion for motion in MOTIONS if not (options.quick and motion == "not given")]
    rows = Rows()
    for o, (name, model) in enumerate(things(options.quick).items()):
        for m, motion in enumerate(motions):
            for t in report.progress(range(options.trials), f"{name}: {motion}"):
                row = trial(name, model, motion, grasps, options.rng(o, m, t))
                rows.append({"number": t, **row})
    said = f"{options.trials} trials (synthetic images)"
    report.print_by(f"Reconstructions, {said}", rows, "object, motion", SHAPES)
    note = "mm: mean error in what true contacts can see. 95 %: truths in that region."
    title = f"Corrections with them, {grasps} grasps a trial"
    report.print_by(title, rows, "object, motion", CORRECTIONS, note)
    report.write_csv(options.output / "reconstruction.csv", rows)


if __name__ == "__main__":
    main()
