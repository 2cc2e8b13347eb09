"""Frozen numbers of real frames: `PYTHONPATH=.:tests python tests/vision/real_evidence.py` writes them beside this file.

Poses that were answered, with their scores, are written by `python -m experiments.sight.frames --trials 5
--no-recognition --store tests/vision/real_answers.csv`. Neither file contains images, meshes or true poses.
"""

import json
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.vision import STRUCTURED_LIGHT
from handsight.vision.candidates import NOTHING_KNOWN, UNKNOWN, candidates_at, center_depths, depth_errors
from handsight.vision.kernels import depth_term
from handsight.vision.kernels.vision_records import STAGE
from handsight.vision.object.first_pose import FIRST_SPACING, MAX_POINTS
from handsight.vision.object.region import observed_points, scene_of
from testbed import real_frames

EVIDENCE, ANSWERS = (Path(__file__).with_name(name) for name in ("real_evidence.json", "real_answers.csv"))
FRAMES = (("0000", "000007"), ("0001", "000001"), ("0002", "000009"))
BOUND = 0.012
"""Tukey's bound [m]: the true poses are good to 2 to 5 mm."""


def evidence(model, frame, instance):
    """What the depth term says at the true pose: gradient (6,), information (6, 6) by (δp, radius δθ) of the object's
    centre along the camera's axes, and the sum of the points' weights."""
    scene = scene_of(
        frame.camera, frame.depth, wanted=frame.wanted(instance, "mask"), table=np.array([0, 0, 0, 9.0])
    )
    points = observed_points(scene, FIRST_SPACING * model.diameter, MAX_POINTS)
    stage = np.array([(1, BOUND, BOUND, 1, 1)], dtype=STAGE)
    candidates = candidates_at(instance.T_camera_object[None])
    candidates["bound"] = BOUND
    unknown = UNKNOWN[0] * model.diameter, UNKNOWN[1] * model.diameter
    errors = depth_errors(frame.camera, STRUCTURED_LIGHT, center_depths(model, candidates), unknown)
    informed, covariances = np.empty((1, 2, 6, 6)), np.empty((1, 6, 6))
    depth_term.pose_covariances(*model.record[:2], points, errors, candidates, informed, covariances)
    information, weight = informed[0, 0].copy(), float(candidates["weight"][0])
    depth_term.refine_poses(*model.record[:2], points, stage, 1.0, NOTHING_KNOWN, candidates)
    T = se3.compose(candidates["pose"]["rotation"][0], candidates["pose"]["position"][0])
    off = se3.difference(T, instance.T_camera_object)
    lever = T[:3, :3] @ model.center_object - instance.T_camera_object[:3, :3] @ model.center_object
    step = np.concatenate([off[:3] + lever, model.radius * off[3:]])  # of one Gauss-Newton step
    return {"gradient": (-information @ step).tolist(), "information": information.tolist(), "weight": weight}


def frozen(frames):
    """The evidence of each object in three frames, by scene/frame/object."""
    found = {}
    for scene, name in FRAMES:
        for frame in (read() for read in frames.scenes[scene]):
            if frame.name == name:
                for one in frame.instances:
                    found[f"{scene}/{name}/{one.name}"] = evidence(frames.models[one.name], frame, one)
    return found


def main():
    """Writes the evidence to six digits, a line an object."""
    found = frozen(real_frames.open_folder(real_frames.default_folder()))
    digits = {
        name: {key: np.vectorize(lambda x: float(f"{x:.6g}"))(value).tolist() for key, value in one.items()}
        for name, one in found.items()
    }
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(one)}" for name, one in digits.items())
    EVIDENCE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
