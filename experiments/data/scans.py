"""What a scanned model costs: grasps corrected with clouds of the object in place of the object itself.

A can (no symmetry declared) touched on its side, a box on three faces, the same box between two fingers and a thumb, a
ball; and YCB objects touched anywhere. Contacts on the true surface, 0.5 mm and 2 degrees per axis; vision off by 65 mm
and 20 degrees root mean square. Scans: 4 000 points with white noise of three sizes, with exact normals or none;
"fused": no normals, 0.8 mm of noise that neighbours within 6 mm share, in steps of half a millimetre, averaged in 3 mm
voxels, the base unseen and one side in every second scan; "points": the clouds that the authors of YCB-Video drew,
contacts on its meshes. Every scan is another, and holds several grasps. Error: shift and turn (times the radius) in the
directions that true contacts on the true object can see. Open: directions that these cannot see, and that the answer
names.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

import handsight as hs
from handsight import se3
from handsight.objects import Symmetries
from testbed import report, scenes, ycb
from testbed.report import Array, Row, Rows

POINTS = 4000
SIGMAS_MM = (0.5, 1.0, 2.0)
VISION = (0.065, float(np.deg2rad(20)))
"""Root mean square length and angle of vision's error."""
NAMED = 0.9
"""Share of a direction within the estimate's unobservable directions above which it counts as named."""
FUSED_SIGMA, FUSED_LENGTH, FUSED_STEP, VOXEL = 8e-4, 3e-3, 5e-4, 3e-3
WAVES = 400
YCB = ("006_mustard_bottle", "021_bleach_cleanser", "002_master_chef_can", "004_sugar_box")
Rng = np.random.Generator
Draw = Callable[[Rng], scenes.Surface]


@dataclass(frozen=True)
class Thing:
    """An object, and how it is touched."""

    model: hs.ObjectModel
    draw: Draw


def things() -> dict[str, Thing]:
    """By name; none of them declares a symmetry."""
    can, box, ball = (
        model.with_symmetries(Symmetries())
        for model in (scenes.can(), scenes.box(), hs.ObjectModel.sphere(0.035))
    )
    return {
        "can": Thing(can, scenes.on_can_side),
        "box, gripped": Thing(box, scenes.across_box),
        "box, 3 faces": Thing(box, scenes.on_box_faces),
        "ball": Thing(ball, scenes.anywhere_on(ball)),
    }


def white(sigma: float, normals: bool, thing: Thing, rng: Rng) -> hs.ObjectModel:
    """Returns a scan whose points have independent noise."""
    points, outward = thing.model.sample(POINTS, int(rng.integers(1 << 31)))
    noisy = points + sigma * rng.normal(size=points.shape)
    return hs.ObjectModel.from_points(noisy, outward if normals else None)


def fused(thing: Thing, rng: Rng) -> hs.ObjectModel:
    """Returns a scan like depth images fused into one cloud."""
    points, normals = thing.model.sample(10 * POINTS, int(rng.integers(1 << 31)))
    waves, phases = rng.normal(size=(3, WAVES)) / FUSED_LENGTH, rng.uniform(0, 2 * np.pi, WAVES)
    noise = FUSED_SIGMA * np.sqrt(2 / WAVES) * np.cos(points @ waves + phases).sum(axis=1)
    seen = normals[:, 2] > -0.5
    if rng.random() < 0.5:
        seen &= normals[:, 0] > -0.7
    noisy = (points + (FUSED_STEP * np.round(noise / FUSED_STEP))[:, None] * normals)[seen]
    _, voxel = np.unique(np.floor(noisy / VOXEL).astype(np.int64), axis=0, return_inverse=True)
    count = np.bincount(voxel.reshape(-1))
    columns = [np.bincount(voxel.reshape(-1), noisy[:, k]) / count for k in range(3)]
    return hs.ObjectModel.from_points(np.stack(columns, axis=1))


def cells() -> Iterator[tuple[str, str, Thing, Callable[[Thing, Rng], hs.ObjectModel]]]:
    """Object, scan, and how it is made; the clouds that others drew last."""
    for name, thing in things().items():
        for mm in SIGMAS_MM:
            for normals in (True, False):
                label = f"{mm:g} mm, {'with' if normals else 'without'} normals"
                yield name, label, thing, partial(white, 1e-3 * mm, normals)
        yield name, "fused", thing, fused
    folder = ycb.data_folder()
    for name in YCB if folder else ():
        model = hs.ObjectModel.from_file(f"{folder}/ycb_meshes/{name}.ply")
        cloud = hs.ObjectModel.from_points(np.loadtxt(f"{folder}/ycbv_points/{name}.xyz"))
        drawn = scenes.anywhere_on(model)
        yield name, "points", Thing(model, partial(drawn, n=4)), lambda *_, cloud=cloud: cloud


