"""`handsight locate`: where an object is in depth images, without a guess."""

import math
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer
from typer import Argument, Option

from handsight.cli import terminal
from handsight.cli.options import DEPTH_CAMERAS, LibraryPlace, RigPath, find_models, find_rig
from handsight.cli.terminal import announce_compiling
from handsight.errors import HandsightError, InvalidInput
from handsight.files import check_not_overwritten, stream_name, write_errors

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording.detections import Located
    from handsight.recording.frames import Frame, Frames, Unread
    from handsight.rig import DepthCamera
    from handsight.vision import DepthNoise, ObjectDetection

MOST_PANELS = 6
"""Number of images in the picture."""
MAX_MESSAGES = 5
"""Number of messages about unreadable images, and about images without the object."""


def locate(
    images: Annotated[
        Path,
        Argument(
            help="A depth image (PNG of 16 bits), a folder of them, a BOP scene or split, or a recording.",
            show_default=False,
        ),
    ],
    object: Annotated[
        list[str] | None,
        Option(
            "--object",
            metavar="NAME|FILE",
            help="Name of an object of the library or, for a recording, of its rig; or a mesh file. Given several "
            "times: recognise which of these is in the image. Not given: which of all in the rig or the library.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            help="File for the answers: a line of JSON for each image, or BOP results if its name ends in .csv. "
            "Default: stdout.",
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
        Option(help="File of the camera's intrinsics, as above. Default: camera.json beside the images."),
    ] = None,
    color: Annotated[
        Path | None, Option(help="Colour image with the pixels of the depth image, for the picture.")
    ] = None,
    depth_scale: Annotated[float, Option(help="Metres per step of depth; 0.001 for millimetres.")] = 0.001,
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
            metavar="FILE",
            help="Search only in the boxes and masks of a detector: JSON as CNOS writes it, by BOP's numbers of scene, "
            "image, object. In a folder, the last number in an image's name is its number.",
        ),
    ] = None,
    start: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Poses of another estimator, as BOP results (.csv): refined, compared with what is found without "
            "them, and judged: `starts` in the answer says which are right.",
        ),
    ] = None,
    targets: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Which objects to find in which images of a BOP scene or split: test_targets_bop19.json.",
        ),
    ] = None,
    depth_camera: Annotated[
        str | None,
        Option(
            metavar=DEPTH_CAMERAS,
            help="How the camera measures depth. Default: structured_light; for a recording, as in the rig.",
        ),
    ] = None,
    scale: Annotated[float, Option(help="Metres per unit of a mesh file; 0.001 for millimetres.")] = 1.0,
    library: LibraryPlace = None,
    rig: RigPath = None,
) -> None:
    """Locate an object in depth images, without a guess of its pose, and recognise which of several objects it is.

    Only depth is used. The table and, in a recording, the robot's hand are removed; the remaining points vote for
    poses.

    * **One image or a folder of them**: PNGs of 16 bits, in millimetres or in the unit of `--depth-scale`, 0 where
      depth is unknown. Their camera is in `camera.json`: `{"fx": 615, "fy": 615, "cx": 320, "cy": 240, "width":
      640, "height": 480}` [pixels], with `"lens": [k1, k2, p1, p2, k3]` where the images are not rectified. In a
      folder, depth is in `depth/`, with colour under the same names in `rgb/` or `color/`; or all images are in the
      folder itself, with "depth" in their names.
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
    handsight locate depth.png --object mug --object mustard
    handsight locate depth.png --library lab/
    ```

    The last two recognise which object is in the image: one of the two, or one of all in the library.

    An answer has position [m] and quaternion_xyzw of the object in the camera's frame (x right, y down, z forward),
    covariance (6x6, position then rotation along the camera's axes), the probability that the pose is right, other
    hypotheses with weights, and seconds; or `"found": false` and the reason. With several objects it also has the
    probability of each (`scores`) and of `none` of them; the pose is that of the most probable one, and `"object"` is
    null if `none` is more probable. An image that cannot be read is answered with `{"error": ...}`, and the exit code
    is then 1; it is 2 if no image can be read, and 74 if answers cannot be written. After Ctrl-C, the answers until
    then are kept.
    """
    from handsight.checks import suggestion
    from handsight.objects.library import Library, NoLibrary
    from handsight.recording.bop import Hints
    from handsight.recording.frames import Beside, Frame, is_recording, open_frames, within
    from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT

    announce_compiling()
    for place, what in ((output, "the answers"), (plot, "the picture")):
        for source in (images, camera, color, mask, rig, detections, start, targets):
            check_not_overwritten(place, what, source, "what is read")
    check_not_overwritten(plot, "the picture", output, "the answers")
    terminal.check_plots(plot)
    csv, numbers, names = output is not None and output.suffix.lower() == ".csv", None, object or []
    beside = Beside(camera=camera, color=color, mask=mask, depth_scale=depth_scale)
    if is_recording(images):
        if csv:
            raise InvalidInput("--output: expected JSON lines of a recording, got BOP's .csv")
        if depth_camera is not None:
            raise InvalidInput(f"--depth-camera: expected beside depth images, got it beside {images}")
        for option, given in (("detections", detections), ("start", start), ("targets", targets)):
            if given is not None:
                raise InvalidInput(f"--{option}: expected beside depth images, got it beside {images}")
        robot, rig_path = find_rig(images, rig)
        models = find_models(names, robot, rig_path)
        noise = STRUCTURED_LIGHT if robot.camera is None else PRESETS[robot.camera.depth_camera]
        frames = open_frames(images, beside, robot)
    else:
        if rig is not None:
            raise InvalidInput(f"--rig: expected beside a recording, got it beside {images}")
        noise = STRUCTURED_LIGHT
        if depth_camera is not None:
            if depth_camera not in PRESETS:
                expected = f"expected one of {', '.join(PRESETS)}"
                hint = suggestion(depth_camera, PRESETS)
                raise InvalidInput(f"--depth-camera: {expected}, got {depth_camera!r:.80}{hint}")
            noise = PRESETS[cast("DepthCamera", depth_camera)]
        frames = open_frames(images, beside)
        library = library or (str(frames.library) if frames.library else None)
        models = find_models(names, library=library, scale=scale)
        if csv:  # BOP's results name objects by the library's numbers
            entries, opened = zip(models, names or models, strict=True), Library(library)
            numbers = {name: opened.entry(entry).number for name, entry in entries}
        if any((mask, detections, start, targets)):
            try:
                known = {entry.name: entry.number for entry in Library(library).entries()}
            except NoLibrary:
                known = {}
            asked = {name: known[name] for name in models if name in known}
            files = {"detections": detections, "start": start, "targets": targets}
            hints = Hints(list(models), asked, known.values(), **files)
            for sentence in hints.sentences:
                terminal.say(f"handsight: {sentence}")
            frames = frames._replace(
                total=None if targets else frames.total, each=hints.beside_each(frames.each)
            )
    if box is not None:
        try:
            left, top, right, bottom = (float(part) for part in box.split(","))
        except ValueError:
            expected = "expected 4 numbers u0,v0,u1,v1"
            raise InvalidInput(f"--box: {expected}, got {box!r:.60}") from None
        area = (left, top, right, bottom)
        each = (within(frame, area) if isinstance(frame, Frame) else frame for frame in frames.each)
        frames = frames._replace(each=each)
    if code := _locate_all(frames, models, noise, output, plot, numbers):
        raise typer.Exit(code)


