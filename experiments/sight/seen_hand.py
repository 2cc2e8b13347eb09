"""The seen hand: the palm's pose in the camera, from a depth image and a guess that is off. SYNTHETIC pictures.

The Shadow hand, curled at random and holding one of ten YCB objects, is drawn from any side at .55 to 1.1 m over a
table, in every second picture with its forearm before or behind it; at least 1500 pixels of it are visible. Depth has
the noise of a structured-light camera: correlated, rounded disparity, pixels lost behind edges, a smooth bias (1.5 mm
at 1 m) and an offset (1 mm). Each joint is off by 1° (standard deviation), constantly. The guess is off by the stated
amount at the hand's middle, in a random direction, and about a random axis; in the row "simulator" by 64 mm and 6° per
axis, as its camera is by default. "Followed": the last picture's pose, that far off, is refined without a search.

  median        of what was answered: at the hand's middle [mm], and the turn [°]
  within 8 mm   of all pictures; rejected ones do not count as within
  wrong         of all pictures: answered, and beyond 8 mm
  held          by 95 % regions, of all that was answered
  ms            of CPU time on one core, median
"""

import time
from typing import Any

import numpy as np
import trimesh

from handsight import se3
from handsight.hand import Hand
from handsight.simulation import Scenario, rig_of
from handsight.vision import HandAppearance, PalmDetection, PalmNotFound, PlacedHand, detect_palm, follow_palm
from testbed import report, sight_scenes, ycb
from testbed.report import Array, Row, Rows

BELIEFS = ((20.0, 2.0), (40.0, 4.0), (60.0, 4.0), (80.0, 5.0), (None, None))
"""Off by [mm, °]; None: as the simulator's camera is."""
SIMULATOR = 0.064, float(np.deg2rad(6))
FOLLOWED = ((3.0, 1.0), (8.0, 2.5), (20.0, 6.0))
"""The same, of a hand that is followed."""
JOINTS = (0.0, 1.0, 2.0, 3.0)
"""Standard deviation of joints' errors [°], each with a belief that is off by 40 mm and 4°."""
COVERED = 0.3
"""Share of the hand."""
MISSED, REGION = 8.0, 12.59
"""[mm]; χ² of six degrees of freedom that 95 % are below."""
ARM = ("robot0:forearm", "robot0:wrist")


class Stage:
    """The hand, the objects, and all that is computed of them once."""

    def __init__(self) -> None:
        self.hand = rig_of(Scenario(object="can")).hand
        self.shape, self.look = self.hand.shape(), HandAppearance.of(self.hand)
        whole = Hand.from_file(self.hand.file, palm=ARM[0], tips={"palm": self.hand.palm})
        self._whole, self._arm = whole, whole.shape()
        bodies = [k for k, body in enumerate(self._arm.bodies) if body in ARM]
        self._faces = self._arm.faces[np.isin(self._arm.body_of[self._arm.faces[:, 0]], bodies)]
        meshes = [
            trimesh.load_mesh(path) for path in sorted((ycb.data_or_goodbye() / "ycb_meshes").glob("*.ply"))
        ]
        self.objects = [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in meshes]

    def arm(self, joints: dict[str, float]) -> tuple[Array, Array]:
        """Vertices in the palm, and faces, of the forearm and the wrist, which is straight."""
        joints = {**dict.fromkeys(self._whole.joint_names, 0.0), **joints}
        T_palm_arm = se3.inverse(self._whole.Ts_palm_tip(joints)[0])
        return se3.apply(T_palm_arm, self._arm.vertices_palm(joints)), self._faces


def scene_and_belief(
    stage: Stage, options: report.Options, trial: int, off: tuple[Any, Any], joints: float
) -> tuple[Any, Any, Array, tuple[float, float]]:
    """Returns a picture, the hand as guessed, its guessed pose, and the stated errors of both."""
    rng = options.rng(trial, 77)
    shapes = stage.shape, stage.objects[trial % len(stage.objects)], stage.arm if trial % 2 else None
    scene = sight_scenes.hand_scene(stage.hand, shapes, rng, sigma_joint=np.deg2rad(joints))
    hand = stage.look.placed(scene.joints, sigma_joint=np.deg2rad(joints))
    if off[0] is None:
        shift, turn = SIMULATOR[0] * rng.normal(size=3), se3.rotation_exp(SIMULATOR[1] * rng.normal(size=3))
        sigmas = SIMULATOR
    else:
        shift, turn = sight_scenes.palm_error(rng, off[0] / 1e3, np.deg2rad(off[1]))
        sigmas = off[0] / 1e3 / np.sqrt(3), float(np.deg2rad(off[1])) / np.sqrt(3)
    T = scene.T_camera_palm
    about = T[:3, :3] @ hand.middle
    return scene, hand, sight_scenes.moved_palm(T, shift + about - turn @ about, turn), sigmas


