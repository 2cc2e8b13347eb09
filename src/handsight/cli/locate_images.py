"""What `handsight locate` does with each picture: the object is looked for, the answer written, and shown."""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

from handsight.cli.terminal import FAILED, WRONG_INPUT, bar, kept_going, table, writing
from handsight.errors import HandsightError, printable
from handsight.files import stream_name, write_errors

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.recording.detections import Located
    from handsight.recording.frames import Frame, Frames, Unread
    from handsight.vision import DepthNoise
    from handsight.vision.object.recognition import Recognition

MOST_PANELS = 6
"""Pictures that a figure has room for."""
MAX_MESSAGES = 5
"""Pictures that cannot be read, or have no such object in them, that are told each."""
COLUMNS = ("picture", "x, y, z in the camera [mm]", "± [mm]", "± [°]", "explained", "weight", "others", "ms")


class Sought(NamedTuple):
    """A `Sought` is what is looked for in pictures."""

    models: "Mapping[str, ObjectModel]"
    """By name; of several it is said which a picture shows."""
    noise: "DepthNoise"
    """Of the depth."""
    numbers: Mapping[str, int] | None = None
    """BOP's by name, for its results; None: the answers are lines of JSON."""


@dataclass(slots=True)
class Run:
    """The way through pictures."""

    done: int = 0
    found: int = 0
    unread: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    """Where the object is not, and why."""
    panels: "list[Located]" = field(default_factory=list)
    """The first ones, for a figure."""
    cells: list[list[str]] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    """What is to be told beside."""
    ended: int = 0
    """Exit code of what ended it early."""

    @property
    def exit_code(self) -> int:
        """Of the command: 1 where some pictures could not be read, 2 where none could."""
        if self.ended or not self.unread:
            return self.ended
        return WRONG_INPUT if len(self.unread) == self.done else FAILED

    def take(self, row: "Located | Unread") -> None:
        """Counts a picture and keeps what is shown of it."""
        from handsight.recording.frames import Unread

        self.done += 1
        if isinstance(row, Unread):
            self.unread.append(row.reason)
            return
        self.found += row.reason is None
        if row.reason is not None:
            self.missed.append(f"{row.frame.name}: not here: {row.reason}")
        if len(self.panels) < MOST_PANELS:
            self.panels.append(row)

    def sentences(self, output: Path | None) -> Iterator[str]:
        """Yields the run for a person."""
        for messages in self.unread[:MAX_MESSAGES]:
            yield f"handsight: {messages}"
        if len(self.unread) > MAX_MESSAGES:
            yield f"handsight: {len(self.unread) - MAX_MESSAGES} more pictures cannot be read"
        if output is not None:
            yield f"wrote {output}: found in {self.found} of {self.done} pictures"
        yield from self.messages


def run(frames: "Frames", sought: Sought, output: Path | None) -> Run:
    """Looks for what is sought in each picture and writes the answers: JSON lines, or for `numbers` BOP's results.

    On a terminal a table is shown in place of JSON. Whatever ends it early, what was found by then is written.
    """
    ended = Run()
    shown = output is None and sys.stdout.isatty()
    place = contextlib.nullcontext(sys.stdout) if output is None or str(output) == "-" else writing(output)
    with place as sink, kept_going() as end, bar("locating") as move:
        if sought.numbers is not None:
            from handsight.recording.detections import BOP_COLUMNS

            _write(sink, BOP_COLUMNS)
        for row in _rows(frames, sought):
            ended.take(row)
            if shown:
                ended.cells.append(_cells(row, several=len(sought.models) > 1))
            else:
                _write(sink, _line(row, sought.numbers))
            total = frames.total
            move(ended.done / total if total else None, f"{ended.done} of {total or '?'} pictures")
    if shown and ended.cells:
        _show(ended.cells, list(sought.models))
        ended.messages += ended.missed[:MAX_MESSAGES]
    ended.ended = end.exit_code
    if isinstance(end.error, HandsightError) and not ended.done:
        raise end.error
    if end.exit_code:
        ended.messages.append(
            end.message or f"handsight: stopped after {ended.done} pictures; what was found is kept"
        )
    return ended


