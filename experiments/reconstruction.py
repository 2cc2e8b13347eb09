"""Objects reconstructed from depth images, and corrections with what was reconstructed in place of the object.

A can, a box and two YCB objects stand on a table, a camera goes once around them, up and down (all drawn, 320 x 240
pixels from 0.45 m, errors of `vision.depth_noise`'s structured-light camera, constant ones in each trial others).
Poses: given; wrong by 4 mm and 2 degrees each, found by the growing surface; not given at all, views 5 degrees apart,
found by it too. Errors: of the points that were seen, against the object, laid on it as well as they can be where poses
were found. Bias: their median, outward positive. Covered: share of the surface, but for what it stands on, within 4 mm
of a point that was seen. Corrections: as in `scans.py`, contacts anywhere, on what is guessed too. Where Open3D is
installed, its VoxelBlockGrid fuses the same images with given poses.

Real frames (`--frames`, default: the data folder's `ycbv_frames`): those scenes of YCB-Video that have ten frames and
more, each object's own pixels fused in its pose as it was annotated, or in that of the first frame and those that the
growing surface finds. Said: at most so much of the closed surface is measured, by the command; covered: how much it is.
"""

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import handsight as hs
from handsight import se3
from handsight.objects import Shape, ply_bytes
from handsight.vision.reconstruction.completion import (
    ReconstructedModel,
    closed,
    one_object,
    parts_of,
    share_observed,
)
from handsight.vision.reconstruction.reconstruct import Reconstruction, View
from handsight.vision.reconstruction.segmentation import on_table
from scans import Thing, grasp
from shared import figures, report, scenes, ycb
from sight_scenes import CAMERA
from testbed import real_frames, views_around
from testbed.real_frames import RealFrame
from testbed.report import Array, Row, Rows

YCB = ("006_mustard_bottle", "021_bleach_cleanser")
CELL, BOUND, COVERED = 0.002, 0.006, 0.004
MARGIN, BELOW = 0.03, 0.02
"""Around the object, and below the table, of what is fused [m]."""
STANDS = 0.006
"""Height below which the surface is not judged: it is the table's [m]."""
FAR = 20.0
"""Depth of what is behind the object [m]."""
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


def trial(
    name: str, model: hs.ObjectModel, motion: str, grasps: int, rng: np.random.Generator
) -> tuple[Row, ReconstructedModel]:
    """Returns rows of one reconstruction, and of grasps corrected with it."""
    shape = views_around.standing(model)
    Ts = views_around.path(MOTIONS[motion], rng)
    images = views_around.pictures(Ts, shape, rng)
    believed = {"given": Ts, "not given": np.repeat(Ts[:1], len(Ts), axis=0)}.get(motion)
    if believed is None:
        believed = views_around.wrong(Ts, rng)
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
    found = closed(one_object(volume.surface(), volume, table=True), volume, table=True)
    T_object_table = se3.compose(np.eye(3), np.array(model.vertices)[0] - shape[0][0])
    if motion != "given":
        T_object_table = T_object_table @ laid(model, T_object_table, found.points[found.measured])
    points, normals = se3.apply(T_object_table, found.points), found.normals @ T_object_table[:3, :3].T
    row: Row = {"object": name, "motion": motion, "fitted": fitted / len(Ts), "ms": 1e3 * taken / len(Ts)}
    row |= judged(model, points[found.measured], found.points[found.measured, 2])
    row["guessed mm"] = 1e3 * float(np.abs(model.evaluate(points[~found.measured]).distance).mean())
    row["seen"] = float(found.measured.mean())
    thing, own = Thing(model, scenes.anywhere_on(model)), as_a_file(replace(found, points=points))
    corrected = [grasp(thing, own, rng) for _ in range(grasps)]
    for key in ("exact mm", "scan mm", "exact in 95%", "scan in 95%"):
        row[key] = float(report.values(corrected, key).mean())
    if motion == "given":
        row |= peer(model, images, Ts, T_object_table)
    return row, ReconstructedModel(points, normals, found.measured, found.guesses)


def as_a_file(found: ReconstructedModel) -> hs.ObjectModel:
    """Returns the model of the file that `handsight reconstruct` writes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.ply"
        path.write_bytes(ply_bytes(Shape(found.points, sigmas=found.sigmas), 1.0, found.measured))
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


def peer(model: hs.ObjectModel, images: list[Array], Ts: Array, T_object_table: Array) -> Row:
    """Returns the same for Open3D's VoxelBlockGrid with the same cells and bound; nothing where it is not installed."""
    try:
        import open3d as o3d
    except ImportError:
        return {}
    o3c = o3d.core
    kinds = (o3c.float32, o3c.float32)
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), kinds, ((1), (1)), CELL, 16, 20_000)
    K, began = o3c.Tensor(CAMERA.matrix), time.perf_counter()
    for depth, T in zip(images, Ts, strict=True):
        image, pose = o3d.t.geometry.Image(o3c.Tensor(depth)), o3c.Tensor(T)
        blocks = grid.compute_unique_block_coordinates(image, K, pose, 1.0, 1.0, BOUND / CELL)
        grid.integrate(blocks, image, K, pose, 1.0, 1.0, BOUND / CELL)
    taken = time.perf_counter() - began
    cloud = grid.extract_point_cloud(weight_threshold=2.0).point.positions.numpy().astype(float)
    low, high = bounds(model)
    cloud = cloud[((cloud > low) & (cloud < high)).all(axis=1) & (cloud[:, 2] > STANDS)]
    row = judged(model, se3.apply(T_object_table, cloud), cloud[:, 2])
    return {f"Open3D {key}": value for key, value in (row | {"ms": 1e3 * taken / len(images)}).items()}


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
                    "views": fitted,
                    "median mm": 1e3 * float(np.median(off)),
                    "p95 mm": 1e3 * float(np.quantile(off, 0.95)),
                    "laid median mm": 1e3 * float(np.median(laid_off)),
                    "laid p95 mm": 1e3 * float(np.quantile(laid_off, 0.95)),
                    "covered": float(covered.mean()),
                    "said": share_observed(surface, rec.volume),
                }
            )
    return rows