def grasp(thing: Thing, scan: hs.ObjectModel, rng: Rng) -> Row:
    """Returns a row of one grasp, corrected with the object itself and with its scan."""
    scene = scenes.random_scene(thing.draw(rng), rng, error=VISION)
    open_ = truly_open(thing.model, scene)
    row: Row = {"open": len(open_)}
    for label, model in (("exact", thing.model), ("scan", scan)):
        estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision)
        delta = se3.difference(estimate.T_palm_object, scene.T_palm_object)
        delta = delta * np.repeat([1.0, thing.model.radius], 3)
        region = scenes.region(model.with_symmetries(Symmetries()), estimate, scene.T_palm_object)
        row |= {
            f"{label} mm": 1e3 * float(np.linalg.norm(delta - open_.T @ (open_ @ delta))),
            f"{label} in 50%": region["in 50%"],
            f"{label} in 95%": region["in 95%"],
            f"{label} named": named(open_, estimate.unobservable),
        }
    return row


def truly_open(model: hs.ObjectModel, scene: scenes.Scene) -> Array:
    """Returns the directions (k, 6) that contacts on the true surface leave unobservable at the true pose."""
    T = scene.T_palm_object
    contacts = hs.Contacts(
        se3.apply(T, scene.points_object),
        scene.normals_object @ T[:3, :3].T,
        sigma_point=scenes.NOISE[0],
        sigma_normal=scenes.NOISE[1],
    )
    return hs.correct_pose(model, contacts, vision=hs.PosePrior(T, scene.vision.covariance)).unobservable


def named(open_: Array, said: Array) -> float:
    """Returns how many of the unobservable directions are reported."""
    return float((np.linalg.norm(open_ @ said.T, axis=1) > NAMED).sum()) if len(said) else 0.0


def run(options: report.Options, grasps: int, only: str) -> Rows:
    """A row per object, scan and grasp."""
    rows = Rows()
    for c, (name, label, thing, make) in enumerate(cells()):
        if only not in f"{name}: {label}":
            continue
        for s in report.progress(range(options.trials), f"{name}: {label}"):
            rng = options.rng(c, s)
            scan = make(thing, rng)
            key = {"object": name, "scan": label, "number": s}
            rows += [key | grasp(thing, scan, rng) for _ in range(grasps)]
    return rows


def inside(rows: Rows) -> str:
    """The cell of the share of truths in the 95 % region, with its standard error over scans."""
    by_scan = [report.values(rows, "scan in 95%", number=s).mean() for s in report.distinct(rows, "number")]
    spread = np.std(by_scan, ddof=1) / np.sqrt(len(by_scan))
    return f"{100 * report.values(rows, 'scan in 95%').mean():.0f}±{100 * spread:.0f}"


CELLS: dict[str, report.Cell] = {
    "exact mm": report.of("exact mm"),
    "scan mm": report.of("scan mm"),
    "ratio": report.ratio("scan mm", "exact mm"),
    "50 %": report.of("scan in 50%", ".0f", scale=100),
    "95 %": inside,
    "exact 95 %": report.of("exact in 95%", ".0f", scale=100),
    "named": report.ratio("scan named", "open"),
    "exact named": report.ratio("exact named", "open"),
}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    arguments.add_argument("--grasps", type=report.at_least(1), default=5, help="on each scan (default: 5)")
    arguments.add_argument(
        "--only", default="", help='part of a cell\'s name, as "ball: fused" (default: all)'
    )
    options, given = report.parsed(arguments, trials=24, quick_trials=2)
    rows = run(options, given.grasps, given.only)
    report.print_by(
        f"Corrections with a scanned model, {options.trials} scans of {given.grasps} grasps (synthetic contacts)",
        rows,
        "object, scan",
        CELLS,
        "mm: mean error in what true contacts can see. 50 %, 95 %: truths in these regions, ± one standard error over "
        "scans. named: share of the open directions that the answer calls unobservable.",
    )
    report.write_csv(options.output / "scans.csv", rows)


if __name__ == "__main__":
    main()
