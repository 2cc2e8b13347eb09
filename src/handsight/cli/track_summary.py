"""The result of `handsight track`, in sentences and in numbers."""

import contextlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from handsight.cli.terminal import FAILED, End, kept_going, plain_table, print_out
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.evaluation import TrackErrors, Truths
    from handsight.forces import ObjectWeight
    from handsight.tracking.diagnosis import Diagnosis
    from handsight.tracking.replay import Step, Tally


@dataclass(slots=True)
class TrackResult:
    """A `TrackResult` is the result of tracking a recording."""

    name: str
    """Name of the recording."""
    tally: "Tally"
    truths: "Truths"
    steps: "list[Step]" = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    """Sentences about what is wrong with the recording."""
    corrections: int = 0
    reason: str = ""
    """The reason for the tracker's last state, or why there is no pose."""
    errors: "dict[str, TrackErrors]" = field(default_factory=dict)
    """Errors of "vision" and "tracked" against the truth, if the recording has it."""
    untouched: dict[str, dict[str, int]] = field(default_factory=dict)
    """For each finger that never touched anything: the number of observations without a contact, by reason."""
    margins: dict[str, float] = field(default_factory=dict)
    """For each link of the hand whose shape in the hand's file is too large: by how much [m]."""
    images: dict[str, int] = field(default_factory=dict)
    """Counts of depth images, if any were used: searched, object found, searched for the hand, hand found."""
    latency: tuple[float, float] | None = None
    """How much older vision's poses are than their stamps, and its standard deviation [s]; None without vision."""
    latency_declared: float = 0.0
    """What the rig says of it [s]."""
    weight: "ObjectWeight | None" = None
    """The object's weight, as measured last in the air."""
    diagnosis: "Diagnosis | None" = None
    """What the recording tells of the values that the rig and the model declare."""
    ends: list[End] = field(default_factory=list)
    """The ends of the parts of the command that ended early."""

    @property
    def exit_code(self) -> int:
        """Returns the command's exit code: that of the first part that ended early, or of a result without a pose."""
        return next((end.exit_code for end in self.ends), 0 if self.steps else FAILED)

    @contextlib.contextmanager
    def part(self) -> Iterator[End]:
        """Runs a part of the command that may end early, without ending the others."""
        with kept_going() as end:
            yield end
        if end.exit_code:
            self.ends.append(end)

    @property
    def friction(self) -> float | None:
        """Returns the coefficient of friction between object and fingertips as estimated at the end."""
        return self.steps[-1].slip.friction if self.steps else None

    @property
    def slips(self) -> list[tuple[float, float]]:
        """Returns the stamp and the duration of each slip [s]."""
        found: dict[float, float] = {}
        for step in self.steps:
            if step.slip.slipping:
                found[step.slip.began] = step.stamp - step.slip.began
        return list(found.items())

    @property
    def rejected(self) -> dict[str, float]:
        """Returns, by finger, the share of the poses with its contact in which the contact was an outlier."""
        touching = Counter(finger for step in self.steps for finger in step.fingers)
        wrong = Counter(finger for step in self.steps for finger in step.rejected)
        return {finger: wrong[finger] / count for finger, count in touching.items()}

    def summary(self) -> dict[str, object]:
        """Returns the result in numbers, ready for JSON."""
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
            "fingers_rejected": {finger: round(part, 3) for finger, part in self.rejected.items()},
            "link_margins_mm": {link: round(1e3 * margin, 1) for link, margin in self.margins.items()},
            "depth_images": self.images,
            "diagnosis": []
            if self.diagnosis is None
            else [value.numbers() for value in self.diagnosis.values],
            "vision_latency_ms": None if self.latency is None else [round(1e3 * x, 1) for x in self.latency],
            "weight": None if self.weight is None else weight_numbers(self.weight),
            "recording_says": self.messages,
            "friction": self.friction,
            "poses_with_skin": sum(step.skin.pressed for step in self.steps),
            "slips": [{"began": began, "seconds": round(seconds, 3)} for began, seconds in self.slips],
            "errors_mm_deg": {name: errors.summary() for name, errors in self.errors.items()},
        }

    def write_summary(self, path: Path) -> None:
        """Writes the summary as JSON."""
        text = json.dumps(self.summary(), indent=1, ensure_ascii=False, allow_nan=False)
        with write_errors(path):
            path.write_text(text + "\n", encoding="utf-8")

    def sentences(self) -> list[str]:
        """Returns the result as sentences for a person."""
        tally = self.tally
        factor = f"{tally.recorded / tally.wall:.0f}x real time" if tally.wall else "nothing to time"
        lines = [
            f"{tally.answered} poses of {tally.observations} observations, {self.corrections} corrections; "
            f"{tally.recorded:.1f} s in {tally.wall:.1f} s ({factor})"
        ]
        if not tally.answered:
            lines.append(f"no pose: {self.reason}")
        longest_first = sorted(tally.states.items(), key=lambda state: -state[1])
        if spent := ", ".join(f"{state} {seconds:.1f} s" for state, seconds in longest_first):
            lines.append(spent + (f"; at the end: {self.reason}" if self.reason else ""))
        lines += refusals(tally)
        lines += self._touch_sentences()
        if self.images:
            searched, detected, searched_hand, hands = self.images.values()
            hand = f"the hand in {hands} of {searched_hand} searched for it"
            lines.append(f"{searched} depth images: the object was found in {detected}, {hand}")
        if self.latency is not None:
            lines += latency_text(self.latency, self.latency_declared)
        if self.margins:
            by = ", ".join(f"{link} by {1e3 * margin:.1f} mm" for link, margin in self.margins.items())
            lines.append(
                "these shapes in the hand's file are too large, as they would be inside the object although the "
                f"contacts fit, and were shrunk: {by}"
            )
        if self.weight is not None:
            lines.append(f"weight: {weight_text(self.weight)}")
        for value in () if self.diagnosis is None else self.diagnosis.wrong:
            lines.append(f"{value.name}: {value.verdict}")
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
                    "check its reading, bias, sensor.pose and surface"
                )
        if pressed := sum(step.skin.pressed for step in self.steps):
            yield f"tactile arrays: pressed in {pressed} of {len(self.steps)} poses"
        if slips := self.slips:
            first = slips[0][0] - self.steps[0].stamp
            times = "once" if len(slips) == 1 else f"{len(slips)} times"
            yield (
                f"the object slipped {times}, {sum(seconds for _, seconds in slips):.2f} s in all, first at "
                f"{first:.2f} s; friction {self.friction:.2f}"
            )