def print_tables(rows: Rows, trials: int, grasps: int) -> None:
    """Shapes, then corrections, then Open3D's shapes, by object and motion."""
    seen, shape = ("guessed mm", "seen", "fitted"), ("mean mm", "p95 mm", "bias mm", "covered")
    shapes, corrections, peers = [], [], []
    for name in report.distinct(rows, "object"):
        for motion in report.distinct(rows, "motion"):
            mean = means(report.chosen(rows, object=name, motion=motion))
            shapes.append([name, motion, *(f"{mean[key]:.2f}" for key in shape + seen), f"{mean['ms']:.0f}"])
            error = [mean["exact mm"], mean["scan mm"], mean["scan mm"] / mean["exact mm"]]
            shares = [f"{100 * mean[key]:.0f}" for key in ("scan in 95%", "exact in 95%")]
            corrections.append([name, motion, *(f"{value:.2f}" for value in error), *shares])
            for by, own in (("handsight", ""), ("Open3D", "Open3D ")) if "Open3D ms" in mean else ():
                peers.append(
                    [name, by, *(f"{mean[own + key]:.2f}" for key in shape), f"{mean[own + 'ms']:.0f}"]
                )
    said = f"{trials} trials (synthetic images)"
    columns = ["object", "motion", *shape, *seen, "ms/view"]
    note = "seen: share of the points; the others are guessed."
    report.print_table(f"Reconstructions, {said}", columns, shapes, note)
    columns = ["object", "motion", "exact mm", "reconstructed mm", "ratio", "95 %", "exact 95 %"]
    note = "mm: mean error in what true contacts can see. 95 %: truths in that region."
    report.print_table(f"Corrections with them, {grasps} grasps a trial", columns, corrections, note)
    if peers:
        columns = ["object", "by", *shape, "ms/view"]
        report.print_table(f"Given poses, {said}", columns, peers, "Fusion alone, on the same images.")


def means(rows: Rows) -> dict[str, float]:
    """Of each number that all rows have."""
    return {key: float(report.values(rows, key).mean()) for key in rows[0] if key not in ("object", "motion")}


def draw(models: dict[str, hs.ObjectModel], found: dict[str, ReconstructedModel], path: Path) -> None:
    """Each object's truth above what was reconstructed of it."""
    plt = figures.pyplot()
    figure = plt.figure(figsize=(2.6 * len(models), 5.6), layout="constrained")
    for k, (name, model) in enumerate(models.items()):
        own = found[name]
        truth = model.sample(5000)
        drawn = [
            ("", *truth, np.full(len(truth[0]), True)),
            ("reconstructed", own.points, own.normals, own.measured),
        ]
        for row, (said, points, normals, measured) in enumerate(drawn):
            axes = figure.add_subplot(2, len(models), 1 + k + row * len(models), projection="3d")
            light = 0.35 + 0.6 * np.clip(normals @ np.array([0.5, -0.6, 0.62]), 0, 1)
            colors = np.where(
                measured[:, None], light[:, None] * [0.55, 0.7, 0.9], light[:, None] * [1.0, 0.6, 0.2]
            )
            facing = normals @ np.array([0.49, -0.79, 0.37]) > 0
            axes.scatter(*points[facing].T, c=colors[facing], s=2.5, depthshade=False)
            figures.frame_3d(axes, model.sample(500)[0])
            axes.set_axis_off()
            axes.set_title(f"{name}{': ' + said if said else ''}", fontsize=8)
    figure.suptitle("Above the object, below its reconstruction (blue: seen; orange: guessed)")
    figures.save(figure, path)


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    arguments.add_argument(
        "--grasps", type=report.at_least(1), default=10, help="with each model (default: 10)"
    )
    arguments.add_argument("--frames", type=Path, help="folder of real frames (default: the data folder's)")
    options, given = report.parsed(arguments, trials=3, quick_trials=2)
    folder = given.frames or (ycb.data_folder() or Path()) / "ycbv_frames"
    if folder.is_dir():
        real = real_frames.open_folder(folder)
        scenes_ = [scene for scene in real.scenes.values() if len(scene) >= LEAST_FRAMES]
        rows = [row for scene in scenes_ for row in of_real_frames([read() for read in scene], real.models)]
        columns = list(rows[0])
        lines = [
            [f"{each:.2f}" if isinstance(each, float) else str(each) for each in row.values()] for row in rows
        ]
        note = "Distances of measured points from the given mesh; laid: on it as well as they can be."
        report.print_table("Fused from real frames", columns, lines, note)
    models = things(options.quick)
    motions = [motion for motion in MOTIONS if not (options.quick and motion == "not given")]
    rows, last = Rows(), dict[str, ReconstructedModel]()
    for o, (name, model) in enumerate(models.items()):
        for m, motion in enumerate(motions):
            for t in report.progress(range(options.trials), f"{name}: {motion}"):
                row, last[name] = trial(name, model, motion, given.grasps, options.rng(o, m, t))
                rows.append({"number": t, **row})
    print_tables(rows, options.trials, given.grasps)
    every = list(dict.fromkeys(key for row in rows for key in row))
    report.write_csv(
        options.output / "reconstruction.csv", [{key: row.get(key, "") for key in every} for row in rows]
    )
    draw(models, last, options.output / "reconstruction.png")


if __name__ == "__main__":
    main()
