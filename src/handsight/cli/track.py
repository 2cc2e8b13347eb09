"""`handsight track`: an object tracked through a recording, with results in files and a report on stderr."""

import contextlib
import hashlib
import json
import math
import pickle
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from handsight.cli import options
from handsight.cli.options import Run, renamed, tracker_settings
from handsight.cli.terminal import FAILED, End, kept_going, live_rows, plain_table, print_out, say
from handsight.errors import HandsightError, MissingExtra, printable
from handsight.files import text_file

if TYPE_CHECKING:
    from handsight.evaluation import TrackErrors, Truths
    from handsight.forces import ObjectWeight, Slip
    from handsight.objects import ObjectModel
    from handsight.observation import Observation
    from handsight.recording.track_log import TrackLog
    from handsight.tracking import Tracker
    from handsight.tracking.replay import Step, Tally
    from handsight.tracking.verdicts import Diagnosis

CHECKPOINT_PERIOD = 10.0
"""Between two checkpoints, from which tracking goes on after it has ended early [s]."""
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
    former_output: Annotated[Path | None, Option("--output", "-o", hidden=True)] = None,
    rate: options.Rate = None,
    answer: options.Answer = "best",
    samples: options.Samples = 0,
    outside: options.OutsidePoints = 200,
    images: options.WithImages = True,
    alternative: Annotated[
        list[str] | None,
        Option(
            metavar="NAME|FILE",
            help="Another object that may be in the hand; repeatable. If contacts contradict the object for a second, "
            "the reason names the alternative that explains them better.",
        ),
    ] = None,
    diagnose: Annotated[
        bool,
        Option(
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

    After an error or Ctrl-C, the track until then is written, and the same command goes on from there, as it does after
    the process was killed; without `track.part` in the folder it starts again. The exit code is 0 only if the recording
    was tracked to its end and there is at least one pose.
    """
    settings = tracker_settings(rate=rate, answer=answer, samples=samples, outside=outside, images=images)
    run = Run.of(recording, rig, object, settings, alternative or ())
    output_folder = renamed(output_folder, former_output, ("--output-folder", "--output"))
    folder = output_folder or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    with live_rows(recording.name, progress) as watch:
        result, log = tracked(run, watch, folder)
    wrote = list[str]()
    try:
        # Before anything is printed, so that Ctrl-C while printing does not cost the results.
        wrote.extend(write(result, run, folder, log))
    finally:
        log.close(resumable=bool(result.ends))
        say(*result.messages, *result.sentences(), *wrote)
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
    if slip.least is None and slip.unmeasured:
        return f"no force is measured by {', '.join(slip.unmeasured)}"
    if slip.least is None:
        return "friction is not known yet" if slip.friction is None else "no finger holds the object"
    used = f"the finger that holds best uses {slip.least:.0%} of what friction {slip.friction:.2f} allows"
    return f"slips: {used}" if slip.slipping else used


def tracked(
    run: Run, watch: "Callable[[Tally, Step, Tracker], None]", folder: Path
) -> "tuple[TrackResult, TrackLog]":
    """Returns the result of tracking a recording, and its rows; `watch` is called with every step.

    It goes on from the checkpoint in the folder, if there is one. After an error or Ctrl-C, the result has the steps
    until then. A HandsightError before the first step is raised.
    """
    from handsight._kernels.runtime.kernel_cache import STAMP
    from handsight.evaluation import Truths, track_errors
    from handsight.recording import TrackRow
    from handsight.recording.track_log import TrackLog
    from handsight.tracking.diagnosis import Diagnoser
    from handsight.tracking.replay import Tally, replay

    with run.opened() as (recording, tracker):
        files = [(file.path, file.path.stat().st_mtime_ns) for file in recording.report.files]
        seal = hashlib.sha256(pickle.dumps((run, files, STAMP, version("handsight")))).hexdigest()
        log = TrackLog(folder, seal)
        result = TrackResult(printable(run.recording.name), Tally(), Truths([]), tracker)
        place, tracker, diagnoser, result = log.state or (None, tracker, Diagnoser(tracker), result)
        if place is not None:
            say(f"{log.folder}: goes on after {result.poses} poses, where it had ended early")

        def logged() -> "Iterator[Observation]":
            """Yields the observations, between two of which the state is saved from time to time."""
            saved = time.monotonic()
            for observation in recording.observations(place):
                yield observation
                if time.monotonic() - saved >= CHECKPOINT_PERIOD:
                    log.save((recording.place, tracker, diagnoser, result))
                    saved = time.monotonic()

        with result.part() as end:
            for step in replay(logged(), tracker, result.tally):
                diagnoser.watch()
                e = step.estimate
                pose = e.T_palm_object, e.covariance
                log.append(TrackRow(step.stamp, *pose, step.state, step.reason, e.information))
                result.add(step.summary())
                result.weight = tracker.weight or result.weight
                watch(result.tally, step, tracker)
        # Ctrl-C may have come between counting an answer and storing it.
        tally = result.tally
        tally.answered = result.poses
        if isinstance(end.error, HandsightError) and not tally.answered:
            log.close(resumable=False)
            raise end.error
        result.messages = [*recording.report.sentences(), *recording.lacks()]
        result.truths = Truths(recording.truth)
    result.reason, result.diagnosis = tracker.reason, diagnoser.diagnosis()
    if not tally.answered and not tally.observations:
        result.reason = "the recording has no observation"
    elif not tally.answered and tally.refused.total() == tally.observations:
        result.reason = "all observations were left out"
    elif not tally.answered and (unplaced := tracker.vision.unplaced):
        why = "as the palm's pose in the world was not known"
        result.reason = f"{unplaced} poses of vision could not be placed, {why}"
    untouched = [name for name in run.rig.fingers if name not in tally.touched]
    result.untouched = {name: dict(tally.without.get(name, {})) for name in untouched}
    with result.part():
        for name, vision in (("vision", True), ("tracked", False)):
            errors = track_errors(run.model, result.steps, result.truths, vision=vision)
            if len(errors):
                result.errors[name] = errors
    return result, log


def write(result: "TrackResult", run: Run, folder: Path, log: "TrackLog") -> Iterator[str]:
    """Writes the results to a folder and yields sentences about it; failures are added to `result.ends`."""
    from handsight.recording import write_track_csv, write_track_mcap, write_track_tum

    files: dict[str, Callable[..., None]] = {
        "track.mcap": partial(write_track_mcap, frame=run.rig.frames["palm"]),
        "track.tum": write_track_tum,
        "track.csv": write_track_csv,
    }
    done = []
    for name, write_file in files.items():
        with result.part():
            write_file(folder / name, islice(log.rows(), result.poses))
            done.append(name)
    with result.part(), text_file(folder / "summary.json") as file:
        text = json.dumps(result.summary(), indent=1, ensure_ascii=False, allow_nan=False)
        file.write(text + "\n")
        done.append("summary.json")
    yield f"wrote {folder}: {', '.join(done)}"
    if not result.poses:
        yield "no picture: there is no pose"
        return
    with result.part():
        yield draw(result, run.model, folder / "track.png")


def draw(result: "TrackResult", model: "ObjectModel", path: Path) -> str:
    """Draws a result to a file, and returns a sentence that names it, or says why there is none."""
    try:
        from handsight.viewer.track_figure import draw_track

        draw_track(result.name, model, result.steps, result.truths, path)
    except MissingExtra as error:
        return f"no picture: {error}"
    return f"wrote {path}"


@dataclass(slots=True)
class TrackResult:
    """A `TrackResult` is the result of tracking a recording."""

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
    unmeasured: set[str] = field(default_factory=set)
    """The fingers whose force was not measured while they touched."""
    slips: dict[float, float] = field(default_factory=dict)
    """The duration of each slip by its begin [s]."""
    friction: float | None = None
    """The coefficient of friction between object and fingertips as estimated at the end."""
    messages: list[str] = field(default_factory=list)
    """Sentences about what is wrong with the recording."""
    reason: str = ""
    """The reason for the tracker's last state, or why there is no pose."""
    errors: "dict[str, TrackErrors]" = field(default_factory=dict)
    """Errors of "vision" and "tracked" against the truth, if the recording has it."""
    untouched: dict[str, dict[str, int]] = field(default_factory=dict)
    """For each finger that never touched anything: the number of observations without a contact, by reason."""
    weight: "ObjectWeight | None" = None
    """The object's weight, as measured last in the air."""
    diagnosis: "Diagnosis | None" = None
    """What the recording tells of the values that the rig and the model declare."""
    ends: list[End] = field(default_factory=list)
    """The ends of the parts of the command that ended early."""

    @property
    def exit_code(self) -> int:
        """Returns the command's exit code: that of the first part that ended early, or of a result without a pose."""
        return next((end.exit_code for end in self.ends), 0 if self.poses else FAILED)

    def add(self, step: "Step") -> None:
        """Adds a step."""
        if self.poses % self.every == 0:
            self.steps.append(step)
        if len(self.steps) == MAX_STEPS:
            del self.steps[1::2]
            self.every *= 2
        self.touching.update(step.fingers)
        self.outliers.update(step.rejected)
        self.unmeasured.update(step.slip.unmeasured)
        if step.slip.slipping:
            self.slips[step.slip.began] = step.stamp - step.slip.began
        self.poses += 1
        self.pressed += step.pressed
        self.friction = step.slip.friction

    @contextlib.contextmanager
    def part(self) -> Iterator[End]:
        """Runs a part of the command that may end early, without ending the others."""
        with kept_going() as end:
            yield end
        if end.exit_code:
            self.ends.append(end)

    @property
    def rejected(self) -> dict[str, float]:
        """Returns, by finger, the share of the poses with its contact in which the contact was an outlier."""
        return {finger: self.outliers[finger] / count for finger, count in self.touching.items()}

    def summary(self) -> dict[str, object]:
        """Returns the result in numbers, ready for JSON."""
        tally, tracker, weight, latency = self.tally, self.tracker, self.weight, self.tracker.vision_latency()
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
            "link_margins_mm": {link: round(1e3 * m, 1) for link, m in tracker.link_margins.items()},
            "depth_images": tracker.images,
            "diagnosis": [value.numbers() for value in self.diagnosis.values] if self.diagnosis else [],
            "vision_latency_ms": None if latency is None else [round(1e3 * x, 1) for x in latency],
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
            "poses_with_skin": self.pressed,
            "slips": [{"began": began, "seconds": round(s, 3)} for began, s in self.slips.items()],
            "errors_mm_deg": {name: errors.summary() for name, errors in self.errors.items()},
        }

    def sentences(self) -> list[str]:
        """Returns the result as sentences for a person."""
        tally, tracker = self.tally, self.tracker
        factor = f"{tally.recorded / tally.wall:.0f}x real time" if tally.wall else "nothing to time"
        poses = f"{tally.answered} poses of {tally.observations} observations"
        took = f"{tally.recorded:.1f} s in {tally.wall:.1f} s ({factor})"
        lines = [f"{poses}, {tracker.corrections} corrections; {took}"]
        if not tally.answered:
            lines.append(f"no pose: {self.reason}")
        longest_first = sorted(tally.states.items(), key=lambda state: -state[1])
        if spent := ", ".join(f"{state} {seconds:.1f} s" for state, seconds in longest_first):
            lines.append(spent + (f"; at the end: {self.reason}" if self.reason else ""))
        lines += refusals(tally)
        lines += self._touch_sentences()
        differed = "contacts and vision have differed" in self.reason
        if differed or ("vision" in self.reason and not tally.answered):
            pose = "the order of its quaternion (x, y, z, w), camera.pose and frames.palm"
            lines.append(f"vision: check its topic, {pose}")
        if tracker.images:
            searched, detected, searched_hand, hands = tracker.images.values()
            hand = f"the hand in {hands} of {searched_hand} searched for it"
            lines.append(f"{searched} depth images: the object was found in {detected}, {hand}")
        lines += latency_text(tracker)
        if margins := tracker.link_margins:
            by = ", ".join(f"{link} by {1e3 * margin:.1f} mm" for link, margin in margins.items())
            why = "as they would be inside the object although the contacts fit"
            lines.append(f"these shapes in the hand's file are too large, {why}, and were shrunk: {by}")
        if self.weight is not None:
            lines.append(f"weight: {weight_text(self.weight)}")
        for value in () if self.diagnosis is None else self.diagnosis.wrong:
            lines.append(f"{value.name}: {value.verdict}")
        lines += [end.message for end in self.ends if end.message]
        for name, errors in self.errors.items():
            n = errors.summary()
            base = f"{n['base_mean']:.1f} mm on average ({n['base_last']:.1f} at the end)"
            others = f"middle {n['middle_mean']:.1f} mm, rotation {n['rotation_mean']:.1f}°"
            lines.append(f"{name}: base centre off by {base}, {others}")
        return lines

    def _touch_sentences(self) -> Iterator[str]:
        """Yields sentences about fingers, tactile arrays and slips."""
        for finger, why in self.untouched.items():
            reasons = ", ".join(f"{reason} in {count}" for reason, count in why.items())
            yield f"finger {finger}: no contact in any observation ({reasons or 'none was taken'})"
        for finger, part in self.rejected.items():
            if part >= 0.5:
                often = f"in {100 * part:.0f} % of the poses while it touched"
                check = "check its topic, reading, bias, sensor.pose and surface"
                yield f"finger {finger}: contradicts the others {often}; {check}; `handsight rig check` tries them"
        if self.pressed:
            yield f"tactile arrays: pressed in {self.pressed} of {self.poses} poses"
        if self.unmeasured:
            yield f"no evidence of slips, as no force is measured there: {', '.join(sorted(self.unmeasured))}"
        for name, faults in self.tracker.skin.faults.items():
            yield f"skin {name}: {faults}"
        if slips := self.slips:
            first = next(iter(slips)) - self.steps[0].stamp
            times = "once" if len(slips) == 1 else f"{len(slips)} times"
            when = f"{sum(slips.values()):.2f} s in all, first at {first:.2f} s"
            yield f"the object slipped {times}, {when}; friction {self.friction:.2f}"


def latency_text(tracker: "Tracker") -> list[str]:
    """Returns a sentence where vision's poses are older than the rig declares by more than 20 ms, and by more than the
    error of what is known with a level of one in twenty; else none."""
    if (known := tracker.vision_latency()) is None:
        return []
    (latency, sigma), declared = known, tracker.vision.camera.latency
    if abs(latency - declared) <= 0.02 + 2 * sigma:
        return []
    age = f"{1e3 * latency:.0f} ± {1e3 * sigma:.0f} ms older than their stamps"
    rig_says = f"(the rig says {1e3 * declared:.0f}), which is taken into account"
    return [f"vision's poses are {age} {rig_says}; see camera.latency"]


def weight_text(weight: "ObjectWeight | None", why: str = "") -> str:
    """Returns a line about an object's mass and centre of mass, or `why` it was not weighed."""
    if weight is None:
        return f"not weighed: {why or 'not in the air'}"
    place = ", ".join(str(round(1e3 * x)) for x in weight.center_object)  # round: no -0
    sigma = 1e3 * math.sqrt(weight.covariance.trace() / 3)
    text = f"{1e3 * weight.mass:.0f} ± {1e3 * weight.sigma_mass:.0f} g, centre [{place}] ± {sigma:.0f} mm in the object"
    if weight.biased:
        text += f"; the excess force of {', '.join(weight.biased)} in the air is subtracted"
    if weight.assumed:
        text += f"; {weight.assumed}"
    return f"not believed: {weight.reason} ({text})" if weight.reason else text


def refusals(tally: "Tally") -> list[str]:
    """Returns a sentence for each of the five most frequent reasons for which observations were left out."""
    return [f"{count} observations left out: {message}" for message, count in tally.refused.most_common(5)]


def print_diagnosis(diagnosis: "Diagnosis") -> None:
    """Prints a line for each value that a recording measures, the most doubtful first, and names the others."""
    measured, rows = [v for v in diagnosis.values if v.measured or v.wrong], list[tuple[str, ...]]()
    for v in sorted(measured, key=lambda v: (not v.wrong, -v.chi2)):
        known = f"{v.declared:.4g} ± {v.sigma:.3g}", f"{v.estimated:.4g} ± {v.sigma_estimated:.3g}"
        rows.append((v.name, v.unit, *known, f"{v.chi2:.1f}", v.verdict))
    if rows:
        print_out("", plain_table(("value", "in", "declared", "recording", "χ²", "verdict"), rows, texts=2))
    others = [v.name for v in diagnosis.values if v not in measured]
    joints = [name for name in others if re.match("joint ", name)]
    shifts = [name for name in others if re.match("tip .* shift", name)]
    kinds = [f"{len(joints)} joints"] * bool(joints) + [f"{len(shifts)} shifts of tips"] * bool(shifts)
    kinds += [name for name in others if name not in joints and name not in shifts]
    text = f"Different grasps that were compared: {diagnosis.instants}."
    if diagnosis.message:
        text += f" They were not compared with joints, tips and size: {diagnosis.message}."
    elif kinds:
        text += f" The recording does not measure {', '.join(kinds)}."
    print_out(text)
