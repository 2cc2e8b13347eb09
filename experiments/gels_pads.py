"""Gels and binary pads: their contacts, and the poses that these give with a camera's prior. All synthetic.

A gel of 14 by 19 mm, a membrane on springs, whose image is blurred, has correlated noise, a scale that is off by 8 %,
and dead pixels: objects are pressed 0.3 to 1 mm into it. A pad says no more than that it is touched somewhere; it is
5 by 4 points of a fingertip's flat pad, of a dome, of a palm, of a bent phalanx. Both are off by 0.5 mm along their
normals. Vision is off by 20 mm and 15°; with two fingertips, 1 mm and 2°, on the object's far side. Constants were
chosen with other seeds of all but the bodies, pads and objects that are held out, which were drawn for the first time
when the constants were chosen.

  point    distance of a gel's contact from the object's surface, median and 90 % quantile
  NEES     squared error by the covariance, per degree of freedom, median and mean
  in 95 %  share of the answer's 95 % regions that hold the truth; of their maximum, where the answer is a mean
  region   its size as a share of that without the gel or the pad, median over trials
  exact    the same by 8 000 poses of the prior, weighted by how near the pad's nearest point is to the surface
"""

from typing import Any

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from shared import gel_scenes, pad_scenes, report, scenes
from testbed.report import Array, Row, Rows

HELD_OUT = 41
"""A key of the scenes that no constant was chosen on."""
SAMPLES = 8_000
SIGMA_EXACT = 6e-4
"""Of the distance of a pad's nearest point: the mount, and how far it is pressed in [m]."""


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=60, quick_trials=6)
    gels, pads = of_gels(options), of_pads(options)
    print_gels(gels)
    print_pads(pads)
    report.write_csv(options.output / "gels.csv", gels["contacts"] + gels["poses"])
    report.write_csv(options.output / "pads.csv", pads)


def of_gels(options: report.Options) -> dict[str, Rows]:
    """The errors of a gel's contacts, and of the poses by them."""
    gel, found = gel_scenes.gel(), {"contacts": list[Row](), "poses": list[Row]()}
    for n, (name, (make, tilt)) in enumerate(gel_scenes.BODIES.items()):
        model = make()
        for k in report.progress(range(options.trials), name):
            rng = options.rng(HELD_OUT, n, k)
            scene = gel_scenes.pressed(model, rng, tilt=tilt)
            touch = gel.touch(scene.image)
            found["contacts"] += [
                {"body": name, **gel_scenes.errors(model, patch, scene.T_true)} for patch in touch.patches
            ]
            contacts = touch.contacts(np.eye(4))
            if contacts is None or name in ("marble", "rod"):
                continue
            ideal = drawn(model, contacts, scene.T_gel_object, rng)
            cases = {"gel": contacts, "tips": scene.tips, "tips, gel": scene.tips.joined(contacts),
                     "tips, ideal": scene.tips.joined(ideal)}  # fmt: skip
            found["poses"] += [
                {
                    "body": name,
                    "with": case,
                    **posed(model, each, scene.vision, scene.T_gel_object, scene.tips),
                }
                for case, each in cases.items()
            ]
    return found


def drawn(model: hs.ObjectModel, contacts: hs.Contacts, T: Array, rng: np.random.Generator) -> hs.Contacts:
    """Contacts at the same places of the object whose errors are drawn by the covariances themselves."""
    field = model.evaluate(se3.apply(se3.inverse(T), contacts.points_palm))
    normals = field.gradient @ T[:3, :3].T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = contacts.points_palm - field.distance[:, None] * normals
    noise = np.array([rng.multivariate_normal(np.zeros(6), C) for C in contacts.covariance])
    return hs.Contacts(points + noise[:, :3], normals + noise[:, 3:], covariance=contacts.covariance)


def posed(
    model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior, T: Array, tips: hs.Contacts
) -> Row:
    """How good a pose is and says to be; its region beside that by vision, and where there are tips by these too."""
    both = len(contacts) > len(tips) and np.allclose(contacts.points_palm[: len(tips)], tips.points_palm)
    before: Array = np.linalg.inv(vision.covariance)
    if both:
        before = hs.correct_pose(model, tips, vision=vision).information
    best, most = (hs.correct_pose(model, contacts, vision=vision, answer=a) for a in ("best", "maximum"))
    regions = [scenes.region(model, each, T) for each in (best, most)]
    return {
        "in 95%": regions[0]["in 95%"],
        "in 95% of maximum": regions[1]["in 95%"],
        "nees": regions[0]["squared"] / regions[0]["freedom"],
        "region": pad_scenes.shrunk(before, best.information),
    }


