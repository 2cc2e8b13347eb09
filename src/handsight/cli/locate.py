"""`handsight locate`: where an object is in depth images, without a guess."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from handsight.cli import terminal
from handsight.cli.options import DEPTH_CAMERAS, LibraryPlace, RigPath, find_models, find_rig, refuse
from handsight.cli.terminal import announce_compiling, millimetres
from handsight.errors import HandsightError, InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording.detections import Located, LocatedAll
    from handsight.recording.frames import Box, Frame, Frames, Unread
    from handsight.vision import DepthNoise, ObjectDetection

    Row = Located | LocatedAll | Unread

MAX_INSTANCES = 100
"""Most instances of one object in an image."""
MOST_PANELS = 6
"""Number of images in the picture."""
MAX_MESSAGES = 5
"""Number of messages about unreadable images."""
DOUBT = 0.01
"""Another pose, or another object, that fits with at least this probability is told."""


def locate(
    images: Annotated[
        Path,
        Argument(
            help="A depth image (PNG, TIFF, .npy, EXR), a folder of them, a BOP scene or split, or a recording.",
            show_default=False,
        ),
    ],
    object: Annotated[
        list[str] | None,
        Option(
            "--object",
            metavar="NAME|FILE[*N]",
            help="Name of an object of the library or, for a recording, of its rig; or a mesh file. Given several "
            "times: find each that is there, once; not given: all of the rig or the library. `NAME*2`: two at most.",
        ),
    ] = None,
    which: Annotated[
        bool,
        Option(
            "--which", help="Only one of the objects is there: recognise which, or that it is none of them."
        ),
    ] = False,
    output: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            help="File for the answers, a line of JSON for each image (- for stdout), or BOP results if its name "
            "ends in .csv; OUTPUT.part until they are complete. Default: a short line a pose.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        Option(
            help=f"File for a picture of the poses in the first {MOST_PANELS} images: PNG, PDF or SVG by its name."
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        Option(help="File of the camera's intrinsics, as above. Default: the one beside the images."),
    ] = None,
    depth_scale: Annotated[
        float | None,
        Option(
            help="Metres per step of depth, such as 0.0002 for TUM's images. Default: floats are metres, whole "
            "numbers in the unit that the camera's file states (depth_scale), else millimetres."
        ),
    ] = None,
    resized: Annotated[
        bool, Option("--resized", help="The images were scaled: scale the camera's intrinsics to their size.")
    ] = False,
    box: Annotated[
        str | None,
        Option(metavar="U0,V0,U1,V1", help="Search between these columns and rows only [pixels]."),
    ] = None,
    mask: Annotated[
        Path | None,
        Option(
            help="Search only where this image is not 0; or a folder of such images, with the names of the depth "
            "images or BOP's names of instances, as mask_visib in each scene."
        ),
    ] = None,
    detections: Annotated[
        Path | None,
        Option(
            help="Search only in the boxes and masks of a detector: JSON of CNOS, SAM-6D or COCO, or a folder of "
            "YOLO's text.",
        ),
    ] = None,
    start: Annotated[
        Path | None,
        Option(
            help="Poses of another estimator (BOP's .csv, JSON of SAM-6D or MegaPose, a folder of 4 x 4 numbers): "
            "refined, and compared with what is found without them.",
        ),
    ] = None,
    targets: Annotated[
        Path | None,
        Option(
            help="Which objects to find in which images of a BOP scene or split: test_targets_bop19.json.",
        ),
    ] = None,
    depth_camera: Annotated[
        str | None,
        Option(
            metavar="KIND",
            help=f"How the camera measures depth: {DEPTH_CAMERAS}. Default: structured_light; for a recording, as in "
            "the rig.",
        ),
    ] = None,
    scale: Annotated[float, Option(help="Metres per unit of a mesh file; 0.001 for millimetres.")] = 1.0,
    library: LibraryPlace = None,
    rig: RigPath = None,
) -> None:
    """Locate objects in depth images, without a guess of their poses, or recognise which of several objects it is.

    Only depth is used. The table and, in a recording, the robot's hand are removed; the remaining points vote for
    poses.

    * **One image or a folder of them**: floats in metres, or whole numbers in millimetres or another unit, 0 where
      depth is unknown. The camera's file is beside them or in the folder above: `camera.json` (`{"fx": 615, "fy": 615,
      "cx": 320, "cy": 240, "width": 640, "height": 480}` [pixels], with `"lens": [k1, k2, p1, p2, k3]` where the images
      are not rectified), or that of another program. In a folder, depth is in `depth/`, with colour under the same
      names in `rgb/` or `color/`; or all images are in the folder itself, with "depth" in their names.
    * **A BOP scene** (`scene_camera.json`, `depth/000000.png`, `rgb/`), or a split with scenes in it; the objects are
      those of its data set, unless `--library` names others.
    * **A recording** with depth images, as for `handsight track`: the rig names the topics. The hand is masked where it
      is detected in the image, else where it is by the joints and the camera's calibration.

    ```
    handsight locate depth.png --camera d435.json --object mustard --plot found.png
    handsight locate frames/ --object mustard.ply --box 200,120,420,400 -o poses.jsonl
    handsight locate ycbv/test/000048 --object 5 -o handsight_ycbv-test.csv
    handsight locate ycbv/test/000048 --object 5 --detections cnos_ycbv-test.json
    handsight locate ycbv/test/000048 --object 5 --start megapose_ycbv-test.csv
    handsight locate can.mcap --plot found.png
    handsight locate depth.png --object mug --object mustard --object can*2
    handsight locate depth.png --library lab/ --box 200,120,420,400 --which
    ```

    Several objects are explained together, each pixel by one of them at most. Each is there once at most, or as often
    as `can*2` says. `--which` recognises the one object in
    the image, or in a detector's box.

    A line has the object's pose in the camera's frame (x right, y down, z forward), its standard deviations, the
    probability that it is right, and what else fits.

    With `-o`, an answer has position [m], quaternion_xyzw, covariance (6x6, position then rotation along the camera's
    axes), probability, up to three hypotheses with weights, and seconds; or `"found": false` and the reason. With
    several objects it lists them in `objects`, and in `missing` why others are not there. With `--which` it has the
    probability of each (`scores`) and of `none` of them; the pose is that of the most probable one, and `"object"` is
    null if `none` is more probable.

    An image that cannot be read is answered with `{"error": ...}`, and the exit code is then 1; it is 2 if no image
    can be read, and 74 if answers cannot be written. After Ctrl-C or an error, the answers until then are in
    OUTPUT.part, and OUTPUT is as it was.
    """
    from handsight.recording.frames import Beside, Frame, is_recording, open_frames, recorded_frames, within
    from handsight.vision.depth_noise import PRESETS

    announce_compiling()
    terminal.check_outputs(output, plot, images, camera, mask, rig, detections, start, targets)
    csv = output is not None and output.suffix.lower() == ".csv"
    noise = _noise(depth_camera)
    numbers = None
    names, most = _counted(object or [])
    if is_recording(images):
        if csv:
            raise InvalidInput("--output: expected JSON lines of a recording, got BOP's .csv")
        refuse(str(images), camera=camera, mask=mask, depth_scale=depth_scale, resized=resized)
        refuse(str(images), depth_camera=depth_camera, detections=detections, start=start, targets=targets)
        robot, rig_path = find_rig(images, rig)
        models = find_models(names, robot, rig_path)
        if robot.camera is not None:
            noise = PRESETS[robot.camera.depth_camera]
        frames = recorded_frames(images, robot)
    else:
        refuse(str(images), rig=rig)
        beside = Beside(camera=camera, resized=resized, mask=mask, depth_scale=depth_scale)
        frames = open_frames(images, beside)
        folder = frames.folder
        if folder is not None:
            names = names or ([str(mesh) for mesh in folder.meshes] if library is None else [])
            start = start or folder.poses
            terminal.say(folder.sentence(images))
        library = library or (str(frames.library) if frames.library else None)
        models = find_models(names, library=library, scale=scale)
        if csv:
            numbers = _numbers(models, names, library)
        if any((mask, detections, start, targets)):
            frames = _hinted(frames, models, library, detections=detections, start=start, targets=targets)
    if box is not None:
        area = _area(box)
        each = (within(frame, area) if isinstance(frame, Frame) else frame for frame in frames.each)
        frames = frames._replace(each=each)
    counts = None
    if not which:
        counts = {name: most[given] for name, given in zip(models, names, strict=False) if given in most}
    if code := _locate_each(frames, models, counts, noise, output, plot, numbers):
        raise typer.Exit(code)


def _noise(kind: str | None) -> "DepthNoise":
    """Returns the noise of a kind of depth camera; raises InvalidInput for one that is not known."""
    from handsight.checks import suggestion
    from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT

    if kind is None:
        return STRUCTURED_LIGHT
    for known, noise in PRESETS.items():
        if known == kind:
            return noise
    came = f"{kind!r:.80}{suggestion(kind, PRESETS)}"
    raise InvalidInput(f"--depth-camera: expected one of {', '.join(PRESETS)}, got {came}")


def _area(box: str) -> "Box":
    """Returns the columns and rows of a box; raises InvalidInput."""
    try:
        left, top, right, bottom = (float(part) for part in box.split(","))
    except ValueError:
        raise InvalidInput(f"--box: expected 4 numbers u0,v0,u1,v1, got {box!r:.60}") from None
    return left, top, right, bottom


def _numbers(
    models: "Mapping[str, ObjectModel]", names: Sequence[str], library: str | None
) -> dict[str, int]:
    """Returns the library's numbers of objects, by which BOP's results call them."""
    from handsight.objects import Library

    known = Library(library)
    return {name: known.entry(given).number for name, given in zip(models, names or models, strict=True)}


def _hinted(
    frames: "Frames", models: "Mapping[str, ObjectModel]", library: str | None, **files: Path | None
) -> "Frames":
    """Returns the images with what files of other programs say of them, which are named as `Hints` names them."""
    from handsight.objects.library import Library, NoLibrary
    from handsight.recording.hints import Hints

    try:
        entries = Library(library).entries()
    except NoLibrary:
        entries = ()
    known = {str(entry.number): entry.name for entry in entries if entry.name in models}
    hints = Hints(models, known, frames.images, **files)
    terminal.say(*hints.sentences)
    total = None if files["targets"] else frames.total
    return frames._replace(total=total, each=hints.beside_each(frames.each))


def _counted(given: list[str]) -> tuple[list[str], dict[str, int]]:
    """Returns the names of objects, each once, and how many there are at most of those given as NAME*N; raises
    InvalidInput."""
    names = list[str]()
    most = dict[str, int]()
    for each in given:
        name, star, digits = each.partition("*")
        if star:
            if not (digits.isascii() and digits.isdecimal() and 0 < int(digits) <= MAX_INSTANCES):
                expected = f"expected NAME*N with a number from 1 to {MAX_INSTANCES}"
                raise InvalidInput(f"--object: {expected}, got {each!r:.80}")
            most[name] = int(digits)
        if name not in names:
            names.append(name)
    return names, most


def _locate_each(
    frames: "Frames",
    models: "Mapping[str, ObjectModel]",
    counts: Mapping[str, int] | None,
    noise: "DepthNoise",
    output: Path | None,
    plot: Path | None,
    numbers: Mapping[str, int] | None,
) -> int:
    """Locates objects in each image, and returns the command's exit code.

    The answers are written to a file or stdout; after Ctrl-C or an error, those until then. An error before the first
    answer is raised. `counts`: as `locator` takes them. `numbers`: BOP's numbers of the objects, by name, for BOP's
    results; None: the answers are lines of JSON, or short without `output`.
    """
    from handsight.recording.detections import bop_lines, json_line
    from handsight.recording.frames import Unread
    from handsight.recording.pose_file import BOP_COLUMNS

    done = found = 0
    locate_in: Callable[[Frame], Located | LocatedAll] | None = None
    panels = list["Located | LocatedAll"]()  # for the picture
    unread = list[str]()
    notes = list[str]()
    with (
        terminal.kept_going() as end,
        terminal.output_lines(output) as write,
        terminal.bar("locating") as move,
    ):
        header = [] if numbers is None else [BOP_COLUMNS]
        for frame in frames.each:
            row: Row
            if isinstance(frame, Unread):
                row = frame
                unread.append(f"handsight: {frame.reason}")
            else:
                locate_in = locate_in or locator(models, noise, counts)
                row = locate_in(frame)
                if row.reason is not None and frame.unit_else is not None:
                    otherwise = locate_in(frame.in_millimetres())
                    row = row if otherwise.reason is not None else otherwise
                notes += [note for note in row.frame.notes if note not in notes]
                found += row.reason is None
                panels = [*panels, row][:MOST_PANELS]
            done += 1  # after the search, which Ctrl-C may end
            if numbers is not None:
                lines = bop_lines(row, numbers)
            elif output is not None:
                lines = [json_line(row)]
            else:
                lines = list(_short_lines(row))
            write(header + lines)
            header = []
            move(done / frames.total if frames.total else None, f"{done} of {frames.total or '?'} images")
    if isinstance(end.error, HandsightError) and not done:
        raise end.error
    sentences = unread[:MAX_MESSAGES]
    if len(unread) > MAX_MESSAGES:
        sentences.append(f"handsight: {len(unread) - MAX_MESSAGES} more images cannot be read")
    sentences += notes[:MAX_MESSAGES]
    if end.exit_code:
        kept = terminal.kept_in(output)
        sentences.append(f"{end.message or 'handsight: stopped'} (after {done} images{kept})")
    elif not terminal.is_stdout(output):
        sentences.append(f"wrote {output}: found in {found} of {done} images")
    if plot is not None and panels:
        sentences.append(draw(panels, plot))
    terminal.say(*sentences)
    if end.exit_code or not unread:
        return end.exit_code
    return terminal.FAILED if panels else terminal.WRONG_INPUT


def locator(
    models: "Mapping[str, ObjectModel]", noise: "DepthNoise", counts: Mapping[str, int] | None = None
) -> "Callable[[Frame], Located | LocatedAll]":
    """Returns a function that locates the object in an image, or each that is there of several.

    counts: how many there are at most, by name; any number of several objects without one.
    `counts` is None: only one object is there, and of several it is said which. Everything that is compiled or computed
    once is done here, so that the seconds of an image do not contain it.
    """
    import numpy as np

    from handsight.camera import Camera
    from handsight.recording.detections import Located, LocatedAll
    from handsight.vision import ObjectDetection, locate_all, recognise
    from handsight.vision.object.first_pose import first_pose
    from handsight.vision.object.region import scene_of

    matrix = np.array([[64, 0, 32], [0, 64, 24], [0, 0, 1.0]])
    camera = Camera(matrix, (64, 48))
    for model in models.values():
        in_front = model.vertices - model.center_object + [0, 0, min(2 * model.diameter, 5.0)]
        drawn = camera.draw(in_front, model.faces).depth
        first_pose(model, scene_of(camera, drawn, extent=model.diameter), noise=noise)

    def locate_in(frame: "Frame") -> "Located | LocatedAll":
        """Returns the objects' poses in an image, and how long the search took."""
        started = time.perf_counter()
        asked = models
        if frame.targets is not None:
            asked = {name: models[name] for name in frame.targets}
        image: dict[str, Any] = {"mask": frame.wanted, "hand": frame.hand, "noise": noise}
        beside = frame.detections is not None or frame.starts is not None
        most = frame.targets or counts or {}
        alone = len(models) == 1 and not counts and max(most.values(), default=1) == 1
        if counts is None or alone:
            here = dict[str, ObjectDetection]()
            which = None
            if beside or len(models) == 1:
                here = {name: _found_beside(frame, model, name, noise)[0] for name, model in asked.items()}
            if len(models) > 1:
                which = recognise(asked, frame.depth, frame.camera, found=here, **image)
                here = which.found
            name, one = next(iter(here.items()))
            seconds = time.perf_counter() - started
            return Located(frame=frame, model=models[name], found=one, seconds=seconds, recognition=which)
        found = None
        if beside:
            named = asked.items()
            found = {name: _found_beside(frame, model, name, noise, each=True) for name, model in named}
        scene = locate_all(asked, frame.depth, frame.camera, counts=most, found=found, **image)
        seconds = time.perf_counter() - started
        return LocatedAll(frame=frame, models=models, found=scene, seconds=seconds)

    return locate_in


def _found_beside(
    frame: "Frame", model: "ObjectModel", name: str, noise: "DepthNoise", *, each: bool = False
) -> "list[ObjectDetection]":
    """Returns where an object is in an image by what other programs say of it: the likeliest place, or, with `each`,
    that of each of the best detections by itself."""
    from handsight.observation import Detection2D
    from handsight.vision import locate_detected
    from handsight.vision.object.locate import MAX_DETECTIONS

    known = (Detection2D(),) if frame.detections is None else frame.detections
    mine = sorted((one for one in known if one.label in ("", name)), key=lambda one: -(one.score or 1.0))
    groups = [[one] for one in mine[:MAX_DETECTIONS]] if each else [mine]
    located = partial(locate_detected, model, frame.depth, frame.camera, hand=frame.hand, noise=noise)
    start = (frame.starts or {}).get(name)
    return [located(detections=group, mask=frame.wanted, start=start) for group in groups]


def draw(panels: "Sequence[Located | LocatedAll]", path: Path) -> str:
    """Draws images with the poses found in them to a file, and returns a sentence that names it."""
    from handsight.viewer.figures import draw_located

    draw_located(panels, path)
    return f"wrote {path}"


def _short_lines(row: "Row") -> Iterator[str]:
    """Yields a line for each object that was found in an image, or that is not there."""
    from handsight.recording.detections import Located
    from handsight.recording.frames import Unread

    if isinstance(row, Unread):
        yield f"{row.name}: cannot be read"
        return
    image = row.frame.name
    if isinstance(row, Located):
        yield f"{image}: {_pose_line(row) if row.reason is None else f'not here: {row.reason}'}"
        return
    for each in row.instances:
        yield f"{image}: {_pose_line(each)}"
    for name, why in row.found.missing.items():
        yield f"{image}: {name} is not here: {why}"


def _pose_line(row: "Located") -> str:
    """Returns an object's pose, its standard deviations and its probability, and what else fits."""
    import numpy as np

    from handsight import se3

    found = row.found
    pose = se3.position_quaternion(found.Ts_camera_object[0])
    turn = ", ".join(f"{x:.3f}" for x in pose["quaternion_xyzw"])
    sigmas = np.sqrt(found.covariances[0].diagonal())
    off = millimetres(sigmas[:3].max())
    tilt = math.degrees(sigmas[3:].max())
    line = f"{row.model.name} at [{millimetres(pose['position'])}] mm ± {off}, turned [{turn}] (xyzw) ± {tilt:.1f}°"
    line += f", probability {found.probability:.2f}"
    others = [f"another pose {weight:.2f}" for weight in found.weights[1:3] if weight > DOUBT]
    if row.recognition is not None:
        scores = row.recognition.scores | {"none of them": row.recognition.none}
        others += [f"{name} {p:.2f}" for name, p in scores.items() if p > DOUBT and name != row.model.name]
    return f"{line}; or {', '.join(others)}" if others else line