def _locate_all(
    frames: "Frames",
    models: "Mapping[str, ObjectModel]",
    noise: "DepthNoise",
    output: Path | None,
    plot: Path | None,
    numbers: Mapping[str, int] | None,
) -> int:
    """Locates one of the objects in each image, and returns the command's exit code.

    The answers are written to a file or stdout, or shown as a table on a terminal; after Ctrl-C or an error, those
    until then. An error before the first answer is raised. `numbers`: BOP's numbers of the objects, by name, for BOP's
    results; None: the answers are lines of JSON.
    """
    from handsight.recording.bop import BOP_COLUMNS
    from handsight.recording.detections import bop_line, json_line
    from handsight.recording.frames import Unread

    done, found, locate_in, several = 0, 0, None, len(models) > 1
    # Messages about images that cannot be read, and about those without the object.
    unread, missed = list[str](), list[str]()
    panels, cells = list["Located"](), list[list[str]]()  # for the picture, and for the table
    as_table = output is None and sys.stdout.isatty()
    with (
        terminal.output_stream(output) as sink,
        terminal.kept_going() as end,
        terminal.bar("locating") as move,
    ):

        def write(line: str | None) -> None:
            """Writes the line of an answer at once; None: it has none."""
            if line is not None:
                with write_errors(stream_name(sink)):
                    sink.write(f"{line}\n")
                    sink.flush()

        if numbers is not None:
            write(BOP_COLUMNS)
        for frame in frames.each:
            row: Located | Unread
            if isinstance(frame, Unread):
                row = frame
                unread.append(f"handsight: {frame.reason}")
            else:
                locate_in = locate_in or locator(models, noise)
                row = locate_in(frame)
                found += row.reason is None
                if row.reason is not None:
                    missed.append(f"{frame.name}: not here: {row.reason}")
                if len(panels) < MOST_PANELS:
                    panels.append(row)
            done += 1  # after the search, which Ctrl-C may end
            if as_table:
                cells.append(_cells(row, several=several))
            else:
                write(json_line(row) if numbers is None else bop_line(row, numbers))
            move(done / frames.total if frames.total else None, f"{done} of {frames.total or '?'} images")
    if cells:
        which = ["object"] * several
        title = (f"{len(models)} objects" if several else next(iter(models))) + " in depth images"
        columns = ["image", *which, "x, y, z in the camera [mm]", "± [mm]", "± [°]", "explained"]
        columns += ["weight", "others", "ms"]
        terminal.print_out(terminal.table(columns, cells, texts=1 + several, title=title))
    if isinstance(end.error, HandsightError) and not done:
        raise end.error
    drawn = [draw(panels, plot)] if plot is not None and panels else []
    if more := unread[MAX_MESSAGES:]:
        unread[MAX_MESSAGES:] = [f"handsight: {len(more)} more images cannot be read"]
    wrote = [] if output is None else [f"wrote {output}: found in {found} of {done} images"]
    stopped = f"handsight: stopped after {done} images; what was found is kept"
    ended = [end.message or stopped] if end.exit_code else []
    for sentence in (*unread, *wrote, *missed[: MAX_MESSAGES if cells else 0], *ended, *drawn):
        terminal.say(sentence)
    if end.exit_code or not unread:
        return end.exit_code
    return terminal.FAILED if panels else terminal.WRONG_INPUT


