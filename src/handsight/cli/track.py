"""A recording tracked from end to end: what is shown meanwhile, what is written, what is said at the end."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handsight.errors import InvalidFile, MissingExtra
from handsight.objects import ObjectModel
from handsight.recording import (
    TrackRow,
    open_recording,
    write_track_csv,
    write_track_mcap,
    write_track_tum,
)
from handsight.rig import Rig
from handsight.tracking import Tracker, TrackerSettings
from handsight.tracking.replay import Errors, Step, Tally, Truths, errors, replay

REFRESH = 0.2
"""Seconds between two looks at a run."""
MOST_REFUSED = 5
"""Kinds of wrong observations that are told each."""


@dataclass(slots=True)
class Run:
    """A recording's way through a tracker."""

    name: str
    tally: Tally = field(default_factory=Tally)
    steps: list[Step] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    """What the recording has to say of itself."""
    corrections: int = 0
    reason: str = ""
    """Why the tracker's last state was no better."""
    vision: Errors | None = None
    tracked: Errors | None = None
    """Errors against the truth; None where the recording has none."""
    truths: Truths = field(default_factory=lambda: Truths([]))
    interrupted: bool = False

    def rows(self) -> Iterator[TrackRow]:
        """What was tracked, for files."""
        for step in self.steps:
            estimate = step.estimate
            yield TrackRow(step.stamp, estimate.T_palm_object, estimate.covariance, step.state, step.reason)

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
            "recording_says": self.said,
            "errors_mm_deg": {
                name: _error_numbers(found)
                for name, found in (("vision", self.vision), ("tracked", self.tracked))
                if found is not None and len(found)
            },
        }

    def sentences(self) -> list[str]:
        """The run for a person."""
        tally = self.tally
        factor = f"{tally.recorded / tally.wall:.0f}x real time" if tally.wall else "nothing to time"
        lines = [
            f"{tally.answered} poses of {tally.observations} observations, {self.corrections} corrections; "
            f"{tally.recorded:.1f} s in {tally.wall:.1f} s ({factor})"
        ]
        spent = ", ".join(
            f"{state} {seconds:.1f} s" for state, seconds in sorted(tally.states.items(), key=lambda s: -s[1])
        )
        if spent:
            lines.append(spent + (f"; at the end: {self.reason}" if self.reason else ""))
        lines += [
            f"{count} observations left out: {said}"
            for said, count in tally.refused.most_common(MOST_REFUSED)
        ]
        for name, found in (("vision", self.vision), ("tracked", self.tracked)):
            if found is not None and len(found):
                n = _error_numbers(found)
                lines.append(
                    f"{name}: base centre off by {n['base_mean']:.1f} mm on average ({n['base_last']:.1f} at the end), "
                    f"middle {n['middle_mean']:.1f} mm, rotation {n['rotation_mean']:.1f}°"
                )
        return lines


def _error_numbers(found: Errors) -> dict[str, float]:
    return {
        "base_mean": 1e3 * float(found.base.mean()),
        "base_last": 1e3 * float(found.base[-1]),
        "middle_mean": 1e3 * float(found.middle.mean()),
        "middle_last": 1e3 * float(found.middle[-1]),
        "rotation_mean": float(np.rad2deg(found.rotation.mean())),
        "count": len(found),
    }


def watching(show: Callable[[list[tuple[str, str]]], None]) -> Callable[[Tally, Step, Tracker], None]:
    """Shows the run a few times a second."""
    last = -np.inf

    def watch(tally: Tally, step: Step, tracker: Tracker) -> None:
        """The run as it is now, unless it was shown a moment ago."""
        nonlocal last
        now = time.monotonic()
        if now - last < REFRESH:
            return
        last = now
        position = 1e3 * step.estimate.T_palm_object[:3, 3]
        show(
            [
                ("state", step.state + (f": {step.reason}" if step.reason else "")),
                ("time", f"{tally.recorded:.1f} s, {tally.recorded / max(tally.wall, 1e-9):.1f}x real time"),
                (
                    "rate",
                    f"{tally.answered / max(tally.recorded, 1e-9):.0f} poses/s, {tracker.corrections} corrections",
                ),
                ("position", "x {:.1f}, y {:.1f}, z {:.1f} mm in the palm".format(*position)),
                ("σ", f"{1e3 * step.sigma:.1f} mm"),
                ("touching", ", ".join(step.fingers) or "nothing"),
            ]
        )

    return watch


def run(
    path: Path,
    rig: Rig,
    model: ObjectModel,
    settings: TrackerSettings,
    watch: Callable[[Tally, Step, Tracker], None],
) -> Run:
    """Tracks a recording; Ctrl-C ends it early, and what was tracked by then is there."""
    ended = Run(path.name)
    tracker = Tracker(rig, model, settings=settings)
    with open_recording(path, rig) as recording:
        try:
            observations = recording.observations()
            for step in replay(observations, tracker, ended.tally):
                ended.steps.append(step)
                watch(ended.tally, step, tracker)
        except KeyboardInterrupt:
            ended.interrupted = True
            # It may come between an answer's count and the answer.
            ended.tally.answered = len(ended.steps)
        ended.said = [*recording.report.sentences(), *recording.lacks()]
        ended.truths = Truths(recording.truth)
    ended.corrections, ended.reason = tracker.corrections, tracker.reason
    if len(ended.truths):
        ended.vision = errors(model, ended.steps, ended.truths, vision=True)
        ended.tracked = errors(model, ended.steps, ended.truths, vision=False)
    return ended


def write(ended: Run, rig: Rig, model: ObjectModel, folder: Path) -> Iterator[str]:
    """Writes the results into a folder, and says what was written, or why a figure was not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidFile(f"{folder}: {error.strerror}") from None
    rows = list(ended.rows())
    write_track_mcap(folder / "track.mcap", rows, frame=rig.frames["palm"])
    write_track_tum(folder / "track.tum", rows)
    write_track_csv(folder / "track.csv", rows)
    text = json.dumps(ended.summary(), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    yield f"wrote {folder}: track.mcap, track.tum, track.csv, summary.json"
    if not rows:
        yield "no picture: there is no pose"
        return
    try:
        from handsight.viewer.track import draw_track

        draw_track(ended.name, model, ended.steps, ended.truths, folder / "track.png")
        yield f"wrote {folder / 'track.png'}"
    except MissingExtra as error:
        yield f"no picture: {error}"
