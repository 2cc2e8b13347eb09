"""`handsight track`: an object tracked through a recording, with results in files and a report on stderr."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handsight.cli import options
from handsight.cli.options import Run, renamed, tracker_settings
from handsight.cli.terminal import live_rows, say
from handsight.cli.track_summary import TrackResult, print_diagnosis, weight_text
from handsight.errors import HandsightError, MissingExtra, printable
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.forces import Slip
    from handsight.objects import ObjectModel
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Step, Tally


def track(
    recording: options.RecordingPath,
    rig: options.RigPath = None,
    object: options.ObjectName = None,
    output_folder: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. Default: RECORDING-track in the current folder."),
    ] = None,
    former_output: Annotated[Path | None, typer.Option("--output", "-o", hidden=True)] = None,
    rate: options.Rate = None,
    answer: options.Answer = "best",
    samples: options.Samples = 0,
    outside: options.OutsidePoints = 200,
    images: options.WithImages = True,
    alternative: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Another object that may be in the hand; repeatable. If contacts contradict the object for a second, "
            "the reason names the alternative that explains them better.",
        ),
    ] = None,
    diagnose: Annotated[
        bool,
        typer.Option(
            help="Print a table: what the recording tells of each value that the rig and the model declare."
        ),
    ] = False,
) -> None:
    """Track an object in the hand through a recording.

    It reads joint states, the wrenches of each finger, and depth images or a camera's poses of the object, if any, from
    the topics that the rig names. For each joint state it estimates the object's pose in the palm's frame.

    The results are `track.mcap` (PoseWithCovarianceStamped), `track.tum`, `track.csv`, `summary.json`, and
    `track.png` where matplotlib is installed. Positions are in metres.

    ```
    handsight simulate can --output can.mcap
    handsight track can.mcap
    handsight simulate can --images --output seen.mcap && handsight track seen.mcap
    handsight track grasp.bag --rig robot.yaml --object mustard.ply --rate 100 --output-folder results
    handsight track session.mcap --rig robot.yaml --object can --diagnose
    ```

    After an error or Ctrl-C, the track until then is written. The exit code is 0 only if the recording was tracked to
    its end and there is at least one pose.
    """
    settings = tracker_settings(rate=rate, answer=answer, samples=samples, outside=outside, images=images)
    run = Run.of(recording, rig, object, settings, alternative or ())
    output_folder = renamed(output_folder, former_output, ("--output-folder", "--output"))
    folder = output_folder or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    with live_rows(recording.name, progress) as watch:
        result = tracked(run, watch)
    wrote = list[str]()
    try:
        # Before anything is printed, so that Ctrl-C while printing does not cost the results.
        wrote.extend(write(result, run, folder))
    finally:
        for sentence in (*result.messages, *result.sentences(), *wrote):
            say(sentence)
        if diagnose and result.diagnosis is not None:
            print_diagnosis(result.diagnosis)
    if code := result.exit_code:
        raise typer.Exit(code)


def progress(tally: "Tally", step: "Step", tracker: "Tracker") -> list[tuple[str, str]]:
    """Returns names and values that show the state of the tracker."""
    x, y, z = 1e3 * step.estimate.T_palm_object[:3, 3]
    rate = tally.answered / tally.recorded if tally.recorded else 0.0  # at the first step no time has passed
    speed = tally.recorded / max(tally.wall, 1e-9)
    return [
        ("state", step.state + (f": {step.reason}" if step.reason else "")),
        ("time", f"{tally.recorded:.1f} s, {speed:.1f}x real time"),
        ("rate", f"{rate:.0f} poses/s, {tracker.corrections} corrections"),
        ("position", f"x {x:.1f}, y {y:.1f}, z {z:.1f} mm in the palm"),
        ("σ", f"{1e3 * step.sigma:.1f} mm"),
        ("touching", ", ".join(step.fingers) or "nothing"),
        ("grip", grip(step.slip)),
        ("weight", weight_text(tracker.weight, tracker.unweighed)),
    ]


def grip(slip: "Slip") -> str:
    """Returns in words how near the object is to slipping."""
    if slip.least is None:
        return "friction is not known yet" if slip.friction is None else "no finger holds the object"
    used = f"the finger that holds best uses {slip.least:.0%} of what friction {slip.friction:.2f} allows"
    return f"slips: {used}" if slip.slipping else used


def tracked(run: Run, watch: "Callable[[Tally, Step, Tracker], None]") -> TrackResult:
    """Returns the result of tracking a recording; `watch` is called with every step.

    After an error or Ctrl-C, the result has the steps until then. A HandsightError before the first step is raised.
    """
    from handsight.evaluation import Truths, track_errors
    from handsight.tracking.diagnosis import Diagnoser
    from handsight.tracking.replay import Tally, replay

    with run.opened() as (recording, tracker):
        result = TrackResult(printable(run.recording.name), Tally(), Truths([]))
        diagnoser = Diagnoser(tracker)
        with result.part() as end:
            for step in replay(recording.observations(), tracker, result.tally):
                diagnoser.watch()
                result.steps.append(step)
                result.weight = tracker.weight or result.weight
                watch(result.tally, step, tracker)
        # Ctrl-C may have come between counting an answer and storing it.
        tally = result.tally
        tally.answered = len(result.steps)
        if isinstance(end.error, HandsightError) and not result.steps:
            raise end.error
        result.messages = [*recording.report.sentences(), *recording.lacks()]
        result.truths = Truths(recording.truth)
    result.images, result.corrections = tracker.images, tracker.corrections
    result.margins, result.reason = tracker.link_margins, tracker.reason
    result.diagnosis = diagnoser.diagnosis()
    result.latency, result.latency_declared = tracker.vision_latency(), tracker.vision.camera.latency
    if not result.steps and not tally.observations:
        result.reason = "the recording has no observation"
    elif not result.steps and tally.refused.total() == tally.observations:
        result.reason = "all observations were left out"
    elif not result.steps and (unplaced := tracker.vision.unplaced):
        why = "as the palm's pose in the world was not known"
        result.reason = f"{unplaced} poses of vision could not be placed, {why}"
    result.untouched = {
        name: dict(tally.without.get(name, {})) for name in run.rig.fingers if name not in tally.touched
    }
    with result.part():
        for name, vision in (("vision", True), ("tracked", False)):
            errors = track_errors(run.model, result.steps, result.truths, vision=vision)
            if len(errors):
                result.errors[name] = errors
    return result


def write(result: TrackResult, run: Run, folder: Path) -> Iterator[str]:
    """Writes the results to a folder and yields sentences about it; failures are added to `result.ends`."""
    from handsight.recording import TrackRow, write_track_csv, write_track_mcap, write_track_tum

    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    rows = [
        TrackRow(s.stamp, e.T_palm_object, e.covariance, s.state, s.reason, e.information)
        for s in result.steps
        for e in [s.estimate]
    ]
    files: dict[str, Callable[..., None]] = {
        "track.mcap": partial(write_track_mcap, frame=run.rig.frames["palm"]),
        "track.tum": write_track_tum,
        "track.csv": write_track_csv,
        "summary.json": lambda path, _: result.write_summary(path),
    }
    done = []
    for name, write_file in files.items():
        with result.part():
            write_file(folder / name, rows)
            done.append(name)
    yield f"wrote {folder}: {', '.join(done)}"
    if not rows:
        yield "no picture: there is no pose"
        return
    with result.part():
        yield draw(result, run.model, folder / "track.png")


def draw(result: TrackResult, model: "ObjectModel", path: Path) -> str:
    """Draws a result to a file, and returns a sentence that names it, or says why there is none."""
    try:
        from handsight.viewer.track_figure import draw_track

        draw_track(result.name, model, result.steps, result.truths, path)
    except MissingExtra as error:
        return f"no picture: {error}"
    return f"wrote {path}"