def of_pads(options: report.Options) -> Rows:
    """The errors of the poses by a pad alone, by two tips, and by both."""
    rows: Rows = []
    for n, (name, make) in enumerate(pad_scenes.OBJECTS.items()):
        model = make()
        for m, (pad, shape) in enumerate(pad_scenes.SHAPES.items()):
            if (pad in pad_scenes.HELD_OUT) != (name in pad_scenes.OBJECTS_HELD_OUT):
                continue
            contact: Any = shape.pad().touch([1.0]).contacts(np.eye(4))
            for k in report.progress(range(options.trials), f"{name} on {pad}"):
                rng = options.rng(HELD_OUT, 10 + n, m, k)
                scene = pad_scenes.touching(model, shape, rng)
                truth, vision = scene.T_palm_object, scene.vision
                cases = {"pad": contact, "tips": scene.tips, "tips, pad": scene.tips.joined(contact)}
                rows += [
                    {"body": name, "pad": pad, "with": case, **posed(model, each, vision, truth, scene.tips)}
                    for case, each in cases.items()
                ]
                points = shape.surface(6, 6)[0]
                rows.append({"body": name, "pad": pad, "with": "exact", **exact(model, points, scene, rng)})
    return rows


def exact(model: hs.ObjectModel, points: Array, scene: pad_scenes.PadScene, rng: np.random.Generator) -> Row:
    """The region by poses of the prior, weighted by the distance of the pad's nearest point to the surface."""
    vision = scene.vision
    steps = rng.multivariate_normal(np.zeros(6), vision.covariance, SAMPLES)
    T = vision.T_palm_object
    poses = np.array([se3.moved(T, step) for step in steps])
    R, p = poses[:, :3, :3], poses[:, :3, 3]
    nearest = np.full(SAMPLES, np.inf)
    for point in points:
        places = np.einsum("nji,nj->ni", R, point - p)
        nearest = np.minimum(nearest, model.evaluate(places).distance)
    weight = np.exp(-0.5 * (nearest / SIGMA_EXACT) ** 2)
    weight /= weight.sum()
    mean = weight @ steps
    C = (weight[:, None] * (steps - mean)).T @ (steps - mean)
    T_mean = se3.moved(T, mean)
    error = se3.difference(scenes.nearest_truth(model, scene.T_palm_object, T_mean), T_mean)
    keep = free(model, T_mean)
    squared = error @ keep @ np.linalg.solve(keep.T @ C @ keep, keep.T @ error)
    sizes = [np.linalg.slogdet(keep.T @ each @ keep)[1] for each in (C, vision.covariance)]
    return {
        "in 95%": bool(squared < chdtri(keep.shape[1], 0.05)),
        "nees": float(squared) / keep.shape[1],
        "region": float(np.exp((sizes[0] - sizes[1]) / 2)),
    }


def free(model: hs.ObjectModel, T: Array) -> Array:
    """A basis (6, k) of the directions that are not symmetries about an axis through the object's origin."""
    if not len(model.symmetries.axes):
        return np.eye(6)
    spin = np.concatenate([np.zeros(3), T[:3, 2]])
    return np.asarray(np.linalg.svd(spin[None])[2][1:].T)


def print_gels(found: dict[str, Rows]) -> None:
    """The tables of gels."""
    table = []
    for name in gel_scenes.BODIES:
        mine = report.chosen(found["contacts"], body=name)
        point, normal, nees = (report.values(mine, key) for key in ("point", "normal", "nees"))
        cells = [f"{f(values):.{d}f}" for values, d in ((point, 2), (normal, 1)) for f in (np.median, p90)]
        use = "held out" if name in gel_scenes.HELD_OUT else "chosen on"
        table.append([name, use, len(mine), *cells, f"{np.median(nees):.2f}", f"{nees.mean():.2f}"])
    header = ["body", "", "contacts", "point mm", "p90", "normal °", "p90", "NEES", "mean"]
    report.print_table("Contacts of a gel (synthetic)", header, table, "")
    print_poses("Poses by a gel (synthetic)", found["poses"], "body", tuple(gel_scenes.BODIES)[2:])


def print_pads(rows: Rows) -> None:
    """The tables of pads: by pad, and by object."""
    print_poses("Poses by a pad, by the pad (synthetic)", rows, "pad", tuple(pad_scenes.SHAPES))
    print_poses("Poses by a pad, by the object (synthetic)", rows, "body", tuple(pad_scenes.OBJECTS))


def print_poses(title: str, rows: Rows, key: str, names: tuple[str, ...]) -> None:
    """A table of regions by a key and what the poses are with."""
    table = []
    for name in (*names, "all"):
        if name == "all" and key == "body" and "pad" in rows[0]:
            continue  # they are in the table by pads
        mine = rows if name == "all" else report.chosen(rows, **{key: name})
        for case in report.distinct(mine, "with"):
            some = report.chosen(mine, **{"with": case})
            most = [row["in 95% of maximum"] for row in some if "in 95% of maximum" in row]
            shares = [
                f"{100 * np.mean(each):.0f} %" if each else ""
                for each in ([row["in 95%"] for row in some], most)
            ]
            nees = report.values(some, "nees")
            region = f"{np.median(report.values(some, 'region')):.2g}"
            table.append([name, case, len(some), *shares, f"{np.median(nees):.2f}", region])
    header = [key, "with", "n", "in 95 %", "maximum", "NEES", "region"]
    report.print_table(title, header, table, "")


def p90(values: Array) -> float:
    """The 90 % quantile."""
    return float(np.quantile(values, 0.9))


if __name__ == "__main__":
    main()
