"""What one tree of handsight answers to the problems of `price.py`: `python -P price_answers.py PROBLEMS ANSWERS`.

It is run once for each tree, with that tree's `src` first on PYTHONPATH. It therefore takes NumPy and public names of
handsight alone, each where it is used. PROBLEMS/KIND/*.npz are the problems of a kind, and ANSWERS/kinds.json says
by which function of this file they are answered. ANSWERS/KIND.jsonl gets a line for each.
"""

import functools
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
Problem = Mapping[str, Array]
"""By name; a text is an array of one. What begins with `truth.` is not for those who answer."""
Answer = dict[str, Any]
"""Numbers, texts and nested lists of them."""
ERROR = "error"
"""The name of an answer that is the type and the text of an exception."""
DEPTH_UNIT = 1e-4
"""Of a depth image's whole numbers [m]."""
TRACK_EVERY = 5
"""Of a track's poses only every so many are kept."""


@functools.lru_cache(maxsize=64)
def model_of(text: str) -> Any:
    """Returns the model that a text in JSON describes by the fields of an `ObjectSpec`."""
    from handsight.objects import ObjectSpec

    return ObjectSpec(**json.loads(text)).model()


def models_of(problem: Problem) -> dict[str, Any]:
    """Returns the models of a problem about several objects, by name."""
    described = json.loads(str(problem["models"]))
    return {name: model_of(text) for name, text in described.items()}


def contacts_of(problem: Problem, name: str) -> Any:
    """Returns the contacts of that name."""
    from handsight.contact import Contacts

    normals = list(problem[f"{name}.normals"])
    for i in np.flatnonzero(~problem[f"{name}.has_normal"]):
        normals[i] = None
    groups: dict[str, Array] = {}
    if len(problem[f"{name}.shared_covariance"]):
        groups["group"] = problem[f"{name}.group"]
        groups["shared_covariance"] = problem[f"{name}.shared_covariance"]
    return Contacts(problem[f"{name}.points"], normals, covariance=problem[f"{name}.covariance"], **groups)


def evidence_of(problem: Problem) -> dict[str, Any]:
    """Returns what a correction is given beside the contacts."""
    from handsight.correction import PosePrior, SkinEvidence

    given: dict[str, Any] = {}
    if "vision.pose" in problem:
        given["vision"] = PosePrior(problem["vision.pose"], problem["vision.covariance"])
    if "outside.points" in problem:
        given["outside"] = problem["outside.points"]
    if "skin.untouched" in problem:
        pressed = contacts_of(problem, "skin.contacts") if "skin.contacts.points" in problem else None
        numbers = problem["skin.untouched"], problem["skin.sigmas"], problem["skin.sigma_untouched"]
        given["skin"] = SkinEvidence(pressed, *numbers)
    return given


def corrected(problem: Problem) -> Answer:
    """Returns a correction of the pose; of a scan where the problem has its points."""
    from handsight.correction import correct_pose
    from handsight.objects import ObjectModel

    if "scan.points" in problem:
        model = ObjectModel.from_points(problem["scan.points"], problem.get("scan.normals"))
    else:
        model = model_of(str(problem["model"]))
    estimate = correct_pose(model, contacts_of(problem, "contacts"), **evidence_of(problem))
    return {
        "pose": estimate.T_palm_object.tolist(),
        "information": estimate.information.tolist(),
        "unobservable": estimate.unobservable.tolist(),
        "outliers": [int(i) for i in estimate.outliers],
        "consistent": bool(estimate.consistent),
        "modes": [mode.T_palm_object.tolist() for mode in estimate.hypotheses],
    }


def depth_of(image: Array) -> Array:
    """Returns depths [m] of whole numbers."""
    return (DEPTH_UNIT * image).astype(np.float32)


def camera_of(problem: Problem) -> Any:
    """Returns the camera of a problem's images."""
    from handsight.camera import Camera

    height, width = problem["depth"].shape[-2:]
    return Camera(problem["camera"], (width, height))


def image_of(problem: Problem) -> dict[str, Any]:
    """Returns a depth image, its camera and masks by the arguments that take them."""
    masks = {name: problem[name] for name in ("mask", "hand") if name in problem}
    return {"depth": depth_of(problem["depth"]), "camera": camera_of(problem), **masks}


