"""`handsight simulate`: a scenario simulated into a recording, its rig beside it."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.options import DEPTH_CAMERAS, own_rig
from handsight.cli.terminal import announce_compiling, bar, say
from handsight.errors import InvalidFile, InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectSpec
    from handsight.recording.write import McapFile
    from handsight.rig import Rig
    from handsight.simulation import Grasp, Nuisances, Sample, Scenario

BEGINS = 1000.0
"""Stamp of a recording's first observation [s]: 0 is what robots say that do not know the time."""
TWIST = "geometry_msgs/msg/TwistStamped"
MODELS_OWN = ("object_dent", "object_scan")
"""Nuisances of the robot's model that a rig file cannot say; `handsight.simulation.model_of` makes such models."""


def simulate(
    object: Annotated[str, typer.Argument(help="can, box, or a mesh file in metres.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The recording, MCAP; default: OBJECT-SEED.mcap here."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    motion: Annotated[
        str,
        typer.Option(
            metavar="grasp|manipulate|weigh|ramp|steps|sine",
            help="grasp: close and hold; manipulate: then move, lift and turn the object; weigh: then lift and tilt "
            "it; ramp, steps, sine: then lift it, and something pulls it until it slips.",
        ),
    ] = "manipulate",
    images: Annotated[bool, typer.Option("--images", help="Record the camera's images as well.")] = False,
    skin: Annotated[
        bool,
        typer.Option(
            "--skin", help="Give the palm a tactile array, and hold the can against it: a power grasp."
        ),
    ] = False,
    depth_camera: Annotated[
        str, typer.Option(metavar=DEPTH_CAMERAS, help="How the camera measures depth.")
    ] = "structured_light",
    nuisance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="Another size of a nuisance, in SI units; `none` switches all off."
        ),
    ] = None,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind",
            help="No camera: a finger first searches the object on the table, and it is grasped there.",
        ),
    ] = False,
    grasp: Annotated[
        Path | None,
        typer.Option(help="A grasp found before, OUTPUT.grasp.json of a recording; default: search one."),
    ] = None,
) -> None:
    """Record a simulated Shadow hand that grasps an object, with the truth on a topic of its own.

    Beside the recording goes its rig, OUTPUT.rig.yaml, and for a mesh its grasp, OUTPUT.grasp.json: grasps are tried
    in the simulator until one holds. All of it is synthetic (MuJoCo); what spoils the readings, and by how much, is a
    setting each: `--nuisance joint_offset=0 --nuisance force_noise=0.02`, and so is how hard it is pulled where it is:
    `--motion ramp --nuisance friction=0.6 --nuisance pull_force=6 --nuisance pull_torque=0.05`. With `--blind` what the
    search has found is in the recording as one pose in the world, from which `handsight track` goes on.
    """
    from handsight.simulation import Scenario, read_grasp

    announce_compiling()
    chosen: dict[str, Any] = {
        "motion": motion,
        "depth_camera": depth_camera,
    }  # the scenario says which there are
    scenario = Scenario(
        object=object, seed=seed, images=images, skin=skin, nuisances=nuisances(nuisance or []), **chosen
    )
    if blind and images:
        raise InvalidInput("--images: expected none with --blind, which has no camera, got some")
    path = output or Path(f"{Path(object).stem}-{seed}.mcap")
    _recordable(path)
    chosen_grasp = read_grasp(grasp) if grasp else _found(scenario, path)
    samples, dropped = record(scenario, path, chosen_grasp, blind=blind)
    size = f"{path.stat().st_size / 1e6:.1f} MB (synthetic)"
    say(f"wrote {path}: {samples} observations, {size}, and {own_rig(path).name}")
    if dropped:
        say("the object has slipped out of the grasp; another --seed may hold it")


def nuisances(settings: Iterable[str]) -> "Nuisances":
    """Returns the usual nuisances with some of another size, from `name=value`; `none` begins with all of them off."""
    from handsight import checks
    from handsight.simulation import Nuisances

    chosen = Nuisances()
    names = [field.name for field in dataclasses.fields(Nuisances)]
    for setting in settings:
        if setting == "none":
            chosen = Nuisances.none()
            continue
        name, equals, value = setting.partition("=")
        if not equals or name not in names:
            raise InvalidInput(
                f"--nuisance: expected none or NAME=VALUE, got {setting!r}{checks.suggestion(name, names)}"
            )
        if name in MODELS_OWN:
            raise InvalidInput(
                f"--nuisance {name}: expected one of the recording, got one of the object's model"
            )
        try:
            chosen = dataclasses.replace(chosen, **{name: float(value)})
        except ValueError as error:
            message = str(error) if isinstance(error, InvalidInput) else f"expected a number, got {value!r}"
            raise InvalidInput(f"--nuisance {name}: {message.removeprefix(f'{name}: ')}") from None
    return chosen


