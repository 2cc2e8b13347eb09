"""Fig. 5 of the paper: where a fingertip is touched, from nothing but the wrench at its base (eq. 7).

A finger of the simulated can grasp (MuJoCo): the force and torque that its sensor reads, bias and weight removed,
are one line of force; where that line enters the ellipsoid, the object pushes. Drawn: the tip with the line, the
point found, its normal and the simulator's own contact. How far contacts are off with noise, `section_3.py` says.
"""

from typing import Any

import numpy as np

from experiments.shared.grasp_trials import INSTANTS, last_instant, rig
from handsight import Contact, contact_from_wrench, se3
from handsight.contact import compensate
from handsight.simulation import Nuisances, Scenario
from testbed import figures, report
from testbed.report import Array

FINGER = "th"
LINE, FOUND, TRUE, NORMAL = "#3b6fb6", "#e6b400", "#2e9e4f", "#c2185b"


def load(sample: Any, finger: str) -> tuple[Array, Array, Array]:
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


def touched(sample: Any, finger: str) -> tuple[Any, Any, Array]:
    """What is drawn, in the frame of the tip's surface: the tip, the contact found, the true point [m]."""
    force, torque, T_palm_surface = load(sample, finger)
    tip = rig().fingers[finger].tip
    truth = next(t for t in sample.contacts_truth if t.finger == finger and t.other == "object")
    true = se3.apply(se3.inverse(T_palm_surface), truth.point_palm[None])[0]
    return tip, contact_from_wrench(force, torque, tip), true


def draw_tip(axes: Any, tip: Any, contact: Contact, true: Array) -> None:
    """The ellipsoid with its sensor's frame, the line of force, the point, its normal, and the truth."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1) * tip.semi_axes
    axes.plot_surface(*np.moveaxis(ball, -1, 0), color="0.75", alpha=0.25, linewidth=0)
    axes.plot_wireframe(*np.moveaxis(ball, -1, 0), rstride=4, cstride=6, color="0.6", linewidth=0.5)
    along = 1.3 * tip.semi_axes[2] * contact.force / np.linalg.norm(contact.force)
    start, end = contact.point - along, contact.point + 0.9 * along
    axes.plot(*np.stack([start, end], axis=1), color=LINE, lw=1.5, ls="--")
    axes.quiver(*start, *(0.95 * along), color=LINE, lw=2.2, arrow_length_ratio=0.12)
    axes.quiver(*contact.point, *(0.011 * contact.normal), color=NORMAL, lw=2.2, arrow_length_ratio=0.25)
    dot = {"depthshade": False}
    axes.scatter(*true, s=130, facecolors="none", edgecolors=TRUE, linewidths=2.2, **dot)
    axes.scatter(*contact.point, s=28, color=FOUND, edgecolors="k", linewidths=0.6, zorder=9, **dot)
    origin = tip.T_surface_sensor[:3, 3]
    for direction in np.eye(3):
        axes.quiver(*origin, *(0.006 * direction), color="k", lw=1.2, arrow_length_ratio=0.25)
    axes.text(*np.add(origin, [0.002, 0, -0.003]), "sensor", fontsize=8)
    beside = 14, float(np.rad2deg(np.arctan2(contact.point[1], contact.point[0]))) + 50
    figures.frame_3d(axes, np.vstack([ball.reshape(-1, 3), start, origin]), view=beside)
    for name in "xyz":
        getattr(axes, f"{name}axis").set_major_formatter(lambda value, _: f"{1000 * value:.0f}")
        getattr(axes, f"set_{name}label")(f"tip {name} [mm]")


def legend(axes: Any, error_um: float) -> None:
    """What is what, below."""
    dot = {"linestyle": "none", "marker": "o"}
    axes.plot([], [], color=LINE, lw=2, label="force of the object, and its line")
    axes.plot([], [], **dot, color=FOUND, mec="k", label="point found")
    axes.plot([], [], color=NORMAL, lw=2, label="object's outward normal")
    off = f"simulator's point ({error_um:.0f} µm off)"
    axes.plot([], [], **dot, mfc="none", mec=TRUE, mew=2, ms=10, label=off)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, fontsize=8)


@report.or_skip
def main() -> None:
    """Senses, draws."""
    options = report.options(__doc__, trials=2, quick_trials=2)
    scenario = Scenario(seed=options.first_seed, rate=INSTANTS, nuisances=Nuisances.none())
    tip, contact, true = touched(last_instant(scenario), FINGER)
    error_um = 1e6 * float(np.linalg.norm(contact.point - true))
    report.write_csv(options.output / "figure_5.csv", [{"finger": FINGER, "error_um": error_um}])
    figure = figures.pyplot().figure(figsize=(6, 5.4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    draw_tip(axes, tip, contact, true)
    axes.set_title("thumb of the can grasp, without noise")
    legend(axes, error_um)
    figures.save(figure, options.output / "figure_5.png")


if __name__ == "__main__":
    main()
