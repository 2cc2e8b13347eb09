"""`handsight track`: what is shown of a recording meanwhile, what is written, what is said at the end."""

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.options import ObjectName, Recorded, RigFile, rig_and_object
from handsight.cli.terminal import FAILED, End, announce_compiling, kept_going, live_rows, say
from handsight.errors import HandsightError, MissingExtra, printable
from handsight.files import written

if TYPE_CHECKING:
    from handsight.evaluation import TrackErrors, Truths
    from handsight.objects import ObjectModel
    from handsight.rig import Rig
    from handsight.tracking import Tracker, TrackerSettings
    from handsight.tracking.replay import Step, Tally

    Watch = Callable[[Tally, Step, Tracker], None]

MOST_REFUSED = 5
"""Kinds of wrong observations that are told each."""


def track(
    recording: Recorded,
    rig: RigFile = None,
    object: ObjectName = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for results; default: RECORDING-track, here."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(min=0.1, help="Corrections a second; default: when something changed.")
    ] = None,
    answer: Annotated[
        str, typer.Option(help="best (the mean where the maximum is at a slide's end), maximum, or mean.")
    ] = "best",
    samples: Annotated[
        int,
        typer.Option(min=0, help="Answer with the mean of so many posterior samples instead: a slow check."),
    ] = 0,
    outside: Annotated[
        int,
        typer.Option(
            min=0,
            help="How many points of the hand's links, none of which can be inside the object; 0: none.",
        ),
    ] = 200,
) -> None:
    """Track an object in the hand through a recording.

    Joint states, one wrench topic for each finger and, where there is one, a camera's pose of the object go in, under
    the topics that the rig names; the object's pose in the palm comes out, for each joint state.

    Written to the folder: `track.mcap` (PoseWithCovarianceStamped), `track.tum`, `track.csv`, `summary.json`, and
    `track.png` where matplotlib is installed.

    ```
    handsight simulate can --output can.mcap
    handsight track can.mcap
    handsight track grasp.bag --rig robot.yaml --object mustard.ply --rate 100 --output results
    ```

    Whatever ends it early, what was tracked by then is written. The exit code is 0 only if nothing did, and there is a
    pose.
    """
    from handsight.tracking import TrackerSettings

    announce_compiling()
    settings = TrackerSettings(rate=rate, answer=answer, samples=samples, outside=outside)
    found, model = rig_and_object(recording, rig, object)
    folder = output or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    with live_rows(recording.name, progress) as watch:
        ended = run(recording, found, model, settings, watch)
    wrote = list[str]()
    try:
        # Before anything is said: Ctrl-C while a terminal is being written to must not cost the results.
        wrote.extend(write(ended, found, model, folder))
    finally:
        for sentence in (*ended.said, *ended.sentences(), *wrote):
            say(sentence)
    if code := ended.exit_code:
        raise typer.Exit(code)


@dataclass(slots=True)
class Run:
    """A recording's way through a tracker."""

    name: str
    tally: "Tally"
    truths: "Truths"
    steps: "list[Step]" = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    """What the recording has to say of itself."""
    corrections: int = 0
    reason: str = ""
    """Why the tracker's last state was no better."""
    errors: "dict[str, TrackErrors]" = field(default_factory=dict)
    """Of "vision" and "tracked" against the truth, where the recording has one."""
    untouched: dict[str, dict[str, int]] = field(default_factory=dict)
    """By finger that never touched anything: its observations, by why there was no contact."""
    margins: dict[str, float] = field(default_factory=dict)
    """By link of the hand that is smaller than its shape: by how much [m]."""
    ends: list[End] = field(default_factory=list)
    """Of what ended early."""

    @property
    def exit_code(self) -> int:
        """Of the command: that of what ended first, or of a run without a pose."""
        return next((end.exit_code for end in self.ends), 0 if self.steps else FAILED)

    @contextlib.contextmanager
    def part(self) -> Iterator[End]:
        """A part of the run, which may end early."""
        with kept_going() as end:
            yield end
        if end.exit_code:
            self.ends.append(end)

    def summary(self) -> dict[str, Any]:
        """The run in numbers, as JSON's values."""
        tally = self.tally
        return {
            "recording": self.name,
            "observations": tally.observations,
            "poses": tally.answered,
            "corrections": self.corrections,
            "seconds_recorded": tally.recorded,
            "seconds_taken": tally.wall,
            "real_time_factor": tally.recorded / tally.wall if tally.wall else None,
            "seconds_in_state": {state: round(seconds, 3) for state, seconds in tally.states.items()},
            "last_reason": self.reason,
            "refused": dict(tally.refused),
            "fingers_without_contact": self.untouched,
            "link_margins_mm": {link: round(1e3 * margin, 1) for link, margin in self.margins.items()},
            "recording_says": self.said,
            "errors_mm_deg": {name: errors.summary() for name, errors in self.errors.items()},
        }

    def write_summary(self, path: Path, _: object) -> None:
        """Writes the summary as JSON."""
        text = json.dumps(self.summary(), indent=1, ensure_ascii=False, allow_nan=False)
        with written(path):
            path.write_text(text + "\n", encoding="utf-8")

    def sentences(self) -> list[str]:
        """The run for a person."""
        tally = self.tally
        factor = f"{tally.recorded / tally.wall:.0f}x real time" if tally.wall else "nothing to time"
        lines = [
            f"{tally.answered} poses of {tally.observations} observations, {self.corrections} corrections; "
            f"{tally.recorded:.1f} s in {tally.wall:.1f} s ({factor})"
        ]
        if not tally.answered:
            lines.append(f"no pose: {self.reason}")
        spent = ", ".join(
            f"{state} {seconds:.1f} s" for state, seconds in sorted(tally.states.items(), key=lambda s: -s[1])
        )
        if spent:
            lines.append(spent + (f"; at the end: {self.reason}" if self.reason else ""))
        lines += refusals(tally)
        for finger, why in self.untouched.items():
            reasons = ", ".join(f"{reason} in {count}" for reason, count in why.items())
            lines.append(f"finger {finger}: no contact in any observation ({reasons or 'none was taken'})")
        if self.margins:
            lines.append(larger_shapes(self.margins))
        lines += [end.said for end in self.ends if end.said]
        for name, errors in self.errors.items():
            n = errors.summary()
            lines.append(
                f"{name}: base centre off by {n['base_mean']:.1f} mm on average ({n['base_last']:.1f} at the end), "
                f"middle {n['middle_mean']:.1f} mm, rotation {n['rotation_mean']:.1f}°"
            )
        return lines


