"""What the paper claims about its method, measured: a sentence for each claim.

a  If a contact is "close to an edge", distance alone "can give a wrong result"; with normals "one can also
   know which face of the object the robot is touching". Four contacts on different faces of a 60 x 90 x 140
   mm box, all 1 to 5 mm from an edge, or all at least 15 mm from any. Counted: contacts that lie on another
   face than their own at the corrected pose (of the box' symmetric poses, at the one nearest to it).
b  "By giving a large value to w_n", the method fits normals "more than it will try to minimise the distance".
   Levenberg-Marquardt with normals on Table I's cube and cylinder, for w_n from 0.5 to 50 cm.
c  "A local minimum close to the initial estimate" is "more likely to be a better solution than a global
   minimum". The paper's method from many starts, turned by up to 180°, each corrected twice. Of all poses
   where it came to rest, the nearest to the initial estimate against that of least cost (eq. 3 in the whole
   cloud), by the error of pose √(|δp|² + radius² |δθ|²): as it is, and modulo the object's symmetry.
d  Moving the contacts avoids "having to transform all the points in the object in every iteration";
   quaternions need "less calculations" than rotation matrices. Medians of interleaved repeats, in NumPy.

Starts are 1 cm per axis and 12° off, contacts have noise of 0.5 mm and 2° per axis, clouds 2 000 points.
Rates and means have their standard error over grasps. "confirmed" asks for two of these between both sides.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.correction import paper
from shared import claims_figure, report, scenes
from testbed.report import Array, Row, Rows

START = (0.01, float(np.deg2rad(12)))
EDGE_METHODS = {
    "LM (paper)": ("paper-lm-distance", False),
    "handsight": ("handsight", False),
    "LM with normals (paper)": ("paper-lm", True),
    "handsight with normals": ("handsight", True),
}
W_N_CM = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
CLOUDS = (500, 2000, 8000, 32000)
POINTS = (1, 4, 64, 1024, 16384)
IDENTITY = np.array([1.0, 0, 0, 0, 0, 0, 0])
WEIGHED = {"rme_mm": 1, "mae_deg": 1, "distance_mm": 2, "normal_deg": 2}
"""Columns of claim b, with digits."""
QUARTILES = ("q25_us", "median_us", "q75_us")
Ways = dict[str, Callable[[], Array]]
CONTACTS, CLOUD = "contacts moved", "cloud moved"
QUATERNION, MATRICES = "quaternion, q v q*", ("matrix of a quaternion", "matrix by sine and cosine")


def scene_of(surface: scenes.Surface, rng: np.random.Generator) -> scenes.Scene:
    """These contacts, noisy, and vision 1 cm per axis and 12° off."""
    return scenes.paper_scene(surface, rng, start=START, noise=scenes.NOISE)


def wrong_faces(model: hs.ObjectModel, scene: scenes.Scene, T_hat: Array) -> float:
    """Share of the contacts that lie on another face than their own at that pose, modulo symmetry."""
    half = np.array(scenes.BOX) / 2
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_hat)
    own = scene.normals_object @ scene.T_palm_object[:3, :3].T @ T_near[:3, :3]
    x = se3.apply(se3.inverse(T_hat), scene.contacts.points_palm)
    face = (np.abs(x) - half).argmax(axis=1)[:, None]
    along = np.take_along_axis(own * np.sign(x), face, axis=1)
    return float((along < 0.5).mean())


def edges(options: report.Options) -> Rows:
    """Claim a: a row per distance from the edge, method and grasp."""
    model, rows = scenes.box(), []
    for k in report.progress(range(options.trials), "a edges"):
        for near in (True, False):
            rng = options.rng(k, near)
            scene = scene_of(scenes.on_box_edges(rng, near), rng)
            bare = hs.Contacts(scene.contacts.points_palm, sigma_point=scenes.NOISE[0])
            for label, (method, normals) in EDGE_METHODS.items():
                contacts = scene.contacts if normals else bare
                T = hs.correct_pose(model, contacts, vision=scene.vision, method=method).T_palm_object
                share = wrong_faces(model, scene, T)
                rows.append({"near_edge": int(near), "method": label, "trial": k, "wrong_face": share})
    return rows


def weights(options: report.Options) -> Rows:
    """Claim b: a row per shape, w_n and grasp."""
    models, rows = scenes.table_1_models(), []
    for k in report.progress(range(options.trials), "b w_n"):
        for s, (shape, model) in enumerate(models.items()):
            scene = scene_of(scenes.on_four_sides(model, rng := options.rng(k, s)), rng)
            for w_n in W_N_CM:
                method = hs.PaperMethod(w_n=w_n / 100)
                estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision, method=method)
                rme, turn = scenes.contact_errors(model, scene, estimate.T_palm_object)
                left = {"rme_mm": 1000 * rme, "mae_deg": float(np.rad2deg(turn)), **residuals_left(estimate)}
                rows.append({"shape": shape, "w_n_cm": w_n, "trial": k, **left})
    return rows


def residuals_left(estimate: hs.PoseEstimate) -> Row:
    """Mean distance [mm] and angle of the normals [°] that an answer leaves."""
    distance, normal = np.abs(estimate.residuals.distance).mean(), estimate.residuals.normal.mean()
    return {"distance_mm": 1000 * float(distance), "normal_deg": float(np.rad2deg(normal))}


def rest(model: hs.ObjectModel, scene: scenes.Scene, T: Array) -> tuple[Array, float]:
    """Where two corrections by the paper's method end that begin at `T`, and the cost there [cm]."""
    cloud, normals = model.sample(scenes.CLOUD)
    points, felt = scene.contacts.points_palm, scene.contacts.normals_palm
    for _ in range(2):
        seen = (se3.apply(T, cloud), normals @ T[:3, :3].T)
        T = paper.correct(points, felt, *seen, paper.PaperMethod()).T_new_old @ T
    every = (len(points), *cloud.shape)
    carried = 100 * se3.apply(se3.inverse(T), points), np.broadcast_to(100 * cloud, every)
    G = paper.Matching(*carried, felt @ T[:3, :3], np.broadcast_to(normals, every), w_n=10.0)
    return T, float(np.linalg.norm(paper.residuals(IDENTITY, G)))


