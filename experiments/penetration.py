"""How deep the hand is left inside the object after a correction, with and without outside evidence.

Two fingers and a thumb grip a box across its 90 mm side, or a can across its diameter; vision is off by 60 mm and
15 degrees (root mean square). The hand is simple and synthetic: each finger a capsule of 8 mm radius and 50 mm
length that touches at its contact and leans back to the palm, a plate 10 mm behind the object. Points that
would lie inside the true object are not used. Contacts have 1 mm and 4 degrees of noise per axis, the hand's
points 1 mm. Depth: of the deepest hand point inside the object at the corrected pose, zero where none is inside
(noise alone leaves 1 to 2 mm).
Flagged: the answer says the evidence does not fit; without outside evidence it cannot know of the hand.
"""

import numpy as np

import handsight as hs
import report
import scenes
from handsight import se3

RADIUS, LENGTH, RINGS, AROUND = 0.008, 0.050, 7, 10
PALM_BEHIND, PALM_HALF = 0.010, (0.045, 0.040)
NOISE = (1e-3, np.deg2rad(4))
ERROR = (0.060, np.deg2rad(15))
DEEP = 0.005


def opposed(rng, half, flat):
    """Two fingers at +half and the thumb at -half along y, object frame; on a can's side where not flat."""
    spread = 0.012 if flat else 0.35
    along = rng.uniform(-0.02, 0.02) + 0.012 * np.array([1, -1, 0.0])
    aside = spread * np.array([-0.6, 0.6, 0.0]) + rng.uniform(-1, 1) * spread * 0.3
    sign = np.array([1.0, 1, -1])
    if flat:
        points = np.column_stack([aside, sign * half, along])
        normals = np.column_stack([0 * along, sign, 0 * along])
    else:
        normals = np.column_stack([np.sin(aside), sign * np.cos(aside), 0 * along])
        points = half * normals + along[:, None] * [0, 0, 1.0]
    return points, normals


def hand_points(points, normals, model):
    """(m, 3) on the fingers and on the palm, which is on the object's +x side, object frame."""
    back = np.array([1.0, 0, 0])
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    cloud = []
    for point, normal in zip(points, normals, strict=True):
        axis = normal + 1.2 * back
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        ring = RADIUS * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
        for step in np.linspace(0, LENGTH, RINGS):
            cloud.append(point + RADIUS * normal + step * axis + ring)
    x = model.bounds_object[1, 0] + PALM_BEHIND
    y, z = (np.linspace(-h, h, 8) for h in PALM_HALF)
    cloud.append(np.stack(np.meshgrid([x], y, z), axis=-1).reshape(-1, 3))
    return np.concatenate(cloud)


def trial(model, half, flat, rng):
    """Depths, errors and flags of one grip, a row for each kind of evidence."""
    points, normals = opposed(rng, half, flat)
    scene = scenes.grasp(points, normals, rng, noise=NOISE, error=ERROR)
    cloud = hand_points(points, normals, model)
    cloud = cloud[model.fine.evaluate(cloud).distance > 0]
    hand = se3.apply(scene.T_palm_object, cloud) + NOISE[0] * rng.normal(size=cloud.shape)
    rows = []
    for evidence, outside in (("contacts", None), ("contacts + outside", hand)):
        estimate, seconds = report.timed(
            lambda o=outside: hs.correct_pose(model, scene.contacts, vision=scene.vision, outside=o)
        )
        inside = se3.apply(se3.inverse(estimate.T_palm_object), hand)
        depth = max(0.0, -float(model.fine.evaluate(inside).distance.min()))
        shift, turn, _, _ = scenes.pose_errors(model, estimate, scene.T_palm_object)
        flagged = not estimate.consistent
        rows.append(
            {"evidence": evidence, "depth_mm": 1e3 * depth, "shift_mm": 1e3 * shift,
             "turn_deg": np.rad2deg(turn), "flagged": flagged, "ms": 1e3 * seconds}
        )  # fmt: skip
    return rows


def main():
    """Runs the experiment."""
    options, _ = report.parsed(report.parser(__doc__), trials=200, quick_trials=12)
    objects = {
        "box": (hs.ObjectModel.box(scenes.BOX), scenes.BOX[1] / 2, True),
        "can": (hs.ObjectModel.cylinder(**scenes.CAN), scenes.CAN["radius"], False),
    }
    rows = []
    for o, (name, (model, half, flat)) in enumerate(objects.items()):
        for k in report.progress(range(options.trials), name):
            rows += [{"object": name, "trial": k, **r} for r in trial(model, half, flat, options.rng(o, k))]
    report.print_table(
        f"Deepest hand point inside the object, {options.trials} grips each (synthetic)",
        [
            "object",
            "evidence",
            "depth median mm",
            "p99 mm",
            f"> {1e3 * DEEP:.0f} mm",
            "of these flagged",
            "shift mm",
            "turn °",
            "ms",
        ],
        [
            summarised(name, evidence, rows)
            for name in objects
            for evidence in ("contacts", "contacts + outside")
        ],
        "shift and turn: mean error of the pose, ± one standard error.",
    )
    report.write_csv(options.output / "penetration.csv", rows)
    draw_figure(rows, options.output / "penetration.png")


def summarised(name, evidence, rows):
    """The cells of one row of the table."""
    mine = [r for r in rows if r["object"] == name and r["evidence"] == evidence]
    depth = [r["depth_mm"] for r in mine]
    deep = [r for r in mine if r["depth_mm"] > 1e3 * DEEP]
    flagged = f"{sum(r['flagged'] for r in deep)} of {len(deep)}"
    return [name, evidence, f"{np.median(depth):.1f}", f"{np.quantile(depth, 0.99):.1f}",
            f"{len(deep)} of {len(mine)}", flagged, report.plus_minus((r["shift_mm"] for r in mine), 1),
            report.plus_minus((r["turn_deg"] for r in mine), 1),
            f"{np.median([r['ms'] for r in mine]):.0f}"]  # fmt: skip


def draw_figure(rows, path):
    """Depth, sorted, with and without outside evidence."""
    plt = report.pyplot()
    names = list(dict.fromkeys(r["object"] for r in rows))
    figure, panels = plt.subplots(1, len(names), figsize=(8, 3.4), sharey=True, layout="constrained")
    for axes, name in zip(panels, names, strict=True):
        for evidence, colour in (("contacts", report.INITIAL), ("contacts + outside", report.TRUTH)):
            depth = np.sort(
                [r["depth_mm"] for r in rows if r["object"] == name and r["evidence"] == evidence]
            )
            axes.plot(
                depth, (np.arange(len(depth)) + 1) / len(depth), color=colour, label=evidence, linewidth=2
            )
        axes.set_title(name)
        axes.set_xlabel("deepest hand point inside the object [mm]")
    panels[0].set_ylabel("share of grips")
    panels[0].legend(loc="lower right")
    report.save_figure(figure, path)


if __name__ == "__main__":
    main()
