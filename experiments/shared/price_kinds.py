"""The kinds of problems of `price.py`: how each is drawn, what in `price_answers.py` answers it, how it is judged.

A problem is drawn once, by this tree, and is numbers and texts; its truth is in it, but not shown to those who answer.
"""

import itertools
import json
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from experiments.data import scans, three_finger_contacts, vision_errors
from experiments.shared import grasp_trials, slips
from experiments.shared.grips import ON_TABLE, gripped
from experiments.shared.price_answers import DEPTH_UNIT, Answer, Problem, model_of
from experiments.sight import reconstruction
from experiments.touch import gripped_box, many_contacts, means, penetration, regions
from experiments.touch.convergence import spoiled
from experiments.tracking import harsh
from handsight import se3
from handsight.recording import RecordingWriter
from handsight.rig import save
from handsight.simulation import Scenario, rig_of, simulate
from handsight.simulation import model_of as simulated_model
from testbed import losing, real_frames, scenes, sight, sight_scenes, skin_scenes, ycb
from testbed.report import Array

RIGHT_SHARE = 0.1
"""Mean distance of the surface below which a pose in an image is right [diameters]."""
HELD_FROM = 2.0
"""From then on an object that is tracked is in the hand alone [s]."""
TRACK_RATE = 50.0
"""Observations a second of a recording."""
POSE, REGION = "pose right", "in 95 %"
"""What is counted as right in most kinds; the second should be so in 95 of 100."""
BEGINS = 1000.0
"""Stamp at which a recording begins [s]: one of 0 would mean that the robot does not know the time."""


class Score(NamedTuple):
    """How good an answer is."""

    right: bool
    error: float
    """In the kind's unit; NaN where there is no such error."""


Problems = Iterator[dict[str, Any]]


@dataclass(frozen=True)
class Kind:
    """A kind of problems."""

    counted: str
    """What is counted as right."""
    way: str
    """Name of the function of `price_answers.py`."""
    problems: Callable[[int, int], Problems]
    """Of a seed, so many."""
    score: Callable[[Problem, Answer], Score]
    count: int
    quick: int
    unit: str = "mm"
    """Of an error."""

    @property
    def wanted(self) -> float:
        """The share that should be right."""
        return 0.95 if self.counted == REGION else 1.0


# Problems of a correction


def as_text(**described: Any) -> str:
    """Returns the text by which a model is built again, see `price_answers.model_of`."""
    return json.dumps(described)


CAN, BOX = as_text(cylinder=list(scenes.CAN.values())), as_text(box=scenes.BOX)
SHAPES = ((CAN, scenes.on_can_side), (BOX, scenes.on_box_faces))
"""Each with how contacts are drawn on it."""


def mesh(name: str) -> str:
    """Returns the text of an object of the data folder, with the symmetries of its surface."""
    return as_text(mesh=str(ycb.data_or_goodbye() / "ycb_meshes" / f"{name}.ply"), symmetries="find")


def meshes() -> list[str]:
    """Returns the names of all objects of the data folder."""
    return sorted(path.stem for path in (ycb.data_or_goodbye() / "ycb_meshes").glob("*.ply"))


def contact_arrays(name: str, contacts: Any) -> dict[str, Any]:
    """Returns contacts as arrays."""
    return {
        f"{name}.points": contacts.points_palm,
        f"{name}.normals": contacts.normals_palm,
        f"{name}.has_normal": contacts.has_normal,
        f"{name}.covariance": contacts.covariance,
        f"{name}.group": contacts.group,
        f"{name}.shared_covariance": contacts.shared_covariance,
    }


def correction(model: str, contacts: Any, vision: Any, truth: Array) -> dict[str, Any]:
    """Returns a problem of a correction as arrays."""
    problem = {"model": model, "truth.pose": truth} | contact_arrays("contacts", contacts)
    if vision is not None:
        problem |= {"vision.pose": vision.T_palm_object, "vision.covariance": vision.covariance}
    return problem


def generators(seed: int, n: int, name: str) -> Iterator[tuple[int, np.random.Generator]]:
    """Yields so many numbers, each with a random generator of its own."""
    for k in range(n):
        yield k, np.random.default_rng([seed, *name.encode(), k])