def record(
    scenario: "Scenario", path: Path, grasp: "Grasp | None" = None, *, blind: bool = False
) -> tuple[int, bool]:
    """Returns how many observations were simulated into `path`, and whether the hand dropped the object in the end.

    `grasp`: else the object's own, or one that is searched. `blind`: a finger searches the object first. The rig is
    written beside it. Ctrl-C, or an error, leaves what was simulated by then.
    """
    from handsight.recording import RecordingWriter
    from handsight.rig.save import write as write_rig
    from handsight.simulation import rig_of, simulate, simulate_touch_search, touch_search_rig
    from handsight.simulation.loads import pulls

    _recordable(path)
    rig = touch_search_rig(scenario) if blind else rig_of(scenario)
    # The one object there is need not be named to `track`.
    rig = dataclasses.replace(rig, objects={Path(scenario.object).stem: _believed(scenario, rig)})
    samples, dropped = 0, False
    with RecordingWriter(path, rig) as writer, bar("simulating") as advance:
        write_rig(rig, own_rig(path))
        for sample in simulate_touch_search(scenario, grasp) if blind else simulate(scenario, advance, grasp):
            observation = dataclasses.replace(sample.observation, stamp=BEGINS + sample.observation.stamp)
            writer.write(observation)
            writer.write_truth(observation.stamp, sample.T_palm_object)
            if pulls(scenario.motion):
                write_slips(writer, observation.stamp, sample, rig)
            samples, dropped = samples + 1, sample.dropped
    return samples, dropped


def write_slips(writer: "McapFile", stamp: float, sample: "Sample", rig: "Rig") -> None:
    """Appends how the object truly moves along each tip that touches it, in the palm: `/slip/FINGER` by the truth."""
    from types import SimpleNamespace as Message

    from handsight.recording.write import header, parts

    top = header(stamp, rig.frames["palm"])
    for finger, touch in sample.touches.items():
        velocity, turn = parts("xyz", touch.velocity_palm[:3]), parts("xyz", touch.velocity_palm[3:])
        twist = Message(linear=velocity, angular=turn)
        writer.append(f"{rig.topics.truth}/slip/{finger}", TWIST, stamp, header=top, twist=twist)


def _recordable(path: Path) -> None:
    if path.suffix.lower() != ".mcap":
        raise InvalidFile(f"{path}: expected a name that ends in .mcap")


def _found(scenario: "Scenario", path: Path) -> "Grasp":
    """Returns the scenario's grasp; one that was searched is said, and written beside the recording."""
    from handsight.simulation import find_grasp, write_grasp

    with bar("searching a grasp") as advance:
        found = find_grasp(scenario, advance)
    if found.trials:
        beside = path.with_suffix(".grasp.json")
        write_grasp(found, scenario.object, beside)
        before = f" ({found.failures})" if found.failures else ""
        end = "the last one holds" if found.succeeded else "none holds, this one did longest"
        say(f"wrote {beside}: {found.hold}; of {found.trials} grasps tried {end}{before}")
    return found.grasp


def _believed(scenario: "Scenario", rig: "Rig") -> "ObjectSpec":
    """Returns the object in the size that the robot takes it to have."""
    from handsight.objects import ObjectSpec

    entry = rig.objects.get(scenario.object) or ObjectSpec(mesh=Path(scenario.object))
    k = scenario.nuisances.object_scale
    if scenario.nuisances.object_off_center:
        entry = dataclasses.replace(entry, center_of_mass=None, sigma_center_of_mass=None)  # it is not known
    if entry.box is not None:
        x, y, z = entry.box
        return dataclasses.replace(entry, box=(k * x, k * y, k * z))
    if entry.cylinder is not None:
        radius, height = entry.cylinder
        return dataclasses.replace(entry, cylinder=(k * radius, k * height))
    return dataclasses.replace(entry, scale=k * entry.scale)
