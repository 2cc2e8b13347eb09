"""`handsight track`: what is shown of a recording meanwhile, what is written, what is said at the end."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handsight.cli.options import (
    ObjectName,
    Recorded,
    RigFile,
    renamed,
    rig_and_object,
    with_intrinsics,
    with_settings,
)
from handsight.cli.terminal import announce_compiling, live_rows, say
from handsight.cli.track_summary import Run, weight_text
from handsight.errors import HandsightError, MissingExtra, printable
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.forces import Slip
    from handsight.objects import ObjectModel
    from handsight.rig import Rig
    from handsight.tracking import Tracker, TrackerSettings
    from handsight.tracking.replay import Step, Tally

    Watch = Callable[[Tally, Step, Tracker], None]


@with_settings
def track(
    recording: Recorded,
    rig: RigFile = None,
    object: ObjectName = None,
    output_folder: Annotated[
        Path | None,
        typer.Option("--output-folder", help="Folder for results; default: RECORDING-track, here."),
    ] = None,
    old_output: Annotated[Path | None, typer.Option("--output", "-o", hidden=True)] = None,
    *,
    settings: "TrackerSettings",
) -> None:
    """Track an object in the hand through a recording.

    Joint states, one wrench topic for each finger and, where there are some, depth images or a camera's poses of the
    object go in, under the topics that the rig names; the object's pose in the palm comes out, for each joint state.

    Written to the folder: `track.mcap` (PoseWithCovarianceStamped), `track.tum`, `track.csv`, `summary.json`, and
    `track.png` where matplotlib is installed.

    ```
    handsight simulate can --output can.mcap
    handsight track can.mcap
    handsight simulate can --images --output seen.mcap && handsight track seen.mcap
    handsight track grasp.bag --rig robot.yaml --object mustard.ply --rate 100 --output-folder results
    ```

    Whatever ends it early, what was tracked by then is written. The exit code is 0 only if nothing did, and there is a
    pose.
    """
    announce_compiling()
    found, model = rig_and_object(recording, rig, object)
    if renamed(False, old_output is not None, ("--output-folder", "--output")):
        output_folder = output_folder or old_output
    folder = output_folder or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    with live_rows(recording.name, progress) as watch:
        ended = run(recording, found, model, settings, watch)
    wrote = list[str]()
    try:
        # Before anything is said: Ctrl-C while a terminal is being written to must not cost the results.
        wrote.extend(write(ended, found, model, folder))
    finally:
        for sentence in (*ended.messages, *ended.sentences(), *wrote):
            say(sentence)
    if code := ended.exit_code:
        raise typer.Exit(code)


def progress(tally: "Tally", step: "Step", tracker: "Tracker") -> list[tuple[str, str]]:
    """Returns how a run goes, as names and values."""
    position = 1e3 * step.estimate.T_palm_object[:3, 3]
    rate = tally.answered / max(tally.recorded, 1e-9)
    return [
        ("state", step.state + (f": {step.reason}" if step.reason else "")),
        ("time", f"{tally.recorded:.1f} s, {tally.recorded / max(tally.wall, 1e-9):.1f}x real time"),
        ("rate", f"{rate:.0f} poses/s, {tracker.corrections} corrections"),
        ("position", "x {:.1f}, y {:.1f}, z {:.1f} mm in the palm".format(*position)),
        ("σ", f"{1e3 * step.sigma:.1f} mm"),
        ("touching", ", ".join(step.fingers) or "nothing"),
        ("grip", grip(step.slip)),
        ("weight", weight_text(tracker.weight, tracker.unweighed)),
    ]


def grip(slip: "Slip") -> str:
    """Returns how near to slipping the object is."""
    if slip.least is None:
        return "friction is not known yet" if slip.friction is None else "nothing is held"
    used = f"the finger that holds best uses {slip.least:.0%} of what friction {slip.friction:.2f} holds"
    return f"slips: {used}" if slip.slipping else used


def run(path: Path, rig: "Rig", model: "ObjectModel", settings: "TrackerSettings", watch: "Watch") -> Run:
    """Tracks a recording. Whatever ends it early, Ctrl-C too, what was tracked by then is there.

    Raises what the recording is refused for, if nothing was tracked.
    """
    from handsight.evaluation import Truths, track_errors
    from handsight.recording import open_recording
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Tally, replay

    with open_recording(path, rig) as recording:
        rig = with_intrinsics(rig, recording)
    tracker = Tracker(rig, model, settings=settings)
    with open_recording(path, rig) as recording:
        ended = Run(printable(path.name), Tally(), Truths([]))
        with ended.part() as end:
            for step in replay(recording.observations(), tracker, ended.tally):
                ended.steps.append(step)
                ended.weight = tracker.weight or ended.weight
                watch(ended.tally, step, tracker)
        # It may end between an answer's count and the answer.
        ended.tally.answered = len(ended.steps)
        if isinstance(end.error, HandsightError) and not ended.steps:
            raise end.error
        ended.messages = [*recording.report.sentences(), *recording.lacks()]
        ended.truths = Truths(recording.truth)
    ended.images = tracker.images
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
    """Returns why a run has no pose."""
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
    """Writes the results into a folder, and says what was written; why anything was not is in `ended.ends`."""
    from handsight.recording import TrackRow, write_track_csv, write_track_mcap, write_track_tum

    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    rows = [
        TrackRow(
            step.stamp,
            step.estimate.T_palm_object,
            step.estimate.covariance,
            step.state,
            step.reason,
            step.estimate.information,
        )
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
        with ended.part():
            write_file(folder / name, rows)
            done.append(name)
    yield f"wrote {folder}: {', '.join(done)}"
    if not rows:
        yield "no picture: there is no pose"
        return
    with ended.part():
        yield draw(ended, model, folder / "track.png")


def draw(ended: Run, model: "ObjectModel", path: Path) -> str:
    """Draws a run, and says what was written, or why not."""
    try:
        from handsight.viewer.track_figure import draw_track

        draw_track(ended.name, model, ended.steps, ended.truths, path)
    except MissingExtra as error:
        return f"no picture: {error}"
    return f"wrote {path}"