def minima(options: report.Options) -> Rows:
    """Claim c: a row per object and grasp."""
    models = {"box": scenes.box(), "can": scenes.can()}
    count, rows = 12 if options.quick else 24, []
    for k in report.progress(range(max(options.trials // 3, 6)), "c minima"):
        for s, (shape, model) in enumerate(models.items()):
            scene = scene_of(scenes.on_four_sides(model, rng := options.rng(k, s)), rng)
            axes = rng.normal(size=(count, 3))
            turns = axes / np.linalg.norm(axes, axis=1, keepdims=True) * rng.uniform(0, np.pi, (count, 1))
            starts = se3.compose(se3.rotation_exp(turns), 2 * START[0] * rng.normal(size=(count, 3)))
            starts[0] = scene.vision.T_palm_object
            found = [rest(model, scene, T) for T in starts]
            rows.append({"object": shape, "trial": k, **compared(model, scene, found)})
    return rows


def compared(model: hs.ObjectModel, scene: scenes.Scene, found: Sequence[tuple[Array, float]]) -> Row:
    """Errors [mm], as they are and modulo symmetry, of the nearest rest, the cheapest, and handsight."""

    def apart(T: Array, T_other: Array) -> float:
        return 1000 * float(np.linalg.norm(se3.difference(T, T_other) * np.repeat([1, model.radius], 3)))

    nearest = min(found, key=lambda pair: apart(pair[0], scene.vision.T_palm_object))
    cheapest = min(found, key=lambda pair: pair[1])
    ours = hs.correct_pose(model, scene.contacts, vision=scene.vision).T_palm_object
    row = {"cost_nearest_cm": nearest[1], "cost_cheapest_cm": cheapest[1]}
    for name, T in (("nearest", nearest[0]), ("cheapest", cheapest[0]), ("handsight", ours)):
        row[f"{name}_mm"] = apart(T, scene.T_palm_object)
        row[f"{name}_symmetric_mm"] = apart(T, scenes.nearest_truth(model, scene.T_palm_object, T))
    return row


def evaluations(m: int) -> Ways:
    """Two ways to evaluate eq. 3 for a cloud of m points, each contact in its 200 nearest."""
    model, rng = scenes.box(), np.random.default_rng(m)
    scene = scene_of(scenes.on_four_sides(model, rng), rng)
    cloud, normals = model.sample(m)
    points, felt = scene.contacts.points_palm, scene.contacts.normals_palm
    near = np.array(paper.regions(points, cloud, 1e-9, 200))
    x = paper.normalised(np.array([1, 0.1, -0.05, 0.02, 0.01, -0.02, 0.005]))
    G = paper.Matching(points, cloud[near], felt, normals[near], 0.1)

    def cloud_moved() -> Array:
        M = paper.rotation(x[:4])
        moved, turned = (cloud - x[4:]) @ M, normals @ M
        return paper.residuals(IDENTITY, paper.Matching(points, moved[near], felt, turned[near], 0.1))

    return {CONTACTS: lambda: paper.residuals(x, G), CLOUD: cloud_moved}


def rotations(m: int) -> Ways:
    """Three ways to rotate m points."""
    v = np.random.default_rng(m).normal(size=(m, 3))
    w = np.array([0.3, -0.5, 0.2])
    half = np.linalg.norm(w) / 2
    q = np.array([np.cos(half), *(np.sin(half) / (2 * half) * w)])

    def cross(a: Any, b: Any) -> Array:
        return np.stack([a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)])

    def sandwich() -> Array:
        t = 2 * cross(q[1:], v.T)
        return np.transpose(v.T + q[0] * t + cross(q[1:], t))

    return {
        QUATERNION: sandwich,
        MATRICES[0]: lambda: v @ paper.rotation(q).T,
        MATRICES[1]: lambda: v @ se3.rotation_exp(w).T,
    }


def speed(options: report.Options) -> Rows:
    """Claim d: a row per task, number of points and way, their repeats interleaved."""
    tasks = [("evaluate", m, evaluations(m)) for m in CLOUDS] + [("rotate", m, rotations(m)) for m in POINTS]
    rows = []
    for task, m, ways in report.progress(tasks, "d times"):
        for way in ways.values():
            np.testing.assert_allclose(way(), next(iter(ways.values()))(), atol=1e-9)
        repeats = range(60 if options.quick else 400)
        times = np.array([[report.timed(way)[1] for way in ways.values()] for _ in repeats])
        for name, quartiles in zip(ways, np.quantile(1e6 * times, (0.25, 0.5, 0.75), axis=0).T, strict=True):
            row = dict(zip(QUARTILES, map(float, quartiles), strict=True))
            rows.append({"task": task, "points": m, "way": name, **row})
    return rows


def edges_judged(rows: Rows) -> Rows:
    """Claim a, for the paper's method and for handsight."""
    found = []
    for bare, felt in (("LM (paper)", "LM with normals (paper)"), ("handsight", "handsight with normals")):
        near, far = (report.values(rows, "wrong_face", method=bare, near_edge=n) for n in (1, 0))
        normals = report.values(rows, "wrong_face", method=felt, near_edge=1)
        claim = f"a {bare}: near an edge distance alone picks the wrong face, and normals do not"
        text = (
            f"Near an edge {report.plus_minus(near)} of contacts are on a wrong face by distance alone, "
            f"{report.plus_minus(normals)} with normals; far from any, {report.plus_minus(far)} by distance."
        )
        found.append(report.verdict(claim, report.positive(near - normals), text))
    return found


def weights_judged(rows: Rows) -> Rows:
    """Claim b, for each shape: from the smallest to the largest w_n."""
    found = []
    for shape in ("cube", "cylinder"):
        by_w = {n: np.array([report.values(rows, n, shape=shape, w_n_cm=w) for w in W_N_CM]) for n in WEIGHED}
        normals, distances = by_w["normal_deg"], by_w["distance_mm"]
        fits = [report.positive(normals[0] - normals[-1]), report.positive(distances[-1] - distances[0])]
        mean = {name: array.mean(axis=1) for name, array in by_w.items()}
        best = {name: f"{m.min():.1f} at {W_N_CM[m.argmin()]:g} cm" for name, m in mean.items()}
        (a, *_, b), (c, *_, d) = mean["normal_deg"], mean["distance_mm"]
        text = (
            f"From w_n = {W_N_CM[0]} to {W_N_CM[-1]} cm the normals' angle goes from {a:.1f} to {b:.1f}° "
            f"(least {best['normal_deg']}), the distance from {c:.2f} to {d:.2f} mm; least RME [mm]: "
            f"{best['rme_mm']}; least MAE [°]: {best['mae_deg']}."
        )
        claim = f"b {shape}: a larger w_n fits the normals better and the distances worse"
        found.append(report.verdict(claim, report.all_of(fits), text))
    return found


def minima_judged(rows: Rows) -> Rows:
    """Claim c, for each object, as it is and modulo symmetry."""
    found = []
    for shape, part in itertools.product(("box", "can"), ("", "_symmetric")):
        near, cheap = (report.values(rows, f"{n}{part}_mm", object=shape) for n in ("nearest", "cheapest"))
        worse, better = (cheap > near + 1) * 1.0, (cheap < near - 1) * 1.0
        how = ", modulo symmetry" if part else ""
        claim = f"c {shape}{how}: the nearest minimum is closer to the truth than the cheapest"
        text = (
            f"By over 1 mm the cheapest is worse in {report.plus_minus(worse)} of grasps, better in "
            f"{report.plus_minus(better)}; nearest: median {np.median(near):.1f}, mean {near.mean():.1f} mm; "
            f"cheapest: median {np.median(cheap):.1f}, mean {cheap.mean():.1f} mm."
        )
        found.append(report.verdict(claim, report.positive(worse - better), text))
    return found


def speed_judged(rows: Rows) -> Rows:
    """Claim d: confirmed where one way's median is below every other's at every size."""
    found = []
    for sizes, way, others, claim in (
        (CLOUDS, CONTACTS, (CLOUD,), "moving the contacts is faster than moving the cloud"),
        (POINTS, QUATERNION, MATRICES, "quaternions rotate points faster than matrices"),
    ):
        ratios = []
        for m in sizes:
            own, *rest_ = (report.values(rows, "median_us", points=m, way=w)[0] for w in (way, *others))
            ratios.append(min(rest_) / own)
        text = ", ".join(f"{ratio:.2f} ({m})" for m, ratio in zip(sizes, ratios, strict=True))
        text = f"Time of the fastest other way over its own, by number of points: {text}."
        found.append(report.verdict(f"d {claim}", min(ratios) > 1, text))
    return found


def print_tables(a: Rows, b: Rows, c: Rows, d: Rows) -> None:
    """One table a claim."""
    share = "Mean±standard error over grasps."
    report.print_grouped("a  Contacts on a wrong face", a, ("near_edge", "method"), {"wrong_face": 3}, share)
    report.print_grouped("b  LM with normals, by w_n", b, ("shape", "w_n_cm"), WEIGHED, share)
    for part, how in (("_mm", ""), ("_symmetric_mm", ", modulo symmetry")):
        names = dict.fromkeys((f"{name}{part}" for name in ("nearest", "cheapest", "handsight")), 1)
        report.print_grouped(f"c  Error of pose by choice of minimum{how}", c, ("object",), names, share)
    cells = [[r["task"], r["points"], r["way"], *(f"{r[q]:.1f}" for q in QUARTILES)] for r in d]
    columns = ["task", "points", "way", "25 % µs", "median µs", "75 % µs"]
    report.print_table("d  Times", columns, cells, report.machine())


def main() -> None:
    """Measures every claim, then judges each."""
    options = report.options(__doc__, trials=150, quick_trials=20)
    measured = {"edges": edges(options), "w_n": weights(options)}
    measured |= {"minima": minima(options), "speed": speed(options)}
    print_tables(*measured.values())
    judges = (edges_judged, weights_judged, minima_judged, speed_judged)
    found = [row for judge, rows in zip(judges, measured.values(), strict=True) for row in judge(rows)]
    for name, rows in measured.items():
        report.write_csv(options.output / f"claims_{name}.csv", rows)
    report.write_csv(options.output / "claims.csv", found)
    claims_figure.draw(measured, options.output / "claims.png")


if __name__ == "__main__":
    main()
