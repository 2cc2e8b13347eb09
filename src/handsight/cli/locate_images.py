"""The loop of `handsight locate` over images: locate an object in each, write the answer, or show a table."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from handsight.cli.terminal import FAILED, WRONG_INPUT, bar, kept_going, output_stream, print_out, table
from handsight.errors import HandsightError
from handsight.files import stream_name, write_errors

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording.detections import Located
    from handsight.recording.frames import Frame, Frames, Unread
    from handsight.vision import DepthNoise

MOST_PANELS = 6
"""Number of images in the picture."""
MAX_MESSAGES = 5
"""Number of messages about unreadable images, and about images without the object."""


class Targets(NamedTuple):
    """`Targets` are the objects to locate, and the noise of the camera."""

    models: "Mapping[str, ObjectModel]"
    """By name; if there are several, the answer says which one an image shows."""
    noise: "DepthNoise"
    numbers: Mapping[str, int] | None = None
    """BOP's numbers of the objects, by name, for BOP's results; None: the answers are lines of JSON."""


@dataclass(slots=True)
class LocateResult:
    """A `LocateResult` has the counts and messages after locating an object in many images."""

    done: int = 0
    found: int = 0
    unread: list[str] = field(default_factory=list)
    """Messages about images that cannot be read."""
    panels: "list[Located]" = field(default_factory=list)
    """The first answers, for the picture."""
    messages: list[str] = field(default_factory=list)
    """Other sentences to print."""
    exit_code: int = 0
    """The command's exit code: that of the Ctrl-C or the error that ended it early; else 1 where some images could not
    be read, 2 where none could."""

    def sentences(self, output: Path | None) -> Iterator[str]:
        """Yields the result for a person."""
        for message in self.unread[:MAX_MESSAGES]:
            yield f"handsight: {message}"
        if len(self.unread) > MAX_MESSAGES:
            yield f"handsight: {len(self.unread) - MAX_MESSAGES} more images cannot be read"
        if output is not None:
            yield f"wrote {output}: found in {self.found} of {self.done} images"
        yield from self.messages


def locate_all(frames: "Frames", targets: Targets, output: Path | None) -> LocateResult:
    """Locates an object in each image, and writes the answers to a file or stdout; on a terminal, as a table.

    After Ctrl-C or an error it returns the answers until then; an error before the first answer is raised.
    """
    from handsight.recording.detections import BOP_COLUMNS, bop_line, json_line
    from handsight.recording.frames import Unread

    result, locate_in, several = LocateResult(), None, len(targets.models) > 1
    as_table, missed = output is None and sys.stdout.isatty(), list[str]()
    cells = list[list[str]]()  # the rows of the table; images would be too large to keep
    with output_stream(output) as sink, kept_going() as end, bar("locating") as move:

        def write(line: str | None) -> None:
            """Writes the line of an answer at once; None: it has none."""
            if line is not None:
                with write_errors(stream_name(sink)):
                    sink.write(f"{line}\n")
                    sink.flush()

        if targets.numbers is not None:
            write(BOP_COLUMNS)
        for frame in frames.each:
            row: Located | Unread
            if isinstance(frame, Unread):
                row = frame
                result.unread.append(row.reason)
            else:
                locate_in = locate_in or locator(targets)
                row = locate_in(frame)
                result.found += row.reason is None
                if row.reason is not None:
                    missed.append(f"{row.frame.name}: not here: {row.reason}")
                if len(result.panels) < MOST_PANELS:
                    result.panels.append(row)
            result.done += 1  # after the search, which Ctrl-C may end
            if as_table:
                cells.append(_cells(row, several=several))
            else:
                write(json_line(row) if targets.numbers is None else bop_line(row, targets.numbers))
            total = frames.total
            move(result.done / total if total else None, f"{result.done} of {total or '?'} images")
    if cells:
        which = ["object"] * several
        title = f"{len(targets.models)} objects" if several else next(iter(targets.models))
        numbers = ["± [mm]", "± [°]", "explained", "weight", "others", "ms"]
        columns = ["image", *which, "x, y, z in the camera [mm]", *numbers]
        print_out(table(columns, cells, texts=1 + several, title=f"{title} in depth images"))
        result.messages += missed[:MAX_MESSAGES]
    if isinstance(end.error, HandsightError) and not result.done:
        raise end.error
    if result.unread:
        result.exit_code = WRONG_INPUT if len(result.unread) == result.done else FAILED
    if end.exit_code:
        result.exit_code = end.exit_code
        stopped = f"handsight: stopped after {result.done} images; what was found is kept"
        result.messages.append(end.message or stopped)
    return result


def locator(targets: Targets) -> "Callable[[Frame], Located]":
    """Returns a function that locates the object in an image; if there are several, the most probable one.

    Everything that is compiled or computed once is done here, so that the seconds of an image do not contain it.
    """
    from handsight.recording.detections import Located
    from handsight.tracking.warm import find_object
    from handsight.vision import locate, recognise
    from handsight.vision.object.appearance import appearance_of

    models = targets.models
    first = next(iter(models.values()))
    find_object()
    for model in models.values():
        appearance_of(model)

    def locate_in(frame: "Frame") -> "Located":
        """Returns the object's pose in an image, and how long the search took."""
        model, recognition, started = first, None, time.perf_counter()
        camera, depth, wanted, hand = frame.camera, frame.depth, frame.wanted, frame.hand
        if len(models) == 1:
            found = locate(first, camera, depth, wanted=wanted, hand=hand, noise=targets.noise)
        else:
            recognition = recognise(models, camera, depth, wanted=wanted, hand=hand, noise=targets.noise)
            name = next(iter(recognition.scores))
            model, found = models[name], recognition.found[name]
        seconds = time.perf_counter() - started
        return Located(frame=frame, model=model, found=found, seconds=seconds, recognition=recognition)

    return locate_in


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