def searched(depth: Array, hand: PlacedHand, believed: Array, sigmas: Any) -> PalmDetection | PalmNotFound:
    """Detects the palm without a previous picture."""
    camera, (position, rotation) = sight_scenes.WIDE, sigmas
    return detect_palm(camera, depth, hand, believed, sigma_position=position, sigma_rotation=rotation)


def followed(depth: Array, hand: PlacedHand, believed: Array, _: Any) -> PalmDetection | PalmNotFound:
    """Detects the palm near its pose in the previous picture."""
    return follow_palm(sight_scenes.WIDE, depth, hand, believed)


def tried(
    stage: Stage,
    options: report.Options,
    trial: int,
    off: tuple[Any, Any],
    joints: float,
    look: Any = searched,
) -> Row:
    """Returns the row of one picture."""
    scene, hand, believed, sigmas = scene_and_belief(stage, options, trial, off, joints)
    start = time.process_time()
    seen = look(scene.depth, hand, believed, sigmas)
    row: Row = {
        "covered": f"{'up to' if scene.hidden <= COVERED else 'above'} {COVERED:.0%}",
        "ms": 1e3 * (time.process_time() - start),
        "hidden": scene.hidden,
        "pixels": scene.hand_pixels,
    }
    if isinstance(seen, PalmNotFound):
        return {**row, "reason": seen.reason, "within": False, "refused": True, "wrong": False}
    T, found = scene.T_camera_palm, seen.T_camera_palm
    middles = [se3.apply(each, hand.middle[None])[0] for each in (T, found)]
    error = se3.difference(T, found)
    chi2 = float(error @ np.linalg.solve(seen.covariance, error))
    mm = 1e3 * float(np.linalg.norm(middles[0] - middles[1]))
    row |= {"mm": mm, "deg": float(np.rad2deg(np.linalg.norm(error[3:]))), "held": chi2 < REGION}
    return {**row, "reason": "", "within": mm < MISSED, "refused": False, "wrong": mm >= MISSED}


CELLS = {
    "mm": report.of("mm", ".1f", np.median),
    "°": report.of("deg", ".1f", np.median),
    "within 8 mm": report.of("within"),
    "refused": report.of("refused"),
    "wrong": report.of("wrong"),
    "held": report.of("held"),
    "ms": report.of("ms", ".0f", np.median),
}


def main() -> None:
    """Prints the tables."""
    options = report.options(__doc__, trials=60, quick_trials=8)
    stage, rows, rows_followed = Stage(), Rows(), Rows()
    asked = [(length, angle, 1.0) for length, angle in BELIEFS]
    asked += [(40.0, 4.0, joints) for joints in JOINTS if joints != 1.0]
    for length, angle, joints in asked:
        name = "simulator" if length is None else f"{length:g} mm, {angle:g}°"
        for trial in report.progress(range(options.trials), f"{name}, joints {joints:g}°"):
            row = tried(stage, options, trial, (length, angle), joints)
            rows.append({"belief": name, "joints": joints, **row})
    for length, angle in FOLLOWED:
        name = f"{length:g} mm, {angle:g}°"
        for trial in report.progress(range(options.trials), f"followed, {name}"):
            row = tried(stage, options, trial, (length, angle), 1.0, followed)
            rows_followed.append({"belief": name, **row})
    usual = report.chosen(rows, joints=1.0)
    report.print_by("Followed", rows_followed, "belief", CELLS)
    report.print_by("Beliefs", usual, "belief", CELLS)
    for name in ("40 mm, 4°", "simulator"):
        title = f"What the object covers of the hand: {name}"
        report.print_by(title, report.chosen(usual, belief=name), "covered", CELLS, detail=True)
    turned = report.chosen(rows, belief="40 mm, 4°")
    report.print_by("Joints, 40 mm, 4°", turned, "joints", CELLS, detail=True)
    report.write_csv(options.output / "seen_hand.csv", rows)


if __name__ == "__main__":
    main()
