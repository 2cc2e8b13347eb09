"""`handsight locate`: where an object is in depth images, without a guess."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from handsight.cli.locate_images import MOST_PANELS, Sought, draw, run
from handsight.cli.options import (
    DEPTH_CAMERAS,
    RigFile,
    by_name,
    library_objects,
    object_named,
    rig_and_objects,
)
from handsight.cli.terminal import announce_compiling, say
from handsight.errors import InvalidInput
from handsight.files import check_not_overwritten

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording.frames import Beside, Frames
    from handsight.vision import DepthNoise


def locate(
    pictures: Annotated[
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
            help="A name of the library, of a recording also of its rig, or a mesh file. Told several times: which of "
            "them it is; not told: which of all that the library, or the rig, has.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A line of JSON for each picture; named .csv: BOP's results. Default: stdout.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help=f"Draw the poses over the first {MOST_PANELS} pictures: PNG, PDF or SVG by its name."
        ),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="Intrinsics, JSON as below; default: camera.json beside the images.")
    ] = None,
    color: Annotated[
        Path | None, typer.Option(help="Colour of one depth image, of the same pixels, to draw on.")
    ] = None,
    depth_scale: Annotated[float, typer.Option(help="Metres of a step of depth.")] = 0.001,
    box: Annotated[
        str | None,
        typer.Option(metavar="U0,V0,U1,V1", help="Look between these columns and rows only [pixels]."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            help="Look where this image is not 0 only; or a folder of such, named as the depth images."
        ),
    ] = None,
    depth_camera: Annotated[
        str | None,
        typer.Option(
            metavar=DEPTH_CAMERAS,
            help="How it measures depth; default: structured_light, of a recording as the rig has it.",
        ),
    ] = None,
    scale: Annotated[float, typer.Option(help="Metres per unit of a mesh file.")] = 1.0,
    library: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|URL",
            help="Of objects; default: the BOP data set's own, else HANDSIGHT_LIBRARY, else the user's.",
        ),
    ] = None,
    rig: RigFile = None,
) -> None:
    """Locate an object in depth images, and say which of several it is, without a guess of where it is.

    Depth alone is used: table and, in a recording, the robot's hand are taken away, and what is left votes.

    * **One image or a folder of them**: PNGs of 16 bits, in millimetres or as `--depth-scale` says, 0 where there is
      no depth. Their camera is `camera.json`:
      `{"fx": 615, "fy": 615, "cx": 320, "cy": 240, "width": 640, "height": 480}`, with `"lens": [k1, k2, p1, p2, k3]`
      where the images are not rectified. In a folder depth is in `depth/`, with colour in `rgb/` or `color/` under
      the same names; or the images lie side by side with "depth" in their names.
    * **A BOP scene** (`scene_camera.json`, `depth/000000.png`, `rgb/`), or a split with scenes in it.
    * **A recording** with depth images, as `handsight track` reads it: the rig names the topics, and its hand is
      masked where it is seen, else where joints and camera say that it is.

    ```
    handsight locate depth.png --camera d435.json --object mustard --plot found.png
    handsight locate frames/ --object mustard.ply --box 200,120,420,400 -o poses.jsonl
    handsight locate ycbv/test/000048 --object 5 -o handsight_ycbv-test.csv
    handsight locate can.mcap --plot found.png
    handsight locate depth.png --object mug --object mustard
    handsight locate depth.png --library lab/
    ```

    The last two ask which object is there: of those named, of all that the library has.

    A line for each picture: position [m] and quaternion_xyzw of the object in the camera (x right, y down, z forward),
    covariance (6x6, position then rotation along the camera's axes), the probability that this is right, other
    hypotheses with weights, seconds; or `"found": false` and why: that is an answer. Of several objects also the
    probability of each (`scores`) and of `none` of them; the pose is the likeliest's, `"object": null` where none is
    likelier. A picture that cannot be read is answered `{"error": ...}`; the exit
    code is then 1; it is 2 where nothing can be read, 74 where answers cannot be written. Ctrl-C keeps what was found.
    """
    from handsight.recording.frames import Beside

    announce_compiling()
    beside = Beside(camera=camera, color=color, mask=mask, depth_scale=depth_scale)
    for place, what in ((output, "the answers"), (plot, "the picture")):
        for source in (pictures, camera, color, mask, rig):
            check_not_overwritten(place, what, source, "what is read")
    check_not_overwritten(plot, "the picture", output, "the answers")
    if plot is not None:
        from handsight.viewer.correction_figures import require_matplotlib

        require_matplotlib()
    asked = Asked(object or [], rig, library, scale, depth_camera)
    frames, sought = _opened(pictures, beside, asked, csv=_is_csv(output))
    if box is not None:
        frames = _boxed(frames, box)
    ended = run(frames, sought, output)
    if plot is not None and ended.panels:
        ended.messages.append(draw(ended.panels, plot))
    for sentence in ended.sentences(output):
        say(sentence)
    if ended.exit_code:
        raise typer.Exit(ended.exit_code)


class Asked(NamedTuple):
    """An `Asked` is what is looked for, and in what kind of depth, as it was told."""

    names: list[str]
    rig: Path | None
    library: str | None
    scale: float
    depth_camera: str | None


def _opened(path: Path, beside: "Beside", asked: Asked, *, csv: bool) -> "tuple[Frames, Sought]":
    """Returns the pictures, and what is looked for in them."""
    from handsight.recording.open_frames import is_recording, open_frames

    if is_recording(path):
        if csv:
            raise InvalidInput("--output: expected JSON lines of a recording, got BOP's .csv")
        if asked.depth_camera is not None:
            raise InvalidInput(f"--depth-camera: expected beside depth images, got it beside {path}")
        found, models = rig_and_objects(path, asked.rig, asked.names)
        noise = _noise(None if found.camera is None else found.camera.depth_camera)
        return open_frames(path, beside, found), Sought(models, noise)
    if asked.rig is not None:
        raise InvalidInput(f"--rig: expected beside a recording, got it beside {path}")
    noise = _noise(asked.depth_camera)
    frames = open_frames(path, beside)
    place = asked.library or (str(frames.library) if frames.library else None)
    models = _models(asked, place)
    return frames, Sought(models, noise, _numbers(asked, models, place) if csv else None)


def _models(asked: Asked, library: str | None) -> "dict[str, ObjectModel]":
    """Returns those named, else all of the library."""
    if not asked.names:
        return library_objects(library)
    return by_name(object_named(name, library=library, scale=asked.scale) for name in asked.names)


def _numbers(asked: Asked, models: "dict[str, ObjectModel]", library: str | None) -> dict[str, int]:
    """BOP's results say objects by number, which is a library's."""
    from handsight.objects import Library

    opened = Library(library)
    declared = zip(models, asked.names or models, strict=True)
    return {name: opened.entry(name_of).number for name, name_of in declared}


def _noise(kind: str | None) -> "DepthNoise":
    """Returns the depth noise of a kind of camera, without one of structured light; raises InvalidInput for others."""
    from handsight.checks import suggestion
    from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT

    for known, noise in PRESETS.items():
        if kind == known:
            return noise
    if kind is None:
        return STRUCTURED_LIGHT
    expected = f"expected one of {', '.join(PRESETS)}"
    raise InvalidInput(f"--depth-camera: {expected}, got {kind!r:.80}{suggestion(kind, PRESETS)}")


def _is_csv(output: Path | None) -> bool:
    return output is not None and output.suffix.lower() == ".csv"


def _boxed(frames: "Frames", text: str) -> "Frames":
    """Returns the same, the object looked for in a box only; raises InvalidInput, of another size than a picture's
    later."""
    from handsight.recording.frames import Frame, within

    try:
        left, top, right, bottom = (int(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(f"--box: expected 4 whole numbers u0,v0,u1,v1, got {text!r:.60}") from None
    each = (
        within(frame, (left, top, right, bottom)) if isinstance(frame, Frame) else frame
        for frame in frames.each
    )
    return frames._replace(each=each)