def converging(error: scenes.Pair, wrong: str = "") -> Callable[[int, int], Problems]:
    """Returns problems of can and box, whose vision is off by so much; of the contacts one is `moved` or `turned`."""

    def problems(seed: int, n: int) -> Problems:
        for k, rng in generators(seed, n, f"convergence {wrong}"):
            model, draw = SHAPES[k % 2]
            scene = scenes.random_scene(draw(rng), rng, error=error)
            contacts = spoiled(scene.contacts, wrong, rng)[0] if wrong else scene.contacts
            yield correction(model, contacts, scene.vision, scene.T_palm_object)

    return problems


def any_surface(seed: int, n: int) -> Problems:
    """Yields five contacts on can, box or meshes, vision near."""
    chosen = [(model, draw) for model, draw in SHAPES]
    for name in regions.MESHES:
        chosen.append((mesh(name), scenes.anywhere_on(model_of(mesh(name)))))
    for k, rng in generators(seed, n, "regions"):
        model, draw = chosen[k % len(chosen)]
        scene = scenes.random_scene(draw(rng), rng)
        yield correction(model, scene.contacts, scene.vision, scene.T_palm_object)


def sliding(seed: int, n: int) -> Problems:
    """Yields grips of boxes and cans of any size, on a table or not."""
    kinds = [kind for kind in means.KINDS if "plane" not in kind and "beside" not in kind]
    for k, rng in generators(seed, n, "means"):
        model, contacts, known, T = means.problem(kinds[k % len(kinds)], rng)
        x, y, z = np.ptp(model.bounds_object, axis=0).tolist()
        text = as_text(cylinder=(x / 2, z)) if model.symmetries.axes else as_text(box=(x, y, z))
        yield correction(text, contacts, known["vision"], T)


def across_a_box(seed: int, n: int) -> Problems:
    """Yields a box between two fingers and a thumb, on a table."""
    for _, rng in generators(seed, n, "gripped box"):
        contacts, vision, T = gripped(scenes.across_box(rng), rng, ON_TABLE)
        yield correction(BOX, contacts, vision, T)


def around_by_hand(seed: int, n: int) -> Problems:
    """Yields grips with points of the hand, which cannot be inside the object."""
    for k, rng in generators(seed, n, "penetration"):
        model, half = (BOX, scenes.BOX[1] / 2) if k % 2 else (CAN, scenes.CAN["radius"])
        surface = scenes.opposed(rng, half, bool(k % 2))
        scene = scenes.random_scene(surface, rng, noise=penetration.NOISE, error=penetration.ERROR)
        cloud = penetration.hand_points(surface, model_of(model))
        cloud = cloud[model_of(model).fine.evaluate(cloud).distance > 0]
        hand = se3.apply(scene.T_palm_object, cloud) + penetration.NOISE[0] * rng.normal(size=cloud.shape)
        yield correction(model, scene.contacts, scene.vision, scene.T_palm_object) | {"outside.points": hand}


def on_skin(seed: int, n: int) -> Problems:
    """Yields a box or a can on the palm's array, held by three tips."""
    from handsight.correction import SkinEvidence

    array = skin_scenes.palm_array()
    for k, rng in generators(seed, n, "skin"):
        scene = (skin_scenes.box_on_skin if k % 2 else skin_scenes.can_on_skin)(rng, array)
        skin = SkinEvidence.of(scene.touch(array), np.eye(4))
        problem = correction(BOX if k % 2 else CAN, scene.tips, scene.vision, scene.T_palm_object)
        problem |= {"skin.untouched": skin.untouched_palm, "skin.sigmas": skin.sigmas}
        problem |= {"skin.sigma_untouched": np.asarray(skin.sigma_untouched), "truth.across": scene.across}
        if skin.contacts is not None:
            problem |= contact_arrays("skin.contacts", skin.contacts)
        yield problem


