"""`handsight rig new`: the first rig of a hand, guessed from its file and from a recording, or a copy of an example."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from handsight.cli.terminal import say
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import write_errors

if TYPE_CHECKING:
    from handsight.hand.guess import GuessedTip

EXAMPLES = Path(__file__).parents[1] / "data" / "rigs"


def new(
    hand: Annotated[Path | None, Argument(help="The hand's URDF or MJCF.")] = None,
    recording: Annotated[Path | None, Argument(help="A recording, whose topics the rig is to have.")] = None,
    output: Annotated[
        Path | None, Option("--output", "-o", help="File for the rig. Default: HAND.rig.yaml in this folder.")
    ] = None,
    like: Annotated[
        str | None, Option(metavar="NAME", help="Copy the example rig of this hand, such as allegro.")
    ] = None,
) -> None:
    """Write the first rig of a hand, with a comment beside each key, to be checked and completed.

    The palm and the fingertips are guessed from the hand's file: fingers end in the last links that move, tips are
    spheres that fit the ends of their meshes. Topics are matched by the types of their messages and by their names;
    those of taxels, and a URDF's tactile sensors, give `skin`. All that was guessed is printed, and at the head of the
    file. What no file says has to be filled in: each sensor's pose, `reading` and noise, the camera's pose, the object.
    A file that exists is never overwritten.

    ```
    handsight rig new my_hand.urdf grasp.mcap
    handsight rig new --like allegro
    ```
    """
    examples = {path.name.removesuffix(".rig.yaml"): path for path in sorted(EXAMPLES.glob("*.rig.yaml"))}
    if hand is not None and like is None:
        text, name = _guessed(hand, recording), hand.stem
    elif hand is None and like is not None:
        if like not in examples:
            raise InvalidInput(f"--like: expected one of {', '.join(examples)}, got {like!r:.60}")
        text, name = examples[like].read_text(encoding="utf-8"), like
    else:
        came = "neither" if like is None else "both"
        raise InvalidInput(f"expected the hand's file, or --like and the name of an example, got {came}")
    path = output or Path(f"{name}.rig.yaml")
    with write_errors(path):
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            raise InvalidFile(
                f"{path}: expected a new file, got one that exists; --output names another"
            ) from None
    say(
        f"wrote {path}; next: handsight rig check {path}{'' if recording is None else f' {recording}'} --plot hand.png"
    )


def _guessed(file: Path, recording: Path | None) -> str:
    """Returns the text of a rig, with what was guessed at its head, and prints that; raises InvalidFile."""
    import numpy as np

    from handsight import se3
    from handsight.contact import Sphere, WrenchCalibration
    from handsight.hand import Hand
    from handsight.hand.guess import guess_hand
    from handsight.messages.match import match_taxels, match_topics
    from handsight.recording.open import open_files
    from handsight.rig import Finger, MountedCamera, Rig, Topics, save

    palm, tips = guess_hand(file)
    types = dict[str, str]()
    for source in open_files(recording) if recording is not None else ():
        types |= source.topics
        source.close()
    topics, used = match_topics(types, list(tips))
    skin = _skin(file, tips, match_taxels(types, list(tips)))
    if recording is None:
        topics = Topics(wrenches={name: f"/{name}/wrench" for name in tips})
    unread = WrenchCalibration(*(np.zeros(3), np.zeros(3), 0.0, np.zeros(3)), reading="on_sensor")
    fingers = {
        name: Finger(
            frame=tip.link,
            T_frame_surface=tip.T_link_surface,
            tip=Sphere(tip.radius, cap=-tip.radius / 2, T_surface_sensor=se3.inverse(tip.T_link_surface)),
            calibration=unread,
        )
        for name, tip in tips.items()
    }
    in_images = topics.vision is not None or topics.depth is not None
    rig = Rig(
        hand=Hand.from_file(file, palm=palm, tips={name: tip.link for name, tip in tips.items()}),
        fingers=fingers,
        camera=MountedCamera() if in_images else None,
        world_from="tf" if topics.tf is not None else None,
        topics=topics,
    )
    lines = [f"palm: {palm}, the last link that all fingers hang on"]
    lines += [
        f"finger {name}: {tip.link} is its tip, a sphere of {1e3 * tip.radius:.1f} mm by its mesh: measure it"
        for name, tip in tips.items()
    ]
    lines += [f"topic {topic}: {what}" for topic, what in used.items()]
    lines += [f"skin {name}: of {entry.get('topic', 'a topic to fill in')}" for name, entry in skin.items()]
    if others := sorted(types.keys() - used.keys() - {entry.get("topic") for entry in skin.values()}):
        lines.append(f"not used: {', '.join(others)}")
    if topics.wrenches:
        lines.append(
            "to fill in: each sensor's pose, reading (on_sensor or on_tip), noise, bias and tip_mass"
        )
    lines.append("to fill in: the camera's pose, and objects" if in_images else "to fill in: objects")
    for line in lines:
        say(line)
    head = "".join(f"# Guessed: {line}\n" for line in lines).replace("Guessed: to fill", "To fill")
    guess = "# Each at the end of its tip, z out of the skin, y along its columns: measure, count, see docs/sensors.md"
    surfaces = [f"  {save.inline(name)}: {save.inline(entry)}" for name, entry in skin.items()]
    return head + save.text(rig) + "".join(f"{line}\n" for line in [guess, "skin:", *surfaces] if surfaces)


def _skin(
    file: Path, tips: "Mapping[str, GuessedTip]", taxels: "Mapping[str, Mapping[str, object]]"
) -> dict[str, dict[str, object]]:
    """Returns the rig's entries of tactile surfaces: those of the hand's URDF, else one at the end of each tip."""
    from handsight import se3
    from handsight.rig.layouts import tactile_sensors

    topic = {"topic": entry["topic"] for entry in taxels.values()}  # noqa: B035 - the last one
    skin = {name: {"urdf": name, "threshold": 0.1, **topic} for name in tactile_sensors(file)}
    for finger, entry in taxels.items() if not skin else ():
        T, radius = tips[finger].T_link_surface, tips[finger].radius
        end = {
            "position": T[:3, 3] + radius * T[:3, 2],
            "quaternion_xyzw": se3.quaternion_from_rotation(T[:3, :3]),
        }
        skin[f"{finger}_tip"] = {"frame": tips[finger].link, "pose": end, **entry}
    return skin
