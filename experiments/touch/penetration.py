"""How deep the hand is left inside the object after a correction, with and without outside evidence.

Two fingers and a thumb grip a box across its 90 mm side, or a can across its diameter; vision is off by 60 mm and
15 degrees (root mean square). The hand is simple and synthetic: each finger a capsule of 8 mm radius and 50 mm
length that touches at its contact and leans back to the palm, a plate 10 mm behind the object. Points that
would lie inside the true object are not used. Contacts have 1 mm and 4 degrees of noise per axis, the hand's
points 1 mm. Depth: of the deepest hand point inside the object at the corrected pose, zero where none is inside
(noise alone leaves 1 to 2 mm).
The answer is the maximum: the default's mean lies in the middle of what contacts allow, away from the hand.
Flagged: the answer says the evidence does not fit; without outside evidence it cannot know of the hand.
"""

from functools import partial

import numpy as np

import handsight as hs
from handsight import se3
from testbed import report, scenes
from testbed.report import Array, Rows

RADIUS, LENGTH, RINGS, AROUND = 0.008, 0.050, 7, 10
PALM_BEHIND, PALM_HALF = 0.010, (0.045, 0.040)
NOISE = (1e-3, float(np.deg2rad(4)))
ERROR = (0.060, float(np.deg2rad(15)))
DEEP = 5.0
"""[mm]"""
EVIDENCE = ("contacts", "contacts + outside")
CELLS = {
    "depth median mm": report.of("depth_mm", ".1f", np.median),
    "p99 mm": report.of("depth_mm", ".1f", report.quantile(0.99)),
    f"> {DEEP:.0f} mm": report.of("deep", ".0f", np.sum),
    "of these flagged": report.of("deep_flagged", ".0f", np.sum),
    "shift mm": report.error_of("shift_mm"),
    "turn °": report.error_of("turn_deg"),
    "ms": report.of("ms", ".0f", np.median),
}


def hand_points(surface: scenes.Surface, model: hs.ObjectModel) -> Array:
    """(m, 3) on the fingers and on the palm, which is on the object's +x side, object frame."""
    back = np.array([1.0, 0, 0])
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    cloud = []
    for point, normal in zip(*surface, strict=True):
        axis = normal + 1.2 * back
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        ring = RADIUS * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
        cloud += [point + RADIUS * normal + step * axis + ring for step in np.linspace(0, LENGTH, RINGS)]
    x = model.bounds_object[1, 0] + PALM_BEHIND
    y, z = (np.linspace(-h, h, 8) for h in PALM_HALF)
    cloud.append(np.stack(np.meshgrid([x], y, z), axis=-1).reshape(-1, 3))
    return np.concatenate(cloud)


def trial(model: hs.ObjectModel, half: float, flat: bool, rng: np.random.Generator) -> Rows:
    """Depths, errors and flags of one grip, a row for each kind of evidence."""
    surface = scenes.opposed(rng, half, flat)
    scene = scenes.random_scene(surface, rng, noise=NOISE, error=ERROR)
    cloud = hand_points(surface, model)
    cloud = cloud[model.fine.evaluate(cloud).distance > 0]
    hand = se3.apply(scene.T_palm_object, cloud) + NOISE[0] * rng.normal(size=cloud.shape)
    rows = []
    for evidence, outside in zip(EVIDENCE, (None, hand), strict=True):
        correct = partial(hs.correct_pose, model, scene.contacts, vision=scene.vision, outside=outside)
        found, seconds = report.timed(correct)
        estimate = scenes.at_maximum(found)
        inside = se3.apply(se3.inverse(estimate.T_palm_object), hand)
        depth = max(0.0, -float(model.fine.evaluate(inside).distance.min()))
        shift, turn, _, _ = scenes.pose_errors(model, estimate, scene.T_palm_object)
        rows.append(
            {"evidence": evidence, "depth_mm": 1e3 * depth, "shift_mm": 1e3 * shift,
             "turn_deg": np.rad2deg(turn), "deep": 1e3 * depth > DEEP, "ms": 1e3 * seconds,
             "deep_flagged": 1e3 * depth > DEEP and not estimate.consistent}
        )  # fmt: skip
    return rows


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=200, quick_trials=12)
    box, can = (scenes.box(), scenes.BOX[1] / 2, True), (scenes.can(), scenes.CAN["radius"], False)
    rows: Rows = []
    for o, (name, given) in enumerate({"box": box, "can": can}.items()):
        for k in report.progress(range(options.trials), name):
            rows += [{"object": name, "trial": k, **r} for r in trial(*given, options.rng(o, k))]
    title = f"Deepest hand point inside the object, {options.trials} grips each (synthetic)"
    note = "shift and turn: mean error of the pose, ± one standard error."
    report.print_by(title, rows, "object, evidence", CELLS, note)
    report.write_csv(options.output / "penetration.csv", rows)


if __name__ == "__main__":
    main()