def located(problem: Problem) -> Answer:
    """Returns where one object is in a depth image."""
    from handsight.vision import locate

    found = locate(model_of(str(problem["model"])), **image_of(problem))
    return {
        "poses": found.Ts_camera_object.tolist(),
        "weights": found.weights.tolist(),
        "probability": float(found.probability),
    }


def recognised(problem: Problem) -> Answer:
    """Returns which of several objects a depth image shows."""
    from handsight.vision import recognise

    found = recognise(models_of(problem), **image_of(problem))
    return {"name": found.name or "none", "scores": found.scores, "none": float(found.none)}


def followed(problem: Problem) -> Answer:
    """Returns an object's state and pose in each of several depth images, from its first pose on."""
    from handsight.vision import DepthTracker

    tracker = DepthTracker(model_of(str(problem["model"])), camera_of(problem), start=problem["start"])
    states, poses = [], []
    for k, image in enumerate(problem["depth"]):
        hand = problem["hands"][k] if problem["hand_known"][k] else None
        seen = tracker.update(float(problem["stamps"][k]), depth_of(image), hand=hand)
        candidate = seen.candidate["pose"][0]
        states.append(seen.state)
        poses.append([candidate["rotation"].tolist(), candidate["position"].tolist()])
    return {"states": states, "poses": poses}


def reconstructed(problem: Problem) -> Answer:
    """Returns points of a surface that is fused from depth images whose poses are known."""
    from handsight.vision.reconstruction.reconstruct import Reconstruction, View

    fused = Reconstruction(camera_of(problem), problem["bounds"])
    for image, pose in zip(problem["depth"], problem["poses"], strict=True):
        fused.grow(View(depth_of(image), pose), estimate=False)
    return {"points": fused.volume.surface().points.tolist()}


def tracked(problem: Problem) -> Answer:
    """Returns a track of a recording."""
    from handsight.recording import open_recording
    from handsight.rig import Rig
    from handsight.tracking import Tracker

    track: Answer = {
        "stamps": [],
        "poses": [],
        "informations": [],
        "states": [],
        "slipping": [],
        "mass": None,
    }
    with tempfile.TemporaryDirectory() as folder:
        recording, rig_file = Path(folder, "recording.mcap"), Path(folder, "recording.rig.yaml")
        recording.write_bytes(problem["recording"].tobytes())
        rig_file.write_text(str(problem["rig"]), encoding="utf-8")
        rig = Rig.from_file(rig_file)
        tracker = Tracker(rig, rig.objects[str(problem["object"])].model())
        with open_recording(recording, rig) as opened:
            for k, observation in enumerate(opened.observations()):
                estimate = tracker.update(observation)
                track["slipping"].append([float(observation.stamp), bool(tracker.slip.slipping)])
                track["mass"] = track["mass"] if tracker.weight is None else float(tracker.weight.mass)
                if estimate is not None and k % TRACK_EVERY == 0:
                    track["stamps"].append(float(observation.stamp))
                    track["poses"].append(estimate.T_palm_object.tolist())
                    track["informations"].append(estimate.information.tolist())
                    track["states"].append(tracker.state)
    return track


def read(path: Path) -> dict[str, Array]:
    """Returns a problem."""
    with np.load(path) as arrays:
        return {name: arrays[name] for name in arrays.files}


def answers(folder: Path, way: str) -> Iterator[Answer]:
    """Yields the answers to the problems of a folder by the function of that name; an exception is an answer too."""
    answer = globals()[way]
    for path in sorted(folder.glob("*.npz")):
        problem = {name: value for name, value in read(path).items() if not name.startswith("truth.")}
        try:
            yield answer(problem)
        except Exception as error:  # what a tree cannot do is a result
            yield {ERROR: f"{type(error).__name__}: {error}"}


def main(problems: Path, results: Path) -> None:
    """Answers all problems; ends the process where handsight is not that of PYTHONPATH."""
    import handsight

    warnings.simplefilter("ignore")
    source = Path(os.environ["PYTHONPATH"]).resolve()
    if not Path(str(handsight.__file__)).resolve().is_relative_to(source):
        sys.exit(f"expected handsight of {source}, got {handsight.__file__}")
    for kind, way in json.loads((results / "kinds.json").read_text(encoding="utf-8")).items():
        begin = time.process_time()
        with (results / f"{kind}.jsonl").open("w", encoding="utf-8") as file:
            for answer in answers(problems / kind, way):
                file.write(json.dumps(answer) + "\n")
        seconds = time.process_time() - begin
        print(f"{results.name}: {kind} in {seconds:.0f} s of CPU", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