def latency_text(known: tuple[float, float], declared: float) -> list[str]:
    """Returns a sentence where vision's poses are older than `declared` [s] by more than 20 ms and by more than the
    error of what is `known` (latency and its sigma [s]), with a level of one in twenty; else none."""
    latency, sigma = known
    if abs(latency - declared) <= 0.02 + 2 * sigma:
        return []
    return [
        f"vision's poses are {1e3 * latency:.0f} ± {1e3 * sigma:.0f} ms older than their stamps (the rig "
        f"says {1e3 * declared:.0f}), which is taken into account; see camera.latency"
    ]


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


def weight_numbers(weight: "ObjectWeight") -> dict[str, object]:
    """Returns an object's weight in numbers, ready for JSON."""
    return {
        "mass_kg": weight.mass,
        "sigma_mass_kg": weight.sigma_mass,
        "center_object_m": weight.center_object.tolist(),
        "covariance_m2": weight.covariance.tolist(),
        "directions": weight.directions,
        "not_believed": weight.reason,
        "biased": list(weight.biased),
        "assumed": weight.assumed,
    }


def refusals(tally: "Tally") -> list[str]:
    """Returns a sentence for each of the five most frequent reasons for which observations were left out."""
    return [f"{count} observations left out: {message}" for message, count in tally.refused.most_common(5)]


def print_diagnosis(diagnosis: "Diagnosis") -> None:
    """Prints a line for each value that a recording measures, the most doubtful first, and names the others."""
    measured = sorted(
        (v for v in diagnosis.values if v.measured or v.wrong), key=lambda v: (not v.wrong, -v.chi2)
    )
    rows = [
        (v.name, v.unit, f"{v.declared:.4g} ± {v.sigma:.3g}", f"{v.estimated:.4g} ± {v.sigma_estimated:.3g}",
         f"{v.chi2:.1f}", v.verdict)
        for v in measured
    ]  # fmt: skip
    if rows:
        print_out("", plain_table(("value", "in", "declared", "recording", "χ²", "verdict"), rows, texts=2))
    others = [v.name for v in diagnosis.values if not (v.measured or v.wrong)]
    many = {"joints": "joint ", "shifts of tips": "tip .* shift"}
    groups = {kind: [name for name in others if re.match(start, name)] for kind, start in many.items()}
    kinds = [f"{len(names)} {kind}" for kind, names in groups.items() if names]
    kinds += [name for name in others if not any(name in names for names in groups.values())]
    text = f"Different grasps that were compared: {diagnosis.instants}."
    if diagnosis.message:
        text += f" They were not compared with joints, tips and size: {diagnosis.message}."
    elif kinds:
        text += f" The recording does not measure {', '.join(kinds)}."
    print_out(text)