def warmed(sought: Sought) -> "Callable[[Frame], Located]":
    """Returns a call that looks for it in a picture; what is compiled or worked out once is no picture's time."""
    from handsight.recording.detections import Located
    from handsight.tracking.warm import find_object
    from handsight.vision import locate, recognise
    from handsight.vision.object.appearance import appearance_of

    models = sought.models
    first = next(iter(models.values()))
    find_object()
    for model in models.values():
        appearance_of(model)

    def locate_in(frame: "Frame") -> "Located":
        """Of several the likeliest."""
        camera, depth, wanted, hand = frame.camera, frame.depth, frame.wanted, frame.hand
        began = time.perf_counter()
        if len(models) == 1:
            found = locate(first, camera, depth, wanted=wanted, hand=hand, noise=sought.noise)
            return Located(frame=frame, model=first, found=found, seconds=time.perf_counter() - began)
        answer = recognise(models, camera, depth, wanted=wanted, hand=hand, noise=sought.noise)
        seconds, name = time.perf_counter() - began, next(iter(answer.scores))
        found = answer.found[name]
        return Located(frame=frame, model=models[name], found=found, seconds=seconds, recognition=answer)

    return locate_in


def draw(panels: "list[Located]", path: Path) -> str:
    """Draws pictures and what was found in them, and says that it did."""
    from handsight.viewer.detection_figures import draw_located

    draw_located(panels, path)
    return f"wrote {path}"


def _rows(frames: "Frames", sought: Sought) -> "Iterator[Located | Unread]":
    """Yields an answer for each picture."""
    from handsight.recording.frames import Unread

    locate_in = None
    for frame in frames.each:
        if isinstance(frame, Unread):
            yield frame
            continue
        locate_in = locate_in or warmed(sought)
        yield locate_in(frame)


def _line(row: "Located | Unread", numbers: Mapping[str, int] | None) -> str | None:
    from handsight.recording.detections import bop_line, json_line

    return json_line(row) if numbers is None else bop_line(row, numbers)


def _write(sink: IO[str], line: str | None) -> None:
    if line is not None:
        with write_errors(stream_name(sink)):
            sink.write(f"{line}\n")
            sink.flush()


def _cells(row: "Located | Unread", *, several: bool) -> list[str]:
    """Returns a picture's line of the table, of several objects with which it is."""
    from handsight.recording.frames import Unread

    if isinstance(row, Unread):
        return [row.name, *[""] * several, "cannot be read"]
    took = f"{1e3 * row.seconds:.0f}"
    which = [] if row.recognition is None else [_which(row.recognition)]
    if row.reason is not None:
        return [row.frame.name, *which, "not here", *[""] * 5, took]
    T, covariance = row.found.Ts_camera_object[0], row.found.covariances[0]
    shift, turn = (math.sqrt(covariance.diagonal()[part].max()) for part in (slice(3), slice(3, 6)))
    place = ", ".join(f"{1e3 * x:.1f}" for x in T[:3, 3])
    sizes = (f"{1e3 * shift:.1f}", f"{math.degrees(turn):.1f}", f"{row.explained:.0%}")
    others = len(row.found.weights) - 1
    return [row.frame.name, *which, place, *sizes, f"{row.found.weights[0]:.2f}", str(others), took]


def _which(answer: "Recognition") -> str:
    """Returns the likeliest, with its probability."""
    if answer.name is None:
        return f"none: {answer.none:.2f}"
    return f"{answer.name}: {answer.scores[answer.name]:.2f}"


def _show(cells: list[list[str]], names: list[str]) -> None:
    from rich.console import Console

    several = len(names) > 1
    columns = (COLUMNS[0], "object", *COLUMNS[1:]) if several else COLUMNS
    title = f"{len(names)} objects" if several else names[0]

    rows = [[printable(cell) for cell in row] for row in cells]
    table_of = table(columns, rows, texts=1 + several, title=f"{title} in depth images")
    Console(markup=False, highlight=False).print(table_of)
