"""How long an update takes with depth images beside it: `python -m benchmarks.concurrent_images`.

A simulated hand grasps a can and holds it, 500 observations a second, at their own pace, with drawn depth images of
640 x 480 pixels at 10 Hz (synthetic). Three trackers from one start, one after the other: without images; with
`TrackerSettings.concurrent_images`; with images that an update evaluates itself. Times are of `Tracker.update`, by the
clock on the wall and of its thread's CPU: where other work shares the machine, the wall says nothing of milliseconds.
"""

import argparse
import gc
import time
from dataclasses import replace

import numpy as np

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.simulation import Sample, Scenario, model_of, rig_of, simulate
from handsight.tracking import TrackerSettings
from handsight.tracking.concurrent_images import image_process

RATE, IMAGES = 500, 10
MATRIX = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])


def drawn(rig: Rig, model: hs.ObjectModel, samples: list[Sample], late: int) -> list[Observation]:
    """Returns observations with images, each `late` observations after it was taken, and poses of vision in none."""
    camera, shape, rng = Camera.of(rig.camera), rig.hand.shape(), np.random.default_rng(0)
    assert rig.camera is not None
    T_camera_world = se3.inverse(rig.camera.T_mount_camera)
    found = [replace(each.observation, vision=None) for each in samples]
    for k in range(0, len(samples) - late, RATE // IMAGES):
        T_world_palm, joints = found[k].T_world_palm, found[k].joint_positions
        assert T_world_palm is not None
        assert joints is not None
        T_camera_palm = T_camera_world @ T_world_palm
        hand = se3.apply(T_camera_palm, shape.vertices_palm(joints))
        thing = se3.apply(T_camera_palm @ samples[k].T_palm_object, model.vertices)
        faces = np.concatenate([shape.faces, model.faces + len(hand)])
        depth = camera.draw(np.concatenate([hand, thing]), faces).depth
        depth = np.where(np.isfinite(depth), depth, np.float32(1.2))
        depth += 1e-3 * rng.normal(size=depth.shape).astype(np.float32)
        found[k + late] = replace(found[k + late], depth=depth, image_stamp=found[k].stamp)
    return found


def row(name: str, rig: Rig, model: hs.ObjectModel, samples: list[Sample], seen: list[Observation]) -> str:
    """Returns a row of the table."""
    gc.collect()
    gc.freeze()  # as a node does: to search all that lives for garbage takes a tenth of a second
    settings = TrackerSettings(images=name != "none", concurrent_images=name == "concurrent")
    if settings.concurrent_images:
        image_process().ready.wait()
    start = hs.PosePrior.from_sigmas(samples[0].T_palm_object, 0.02, 0.2)
    tracker, took = hs.Tracker(rig, model, settings=settings, start=start), []
    began = time.perf_counter()
    for each in seen:
        time.sleep(max(0.0, each.stamp - seen[0].stamp - (time.perf_counter() - began)))
        wall, cpu = time.perf_counter(), time.thread_time()
        tracker.update(each)
        took.append((1e3 * (time.perf_counter() - wall), 1e3 * (time.thread_time() - cpu)))
    cells = [
        f"{np.median(each):.2f}, {np.percentile(each, 99):.2f}, {max(each):.1f}"
        for each in np.transpose(took)
    ]
    estimate = tracker.estimate
    center = np.append(model.center_object, 1.0)
    off = np.nan
    if estimate is not None:
        off = 1e3 * float(np.linalg.norm((estimate.T_palm_object - samples[-1].T_palm_object)[:3] @ center))
    return f"| {name} | {cells[0]} | {cells[1]} | {tracker.images.get('looked_at', 0)} | {off:.1f} |"


def main() -> None:
    """Prints the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--late", type=int, default=20, help="of images, in observations of 2 ms")
    late = arguments.parse_args().late
    scenario = Scenario(object="can", seed=1, motion="grasp", rate=RATE)
    rig, model = rig_of(scenario), model_of(scenario)
    assert rig.camera is not None
    rig = replace(rig, camera=replace(rig.camera, intrinsics=MATRIX, size=(640, 480)))
    samples = list(simulate(scenario))
    tail = samples[-RATE // 2 :]  # of which the hold is more, forth and back, so that nothing jumps
    for k in range(4 * RATE):
        i = k % (2 * len(tail))
        same = tail[-1 - i] if i < len(tail) else tail[i - len(tail)]
        seconds = samples[-1].observation.stamp + 1 / RATE
        samples.append(replace(same, observation=replace(same.observation, stamp=seconds)))
    seen = drawn(rig, model, samples, late)
    print(
        "| images | wall: median, 99 %, most [ms] | CPU: median, 99 %, most [ms] | evaluated | middle off by [mm] |"
    )
    print("|---|---|---|---|---|")
    for name in ("none", "concurrent", "within update"):
        print(row(name, rig, model, samples, seen), flush=True)


if __name__ == "__main__":
    main()
