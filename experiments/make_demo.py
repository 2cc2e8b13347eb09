"""Writes the built-in demo: a can and a box held by five fingers, vision 8 cm off, and a recording of each (synthetic).

Run once; its output in `src/handsight/data` is in the repository: `demo.jsonl`, `demo_truth.jsonl`, and, simulated
with seed 0 as `handsight simulate can` does, `can.mcap`, `box.mcap` and their rigs; and one picture of the can in
the hand: `can.depth.png`, `can.color.jpg`, `can.camera.json`, what the robot knows and the truth in `can.picture.json`.
"""

import json
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image

from handsight import se3
from handsight.camera import Camera
from handsight.simulation import Scenario, add_depth_noise, camera_facing, rig_of, simulate
from handsight.simulation.camera import Renderer
from handsight.simulation.scene import scene
from handsight.vision.depth_noise import STRUCTURED_LIGHT
from testbed import scenes
from testbed.recordings import record
from testbed.report import Array, Row

FOLDER = Path(__file__).parent.parent / "src/handsight/data"
NOISE_POINT, NOISE_NORMAL_DEG = 0.001, 4.0
SIGMA_POSITION, SIGMA_ROTATION_DEG = 0.05, 15.0
RECORDED_SEED = 0
EYE, AIMED_OFF = np.array([0.35, -0.35, 0.45]), np.array([0.03, 0, 0])
"""Where the picture is taken from, and how far beside the can it is aimed [m]."""
CAMERA_OFF = 0.003
"""How well the robot knows where the camera is, so that the hand is masked where it is: sigma [m, rad]."""
CROPPED = 130, 85, 360, 300
"""Column and row, width and height of what is kept of the picture [pixels]."""


def can_grasp() -> scenes.Surface:
    """Four fingers around the can's side and the thumb opposite."""
    angle = np.deg2rad([20.0, 5.0, -8.0, -25.0, 183.0])
    height = np.array([0.030, 0.010, -0.010, -0.030, 0.002])
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=1)
    return scenes.CAN["radius"] * normals + height[:, None] * [0, 0, 1], normals


def box_grasp() -> scenes.Surface:
    """Three fingers and the thumb on opposite faces, the little finger under the box."""
    _, y, z = np.array(scenes.BOX) / 2
    points = [[-0.012, y, 0.02], [0.0, y, -0.01], [0.014, y, -0.035], [0.005, -y, -0.01], [0.01, 0.02, -z]]
    return np.array(points), np.array([[0, 1.0, 0], [0, 1, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]])


def write() -> None:
    """Both files."""
    rng = np.random.default_rng(20131106)
    objects = ({"cylinder": scenes.CAN}, {"box": list(scenes.BOX)})
    problems, truths = [], []
    for described, surface in zip(objects, (can_grasp(), box_grasp()), strict=True):
        R = se3.rotation_exp(np.array([0.1, np.pi / 2, 0.2]))
        T = se3.compose(R, np.array([0.01, -0.085, 0.095]))
        noise = NOISE_POINT, float(np.deg2rad(NOISE_NORMAL_DEG))
        contacts = scenes.touched(T, surface, noise, rng)
        off = rng.normal(size=6)
        off[:3] *= 0.08 / np.linalg.norm(off[:3])
        off[3:] *= np.deg2rad(20) / np.linalg.norm(off[3:])
        T_vision = se3.moved(T, off)
        sigmas = {"sigma_point": NOISE_POINT, "sigma_normal_deg": NOISE_NORMAL_DEG}
        felt = [
            {"point": np.round(point, 5).tolist(), "normal": np.round(normal, 5).tolist(), **sigmas}
            for point, normal in zip(contacts.points_palm, contacts.normals_palm, strict=True)
        ]
        vision = pose(T_vision) | {"sigma_position": SIGMA_POSITION, "sigma_rotation_deg": SIGMA_ROTATION_DEG}
        problems.append({"object": described, "contacts": felt, "vision": vision})
        truths.append(pose(T))
    for name, rows in (("demo.jsonl", problems), ("demo_truth.jsonl", truths)):
        (FOLDER / name).write_text("".join(json.dumps(row) + "\n" for row in rows))


def pose(T: Array) -> Row:
    """The pose as the contract writes it."""
    quaternion = se3.quaternion_from_rotation(T[:3, :3])
    return {"position": np.round(T[:3, 3], 6).tolist(), "quaternion_xyzw": np.round(quaternion, 7).tolist()}


def record_both() -> None:
    """What `handsight simulate can` and `handsight simulate box` write."""
    for name in ("can", "box"):
        scenario = Scenario(object=name, seed=RECORDED_SEED, motion="manipulate")
        record(scenario, FOLDER / f"{name}.mcap")


def take_picture() -> None:
    """The can in the closed hand, from a viewpoint where the fingers hide half of it."""
    scenario = Scenario(object="can", seed=RECORDED_SEED, rate=20)
    sample, rng = list(simulate(scenario))[-1], np.random.default_rng(RECORDED_SEED)
    T_world_camera = camera_facing(EYE, sample.T_world_object[:3, 3] + AIMED_OFF)
    with closing(Renderer(scene("can"))) as renderer:
        color, exact = renderer.take(sample.configuration, T_world_camera)
    left, top, width, height = CROPPED
    window = slice(top, top + height), slice(left, left + width)
    depth = np.nan_to_num(add_depth_noise(exact, STRUCTURED_LIGHT, rng, RECORDED_SEED)[window])
    Image.fromarray(np.round(1e3 * depth).astype(np.uint16)).save(FOLDER / "can.depth.png", optimize=True)
    Image.fromarray(color[window]).save(FOLDER / "can.color.jpg", quality=85)
    intrinsics = Camera.of(rig_of(scenario).camera).matrix
    fx, fy, (cx, cy) = intrinsics[0, 0], intrinsics[1, 1], intrinsics[:2, 2] - [left, top]
    camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height}
    (FOLDER / "can.camera.json").write_text(json.dumps(camera) + "\n")
    T_camera_object = se3.inverse(T_world_camera) @ sample.T_world_object
    T_camera_palm = T_camera_object @ se3.inverse(sample.T_palm_object)
    joints = sample.observation.joint_positions or {}
    known = {
        "joint_positions": {name: round(angle, 5) for name, angle in joints.items()},
        "T_camera_palm": pose(se3.moved(T_camera_palm, CAMERA_OFF * rng.normal(size=6))),
        "truth": pose(T_camera_object),
    }
    (FOLDER / "can.picture.json").write_text(json.dumps(known) + "\n")


if __name__ == "__main__":
    write()
    record_both()
    take_picture()