def locator(models: "Mapping[str, ObjectModel]", noise: "DepthNoise") -> "Callable[[Frame], Located]":
    """Returns a function that locates the object in an image; if there are several, the most probable one.

    Everything that is compiled or computed once is done here, so that the seconds of an image do not contain it.
    """
    import numpy as np

    from handsight.camera import Camera
    from handsight.recording.detections import Located
    from handsight.vision import locate, recognise
    from handsight.vision.object.first_pose import first_pose
    from handsight.vision.object.locate import recognition_of
    from handsight.vision.object.region import scene_of

    first, matrix = next(iter(models.values())), np.array([[64, 0, 32], [0, 64, 24], [0, 0, 1.0]])
    camera = Camera(matrix, (64, 48))
    for model in models.values():
        in_front = model.vertices - model.center_object + [0, 0, min(2 * model.diameter, 5.0)]
        drawn = camera.draw(in_front, model.faces).depth
        first_pose(model, scene_of(camera, drawn, extent=model.diameter), noise=noise)

    def locate_in(frame: "Frame") -> "Located":
        """Returns the object's pose in an image, and how long the search took."""
        recognition, started = None, time.perf_counter()
        camera, depth, mask, hand = frame.camera, frame.depth, frame.wanted, frame.hand
        asked = models
        if frame.targets is not None:
            asked = {name: models[name] for name in frame.targets}
        if frame.detections is not None or frame.starts is not None:
            found_of = {name: _found_beside(frame, each, name, noise) for name, each in asked.items()}
            recognition = None if len(models) == 1 else recognition_of(found_of)
        elif len(models) == 1:
            found_of = {
                name: locate(first, depth, camera, mask=mask, hand=hand, noise=noise) for name in models
            }
        else:
            recognition = recognise(asked, depth, camera, mask=mask, hand=hand, noise=noise)
            found_of = recognition.found
        name = next(iter(recognition.scores)) if recognition else next(iter(found_of))
        model, found = models[name], found_of[name]
        seconds = time.perf_counter() - started
        return Located(frame=frame, model=model, found=found, seconds=seconds, recognition=recognition)

    return locate_in


def _found_beside(frame: "Frame", model: "ObjectModel", name: str, noise: "DepthNoise") -> "ObjectDetection":
    """Returns where an object is in an image, by what other programs say of it."""
    from handsight.observation import Detection2D
    from handsight.vision import locate_detected

    detections, start = frame.detections, (frame.starts or {}).get(name)
    anywhere = (Detection2D(),)
    mine = [each for each in (anywhere if detections is None else detections) if each.label in ("", name)]
    camera, mask, hand = frame.camera, frame.wanted, frame.hand
    return locate_detected(
        model, frame.depth, camera, detections=mine, mask=mask, start=start, hand=hand, noise=noise
    )


def draw(panels: "list[Located]", path: Path) -> str:
    """Draws images with the poses found in them to a file, and returns a sentence that names it."""
    from handsight.viewer.detection_figures import draw_located

    draw_located(panels, path)
    return f"wrote {path}"


def _cells(row: "Located | Unread", *, several: bool) -> list[str]:
    """Returns an answer as a row of the table; `several`: whether it has a column of the object."""
    from handsight.recording.frames import Unread

    if isinstance(row, Unread):
        return [row.name, *[""] * several, "cannot be read"]
    which = []
    if (answer := row.recognition) is not None:
        probability = answer.none if answer.name is None else answer.scores[answer.name]
        which = [f"{answer.name or 'none'}: {probability:.2f}"]
    milliseconds = f"{1e3 * row.seconds:.0f}"
    if row.reason is not None:
        return [row.frame.name, *which, "not here", *[""] * 5, milliseconds]
    T, covariance = row.found.Ts_camera_object[0], row.found.covariances[0]
    shift, turn = (math.sqrt(covariance.diagonal()[part].max()) for part in (slice(3), slice(3, 6)))
    place = ", ".join(f"{1e3 * x:.1f}" for x in T[:3, 3])
    sigmas = (f"{1e3 * shift:.1f}", f"{math.degrees(turn):.1f}")
    weights = (f"{row.found.weights[0]:.2f}", str(len(row.found.weights) - 1))
    return [row.frame.name, *which, place, *sigmas, f"{row.explained:.0%}", *weights, milliseconds]
