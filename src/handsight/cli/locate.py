"""`handsight locate`: where an object is in depth images, without a guess."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from handsight.cli.locate_images import MOST_PANELS, Targets, draw, locate_all
from handsight.cli.options import DEPTH_CAMERAS, LibraryPlace, RigPath, find_models, find_rig
from handsight.cli.terminal import announce_compiling, check_plots, say
from handsight.errors import InvalidInput
from handsight.files import check_not_overwritten

if TYPE_CHECKING:
    from handsight.rig import DepthCamera


def locate(
    images: Annotated[
        Path,
        typer.Argument(
            help="A depth image (PNG of 16 bits), a folder of them, a BOP scene or split, or a recording.",
            show_default=False,
        ),
    ],
    object: Annotated[
        list[str] | None,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="Name of an object of the library or, for a recording, of its rig; or a mesh file. Given several "
            "times: recognise which of these is in the image. Not given: which of all in the rig or the library.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File for the answers: a line of JSON for each image, or BOP results if its name ends in .csv. "
            "Default: stdout.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help=f"File for a picture of the poses in the first {MOST_PANELS} images: PNG, PDF or SVG by its name."
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="File of the camera's intrinsics, as above. Default: camera.json beside the images."
        ),
    ] = None,
    color: Annotated[
        Path | None, typer.Option(help="Colour image with the pixels of the depth image, for the picture.")
    ] = None,
    depth_scale: Annotated[
        float, typer.Option(help="Metres per step of depth; 0.001 for millimetres.")
    ] = 0.001,
    box: Annotated[
        str | None,
        typer.Option(metavar="U0,V0,U1,V1", help="Search between these columns and rows only [pixels]."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            help="Search only where this image is not 0; or a folder of such images with the names of the depth images."
        ),
    ] = None,
    depth_camera: Annotated[
        str | None,
        typer.Option(
            metavar=DEPTH_CAMERAS,
            help="How the camera measures depth. Default: structured_light; for a recording, as in the rig.",
        ),
    ] = None,
    scale: Annotated[
        float, typer.Option(help="Metres per unit of a mesh file; 0.001 for millimetres.")
    ] = 1.0,
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
    from handsight.objects import Library
    from handsight.recording.frames import Beside, Frame, within
    from handsight.recording.open_frames import is_recording, open_frames
    from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT

    announce_compiling()
    for place, what in ((output, "the answers"), (plot, "the picture")):
        for source in (images, camera, color, mask, rig):
            check_not_overwritten(place, what, source, "what is read")
    check_not_overwritten(plot, "the picture", output, "the answers")
    check_plots(plot)
    csv, numbers, names = output is not None and output.suffix.lower() == ".csv", None, object or []
    beside = Beside(camera=camera, color=color, mask=mask, depth_scale=depth_scale)
    if is_recording(images):
        if csv:
            raise InvalidInput("--output: expected JSON lines of a recording, got BOP's .csv")
        if depth_camera is not None:
            raise InvalidInput(f"--depth-camera: expected beside depth images, got it beside {images}")
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
    if box is not None:
        try:
            left, top, right, bottom = (int(part) for part in box.split(","))
        except ValueError:
            expected = "expected 4 whole numbers u0,v0,u1,v1"
            raise InvalidInput(f"--box: {expected}, got {box!r:.60}") from None
        area = (left, top, right, bottom)
        each = (within(frame, area) if isinstance(frame, Frame) else frame for frame in frames.each)
        frames = frames._replace(each=each)
    result = locate_all(frames, Targets(models, noise, numbers), output)
    if plot is not None and result.panels:
        result.messages.append(draw(result.panels, plot))
    for sentence in result.sentences(output):
        say(sentence)
    if result.exit_code:
        raise typer.Exit(result.exit_code)
