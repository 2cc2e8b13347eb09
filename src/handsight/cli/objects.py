"""`handsight objects`: a library of objects: list, show, add, weigh, verify and fetch."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from handsight.cli.options import LibraryPlace, RecordingPath, RigPath, Run, find_rig
from handsight.cli.terminal import announce_compiling, bar, plain_table, print_out, say
from handsight.errors import InvalidInput, printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from handsight.objects.library import Library
    from handsight.objects.symmetry import Symmetries

objects_app = typer.Typer(
    help="Manage a library of objects: a folder in the format of the BOP benchmark, or a URL. Default: "
    "$HANDSIGHT_LIBRARY, else ~/.local/share/handsight/library.",
    no_args_is_help=True,
)

Name = Annotated[str, Argument(help="A name, or a number as in BOP.")]


@objects_app.command("list")
def list_(library: LibraryPlace = None) -> None:
    """Print all objects of the library: names, symmetries, licences, diameters [mm] and masses [g].

    ```
    handsight objects list --library https://host/ycbv
    ```
    """
    rows = []
    for entry in _opened(library).entries():
        facts = entry.facts
        mass = f"{1e3 * facts.mass:.4g}" if facts and facts.mass is not None else "-"
        texts = (entry.name, _symmetries(entry.symmetries), facts.licence if facts else "")
        rows.append((*texts, str(entry.number), f"{1e3 * entry.diameter:.1f}", mass))
    columns = ("name", "symmetries", "licence", "number", "diameter [mm]", "mass [g]")
    print_out(plain_table(columns, rows, texts=3))


@objects_app.command()
def show(name: Name, library: LibraryPlace = None) -> None:
    """Print the facts about an object; the exit code is 1 if its file is missing or was changed.

    ```
    handsight objects show mustard
    ```
    """
    opened = _opened(library)
    entry = opened.entry(name)
    known = {
        "name": entry.name,
        "file": f"{entry.file} of {entry.place}",
        "diameter": f"{1e3 * entry.diameter:.1f} mm",
    }
    if entry.size is not None:
        known["size"] = " x ".join(f"{1e3 * side:.1f}" for side in entry.size) + " mm"
    known["symmetries"] = _symmetries(entry.symmetries)
    if (facts := entry.facts) is not None:
        if facts.mass is not None:
            known["mass"] = f"{1e3 * facts.mass:.4g} g"
        if facts.center_of_mass is not None:
            place = ", ".join(f"{1e3 * x:.1f}" for x in facts.center_of_mass)
            sigma = facts.sigma_center_of_mass
            known["centre of mass"] = f"[{place}] mm" + (f" ± {1e3 * sigma:.1f} mm per axis" if sigma else "")
        known |= {key: text for key in ("licence", "source") if (text := getattr(facts, key))}
        known["SHA-256"] = facts.sha256
    for key, value in known.items():
        typer.echo(printable(f"{key:16}{value}"))
    _print_wrong(opened.wrong([entry]))


@objects_app.command()
def add(
    file: Annotated[
        Path, Argument(help="A mesh (STL, OBJ, PLY, OFF) or a point cloud (PLY, OFF, PCD, XYZ).")
    ],
    name: Annotated[str, Option(help="Name of the object in the library.")],
    scale: Annotated[float, Option(help="Metres per unit of the file; 0.001 for millimetres.")] = 1.0,
    mass: Annotated[float | None, Option(help="Mass [kg].")] = None,
    center_of_mass: Annotated[
        tuple[float, float, float] | None, Option(help="Centre of mass in the object's frame [m].")
    ] = None,
    sigma_center_of_mass: Annotated[
        float | None, Option(help="Standard deviation of the centre of mass per axis [m].")
    ] = None,
    symmetry: Annotated[
        list[str] | None,
        Option(
            metavar="z|z/N|find",
            help="Symmetry of shape and print: rotation by any angle about an axis (x, y, z) through the middle of the "
            "surface, or by an N-th of a turn; find: the symmetries of the shape. May be given several times.",
        ),
    ] = None,
    licence: Annotated[str, Option(help="Licence of the model.")] = "",
    source: Annotated[str, Option(help="Where the model is from.")] = "",
    force: Annotated[
        bool, Option("--force", help="Add it even if its size is not that of an object in a hand.")
    ] = False,
    library: LibraryPlace = None,
) -> None:
    """Add an object to a library in a folder; its model is stored as PLY in millimetres.

    An object is added completely or not at all, and several commands may add at the same time.

    ```
    handsight objects add mustard.obj --name mustard --mass 0.603 --symmetry z/2 --licence "CC BY 4.0"
    handsight objects add can.stl --name can --scale 0.001 --symmetry z --symmetry x/2
    ```
    """
    from handsight.objects import Facts, ObjectModel, Symmetries, declared_symmetries

    facts = Facts(
        name=name,
        mass=mass,
        center_of_mass=center_of_mass,
        sigma_center_of_mass=sigma_center_of_mass,
        licence=licence,
        source=source,
    )
    announce_compiling()
    symmetries = Symmetries()
    if symmetry:
        try:
            symmetries = declared_symmetries(ObjectModel.from_file(file, scale), symmetry)
        except InvalidInput as error:
            raise InvalidInput(f"--symmetry: {str(error).removeprefix('symmetry: ')}") from None
    opened = _opened(library)
    entry = opened.add(file, facts, scale=scale, symmetries=symmetries, force=force)
    size = f"diameter {1e3 * entry.diameter:.1f} mm, symmetries: {_symmetries(entry.symmetries)}"
    say(f"added {entry.name} to {opened.place} as {entry.file}: {size}")


@objects_app.command()
def verify(library: LibraryPlace = None) -> None:
    """Read every model again, and print a sentence for each that is missing, damaged, changed or not as symmetric.

    The exit code is 1 if there is one.

    ```
    handsight objects verify --library lab/
    ```
    """
    opened = _opened(library)
    entries = opened.entries()
    _print_wrong(opened.wrong(entries))
    typer.echo(printable(f"{opened.place}: {len(entries)} objects are as they should be"))


@objects_app.command()
def fetch(url: Annotated[str, Argument(help="URL of a library, such as https://host/ycbv.")]) -> None:
    """Copy a library and all its models to this machine's cache, or update the copy.

    A library at a URL is read from its copy, and the network is used only for what the copy lacks. URLs may be http,
    https and file; others (s3, gs, hf, github) need fsspec: `pip install 'handsight[library]'`.

    ```
    handsight objects fetch https://host/ycbv
    ```
    """
    opened = _opened(url)
    with bar("fetching") as advance:
        wrong = opened.fetch(advance)
    done = len(opened.entries()) - len(wrong)
    say(f"fetched {done} objects; --library or HANDSIGHT_LIBRARY={opened.place} uses them from here")
    _print_wrong(wrong)


@objects_app.command()
def weigh(
    recording: RecordingPath,
    name: Annotated[
        str,
        Option("--object", metavar="NAME", help="Name of the object in the library, or its number."),
    ],
    rig: RigPath = None,
    library: LibraryPlace = None,
) -> None:
    """Estimate an object's mass and centre of mass from a recording, and write both to the library.

    In the recording, the hand must lift the object, tilt it by 20° about two axes, and hold still for half a second
    each time. The uncertainty of the object's pose in the hand is part of the uncertainty of the centre. Both are
    written only if the centre is known to 10 mm (one standard deviation per axis).

    ```
    handsight objects weigh lifted.mcap --object mustard
    ```
    """
    from handsight.tracking.replay import best_weight

    announce_compiling()
    opened = _opened(library)
    robot, _ = find_rig(recording, rig)
    model = opened.model(name)
    # The known weight is removed, so that it is not found again as if it had been measured.
    run = Run(recording, robot, replace(model, mass=None, center_of_mass=None))
    with run.opened() as (recorded, tracker):
        found, reason = best_weight(recorded.observations(), tracker)
    if found is None:
        expected = "expected an object that is weighed in the air"
        raise InvalidInput(f"{recording.name}: {expected}, got none: {reason}")
    center, sigma = found.kept_by_symmetries(model)
    place = ", ".join(f"{1e3 * x:.1f}" for x in center)
    text = f"{1e3 * found.mass:.4g} ± {1e3 * found.sigma_mass:.2g} g, centre [{place}] ± {1e3 * sigma:.1f} mm per axis"
    say(f"{model.name}: {text}, by {found.directions} directions of gravity")
    max_sigma = 0.01  # [m] per axis; a less certain centre is of no use
    if sigma > max_sigma:
        hint = "where the object is in the hand must be known: by more contacts, or by vision"
        expected = f"expected a centre of mass known to {1e3 * max_sigma:g} mm, got {1e3 * sigma:.1f} mm"
        raise InvalidInput(f"{recording.name}: {expected}: not written ({hint})")
    opened.weigh(name, found.mass, center, sigma)
    say(f"wrote {opened.place}")


def _opened(place: str | None) -> "Library":
    from handsight.objects import Library

    return Library(place)


def _print_wrong(sentences: "Iterable[str]") -> None:
    """Prints the sentences about wrong objects; if there are any, ends the command with exit code 1."""
    wrong = False
    for sentence in sentences:
        typer.echo(printable(f"- {sentence}"))
        wrong = True
    if wrong:
        raise typer.Exit(1)


def _symmetries(of: "Symmetries") -> str:
    """Returns an object's symmetries in a few words."""
    if of.trivial:
        return "none"
    if of.round:
        return "any turn"
    turns = len(of.rotations)
    if not of.axes:
        return f"{turns} poses alike"
    _, axis = of.axes[0]
    along = ", ".join(f"{x:g}" for x in axis.round(2) + 0.0)
    return f"about [{along}]" + (", ends alike" if turns > 1 else "")
