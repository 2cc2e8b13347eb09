"""Objects of real frames in a hand that is drawn: images and touch together, as `handsight track` uses them.

Real: the depth of YCB-Video's scene of twenty consecutive frames in the data folder, played to and fro at 30 Hz, and
the true poses (good to 2 to 5 mm). Drawn: a Shadow hand in that depth, as it grasps the object in a simulation of 1.9 s
(MuJoCo), whose joints and wrenches the tracker has, with the errors that the simulator usually gives them. All is
written as a recording, with the camera's pose in the rig right, or wrong by one sigma of its constant error per axis,
and tracked from that file. The first second, in which the hand closes, is left out.

  mm        error of the object's middle in the palm, median over runs and instants
  MSSD      largest distance of a surface point, of the diameter; right: below .1
  tracking  share of instants in that state; unsaid: of those in it, the share that is not right
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import handsight as hs
from handsight import se3
from handsight.observation import Observation
from handsight.recording import RecordingWriter, open_recording
from handsight.rig import Rig
from handsight.simulation import Sample, Scenario, rig_of, simulate
from shared import report
from testbed import bop, real_frames
from testbed import sight_scenes as scenes
from testbed.real_frames import RealFrame
from testbed.report import Array, Row, Rows

SCENE, RATE, IMAGES = "0000", 100, 30
"""The frames; observations and images a second."""
BEGIN, RIGHT = 1.0, 0.1
"""When instants begin to count [s]; MSSD of a right pose [diameters]."""


def poses(frames: Sequence[RealFrame], name: str) -> list[Array]:
    """Returns T_camera_object (4, 4) in each frame, the rotation made exact, as files round it."""
    found = list[Array]()
    for frame in frames:
        T = next(each.T_camera_object for each in frame.instances if each.name == name)
        U, _, V = np.linalg.svd(T[:3, :3])
        found.append(se3.compose(U @ V, T[:3, 3]))
    return found


def held(
    samples: Sequence[Sample], frames: Sequence[RealFrame], name: str, rig: Rig, rng: np.random.Generator
) -> Iterator[Observation]:
    """Yields the observations of a grasp, the world being the camera: real depth, before it the hand."""
    camera, shape, truths, last = frames[0].camera, rig.hand.shape(), poses(frames, name), -1
    to_and_fro = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
    for sample in samples:
        observation, depth = sample.observation, None
        image = int(observation.stamp * IMAGES)
        k = to_and_fro[image % len(to_and_fro)]
        T_world_palm = truths[k] @ se3.inverse(sample.T_palm_object)
        if image != last:
            last, depth = image, np.nan_to_num(frames[k].depth)
            hand = shape.vertices_palm(observation.joint_positions or {})
            drawn = camera.draw(se3.apply(T_world_palm, hand), shape.faces).depth
            before = drawn < np.where(depth > 0, depth, np.inf)
            depth = np.where(before, scenes.noisy(drawn, rng), depth).astype(np.float32)
        yield replace(observation, vision=None, T_world_palm=T_world_palm, depth=depth, color=None)


def rig_in_front(rig: Rig, frames: Sequence[RealFrame], name: str, sample: Sample, error: Array) -> Rig:
    """Returns the simulator's rig before the frames' camera, whose pose in the world is wrong by `error` (6,)."""
    assert rig.camera is not None
    assert sample.observation.T_world_palm is not None
    T_camera_palm = poses(frames, name)[0] @ se3.inverse(sample.T_palm_object)
    gravity = T_camera_palm[:3, :3] @ sample.observation.T_world_palm[:3, :3].T @ rig.gravity
    mounted = replace(rig.camera, T_mount_camera=se3.compose(se3.rotation_exp(error[3:]), error[:3]))
    return replace(rig, camera=mounted.with_images_of(frames[0].camera), table=None, gravity=gravity)


def tracked(
    path: Path, rig: Rig, model: hs.ObjectModel, samples: Sequence[Sample], *, touch: bool, key: Row
) -> Iterator[Row]:
    """Yields a row for each instant of a recording that counts; without touch its wrenches are left out."""
    tracker = hs.Tracker(rig, model)
    with open_recording(path, rig) as recording:
        for observation, sample in zip(recording.observations(), samples, strict=True):
            estimate = tracker.update(observation if touch else replace(observation, wrenches={}))
            if estimate is None or sample.observation.stamp < BEGIN:
                continue
            off = (estimate.T_palm_object - sample.T_palm_object)[:3] @ np.append(model.center_object, 1.0)
            mssd = bop.mssd(model, sample.T_palm_object, estimate.T_palm_object)
            yield key | {"mm": 1e3 * float(np.linalg.norm(off)), "mssd": mssd, "state": tracker.state}


def run(
    name: str, seed: int, frames: Sequence[RealFrame], model: hs.ObjectModel, mesh: Path
) -> Iterator[Row]:
    """Yields the rows of one grasp."""
    scenario = Scenario(object=str(mesh), seed=seed, rate=RATE)
    samples, rig = list(simulate(scenario)), rig_of(replace(scenario, images=True))
    assert rig.camera is not None
    sigmas = np.repeat([rig.camera.sigma_position_constant, rig.camera.sigma_rotation_constant], 3)
    error = sigmas * np.random.default_rng([seed, len(name)]).normal(size=6)
    for calibration, wrong in (("right", 0.0), ("wrong", 1.0)):
        rig = rig_in_front(rig, frames, name, samples[-1], wrong * error)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "held.mcap"
            with RecordingWriter(path, rig) as writer:
                for observation in held(samples, frames, name, rig, np.random.default_rng(seed)):
                    writer.write(observation)
            for uses in ("images", "images and touch"):
                key: Row = {"object": name, "camera": calibration, "uses": uses, "seed": seed}
                yield from tracked(path, rig, model, samples, touch=uses != "images", key=key)


def show(rows: Rows) -> None:
    """Prints errors and states by object, calibration and what is used."""
    table = []
    for name in (*report.distinct(rows, "object"), "all"):
        for camera in ("right", "wrong"):
            for uses in ("images", "images and touch"):
                mine = [
                    r for r in report.chosen(rows, camera=camera, uses=uses) if name in (r["object"], "all")
                ]
                if not mine:
                    continue
                mssd, good = report.values(mine, "mssd"), report.chosen(mine, state="tracking")
                unsaid = f"{np.mean(report.values(good, 'mssd') > RIGHT):.2f}" if good else ""
                numbers = [f"{np.median(report.values(mine, 'mm')):.1f}", f"{np.median(mssd):.3f}"]
                shares = [f"{np.mean(mssd < RIGHT):.2f}", f"{len(good) / len(mine):.2f}", unsaid]
                table.append([name, camera, uses, *numbers, *shares])
    columns = ["object", "camera", "", "mm", "MSSD", "right", "tracking", "unsaid"]
    title = "Real depth, a drawn hand, simulated touch"
    report.print_table(title, columns, table, report.machine())


@report.or_skip
def main() -> None:
    """Grasps, tracks, prints."""
    options = report.options(f"{__doc__}\nA trial is a grasp of each object.", trials=5, quick_trials=1)
    folder = real_frames.default_folder()
    opened, rows = real_frames.open_folder(folder), list[Row]()
    frames = [read() for read in opened.scenes[SCENE]]
    names = [each.name for each in frames[0].instances]
    for k in report.progress(range(options.trials * len(names)), "grasps"):
        name, seed = names[k % len(names)], options.first_seed + k // len(names)
        rows += run(name, seed, frames, opened.models[name], folder / "meshes" / f"{name}.ply")
    show(rows)
    report.write_csv(options.output / "sight_held.csv", rows)


if __name__ == "__main__":
    main()
