"""A box gripped by two fingers and a thumb on opposite faces: what the contacts leave open, and what helps.

Box 60 x 90 x 140 mm, gripped across its 90 mm side; contact noise 1.6 mm and 4 degrees per axis (what joint
offsets of 1 degree leave), vision off by 80 mm on average in the plane of the table, 3 mm in height, 10 degrees
(root mean square), its covariance stated truthfully. The contacts bound the slide along the gripped faces but do
not fix it: the maximum of the density ends at the interval's end, its mean in the middle. Synthetic.

  slide    error along the gripped faces, horizontally; gap: across them; up: vertically
  turned   boxes left turned by more than 20 degrees (modulo symmetry)
"""

import numpy as np

import handsight as hs
import report
import scenes
from handsight import se3
from handsight.objects.symmetry import nearest

NOISE = (1.6e-3, np.deg2rad(4))
PLANE_MEAN, HEIGHT, TURN = 0.080, 0.003, np.deg2rad(10)
SAMPLES = 4000


def grip(rng):
    """Two fingers and the thumb, object frame."""
    x, z = rng.uniform(-0.012, 0.012), rng.uniform(-0.03, 0.03)
    fingers = np.array([[x - 0.009, 0.045, z], [x + 0.009, 0.045, z], [x, -0.045, z]])
    fingers[:, 2] += 0.004 * rng.normal(size=3)
    return fingers, np.array([[0, 1.0, 0], [0, 1, 0], [0, -1, 0]])


def problem(rng):
    """Contacts, vision and the true pose; the table's normal is the box's z."""
    points, normals = grip(rng)
    T = se3.random(rng, spread=0.1)
    R = T[:3, :3]
    touched = se3.apply(T, points) + NOISE[0] * rng.normal(size=(3, 3))
    contacts = hs.Contacts(
        touched, scenes.tilted(normals @ R.T, NOISE[1], rng), sigma_point=NOISE[0], sigma_normal=NOISE[1]
    )
    in_plane = PLANE_MEAN / np.sqrt(np.pi / 2)  # a Rayleigh length has this mean
    sigma = np.array([in_plane, in_plane, HEIGHT, *[TURN / np.sqrt(3)] * 3])
    covariance = se3.rotate_covariance(R, np.diag(sigma**2))
    off = sigma * rng.normal(size=6)
    T_vision = se3.moved(T, np.concatenate([R @ off[:3], R @ off[3:]]))
    return contacts, hs.PosePrior(T_vision, covariance), T


def errors(model, T, T_true):
    """Slide, gap, up [mm] and turn [deg]."""
    truth = nearest(model.symmetries, T_true, T, model.radius)
    delta = se3.difference(T, truth)
    slide, gap, up = 1e3 * np.abs(T_true[:3, :3].T @ delta[:3])
    return {"slide": slide, "gap": gap, "up": up, "turn": np.rad2deg(np.linalg.norm(delta[3:]))}


def main():
    """Runs the experiment."""
    options, _ = report.parsed(report.parser(__doc__), trials=200, quick_trials=15)
    model = hs.ObjectModel.box(scenes.BOX)
    rows = []
    for k in report.progress(range(options.trials), "gripped box"):
        contacts, vision, T = problem(options.rng(k))
        rows.append({"trial": k, "answer": "vision", **errors(model, vision.T_palm_object, T)})
        for answer, samples in (("maximum", 0), ("mean", SAMPLES)):
            estimate, seconds = report.timed(
                lambda s=samples: hs.correct_pose(model, contacts, vision=vision, samples=s)  # noqa: B023
            )
            row = {
                "trial": k,
                "answer": answer,
                **errors(model, estimate.T_palm_object, T),
                "ms": 1e3 * seconds,
            }
            axis = T[:3, 0]
            row["sigma_slide"] = 1e3 * np.sqrt(axis @ estimate.covariance[:3, :3] @ axis)
            rows.append(row)
    summarise(rows, options)


def summarise(rows, options):
    """Table, CSV, figure."""
    table = []
    by_answer = {a: [r for r in rows if r["answer"] == a] for a in ("vision", "maximum", "mean")}
    for answer, mine in by_answer.items():
        turned = sum(r["turn"] > 20 for r in mine)
        sigma = report.plus_minus((r["sigma_slide"] for r in mine), 1) if answer != "vision" else ""
        ms = f"{np.median([r['ms'] for r in mine]):.0f}" if answer != "vision" else ""
        cells = [report.plus_minus((r[key] for r in mine), 1) for key in ("slide", "gap", "up", "turn")]
        table.append([answer, *cells, sigma, turned, ms])
    slide = {a: np.mean([r["slide"] for r in mine]) for a, mine in by_answer.items()}
    report.print_table(
        f"Mean absolute error, {options.trials} grips (synthetic)",
        ["answer", "slide mm", "gap mm", "up mm", "turn °", "σ of slide mm", "turned > 20°", "ms"],
        table,
        f"± one standard error. The mean's slide error is {slide['mean'] / slide['maximum']:.2f} of the maximum's.",
    )
    report.write_csv(options.output / "gripped_box.csv", rows)
    plt = report.pyplot()
    figure, axes = plt.subplots(figsize=(5.6, 3.4), layout="constrained")
    bins = np.linspace(0, 60, 31)
    colours = {"vision": report.INITIAL, "maximum": report.RESULT, "mean": report.TRUTH}
    for answer, mine in by_answer.items():
        values = np.clip([r["slide"] for r in mine], 0, 59.9)
        axes.hist(values, bins, histtype="step", linewidth=1.8, color=colours[answer], label=answer)
    axes.set_xlabel("slide error [mm] (last bin: and above)")
    axes.set_ylabel("grips")
    axes.legend()
    report.save_figure(figure, options.output / "gripped_box.png")


if __name__ == "__main__":
    main()
