"""`handsight simulate`: a simulated scenario as a recording, with its rig beside it."""

import contextlib
import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from handsight.cli.options import refuse, rig_beside
from handsight.cli.terminal import announce_compiling, bar, say
from handsight.errors import InvalidFile, InvalidInput, NotFound

if TYPE_CHECKING:
    from handsight.checks import Array
    from handsight.objects import ObjectSpec
    from handsight.recording.write import McapFile
    from handsight.rig import Rig
    from handsight.search import Belief
    from handsight.simulation import Grasp, Nuisances, Sample, Scenario
    from handsight.simulation.grasp_search import GraspSearchResult

BEGINS = 1000.0
"""Stamp of a recording's first observation [s]; not 0, as a stamp of 0 means that a robot does not know the time."""


def simulate(
    object: Annotated[str, Argument(help="can, box, a mesh file in metres, or a name in the library.")],
    output: Annotated[
        Path | None,
        Option("--output", "-o", help="File for the recording: MCAP. Default: OBJECT-SEED.mcap."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed of all random numbers.")] = 0,
    motion: Annotated[
        str,
        Option(
            metavar="KIND",
            help="grasp: close the hand and hold the object; manipulate: then also move, lift and turn it; weigh: lift "
            "and tilt it; ramp, steps, sine, creep, jerks: lift it, and pull it with a force of that shape until it "
            "slips.",
        ),
    ] = "manipulate",
    images: Annotated[bool, Option("--images", help="Record the depth camera's images as well.")] = False,
    skin: Annotated[
        bool,
        Option(
            "--skin", help="Add a tactile array to the palm, and hold the can against it in a power grasp."
        ),
    ] = False,
    sensors: Annotated[
        str,
        Option(
            metavar="KIND",
            help="What is in the fingertips, and in the palm with --skin: `wrench`, force/torque sensors, or a maker's "
            "kind of taxels: `xela`, `paxini`, `inspire`.",
        ),
    ] = "wrench",
    world: Annotated[
        str,
        Option(
            metavar="usual|harsh",
            help="usual: errors as the rig states them; harsh: everything wrong at once and larger, drawn by the seed.",
        ),
    ] = "usual",
    nuisance: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=VALUE",
            help="Value of a nuisance, in SI units, in place of the world's; `none` switches all off. May be given "
            "several times.",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        Option(
            help="Rig file of your own hand, with a force/torque sensor in each fingertip. Default: a Shadow hand."
        ),
    ] = None,
    blind: Annotated[
        bool,
        Option(
            "--blind",
            help="No camera: a finger searches for the object on the table, and the hand then grasps it.",
        ),
    ] = False,
    grasp: Annotated[
        Path | None,
        Option(
            help="File of the grasp to use, the OUTPUT.grasp.json of an earlier recording. Default: search for a grasp."
        ),
    ] = None,
) -> None:
    """Record a simulated hand that grasps an object; its true pose in the palm is on a topic of its own.

    The hand is the Shadow hand, or any URDF or MJCF hand of a --rig: its grasps are searched as well, nothing is known
    of it but its file and its fingertips. Joints have position servos of 3 N m/rad. Coupled ones follow those that they
    are coupled to, each off by a constant angle of the size that the rig states (`coupled_joint_deg`), and are not
    measured. Camera, table and world are the simulation's. Where no grasp holds, the reasons
    are printed, and the exit code is 1.

    The rig is written beside the recording as OUTPUT.rig.yaml, and the grasp of a mesh as OUTPUT.grasp.json: grasps are
    tried in the simulator until one holds. Everything is synthetic (MuJoCo). Errors of the measurements are set by
    nuisances, such as joint_offset [rad] and force_noise [N]; the pull is set by friction, pull_force [N] and
    pull_torque [N m], the errors of taxels by taxel_noise, taxel_hysteresis, taxel_crosstalk (shares) and taxel_dead
    (how many on each surface). With `--blind`, each touch is reported with what is known after it, the recording has
    the pose that the search found, in the world, and `handsight track` starts from it; the exit code is 1 if it found
    none.

    In a harsh world sensors' gains are wrong and their readings stick, joints are off by up to twice what the rig
    states, the camera is late and its error wanders, messages are lost, tips, table, size and mass are not as declared,
    contacts are soft, and friction is lower. The rig knows nothing of it: does the tracker notice? OUTPUT.world.json
    has all that was drawn. With many seeds the hand drops the object.

    ```
    handsight simulate can --output can.mcap
    handsight simulate box --images --nuisance joint_offset=0 --nuisance force_noise=0.02
    handsight simulate box --rig my.rig.yaml
    handsight simulate can --blind
    handsight simulate can --motion ramp --nuisance friction=0.6 --nuisance pull_force=6 --nuisance pull_torque=0.05
    handsight simulate box --sensors xela --nuisance taxel_dead=2
    handsight simulate box --world harsh --seed 1
    handsight simulate box --nuisance message_loss=0.05 --nuisance vision_delay=0.2
    ```
    """
    from handsight.files import text_file
    from handsight.rig import Rig
    from handsight.simulation import Nuisances, Scenario, constant_errors, read_grasp, write_grasp
    from handsight.simulation.scene import scene
    from handsight.simulation.world import coupling_errors

    announce_compiling()
    if world not in ("usual", "harsh"):
        raise InvalidInput(f"--world: expected usual or harsh, got {world!r:.60}")
    start = Nuisances.harsh(seed) if world == "harsh" else Nuisances()
    own = None if rig is None else Rig.from_file(rig)
    if own is not None and world == "usual":  # errors as the rig states them
        fingers = own.fingers.values()
        start = dataclasses.replace(
            start,
            joint_offset=own.sigma_joint_offset,
            joint_noise=own.sigma_joint,
            coupled_joint=own.sigma_coupled,
            force_noise=max(finger.sigma_force for finger in fingers),
            torque_noise=max(finger.sigma_torque for finger in fingers),
        )
    drawn = nuisances(nuisance or [], start)
    kinds: dict[str, Any] = {"motion": motion, "sensors": sensors}
    scenario = Scenario(object=object, seed=seed, nuisances=drawn, images=images, skin=skin, rig=own, **kinds)
    if blind:
        refuse("--blind", images=images, sensors=sensors != "wrench", rig=own)
    path = output or Path(f"{Path(object).stem}-{seed}.mcap")
    if path.suffix.lower() != ".mcap":
        raise InvalidFile(f"{path}: expected a name that ends in .mcap")
    searched = None
    if grasp is None:
        searched = search(scenario)
        used = searched.grasp
    else:
        used = read_grasp(grasp, scene(scenario.object, rig=own).hand.grasping if own else None)
    samples, dropped = record(scenario, path, used, blind=blind)
    if searched is not None and searched.trials:  # the grasp is not built in
        beside = path.with_suffix(".grasp.json")
        write_grasp(searched, scenario.object, beside)
        say(f"wrote {beside}: {_described(searched)}")
    size = f"{path.stat().st_size / 1e6:.1f} MB (synthetic)"
    say(f"wrote {path}: {samples} observations, {size}, and {rig_beside(path).name}")
    if world == "harsh":
        beside = path.with_suffix(".world.json")
        errors = dataclasses.asdict(constant_errors(scenario))
        content: dict[str, Any] = {"seed": seed, "nuisances": dataclasses.asdict(drawn)}
        content["drawn"] = {name: value.tolist() for name, value in errors.items()}
        content["drawn"] |= {"coupled_joints": coupling_errors(scenario)}
        with text_file(beside) as file:
            file.write(json.dumps(content, indent=1) + "\n")
        say(f"wrote {beside}: what is wrong in this world, which the rig does not know")
    if dropped:
        say("the object has slipped out of the grasp; another --seed may hold it")


def search(scenario: "Scenario") -> "GraspSearchResult":
    """Returns a grasp of the scenario's object; raises NotFound where no grasp of a rig's own hand holds."""
    from handsight.simulation import find_grasp

    with bar("searching a grasp") as advance:
        found = find_grasp(scenario, advance)
    if scenario.rig is not None and not found.succeeded:
        raise NotFound(f"{scenario.object}: no grasp holds it; of {found.trials} tried: {found.failures}")
    return found


def _described(found: "GraspSearchResult") -> str:
    before = f" ({found.failures})" if found.failures else ""
    end = "the last one holds" if found.succeeded else "none holds, this one did longest"
    return f"{found.hold}; of {found.trials} grasps tried {end}{before}"


def nuisances(settings: Iterable[str], start: "Nuisances | None" = None) -> "Nuisances":
    """Returns the default nuisances, or `start`, with changes `name=value`, in order; `none` switches all off.

    Raises InvalidInput.
    """
    from handsight import checks
    from handsight.simulation import Nuisances

    chosen = start or Nuisances()
    names = [field.name for field in dataclasses.fields(Nuisances)]
    for setting in settings:
        if setting == "none":
            chosen = Nuisances.none()
            continue
        name, equals, value = setting.partition("=")
        if not equals or name not in names:
            came = f"{setting!r}{checks.suggestion(name, names)}"
            raise InvalidInput(f"--nuisance: expected none or NAME=VALUE, got {came}")
        try:
            chosen = dataclasses.replace(chosen, **{name: float(value)})
        except ValueError as error:
            message = str(error) if isinstance(error, InvalidInput) else f"expected a number, got {value!r}"
            raise InvalidInput(f"--nuisance {name}: {message.removeprefix(f'{name}: ')}") from None
    return chosen


def record(scenario: "Scenario", path: Path, grasp: "Grasp", *, blind: bool) -> tuple[int, bool]:
    """Simulates a recording; returns its number of observations, and whether the object was dropped at the end.

    `blind`: a finger searches for the object first, and each touch is reported. The rig is written beside the
    recording. After Ctrl-C or an error both are as they were before.
    """
    from handsight.recording import RecordingWriter
    from handsight.rig.save import write as write_rig
    from handsight.simulation import rig_of, simulate, simulate_touch_search, touch_search_rig
    from handsight.simulation.world import pulls

    rig = touch_search_rig(scenario) if blind else rig_of(scenario)
    # With one object only, `track` needs no name.
    spec = believed_object(scenario, rig)
    if blind and spec.mesh is not None:  # the search does not distinguish what touch cannot tell
        spec = dataclasses.replace(spec, symmetries="find")
    rig = dataclasses.replace(rig, objects={Path(scenario.object).stem: spec})
    samples = 0
    dropped = False
    with contextlib.ExitStack() as stack:
        writer = RecordingWriter(path, rig)
        stack.callback(writer.discard)
        advance = stack.enter_context(bar("simulating"))
        searched = simulate_touch_search(scenario, grasp, say_touch)
        for sample in searched if blind else simulate(scenario, advance, grasp):
            observation = dataclasses.replace(sample.observation, stamp=BEGINS + sample.observation.stamp)
            writer.write(observation)
            writer.write_truth(observation.stamp, sample.T_palm_object)
            if pulls(scenario.motion):
                write_slips(writer, observation.stamp, sample, rig)
            samples += 1
            dropped = sample.dropped
        writer.close()
        write_rig(rig, rig_beside(path))
    return samples, dropped


def say_touch(belief: "Belief", T_world_object: "Array") -> None:
    """Says what is known after each touch of a search."""
    best = belief.modes[0]
    number = len(belief.touches)
    if number:
        say(f"touch {number}: position ± {1e3 * best.sigma_position:.1f} mm, certain to {best.certainty:.2f}")
    if best.is_certain:
        say(f"found by {number} touches")


def write_slips(writer: "McapFile", stamp: float, sample: "Sample", rig: "Rig") -> None:
    """Writes the object's true velocity along each fingertip that touches it, in the palm's frame [m/s, rad/s].

    Each is a TwistStamped on the truth's topic with `/slip/FINGER` behind it.
    """
    from handsight.messages.encode import Message, header, parts

    top = header(stamp, rig.frames["palm"])
    for finger, touch in sample.touches.items():
        velocity = parts("xyz", touch.velocity_palm[:3])
        turn = parts("xyz", touch.velocity_palm[3:])
        twist = Message(linear=velocity, angular=turn)
        topic = f"{rig.topics.truth}/slip/{finger}"
        writer.append(topic, "geometry_msgs/msg/TwistStamped", stamp, header=top, twist=twist)


def believed_object(scenario: "Scenario", rig: "Rig") -> "ObjectSpec":
    """Returns the object as the robot describes it, with the size error `object_scale`."""
    from handsight.objects import Library, ObjectSpec
    from handsight.objects.library.documents import METRES
    from handsight.simulation.robot import declared_weight

    mesh = Path(scenario.object)
    named = ObjectSpec(mesh=mesh) if mesh.suffix else ObjectSpec(name=scenario.object)
    spec = rig.objects.get(scenario.object) or named
    n = scenario.nuisances
    k = n.object_scale
    if n.declared_mass:
        mass, sigma = declared_weight(n)
        spec = dataclasses.replace(spec, mass=mass, center_of_mass="homogeneous", sigma_center_of_mass=sigma)
    elif n.object_off_center:
        # The robot does not know it.
        spec = dataclasses.replace(spec, center_of_mass=None, sigma_center_of_mass=None)
    if spec.box is not None:
        x, y, z = spec.box
        return dataclasses.replace(spec, box=(k * x, k * y, k * z))
    if spec.cylinder is not None:
        radius, height = spec.cylinder
        return dataclasses.replace(spec, cylinder=(k * radius, k * height))
    if spec.name is not None and k != 1:  # its file, in BOP's millimetres
        library = Library()
        entry = library.entry(spec.name)
        kept = spec.symmetries if entry.symmetries.trivial else "find"
        spec = dataclasses.replace(spec, name=None, mesh=library.file(entry), scale=METRES, symmetries=kept)
    return dataclasses.replace(spec, scale=k * spec.scale)
