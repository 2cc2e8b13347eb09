"""Fig. 5 of the paper: where a fingertip is touched, from nothing but the wrench at its base (eq. 7).

A finger of the simulated can grasp (MuJoCo): the force and torque that its sensor reads, bias and weight removed,
are one line of force; where that line enters the ellipsoid, the object pushes. Left: the tip with the line, the
point found, its normal and the simulator's own contact. Right: all contacts of the grasps, their errors over noise.
"""

import numpy as np

import report
from grasp_trials import OBJECTS, SEEDS_APART, last_instant, rig, sensing_errors
from handsight import compensate, contact_from_wrench, se3
from handsight.errors import MissingExtra
from handsight.simulation import Nuisances, Scenario

FINGER = "th"
NOISE_DRAWS = 4
PAPER_UM = 266
LINE, FOUND, TRUE, NORMAL = "#3b6fb6", "#e6b400", "#2e9e4f", "#c2185b"


def load(sample, finger):
    """Force and torque (3,) of the object on the tip in the sensor's frame, and T_palm_surface (4, 4)."""
    robot, observation = rig(), sample.observation
    order = list(robot.hand.tips)
    known = robot.fingers[finger]
    T_palm_tip = robot.hand.Ts_palm_tip(observation.joint_positions)[order.index(finger)]
    T_palm_surface = T_palm_tip @ known.T_frame_surface
    T_world_sensor = observation.T_world_palm @ T_palm_surface @ known.tip.T_surface_sensor
    raw = observation.wrenches[finger]
    gravity_sensor = T_world_sensor[:3, :3].T @ robot.gravity
    force, torque = compensate(raw[:3], raw[3:], gravity_sensor, known.calibration)
    return force, torque, T_palm_surface


def touched(sample, finger):
    """What is drawn, in the frame of the tip's surface: contact, the force's line and the true point [m]."""
    force, torque, T_palm_surface = load(sample, finger)
    tip = rig().fingers[finger].tip
    contact = contact_from_wrench(force, torque, tip)
    truth = next(t for t in sample.contacts_truth if t.finger == finger and t.other == "object")
    true = se3.apply(se3.inverse(T_palm_surface), truth.point_palm[None])[0]
    along = contact.force / np.linalg.norm(contact.force)
    return {"tip": tip, "contact": contact, "along": along, "true": true}


def draw_tip(axes, found):
    """The ellipsoid with its sensor's frame, the line of force, the point, its normal, and the truth."""
    tip, contact = found["tip"], found["contact"]
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1) * tip.semi_axes
    axes.plot_surface(*np.moveaxis(ball, -1, 0), color="0.75", alpha=0.25, linewidth=0)
    axes.plot_wireframe(*np.moveaxis(ball, -1, 0), rstride=4, cstride=6, color="0.6", linewidth=0.5)
    length = 1.3 * tip.semi_axes[2]
    start = contact.point - length * found["along"]
    axes.plot(
        *np.stack([start, contact.point + 0.9 * length * found["along"]], axis=1), color=LINE, lw=1.5, ls="--"
    )
    axes.quiver(*start, *(0.95 * length * found["along"]), color=LINE, lw=2.2, arrow_length_ratio=0.12)
    axes.quiver(*contact.point, *(0.011 * contact.normal), color=NORMAL, lw=2.2, arrow_length_ratio=0.25)
    axes.scatter(*found["true"], s=130, facecolors="none", edgecolors=TRUE, linewidths=2.2, depthshade=False)
    axes.scatter(
        *contact.point, s=28, color=FOUND, edgecolors="k", linewidths=0.6, depthshade=False, zorder=9
    )
    for direction in np.eye(3):
        origin = tip.T_surface_sensor[:3, 3]
        axes.quiver(*origin, *(0.006 * direction), color="k", lw=1.2, arrow_length_ratio=0.25)
    axes.text(*(tip.T_surface_sensor[:3, 3] + [0.002, 0, -0.003]), "sensor", fontsize=8)
    report.frame_3d(
        axes, np.vstack([ball.reshape(-1, 3), start, tip.T_surface_sensor[:3, 3]]), view=view(found)
    )
    for name in "xyz":
        getattr(axes, f"{name}axis").set_major_formatter(lambda value, _: f"{1000 * value:.0f}")
        getattr(axes, f"set_{name}label")(f"tip {name} [mm]")