def many(seed: int, n: int) -> Problems:
    """Yields hundreds of contacts of several links, some of them wrong."""
    models, cases = [BOX, CAN, *map(mesh, many_contacts.MESHES)], list(many_contacts.CASES.values())
    for k, rng in generators(seed, n, "many contacts"):
        model = models[k % len(models)]
        scene = scenes.many_scene(model_of(model), rng, cases[k // len(models) % len(cases)])
        yield correction(model, scene.contacts, scene.vision, scene.T_palm_object) | {
            "truth.wrong": scene.wrong
        }


def scanned(seed: int, n: int) -> Problems:
    """Yields grips of a can and a box that are known by scans."""
    for k, rng in generators(seed, n, "scans"):
        text, draw = (*SHAPES, (BOX, scenes.across_box))[k % 3]
        points, normals = model_of(text).sample(scans.POINTS, int(rng.integers(1 << 31)))
        sigma = 1e-3 * rng.choice(scans.SIGMAS_MM)
        scan = {"scan.points": points + sigma * rng.normal(size=points.shape)}
        if rng.random() < 0.5:
            scan["scan.normals"] = normals
        scene = scenes.random_scene(draw(rng), rng, error=scans.VISION)
        yield correction(text, scene.contacts, scene.vision, scene.T_palm_object) | scan


def triplets(seed: int, n: int) -> Problems:
    """Yields three fingertips on YCB objects, simulated by others, blind or with a vision that is drawn."""
    from handsight.contact import Contacts

    listed, levels = ycb.triplets(ycb.data_or_goodbye()), list(three_finger_contacts.LEVELS.values())
    for k, rng in generators(seed, n, "three fingers"):
        name, _, points, normals = listed[k % len(listed)]
        T_palm_world = se3.random(rng, spread=0.1)
        T = T_palm_world @ ycb.TRIPLET_TRUTH
        contacts = Contacts(points, normals, *three_finger_contacts.contact_sigmas()).moved(T_palm_world)
        level = levels[k // len(listed) % len(levels)]
        vision = None if level is None else three_finger_contacts.vision_prior(T, level, rng)
        yield correction(mesh(name), contacts, vision, T)


def simulated_grasps(seed: int, n: int) -> Problems:
    """Yields grasps of can and box at their last instant, with points of the hand, on the table."""
    for name, text in (("can", CAN), ("box", BOX)):
        for trial in grasp_trials.grasps(name, n // 2, 10_000 * seed, Counter()):
            T = trial.sample.T_palm_object
            yield correction(text, trial.contacts, trial.standing, T) | {"outside.points": trial.outside}


def unseen(seed: int, n: int) -> Problems:
    """Yields six contacts on any object, and no vision."""
    texts = [CAN, BOX, *(mesh(name) for name in meshes())]
    for k, rng in generators(seed, n, "blind"):
        text = texts[k % len(texts)]
        scene = scenes.random_scene(scenes.anywhere_on(model_of(text))(rng, 6), rng)
        yield correction(text, scene.contacts, None, scene.T_palm_object)


def real_vision(seed: int, n: int) -> Problems:
    """Yields poses that published estimators found in YCB-Video, with three or five drawn contacts."""
    folder = ycb.data_or_goodbye() / "ycbv_vision_poses"
    files = sorted(path.stem for path in (folder / "ground_truth").glob("*.txt"))
    sigmas = vision_errors.learnt_sigmas(folder.parent, files)
    for k, rng in generators(seed, n, "vision errors"):
        file, (label, method) = files[k % len(files)], list(ycb.ESTIMATORS.items())[k // len(files) % 4]
        name = file.split("_", 1)[1]
        poses, detected = ycb.read_poses(folder / method / f"{file}.txt")
        truths, _ = ycb.read_poses(folder / "ground_truth" / f"{file}.txt")
        if detected.any():
            frame = rng.choice(np.flatnonzero(detected))
            contacts = vision_errors.touched(ycb.surface_samples(folder.parent, name), truths[frame], rng)
            vision = vision_errors.prior(poses[frame], sigmas[name][label])
            some = contacts.select(range(vision_errors.COUNTS[k % 2]))
            yield correction(mesh(name), some, vision, truths[frame])


# Scores of a correction


def estimate_of(answer: Answer) -> Any:
    """Returns the parts of an estimate by which it is judged."""
    arrays = {name: np.array(answer[name], dtype=float) for name in ("pose", "information", "unobservable")}
    pose, information, unobservable = arrays.values()
    return SimpleNamespace(
        T_palm_object=pose, information=information, unobservable=unobservable.reshape(-1, 6)
    )


def if_found(problem: Problem, answer: Answer) -> Score:
    """Returns whether the pose is right in what the contacts observe, and its shift there."""
    model, estimate = model_of(str(problem["model"])), estimate_of(answer)
    truth = problem["truth.pose"]
    shift = scenes.pose_errors(model, estimate, truth)[2]
    return Score(scenes.found(model, estimate, truth), 1e3 * shift)


def if_inside(problem: Problem, answer: Answer) -> Score:
    """Returns whether the 95 % region holds the truth, and the shift of the object's middle."""
    model, estimate, truth = model_of(str(problem["model"])), estimate_of(answer), problem["truth.pose"]
    region = scenes.region(model, estimate, truth)
    return Score(bool(region["in 95%"]), middle_off(model, estimate.T_palm_object, truth))


def middle_off(model: Any, T: Array, truth: Array) -> float:
    """Returns the shift of the object's middle, modulo symmetry [mm]."""
    middle = np.append(model.center_object, 1.0)
    near = scenes.nearest_truth(model, truth, T)
    return 1e3 * float(np.linalg.norm((T - near) @ middle))


def if_upright(problem: Problem, answer: Answer) -> Score:
    """Returns whether the box is not turned by more than 20 degrees, and its error along the slide."""
    model, T = model_of(str(problem["model"])), np.array(answer["pose"])
    errors = gripped_box.errors(model, T, problem["truth.pose"])
    return Score(bool(errors["turn"] < 20), float(errors["slide"]))


def if_outside(problem: Problem, answer: Answer) -> Score:
    """Returns whether no point of the hand is more than 5 mm inside, and how deep the deepest is."""
    points = se3.apply(se3.inverse(np.array(answer["pose"])), problem["outside.points"])
    inside = -float(model_of(str(problem["model"])).fine.evaluate(points).distance.min())
    depth = 1e3 * max(0.0, inside)
    return Score(depth < penetration.DEEP, depth)


def across_the_edge(problem: Problem, answer: Answer) -> Score:
    """Returns whether the 95 % region holds the truth, and the error across the edge that is on the array."""
    inside = if_inside(problem, answer).right
    T = np.array(answer["pose"])
    near = scenes.nearest_truth(model_of(str(problem["model"])), problem["truth.pose"], T)
    return Score(inside, 1e3 * abs(float(se3.difference(T, near)[:3] @ problem["truth.across"])))


def if_told_apart(problem: Problem, answer: Answer) -> Score:
    """Returns whether 9 in 10 wrong contacts and at most 1 in 100 right ones are left out, and the shift."""
    wrong = problem["truth.wrong"]
    called = np.zeros(len(wrong), dtype=bool)
    called[answer["outliers"]] = True
    right = called[wrong].sum() >= 0.9 * wrong.sum() and called[~wrong].sum() <= 0.01 * (~wrong).sum()
    return Score(bool(right), if_inside(problem, answer).error)


def if_covered(problem: Problem, answer: Answer) -> Score:
    """Returns whether the best of five modes is within 1 cm, and the shift of the first."""
    model = model_of(str(problem["model"]))
    off = [middle_off(model, np.array(T), problem["truth.pose"]) for T in answer["modes"][:5]]
    return Score(min(off) < 10, off[0])


# Depth images


def whole_numbers(depth: Array) -> Array:
    """Returns a depth image [m] as whole numbers, 0 where there is none."""
    known = np.nan_to_num(depth, nan=0.0, posinf=0.0) / DEPTH_UNIT
    return np.where(known < 2**16, np.round(known), 0).astype(np.uint16)


def frame_objects() -> dict[str, str]:
    """Returns the texts of all objects that real frames may show, by name."""
    folder = real_frames.default_folder()
    files = sorted([*(folder / "meshes").glob("*.ply"), *(folder.parent / "ycb_meshes").glob("*.ply")])
    return {file.stem: as_text(mesh=str(file), symmetries="find") for file in files}


def frames(n: int) -> Iterator[tuple[real_frames.RealFrame, dict[str, Any]]]:
    """Yields real frames, evenly chosen, each with its image as a problem."""
    opened = real_frames.open_folder(real_frames.default_folder())
    readers = [read for scene in opened.scenes.values() for read in scene]
    for read in readers[:: max(1, len(readers) // n)][:n]:
        frame = read()
        yield frame, {"depth": whole_numbers(frame.depth), "camera": frame.camera.matrix}


def real_objects(_: int, n: int) -> Problems:
    """Yields objects of real frames, anywhere in the image or in a mask."""
    texts = frame_objects()
    for frame, image in frames(n):
        for instance in frame.instances:
            same = [one.T_camera_object for one in frame.instances if one.name == instance.name]
            problem = image | {"model": texts[instance.name], "truth.poses": np.array(same)}
            yield problem
            yield problem | {"mask": frame.wanted(instance, "mask")}


def pictures(seed: int, n: int) -> Problems:
    """Yields drawn pictures of one of ten objects, in a box and behind a hand."""
    texts = json.dumps({name: mesh(name) for name in meshes()})
    bins = list(sight.BINS)
    for k in range(n):
        name, picture = sight.picture(bins[k % len(bins)], k // len(bins), 900 + seed)
        problem = {"models": texts, "depth": whole_numbers(picture.depth), "camera": sight_scenes.WIDE.matrix}
        problem |= {"mask": picture.wanted, "truth.name": name}
        yield problem if picture.hand is None else problem | {"hand": picture.hand}


def sequences(seed: int, n: int) -> Problems:
    """Yields drawn sequences in which an object is hidden or lost."""
    models = sight.objects()
    for k, rng in generators(seed, n, "following"):
        kind, name = list(losing.KINDS)[k % len(losing.KINDS)], list(models)[k % len(models)]
        others = rng.choice([other for other in models if other != name], 3, replace=False)
        images = list(losing.lost(kind, [models[name], *(models[other] for other in others)], rng))
        nothing = np.zeros(images[0].depth.shape, dtype=bool)
        there = np.array([image.T_camera_object is not None for image in images])
        truths = [np.eye(4) if image.T_camera_object is None else image.T_camera_object for image in images]
        yield {
            "model": mesh(name),
            "camera": sight_scenes.WIDE.matrix,
            "depth": np.array([whole_numbers(image.depth) for image in images]),
            "stamps": np.array([image.stamp for image in images]),
            "hands": np.array([nothing if image.hand is None else image.hand for image in images]),
            "hand_known": np.array([image.hand is not None for image in images]),
            "start": truths[0],
            "truth.there": there,
            "truth.poses": np.array(truths),
            "truth.hidden": np.array([image.hidden for image in images]),
        }


def around(seed: int, n: int) -> Problems:
    """Yields a can, a box or a bottle that a camera goes around."""
    texts = [CAN, BOX, *map(mesh, reconstruction.YCB)]
    for k, rng in generators(seed, n, "reconstruction"):
        model = model_of(texts[k % len(texts)])
        shape = sight_scenes.standing(model)
        poses = sight_scenes.path_around(reconstruction.MOTIONS["given"], rng)
        images = sight_scenes.pictures_around(poses, shape, rng)
        yield {
            "model": texts[k % len(texts)],
            "camera": sight_scenes.CAMERA.matrix,
            "depth": np.array([whole_numbers(image) for image in images]),
            "poses": poses,
            "bounds": reconstruction.bounds(model),
            "truth.T_object_table": se3.compose(np.eye(3), np.array(model.vertices)[0] - shape[0][0]),
        }


def surface_off(text: str, truths: Iterable[Array], T: Array) -> float:
    """Returns the mean distance of a surface from the nearest of the true ones [diameters]."""
    return min(real_frames.add_s(model_of(text), truth, T) for truth in truths)


def if_located(problem: Problem, answer: Answer) -> Score:
    """Returns whether the first pose is right, and the mean distance of its surface."""
    text = str(problem["model"])
    if not answer["poses"]:
        return Score(False, math.inf)
    off = surface_off(text, problem["truth.poses"], np.array(answer["poses"][0]))
    return Score(off < RIGHT_SHARE, 1e3 * off * model_of(text).diameter)


def if_recognised(problem: Problem, answer: Answer) -> Score:
    """Returns whether the object is named, and the probability that it is not."""
    truth = str(problem["truth.name"])
    return Score(answer["name"] == truth, 1 - answer["scores"].get(truth, 0.0))


def if_followed(problem: Problem, answer: Answer) -> Score:
    """Returns, of a sequence, whether in 9 of 10 images the state is true, and the surface's error while tracking."""
    text, true, errors = str(problem["model"]), [], []
    for k, (rotation, position) in enumerate(answer["poses"]):
        if problem["truth.hidden"][k] > 0.9:
            continue
        T = se3.compose(np.array(rotation), np.array(position))
        here = bool(problem["truth.there"][k]) and np.linalg.det(T[:3, :3]) > 0.9
        off = surface_off(text, [problem["truth.poses"][k]], T) if here else math.inf
        tracking = answer["states"][k] == "tracking"
        true.append(tracking == (off < RIGHT_SHARE))
        if tracking and here:
            errors.append(1e3 * off * model_of(text).diameter)
    return Score(float(np.mean(true)) >= 0.9, float(np.median(errors)) if errors else math.inf)


def if_reconstructed(problem: Problem, answer: Answer) -> Score:
    """Returns whether 95 % of the surface is within 3 mm of the object, and its mean distance."""
    points = np.array(answer["points"]).reshape(-1, 3)
    points = points[points[:, 2] > reconstruction.STANDS]
    if not len(points):
        return Score(False, math.inf)
    own = se3.apply(problem["truth.T_object_table"], points)
    off = 1e3 * np.abs(model_of(str(problem["model"])).evaluate(own).distance)
    return Score(bool(np.quantile(off, 0.95) < 3), float(off.mean()))


# Recordings


def recorded(scenario: Scenario, case: str = "usual") -> dict[str, Any] | None:
    """Returns a recording, its rig file and the truth; None where the hand did not keep an object that it was to keep.

    case: what the robot believes, of `harsh.CASES`.
    """
    samples = list(simulate(scenario))
    if samples[-1].dropped and scenario.motion in ("manipulate", "weigh"):
        return None
    told = harsh.Problem(samples, rig_of(scenario), simulated_model(scenario))
    told = harsh.CASES[case].believed(told)
    with tempfile.TemporaryDirectory() as folder:
        path, rig_file = Path(folder, "recording.mcap"), Path(folder, "recording.rig.yaml")
        save.write(told.rig, rig_file)
        with RecordingWriter(path, told.rig) as writer:
            for sample in told.samples:
                writer.write(replace(sample.observation, stamp=BEGINS + sample.observation.stamp))
        content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
        rig = rig_file.read_text(encoding="utf-8")
    return {
        "recording": content,
        "rig": rig,
        "object": scenario.object,
        "model": CAN if scenario.object == "can" else BOX,
        "truth.stamps": np.array([BEGINS + sample.observation.stamp for sample in samples]),
        "truth.poses": np.array([sample.T_palm_object for sample in samples]),
        "truth.speeds": np.array([slips.speed(sample) for sample in samples]),
        "truth.pulled": np.array([sample.phase == "pull" and not sample.dropped for sample in samples]),
        "truth.mass": np.array(scenario.nuisances.object_mass),
    }


def recordings(
    scenario_of: Callable[[int, str, str], Scenario], *cases: str
) -> Callable[[int, int], Problems]:
    """Returns recordings of can and box in turn, in each of some worlds of `harsh.py` in turn."""

    def problems(seed: int, n: int) -> Problems:
        numbers = itertools.count(10_000 * seed)
        for k in range(n):
            name, case = ("can", "box")[k % 2], cases[k // 2 % len(cases)]
            tried = (recorded(scenario_of(number, name, case), case) for number in numbers)
            yield next(problem for problem in tried if problem is not None)

    return problems


def manipulated(seed: int, name: str, case: str) -> Scenario:
    """Returns an object that is grasped, moved, lifted and turned."""
    nuisances = harsh.CASES[case].nuisances(seed)
    return Scenario(object=name, seed=seed, motion="manipulate", rate=TRACK_RATE, nuisances=nuisances)


def pulled(seed: int, name: str, _: str) -> Scenario:
    """Returns an object that is pulled until it slips."""
    return slips.scenario(name, seed, 2 * TRACK_RATE)


def weighed(seed: int, name: str, _: str) -> Scenario:
    """Returns an object that is lifted and tilted."""
    return Scenario(object=name, seed=seed, motion="weigh", rate=TRACK_RATE)


def if_tracked(problem: Problem, answer: Answer) -> Score:
    """Returns, of a run, whether three in four regions hold the truth, and the error in its last third."""
    model, inside, off = model_of(str(problem["model"])), [], []
    for stamp, pose, information in zip(
        answer["stamps"], answer["poses"], answer["informations"], strict=True
    ):
        if stamp < BEGINS + HELD_FROM:
            continue
        truth = problem["truth.poses"][np.abs(problem["truth.stamps"] - stamp).argmin()]
        squared, freedom = scenes.chi2(model, np.array(pose), np.array(information), truth)
        inside.append(squared < chdtri(freedom, 0.05))
        off.append(middle_off(model, np.array(pose), truth))
    if not off:
        return Score(False, math.inf)
    return Score(float(np.mean(inside)) >= 0.75, float(np.mean(off[len(off) * 2 // 3 :])))


def if_alarmed(problem: Problem, answer: Answer) -> Score:
    """Returns, of a pull, whether each slip is alarmed and 9 in 10 alarms are right, and the first one's delay [ms]."""
    stamps, alarms = np.array(answer["slipping"]).T
    nearest = np.abs(problem["truth.stamps"][:, None] - stamps).argmin(axis=1)
    chosen = problem["truth.pulled"]
    flags, speeds = alarms[nearest][chosen] > 0, problem["truth.speeds"][chosen]
    if chosen.sum() < 2:
        return Score(not flags.any(), math.nan)
    times = problem["truth.stamps"][chosen]
    found, counts = slips.delays(flags, speeds, times), slips.counted(flags, speeds, times[1] - times[0])
    right = None not in found and counts["right"] >= 0.9 * counts["alarmed"]
    delays = [math.inf if delay is None else 1e3 * delay for delay in found]
    return Score(right, delays[0] if delays else math.nan)


def if_weighed(problem: Problem, answer: Answer) -> Score:
    """Returns whether the mass is right to a tenth, and its error."""
    if answer["mass"] is None:
        return Score(False, math.inf)
    off = 100 * abs(answer["mass"] / float(problem["truth.mass"]) - 1)
    return Score(off < 10, off)


WRONG = ("first", "low", "noise", "gain", "joints", "late", "drift", "harsh")
"""Worlds of `harsh.py` that are not as declared."""
FAR = scenes.VISION_ERRORS["85 mm / 30°"]
KINDS = {
    "convergence, 20 mm": Kind(POSE, "corrected", converging(scenes.ERROR), if_found, 1000, 10),
    "convergence, 85 mm": Kind(POSE, "corrected", converging(FAR), if_found, 1000, 10),
    "one contact moved": Kind(POSE, "corrected", converging(scenes.ERROR, "moved"), if_found, 1000, 10),
    "one normal turned": Kind(POSE, "corrected", converging(scenes.ERROR, "turned"), if_found, 1000, 10),
    "regions": Kind(REGION, "corrected", any_surface, if_inside, 1000, 8),
    "means": Kind(REGION, "corrected", sliding, if_inside, 1000, 6),
    "gripped box": Kind("turned < 20°", "corrected", across_a_box, if_upright, 1000, 6),
    "penetration": Kind("< 5 mm deep", "corrected", around_by_hand, if_outside, 1000, 6),
    "skin": Kind(REGION, "corrected", on_skin, across_the_edge, 400, 4),
    "many contacts": Kind("told apart", "corrected", many, if_told_apart, 250, 5),
    "scans": Kind(REGION, "corrected", scanned, if_inside, 400, 4),
    "three fingers": Kind("< 1 cm, of five", "corrected", triplets, if_covered, 640, 8),
    "section III": Kind(REGION, "corrected", simulated_grasps, if_inside, 200, 2),
    "blind": Kind(POSE, "corrected", unseen, if_found, 600, 12),
    "vision errors": Kind(REGION, "corrected", real_vision, if_inside, 1200, 16),
    "frames": Kind("found", "located", real_objects, if_located, 40, 1),
    "recognition": Kind("named", "recognised", pictures, if_recognised, 180, 6, ""),
    "following": Kind("state true", "followed", sequences, if_followed, 56, 2),
    "reconstruction": Kind("95 % < 3 mm", "reconstructed", around, if_reconstructed, 16, 1),
    "over time": Kind("3 of 4 in 95 %", "tracked", recordings(manipulated, "usual"), if_tracked, 40, 1),
    "harsh worlds": Kind("3 of 4 in 95 %", "tracked", recordings(manipulated, *WRONG), if_tracked, 48, 2),
    "slip": Kind("each alarmed", "tracked", recordings(pulled, "usual"), if_alarmed, 40, 2, "ms"),
    "weight": Kind("mass within 10 %", "tracked", recordings(weighed, "usual"), if_weighed, 30, 1, "%"),
}
"""By name."""
