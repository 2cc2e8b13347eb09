"""`handsight track`: an object tracked through a recording, with results in files and a report on stderr."""

import contextlib
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from handsight.cli import options
from handsight.cli.options import Run
from handsight.cli.terminal import FAILED, End, bar, kept_going, millimetres, plain_table, print_out, say
from handsight.errors import HandsightError, MissingExtra, printable
from handsight.files import text_file, write_errors

if TYPE_CHECKING:
    from handsight.evaluation import TrackErrors, Truths
    from handsight.forces import ObjectWeight
    from handsight.objects import ObjectModel
    from handsight.recording.track_log import TrackLog
    from handsight.tracking import Estimated, Tracker
    from handsight.tracking.replay import Step, Tally

MAX_STEPS = 4000
"""Steps that are kept in memory; of more, every second one is left out."""


def track(
    recording: options.RecordingPath,
    rig: options.RigPath = None,
    object: options.ObjectName = None,
    output_folder: Annotated[
        Path | None,
        Option(help="Folder for the results. Default: RECORDING-track in the current folder."),
    ] = None,
    images: options.WithImages = True,
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
    handsight track grasp.bag --rig robot.yaml --object mustard.ply --output-folder results
    ```

    After an error or Ctrl-C, the track until then is written, if it has a pose; else earlier results stay. The exit
    code is 0 only if the recording was tracked to its end and there is at least one pose.
    """
    from handsight.recording.track_log import TrackLog
    from handsight.tracking import TrackerSettings

    settings = TrackerSettings(images=images)
    run = Run.of(recording, rig, object, settings)
    folder = output_folder or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    with TrackLog() as log:
        with bar(recording.name) as move:
            result = tracked(run, partial(progress, move), log, folder)
        wrote = list[str]()
        try:
            # Before anything is printed, so that Ctrl-C while printing does not cost the results.
            if result.tally.answered or not result.ends:
                wrote.extend(write(result, run, folder, log))
        finally:
            say(*result.messages, *result.sentences(), *wrote)
            if result.estimates:
                rows = [value.row() for value in result.estimates]
                print_out("", plain_table(("value", "in", "declared", "estimated"), rows, texts=2))
    if code := result.exit_code:
        raise typer.Exit(code)


def progress(move: Callable[..., None], tally: "Tally", step: "Step", tracker: "Tracker") -> None:
    """Shows a tracker's state in a progress bar."""
    speed = tally.recorded / tally.wall
    done = f"{tally.recorded:.1f} s, {speed:.1f}x real time, {tracker.corrections} corrections"
    move(None, f"{done}; {step.state}")


def tracked(
    run: Run,
    watch: "Callable[[Tally, Step, Tracker], None]",
    log: "TrackLog",
    folder: Path | None = None,
) -> "TrackResult":
    """Returns the result of tracking a recording, whose rows go to the log; `watch` is called with every step.

    `folder`: created before, if given, so that hours of tracking are not lost where it cannot be. After an error or
    Ctrl-C, the result has the steps until then. A HandsightError before the first step is raised.
    """
    from handsight.evaluation import Truths, track_errors
    from handsight.recording import TrackRow
    from handsight.tracking.estimates import estimated_values
    from handsight.tracking.replay import Tally, replay

    with run.opened() as (recording, tracker):
        if folder is not None:
            with write_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
        result = TrackResult(printable(run.recording.name), Tally(), Truths([]), tracker)
        with result.part() as end:
            for step in replay(recording.observations(), tracker, result.tally):
                e = step.estimate
                pose = e.T_palm_object, e.covariance
                log.append(TrackRow(step.stamp, *pose, step.state, step.reason, e.information))
                result.add(step.summary())
                result.weight = tracker.weight or result.weight
                watch(result.tally, step, tracker)
        tally = result.tally
        tally.answered = result.poses  # Ctrl-C may have come between counting an answer and storing it
        if isinstance(end.error, HandsightError) and not tally.answered:
            raise end.error
        result.messages = [*recording.report.sentences(), *recording.lacks()]
        result.truths = Truths(recording.truth)
    result.estimates = estimated_values(tracker, result.weight)
    result.reason = tracker.reason
    if not tally.answered:
        if not tally.observations:
            result.reason = "the recording has no observation"
        elif tally.refused.total() == tally.observations:
            result.reason = "all observations were left out"
        elif unplaced := tracker.vision.unplaced:
            result.reason = (
                f"{unplaced} poses of vision came while the palm's pose in the world was not known"
            )
    with result.part():
        for name, vision in (("vision", True), ("tracked", False)):
            errors = track_errors(run.model, result.steps, result.truths, vision=vision)
            if len(errors):
                result.errors[name] = errors
    return result


def write(result: "TrackResult", run: Run, folder: Path, log: "TrackLog") -> Iterator[str]:
    """Writes the results to a folder and yields sentences about it; failures are added to `result.ends`."""
    from handsight.recording import write_track_csv, write_track_mcap, write_track_tum

    frame = run.rig.frames["palm"]
    writers: dict[str, Callable[..., None]] = {
        "track.mcap": partial(write_track_mcap, frame=frame),
        "track.tum": write_track_tum,
        "track.csv": write_track_csv,
    }
    done = []
    for name, write_file in writers.items():
        with result.part():
            write_file(folder / name, islice(log.rows(), result.poses))
            done.append(name)
    with result.part(), text_file(folder / "summary.json") as file:
        json.dump(result.summary(), file, indent=1, ensure_ascii=False, allow_nan=False)
        file.write("\n")
        done.append("summary.json")
    yield f"wrote {folder}: {', '.join(done)}"
    if result.poses:
        with result.part():
            yield draw(result, run.model, folder / "track.png")


def draw(result: "TrackResult", model: "ObjectModel", path: Path) -> str:
    """Draws a result to a file, and returns a sentence that names it, or says why there is none."""
    try:
        from handsight.viewer.figures import draw_track

        draw_track(result.name, model, result.steps, result.truths, path)
    except MissingExtra as error:
        return f"no picture: {error}"
    return f"wrote {path}"


@dataclass(slots=True)
class TrackResult:
    """The result of tracking a recording."""

    name: str
    """Name of the recording."""
    tally: "Tally"
    truths: "Truths"
    tracker: "Tracker"
    steps: "list[Step]" = field(default_factory=list)
    """The first step, and each `every`-th after it: less than `MAX_STEPS` for the picture and the errors."""
    every: int = 1
    poses: int = 0
    """The number of all steps."""
    touching: Counter[str] = field(default_factory=Counter)
    outliers: Counter[str] = field(default_factory=Counter)
    """By finger, the number of steps in which it touches, and in which its contact is an outlier."""
    pressed: int = 0
    """The number of steps in which a tactile array is pressed."""
    slips: dict[float, float] = field(default_factory=dict)
    """The duration of each slip by its begin [s]."""
    friction: float | None = None
    """The coefficient of friction between object and fingertips as estimated at the end."""
    slip_doubt: str = ""
    """Why it could not be told whether the object slips, when fingers held it last; empty where it could."""
    messages: list[str] = field(default_factory=list)
    """Sentences about what is wrong with the recording."""
    reason: str = ""
    """The reason for the tracker's last state, or why there is no pose."""
    errors: "dict[str, TrackErrors]" = field(default_factory=dict)
    """Errors of "vision" and "tracked" against the truth, if the recording has it."""
    weight: "ObjectWeight | None" = None
    """The object's weight, as measured last in the air."""
    estimates: "list[Estimated]" = field(default_factory=list)
    """What the tracker knows at the end of values that the rig and the model declare."""
    ends: list[End] = field(default_factory=list)
    """The ends of the parts of the command that ended early."""

    @property
    def exit_code(self) -> int:
        """Returns the command's exit code: that of the first part that ended early, or of a result without a pose."""
        if self.ends:
            return self.ends[0].exit_code
        return 0 if self.poses else FAILED

    def add(self, step: "Step") -> None:
        """Adds a step."""
        if self.poses % self.every == 0:
            self.steps.append(step)
        if len(self.steps) == MAX_STEPS:
            del self.steps[1::2]
            self.every *= 2
        self.touching.update(step.fingers)
        self.outliers.update(step.rejected)
        if step.slip.slipping:
            self.slips[step.slip.began] = step.stamp - step.slip.began
        self.poses += 1
        self.pressed += step.pressed
        self.friction = step.slip.friction
        if step.slip.ratios or step.slip.doubt:
            self.slip_doubt = step.slip.doubt

    @contextlib.contextmanager
    def part(self) -> Iterator[End]:
        """Runs a part of the command that may end early, without ending the others."""
        with kept_going() as end:
            yield end
        if end.exit_code:
            self.ends.append(end)

    @property
    def untouched(self) -> dict[str, dict[str, int]]:
        """Returns why each finger that never touched anything did not: the number of observations by reason."""
        tally = self.tally
        fingers = [name for name in self.tracker.rig.fingers if name not in tally.touched]
        return {name: dict(tally.without.get(name, {})) for name in fingers}

    @property
    def rejected(self) -> dict[str, float]:
        """Returns, by finger, the share of the poses with its contact in which the contact was an outlier."""
        return {finger: self.outliers[finger] / count for finger, count in self.touching.items()}

    @property
    def size_doubt(self) -> str:
        """Returns why the recording does not confirm the size of the object's model; empty where it may.

        Fingers at a few places fit a model of another size, moved a little: its far end is off, and no contact is.
        """
        if self.tally.grasps > 1 or self.tracker.images.get("object_seen"):
            return ""
        grasp = "one grasp" if self.tally.grasps else "no grasp"
        doubt = f"not confirmed: {grasp}, and no depth image was fitted"
        sigma = self.tracker.model.sigma_scale
        return (
            doubt if sigma is None else f"{doubt}; its scale was measured to {100 * sigma:.2g} % (one sigma)"
        )

    def summary(self) -> dict[str, object]:
        """Returns the result in numbers, ready for JSON."""
        tally = self.tally
        tracker = self.tracker
        weight = self.weight
        return {
            "recording": self.name,
            "observations": tally.observations,
            "poses": tally.answered,
            "corrections": tracker.corrections,
            "seconds_recorded": tally.recorded,
            "seconds_taken": tally.wall,
            "real_time_factor": tally.recorded / tally.wall if tally.wall else None,
            "seconds_in_state": {state: round(seconds, 3) for state, seconds in tally.states.items()},
            "last_reason": self.reason,
            "refused": dict(tally.refused),
            "fingers_without_contact": self.untouched,
            "fingers_rejected": {finger: round(part, 3) for finger, part in self.rejected.items()},
            "depth_images": tracker.images,
            "estimates": [asdict(value) for value in self.estimates],
            "size_doubt": self.size_doubt,
            "weight": weight
            and {
                "mass_kg": weight.mass,
                "sigma_mass_kg": weight.sigma_mass,
                "center_object_m": weight.center_object.tolist(),
                "covariance_m2": weight.covariance.tolist(),
                "directions": weight.directions,
                "not_believed": weight.reason,
                "biased": list(weight.biased),
                "assumed": weight.assumed,
            },
            "recording_says": self.messages,
            "friction": self.friction,
            "slip_doubt": self.slip_doubt,
            "poses_with_skin": self.pressed,
            "slips": [{"began": began, "seconds": round(s, 3)} for began, s in self.slips.items()],
            "errors_mm_deg": {name: errors.summary() for name, errors in self.errors.items()},
        }

    def sentences(self) -> list[str]:
        """Returns the result as sentences for a person."""
        tally = self.tally
        tracker = self.tracker
        factor = f"{tally.recorded / tally.wall:.0f}x real time" if tally.wall else "nothing to time"
        lines = [
            f"{tally.answered} poses of {tally.observations} observations, {tracker.corrections} corrections; "
            f"{tally.recorded:.1f} s in {tally.wall:.1f} s ({factor})"
        ]
        if not tally.answered:
            lines.append(f"no pose: {self.reason}")
        if tally.states:
            longest_first = sorted(tally.states.items(), key=lambda state: -state[1])
            spent = ", ".join(f"{state} {seconds:.1f} s" for state, seconds in longest_first)
            lines.append(spent + (f"; at the end: {self.reason}" if self.reason else ""))
        lines += refusals(tally)
        lines += self._touch_sentences()
        if tracker.images:
            searched, detected, searched_hand, hands = tracker.images.values()
            lines.append(
                f"{searched} depth images: the object was found in {detected}, "
                f"the hand in {hands} of {searched_hand} searched for it"
            )
        if tally.answered and (doubt := self.size_doubt):
            lines.append(f"object size: {doubt}")
        if self.weight is not None:
            lines.append(f"weight: {weight_text(self.weight)}")
        lines += [end.message for end in self.ends if end.message]
        for name, errors in self.errors.items():
            n = errors.summary()
            lines.append(
                f"{name}: base centre off by {n['base_mean']:.1f} mm on average ({n['base_last']:.1f} at the end), "
                f"middle {n['middle_mean']:.1f} mm, rotation {n['rotation_mean']:.1f}°"
            )
        return lines

    def _touch_sentences(self) -> Iterator[str]:
        """Yields sentences about fingers, tactile arrays and slips."""
        for finger, why in self.untouched.items():
            reasons = ", ".join(f"{reason} in {count}" for reason, count in why.items())
            yield f"finger {finger}: no contact in any observation ({reasons or 'none was taken'})"
        for finger, part in self.rejected.items():
            if part >= 0.5:
                yield (
                    f"finger {finger}: contradicts the others in {100 * part:.0f} % of the poses while it touched; "
                    "check its topic, reading, bias, sensor.pose and surface; `handsight rig check` tries them"
                )
        if self.pressed:
            yield f"tactile arrays: pressed in {self.pressed} of {self.poses} poses"
        for name, faults in self.tracker.skin.faults.items():
            yield f"skin {name}: {faults}"
        if slips := self.slips:
            first = next(iter(slips)) - self.steps[0].stamp
            when = f"{sum(slips.values()):.2f} s in all, first at {first:.2f} s"
            yield f"the object slipped {len(slips)}x, {when}; friction {self.friction:.2f}"
        if self.slip_doubt:
            yield f"slips: {self.slip_doubt}"


def weight_text(weight: "ObjectWeight") -> str:
    """Returns a line about an object's mass and centre of mass."""
    sigma = math.sqrt(weight.covariance.trace() / 3)
    mass = f"{1000 * weight.mass:.0f} ± {1000 * weight.sigma_mass:.0f} g"
    center = f"[{millimetres(weight.center_object, 0)}] ± {millimetres(sigma, 0)} mm in the object"
    text = f"{mass}, centre {center}"
    if weight.biased:
        text += f"; the excess force of {', '.join(weight.biased)} in the air is subtracted"
    if weight.assumed:
        text += f"; {weight.assumed}"
    return f"not believed: {weight.reason} ({text})" if weight.reason else text


def refusals(tally: "Tally") -> list[str]:
    """Returns a sentence for each of the five most frequent reasons for which observations were left out."""
    return [f"{count} observations left out: {message}" for message, count in tally.refused.most_common(5)]
