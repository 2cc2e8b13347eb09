"""`handsight objects`: a library of objects, listed, shown, added to, weighed, verified and fetched."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import announce_compiling, bar, say, table
from handsight.cli.weigh import weigh
from handsight.errors import InvalidInput, printable

if TYPE_CHECKING:
    from handsight.objects.library import Entry, Library
    from handsight.objects.symmetry import Symmetries

objects_app = typer.Typer(
    help="A library of objects by name: a folder as the BOP benchmark has them, or a URL. It is the one that --library "
    "or HANDSIGHT_LIBRARY names, else ~/.local/share/handsight/library.",
    no_args_is_help=True,
)

Name = Annotated[str, typer.Argument(help="A name, or a number as BOP has it.")]
Place = Annotated[
    str | None,
    typer.Option(
        "--library",
        metavar="FOLDER|URL",
        help="The library; default: HANDSIGHT_LIBRARY, else the user's own.",
    ),
]


@objects_app.command("list")
def list_(library: Place = None) -> None:
    """Print all objects of the library."""
    from rich.console import Console

    opened = _opened(library)
    rows = []
    for entry in opened.entries():
        facts = entry.facts
        mass = f"{1e3 * facts.mass:.4g}" if facts and facts.mass is not None else "-"
        texts = (entry.name, _symmetries(entry.symmetries), facts.licence if facts else "")
        cells = (*texts, str(entry.number), f"{1e3 * entry.diameter:.1f}", mass)
        rows.append([printable(cell) for cell in cells])
    columns = ("name", "symmetries", "licence", "number", "diameter [mm]", "mass [g]")
    style: dict[str, Any] = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
    Console(markup=False, highlight=False).print(table(columns, rows, texts=3, **style))


@objects_app.command()
def show(name: Name, library: Place = None) -> None:
    """Print what is known of an object; the exit code is 1 where its file is missing or was changed."""
    opened = _opened(library)
    entry = opened.entry(name)
    for key, value in _known(entry):
        typer.echo(printable(f"{key:16}{value}"))
    _tell(opened, [entry])


@objects_app.command()
def add(
    file: Annotated[
        Path, typer.Argument(help="A mesh (STL, OBJ, PLY, OFF) or a cloud (PLY, OFF, PCD, XYZ).")
    ],
    name: Annotated[str, typer.Option(help="What it is to be called.")],
    scale: Annotated[float, typer.Option(help="Metres per unit of the file.")] = 1.0,
    mass: Annotated[float | None, typer.Option(help="[kg]")] = None,
    center_of_mass: Annotated[
        tuple[float, float, float] | None, typer.Option(help="In the object's frame [m].")
    ] = None,
    sigma_center_of_mass: Annotated[
        float | None, typer.Option(help="How well it is known: one standard deviation per axis [m].")
    ] = None,
    symmetry: Annotated[
        list[str] | None,
        typer.Option(
            metavar="z|z/N|find",
            help="Turns that change nothing, its print neither: any about an axis through the middle of the surface, "
            "or an N-th of one; find: those that the shape suggests. May be given several times.",
        ),
    ] = None,
    licence: Annotated[str, typer.Option(help="Of the model.")] = "",
    source: Annotated[str, typer.Option(help="Where the model is from.")] = "",
    library: Place = None,
) -> None:
    """Add an object to a library in a folder, as PLY in millimetres.

    It is there with all that belongs to it or not at all, however many add at the same time.

    ```
    handsight objects add mustard.obj --name mustard --mass 0.603 --symmetry z/2 --licence "CC BY 4.0"
    handsight objects add can.stl --name can --scale 0.001 --symmetry z --symmetry x/2
    ```
    """
    from handsight.objects import Facts, ObjectModel, Symmetries
    from handsight.objects.symmetry_search import declared

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
            symmetries = declared(ObjectModel.from_file(file, scale), symmetry)
        except InvalidInput as error:
            raise InvalidInput(f"--symmetry: {str(error).removeprefix('symmetry: ')}") from None
    opened = _opened(library)
    entry = opened.add(file, facts, scale=scale, symmetries=symmetries)
    size = f"diameter {1e3 * entry.diameter:.1f} mm, symmetries: {_symmetries(entry.symmetries)}"
    say(f"added {entry.name} to {opened.place} as {entry.file}: {size}")


@objects_app.command()
def verify(library: Place = None) -> None:
    """Read every model again, and print a sentence for each that is not what it was or should be.

    The exit code is then 1.
    """
    opened = _opened(library)
    entries = opened.entries()
    _tell(opened, entries)
    typer.echo(printable(f"{opened.place}: {len(entries)} objects are as they should be"))


@objects_app.command()
def fetch(url: Annotated[str, typer.Argument(help="Of a library, such as https://host/ycbv.")]) -> None:
    """Copy a library and all its models to this machine's cache, or bring the copy up to date.

    A library at a URL is used from its copy, and asks the network for what that lacks. Known are http, https and file;
    other kinds (s3, gs, hf, github) by fsspec, `pip install 'handsight[library]'`.
    """
    opened = _opened(url)
    with bar("fetching") as advance:
        wrong = opened.fetch(advance)
    for sentence in wrong:
        typer.echo(printable(f"- {sentence}"))
    done = len(opened.entries()) - len(wrong)
    say(f"fetched {done} objects; --library or HANDSIGHT_LIBRARY={url} uses them from here")
    if wrong:
        raise typer.Exit(1)


objects_app.command()(weigh)


def _opened(place: str | None) -> "Library":
    from handsight.objects import Library

    return Library(place)


def _tell(library: "Library", entries: "list[Entry] | tuple[Entry, ...]") -> None:
    """Prints what is wrong with objects; ends the command where anything is."""
    sentences = list(library.wrong(entries))
    for sentence in sentences:
        typer.echo(printable(f"- {sentence}"))
    if sentences:
        raise typer.Exit(1)


def _known(entry: "Entry") -> Iterator[tuple[str, str]]:
    """Yields what is known of an object, in the units that people say it in."""
    yield "name", entry.name
    yield "file", f"{entry.file} of {entry.place}"
    yield "diameter", f"{1e3 * entry.diameter:.1f} mm"
    if entry.size is not None:
        yield "size", " x ".join(f"{1e3 * side:.1f}" for side in entry.size) + " mm"
    yield "symmetries", _symmetries(entry.symmetries)
    facts = entry.facts
    if facts is None:
        return
    if facts.mass is not None:
        yield "mass", f"{1e3 * facts.mass:.4g} g"
    if facts.center_of_mass is not None:
        place = ", ".join(f"{1e3 * x:.1f}" for x in facts.center_of_mass)
        sigma = facts.sigma_center_of_mass
        yield "centre of mass", f"[{place}] mm" + (f" ± {1e3 * sigma:.1f} mm per axis" if sigma else "")
    for key in ("licence", "source"):
        if columns := getattr(facts, key):
            yield key, columns
    yield "SHA-256", facts.sha256


def _symmetries(of: "Symmetries") -> str:
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
