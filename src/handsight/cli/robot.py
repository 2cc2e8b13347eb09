"""The commands for a robot's recordings: parse, call, print."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import live_rows, say
from handsight.errors import InvalidInput

if TYPE_CHECKING:
    from handsight.objects import ObjectModel
    from handsight.rig import Rig

INTERRUPTED = 130
rig_app = typer.Typer(help="What describes a robot: hand, fingertips, camera.", no_args_is_help=True)
calibrate_app = typer.Typer(help="What is constantly wrong, from a recording.", no_args_is_help=True)

Recorded = Annotated[Path, typer.Argument(help="MCAP, rosbag 1 (.bag), or a rosbag 2 folder.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="The robot; default: RECORDING.rig.yaml, else rig.yaml, beside the recording."
    ),
]
ObjectName = Annotated[
    str | None,
    typer.Option(
        "--object", help="A name of the rig's objects, or a mesh file in metres; default: its only object."
    ),
]


def register(app: typer.Typer) -> None:
    """Adds these commands to the program."""
    app.command()(track)
    app.command()(simulate)
    app.add_typer(rig_app, name="rig")
    app.add_typer(calibrate_app, name="calibrate")


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
    samples: Annotated[
        int, typer.Option(min=0, help="Answer with the posterior's mean of so many samples; 0: its maximum.")
    ] = 0,
    outside: Annotated[
        int,
        typer.Option(
            min=0,
            help="Use so many points of the hand's links, none of which can be inside the object; 500 serve well.",
        ),
    ] = 0,
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
    """
    from handsight.cli.track import run, watching, write
    from handsight.tracking import TrackerSettings

    found, model = _rig_and_object(recording, rig, object)
    folder = output or Path(f"{recording.name.removesuffix(recording.suffix)}-track")
    settings = TrackerSettings(rate=rate, samples=samples, outside=outside)
    with live_rows(recording.name) as show:
        ended = run(recording, found, model, settings, watching(show))
    for sentence in [*ended.said, *ended.sentences(), *write(ended, found, model, folder)]:
        say(sentence)
    if ended.interrupted:
        raise typer.Exit(INTERRUPTED)


def simulate(
    object: Annotated[str, typer.Argument(help="can, box, or a mesh file in metres, standing along z.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The recording, MCAP; default: OBJECT-SEED.mcap here."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    motion: Annotated[
        str, typer.Option(help="grasp: close and hold; manipulate: then move, lift and turn the object.")
    ] = "manipulate",
    images: Annotated[bool, typer.Option("--images", help="Record the camera's images as well.")] = False,
    nuisance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="Another size of a nuisance, in SI units; `none` switches all off."
        ),
    ] = None,
) -> None:
    """Record a simulated Shadow hand that grasps an object, with the truth on a topic of its own.

    Beside the recording goes its rig, OUTPUT.rig.yaml. All of it is synthetic (MuJoCo); what spoils the readings, and
    by how much, is a setting each: `--nuisance joint_offset=0 --nuisance force_noise=0.02`.
    """
    from handsight.cli.simulate import nuisances, record
    from handsight.simulation import Scenario

    chosen: Any = motion  # the scenario says which there are
    scenario = Scenario(
        object=object, seed=seed, motion=chosen, images=images, nuisances=nuisances(nuisance or [])
    )
    path = output or Path(f"{Path(object).stem}-{seed}.mcap")
    record(scenario, path, say)


@rig_app.command("check")
def check(
    rig: Annotated[Path, typer.Argument(help="A rig.yaml.")],
    recording: Annotated[Path | None, typer.Argument(help="A recording to check it against.")] = None,
) -> None:
    """Print the rig as a table, and what a recording lacks for it.

    The exit code is 1 where the recording lacks something that tracking needs.
    """
    from handsight.cli.rig import print_rig
    from handsight.rig import Rig

    found = Rig.from_file(rig)
    print_rig(found, str(rig))
    if recording is None:
        return
    from handsight.recording import open_recording

    with open_recording(recording, found) as opened:
        for _ in opened.observations():
            pass
        lacking = [*opened.report.sentences(), *opened.lacks()]
    for sentence in lacking:
        typer.echo(f"- {sentence}")
    if not lacking:
        typer.echo(f"{recording.name} has everything that this rig listens to.")
    if lacking:
        raise typer.Exit(1)


@calibrate_app.command("camera")
def camera(recording: Recorded, rig: RigFile = None, object: ObjectName = None) -> None:
    """The camera's constant error, from an object that was held while the palm turned.

    Vision's error stays where it is in the world while the palm turns with the object; so the two come apart, and touch
    says where the object is. Printed: the camera's corrected pose for the rig file, and how well it is known.
    """
    from handsight.rig.writing import pose_text
    from handsight.tracking.camera_calibration import LITTLE_TURN, calibrate_camera

    found, model = _rig_and_object(recording, rig, object)
    calibrated = calibrate_camera(recording, found, model)
    shift, turn = 1e3 * calibrated.correction[:3], calibrated.correction[3:]
    sigma = calibrated.covariance.diagonal() ** 0.5
    degrees = [[math.degrees(angle) for angle in part] for part in (turn, sigma[3:])]
    typer.echo(f"camera:\n  pose: {pose_text(calibrated.T_mount_camera)}")
    moved = "# shifted by [{:.1f}, {:.1f}, {:.1f}] mm at the object, turned by [{:.2f}, {:.2f}, {:.2f}]°"
    typer.echo(moved.format(*shift, *degrees[0]))
    known = "# known to ± [{:.1f}, {:.1f}, {:.1f}] mm, [{:.2f}, {:.2f}, {:.2f}]° (one standard deviation)"
    typer.echo(known.format(*(1e3 * sigma[:3]), *degrees[1]))
    if calibrated.turned < LITTLE_TURN:
        say(
            f"the palm turned by {math.degrees(calibrated.turned):.0f}° only: error and pose are hardly told apart"
        )


def _rig_and_object(recording: Path, rig: Path | None, name: str | None) -> "tuple[Rig, ObjectModel]":
    from handsight.objects import ObjectModel
    from handsight.rig import Rig

    path = rig or _beside(recording)
    found = Rig.from_file(path)
    if name is None:
        if len(found.objects) != 1:
            raise InvalidInput(
                f"--object: expected, got nothing; {path} knows {', '.join(found.objects) or 'none'}"
            )
        name = next(iter(found.objects))
    if name in found.objects:
        return found, replace(found.objects[name].model(), name=name)
    if not Path(name).exists():
        from handsight.checks import among

        known = among(name, found.objects)
        raise InvalidInput(f"--object: expected a name of {path} or a mesh file, got {name!r}{known}")
    return found, ObjectModel.from_file(name)


def _beside(recording: Path) -> Path:
    own = recording.with_name(f"{recording.name.removesuffix(recording.suffix)}.rig.yaml")
    usual = recording.with_name("rig.yaml")
    for path in (own, usual):
        if path.exists():
            return path
    raise InvalidInput(
        f"--rig: expected, got nothing, and there is neither {own.name} nor rig.yaml beside {recording}"
    )
