"""A scenario simulated into a recording, its rig beside it."""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

from handsight import checks
from handsight.cli.terminal import bar
from handsight.errors import InvalidFile, InvalidInput
from handsight.recording import RecordingWriter
from handsight.rig import ObjectEntry, Rig
from handsight.rig.writing import write as write_rig
from handsight.simulation import Nuisances, Scenario, rig_of, simulate

MODELS_OWN = ("object_dent", "object_scan")
"""Nuisances of the robot's model that a rig file cannot say; `handsight.simulation.model_of` makes such models."""


def nuisances(settings: Iterable[str]) -> Nuisances:
    """The usual nuisances with some of another size, from `name=value`; `none` begins with all of them off."""
    chosen = Nuisances()
    names = [field.name for field in dataclasses.fields(Nuisances)]
    for setting in settings:
        if setting == "none":
            chosen = Nuisances.none()
            continue
        name, equals, value = setting.partition("=")
        if not equals or name not in names:
            raise InvalidInput(
                f"--nuisance: expected none or NAME=VALUE, got {setting!r}{checks.among(name, names)}"
            )
        if name in MODELS_OWN:
            raise InvalidInput(
                f"--nuisance {name}: expected one of the recording, got one of the object's model"
            )
        try:
            chosen = dataclasses.replace(chosen, **{name: float(value)})
        except ValueError as error:
            said = str(error) if isinstance(error, InvalidInput) else f"expected a number, got {value!r}"
            raise InvalidInput(f"--nuisance {name}: {said.removeprefix(f'{name}: ')}") from None
    return chosen


def record(scenario: Scenario, path: Path, say: Callable[[str], None]) -> None:
    """Simulates into `path`, and writes the rig beside it; Ctrl-C leaves what was simulated by then."""
    if path.suffix.lower() != ".mcap":
        raise InvalidFile(f"{path}: expected a name that ends in .mcap")
    rig = rig_of(scenario)
    # The one object there is need not be named to `track`.
    rig = dataclasses.replace(rig, objects={Path(scenario.object).stem: _believed(scenario, rig)})
    rig_path = path.with_name(f"{path.stem}.rig.yaml")
    samples, dropped = 0, False
    with RecordingWriter(path, rig) as writer, bar("simulating") as advance:
        for sample in simulate(scenario, advance):
            writer.write(sample.observation)
            writer.write_truth(sample.observation.stamp, sample.T_palm_object)
            samples, dropped = samples + 1, sample.dropped
    write_rig(rig, rig_path)
    say(
        f"wrote {path}: {samples} observations, {path.stat().st_size / 1e6:.1f} MB (synthetic), and {rig_path.name}"
    )
    if dropped:
        say("the object has slipped out of the grasp; another --seed may hold it")


def _believed(scenario: Scenario, rig: Rig) -> ObjectEntry:
    """The object in the size that the robot takes it to have."""
    entry = rig.objects.get(scenario.object) or ObjectEntry(mesh=Path(scenario.object))
    k = scenario.nuisances.object_scale
    if entry.box is not None:
        x, y, z = entry.box
        return ObjectEntry(box=(k * x, k * y, k * z))
    if entry.cylinder is not None:
        radius, height = entry.cylinder
        return ObjectEntry(cylinder=(k * radius, k * height))
    return dataclasses.replace(entry, scale=k * entry.scale)