def larger_shapes(margins: dict[str, float]) -> str:
    """A sentence of the links whose shapes would be inside the object."""
    by = ", ".join(f"{link} by {1e3 * margin:.1f} mm" for link, margin in margins.items())
    return f"shapes of the hand's file larger than the hand, inside the object though contacts fit: {by}; taken off"


def refusals(tally: "Tally") -> list[str]:
    """A sentence for each of the most frequent kinds of observations that were left out."""
    return [
        f"{count} observations left out: {said}" for said, count in tally.refused.most_common(MOST_REFUSED)
    ]


def progress(tally: "Tally", step: "Step", tracker: "Tracker") -> list[tuple[str, str]]:
    """How a run goes, as names and values."""
    position = 1e3 * step.estimate.T_palm_object[:3, 3]
    rate = tally.answered / max(tally.recorded, 1e-9)
    return [
        ("state", step.state + (f": {step.reason}" if step.reason else "")),
        ("time", f"{tally.recorded:.1f} s, {tally.recorded / max(tally.wall, 1e-9):.1f}x real time"),
        ("rate", f"{rate:.0f} poses/s, {tracker.corrections} corrections"),
        ("position", "x {:.1f}, y {:.1f}, z {:.1f} mm in the palm".format(*position)),
        ("σ", f"{1e3 * step.sigma:.1f} mm"),
        ("touching", ", ".join(step.fingers) or "nothing"),
    ]


def run(path: Path, rig: "Rig", model: "ObjectModel", settings: "TrackerSettings", watch: "Watch") -> Run:
    """Tracks a recording. Whatever ends it early, Ctrl-C too, what was tracked by then is there.

    Raises what the recording is refused for, if nothing was tracked.
    """
    from handsight.evaluation import Truths, track_errors
    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Tally, replay

    tracker = Tracker(rig, model, settings=settings)
    with open_recording(path, rig) as recording:
        ended = Run(printable(path.name), Tally(), Truths([]))
        with ended.part() as end:
            for step in replay(recording.observations(), tracker, ended.tally):
                ended.steps.append(step)
                watch(ended.tally, step, tracker)
        # It may end between an answer's count and the answer.
        ended.tally.answered = len(ended.steps)
        if isinstance(end.error, HandsightError) and not ended.steps:
            raise end.error
        ended.said = [*recording.report.sentences(), *recording.lacks()]
        ended.truths = Truths(recording.truth)
    ended.corrections, ended.margins = tracker.corrections, tracker.link_margins
    ended.reason = tracker.reason if ended.steps else without_pose(ended.tally, tracker)
    without, touched = ended.tally.without, ended.tally.touched
    ended.untouched = {name: dict(without.get(name, {})) for name in rig.fingers if name not in touched}
    with ended.part():
        for name, vision in (("vision", True), ("tracked", False)):
            found = track_errors(model, ended.steps, ended.truths, vision=vision)
            if len(found):
                ended.errors[name] = found
    return ended


def without_pose(tally: "Tally", tracker: "Tracker") -> str:
    """Why a run has no pose."""
    if not tally.observations:
        return "the recording has no observation"
    if tally.refused.total() == tally.observations:
        return "all observations were left out"
    if unplaced := tracker.vision.unplaced:
        return (
            f"{unplaced} poses of vision could not be placed, as the palm's pose in the world was not known"
        )
    return tracker.reason


def write(ended: Run, rig: "Rig", model: "ObjectModel", folder: Path) -> Iterator[str]:
    """Writes the results into a folder, and says what was written, and why anything was not."""
    from handsight.recording import TrackRow, write_track_csv, write_track_mcap, write_track_tum

    with written(folder):
        folder.mkdir(parents=True, exist_ok=True)
    rows = [
        TrackRow(step.stamp, step.estimate.T_palm_object, step.estimate.covariance, step.state, step.reason)
        for step in ended.steps
    ]
    files: dict[str, Callable[..., None]] = {
        "track.mcap": partial(write_track_mcap, frame=rig.frames["palm"]),
        "track.tum": write_track_tum,
        "track.csv": write_track_csv,
        "summary.json": ended.write_summary,
    }
    done = []
    for name, write_file in files.items():
        with ended.part() as end:
            write_file(folder / name, rows)
            done.append(name)
        if end.said:
            yield end.said
    yield f"wrote {folder}: {', '.join(done)}"
    if not rows:
        yield "no picture: there is no pose"
        return
    drawn = ""
    with ended.part() as end:
        drawn = draw(ended, model, folder / "track.png")
    if drawn or end.said:
        yield drawn or end.said


def draw(ended: Run, model: "ObjectModel", path: Path) -> str:
    """Draws a run, and says what was written, or why not."""
    try:
        from handsight.viewer.track import draw_track

        draw_track(ended.name, model, ended.steps, ended.truths, path)
    except MissingExtra as error:
        return f"no picture: {error}"
    return f"wrote {path}"