def view(found):
    """Elevation and azimuth [°] from which the point is seen, the force's line beside it."""
    x, y, _ = found["contact"].point
    return 14, float(np.rad2deg(np.arctan2(y, x))) + 50


def legend(axes, error_um):
    """What is what, below."""
    entry = {"linestyle": "none", "marker": "o"}
    axes.plot([], [], color=LINE, lw=2, label="force of the object, and its line")
    axes.plot([], [], **entry, color=FOUND, mec="k", label="point found")
    axes.plot([], [], color=NORMAL, lw=2, label="object's outward normal")
    axes.plot(
        [],
        [],
        **entry,
        mfc="none",
        mec=TRUE,
        mew=2,
        ms=10,
        label=f"simulator's point ({error_um:.0f} µm off)",
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, fontsize=8)


def draw_errors(axes, sensing):
    """Shares of contacts below an error."""
    styles = {"clean": ("no noise", "-"), "noisy": ("10 mN, 0.05 mN m", "--")}
    for name, colour in zip(sensing, (LINE, "#c2571a"), strict=True):
        for key, (label, style) in styles.items():
            um = np.sort(1e6 * np.array(sensing[name][key]))
            share = np.arange(1, len(um) + 1) / len(um)
            text = f"{name}, {label}: mean {um.mean():.0f} µm"
            axes.plot(um, 100 * share, style, color=colour, drawstyle="steps-post", label=text)
    axes.axvline(
        PAPER_UM, color="0.5", linewidth=1, linestyle=":", label=f"the paper's sensor, mean: {PAPER_UM} µm"
    )
    axes.set(xlabel="error of the point [µm]", ylabel="contacts with less [%]", xlim=(0, 500), ylim=(0, 100))
    axes.legend(loc="lower right", fontsize=8)


def run(options):
    """The contact that is drawn, and the errors of all."""
    sensing = {}
    for o, name in enumerate(OBJECTS):
        sensing[name] = {"clean": [], "noisy": []}
        for k in report.progress(range(options.trials), name):
            scenario = Scenario(object=name, seed=options.seed * SEEDS_APART + k, rate=10.0)
            clean, noisy = sensing_errors(scenario, NOISE_DRAWS, options.rng(o, k))
            sensing[name]["clean"] += clean
            sensing[name]["noisy"] += noisy
    scenario = Scenario(seed=options.seed * SEEDS_APART, rate=10.0, nuisances=Nuisances.none())
    return touched(last_instant(scenario), FINGER), sensing


def main():
    """Senses, draws."""
    options, _ = report.parsed(report.parser(__doc__), trials=30, quick_trials=4)
    try:
        found, sensing = run(options)
    except MissingExtra as error:
        report.say(f"skipped: {error}")
        return
    error_um = 1e6 * float(np.linalg.norm(found["contact"].point - found["true"]))
    rows = [
        {"object": name, "noise": key, "contacts": len(v), "mean_um": 1e6 * float(np.mean(v))}
        for name, by_noise in sensing.items()
        for key, v in by_noise.items()
    ]
    cells = [[r["object"], r["noise"], r["contacts"], f"{r['mean_um']:.0f}"] for r in rows]
    report.print_table("Contacts from simulated wrenches", ["object", "noise", "contacts", "mean µm"], cells)
    report.write_csv(options.output / "figure_5.csv", rows)
    plt = report.pyplot()
    figure = plt.figure(figsize=(11, 5.4), layout="constrained")
    left = figure.add_subplot(1, 2, 1, projection="3d")
    draw_tip(left, found)
    left.set_title("thumb of the can grasp, without noise")
    legend(left, error_um)
    draw_errors(figure.add_subplot(1, 2, 2), sensing)
    report.save_figure(figure, options.output / "figure_5.png")


if __name__ == "__main__":
    main()
