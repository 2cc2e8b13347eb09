"""`handsight objects`: a library of objects: list, show, add, weigh, verify and fetch."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from handsight.cli.options import LibraryPlace, RecordingPath, RigPath, Run, find_rig, refuse
from handsight.cli.terminal import announce_compiling, bar, millimetres, plain_table, print_out, say
from handsight.errors import InvalidInput, printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from handsight.forces import ObjectWeight
    from handsight.objects.library import Library
    from handsight.objects.symmetry import Symmetries

objects_app = typer.Typer(
    help="Manage a library of objects: a folder in the format of the BOP benchmark, or a URL. Default: "
    "$HANDSIGHT_LIBRARY, else ~/.local/share/handsight/library.",
    no_args_is_help=True,
)

FAR = 5.0  # from the origin, in diameters, where an object's frame is of no use
USUAL_SIZE = 0.1  # diameter to which a mesh of unknown scale is brought before it is measured [m]
MAX_SIGMA = 0.01  # of a centre of mass per axis [m]; a less certain one is of no use
MAX_SHARE = 0.1  # of a mass that its standard deviation may be
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
        mass = "-" if facts is None or facts.mass is None else _grams(facts.mass)
        texts = (entry.name, _symmetries(entry.symmetries), facts.licence if facts else "")
        rows.append((*texts, str(entry.number), millimetres(entry.diameter), mass))
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
    known = {"name": entry.name, "file": f"{entry.file} of {entry.place}"}
    known["diameter"] = f"{millimetres(entry.diameter)} mm"
    if entry.size is not None:
        known["size"] = f"{' x '.join(map(millimetres, entry.size))} mm"
    known["symmetries"] = _symmetries(entry.symmetries)
    facts = entry.facts
    if facts is not None:
        if facts.sigma_scale is not None:
            known["scale"] = f"measured, ± {100 * facts.sigma_scale:.2g} % (one standard deviation)"
        if facts.origin_file is not None:
            known["origin"] = f"{_metres(facts.origin_file)} of the file that was added"
        if facts.mass is not None:
            known["mass"] = f"{_grams(facts.mass)} g"
        if facts.center_of_mass is not None:
            known["centre of mass"] = f"[{millimetres(facts.center_of_mass)}] mm"
            if facts.sigma_center_of_mass:
                known["centre of mass"] += f" ± {millimetres(facts.sigma_center_of_mass)} mm per axis"
        known |= {"licence": facts.licence, "source": facts.source, "SHA-256": facts.sha256}
    for key, value in known.items():
        if value:
            typer.echo(printable(f"{key:16}{value}"))
    _print_wrong(opened.wrong([entry]))


@objects_app.command()
def add(
    file: Annotated[
        Path, Argument(help="A mesh (STL, OBJ, PLY, OFF, GLB, DAE, 3MF) or a point cloud (PLY, OFF, XYZ).")
    ],
    name: Annotated[str, Option(help="Name of the object in the library.")],
    scale: Annotated[float, Option(help="Metres per unit of the file; 0.001 for millimetres.")] = 1.0,
    scale_from: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Measure the scale of a mesh that has none: by a depth image of the object, with --mask, or by three "
            "touches or more, better a dozen, all in one frame (.jsonl: a line as `handsight correct` takes it, its "
            "`object` left out, or a contact a line).",
        ),
    ] = None,
    mask: Annotated[
        Path | None, Option(help="With a depth image: an image that is not 0 where the object is.")
    ] = None,
    camera: Annotated[
        Path | None,
        Option(help="With a depth image: file of the camera's intrinsics. Default: that beside the image."),
    ] = None,
    mass: Annotated[float | None, Option(help="Mass [kg].")] = None,
    center_of_mass: Annotated[
        tuple[float, float, float] | None,
        Option(metavar="X Y Z", help="Centre of mass in the object's frame [m]."),
    ] = None,
    sigma_center_of_mass: Annotated[
        float | None, Option(help="Standard deviation of the centre of mass per axis [m].")
    ] = None,
    symmetry: Annotated[
        list[str] | None,
        Option(
            metavar="AXIS",
            help="Symmetry of shape and print: `z`, rotation by any angle about that axis (x, y, z) through the middle "
            "of the surface; `z/N`, by an N-th of a turn; `find`, those of the shape. May be given several times.",
        ),
    ] = None,
    licence: Annotated[str, Option(help="Licence of the model.")] = "",
    recentre: Annotated[
        bool,
        Option(
            "--recentre",
            help="Move it to the middle of its bounds, as from map coordinates; it is said by how much.",
        ),
    ] = False,
    library: LibraryPlace = None,
) -> None:
    """Add an object to a library in a folder; its model is stored as PLY in millimetres.

    An object is added completely or not at all, and several commands may add at the same time.

    ```
    handsight objects add mustard.obj --name mustard --mass 0.603 --symmetry z/2 --licence "CC BY 4.0"
    handsight objects add can.stl --name can --scale 0.001 --symmetry z --symmetry x/2
    handsight objects add generated.glb --name mug --scale-from depth.png --mask mask.png --camera d435.json
    ```
    """
    import numpy as np

    from handsight.objects import Facts, ObjectModel, Symmetries, declared_symmetries
    from handsight.objects.files import read_shape, write_recentred

    announce_compiling()
    with tempfile.TemporaryDirectory() as folder:
        shape = file
        middle = None
        if recentre:
            shape, middle = write_recentred(file, Path(folder))
        sigma_scale = None
        if scale_from is None:
            refuse("a scale that is given", mask=mask, camera=camera)
        else:
            refuse("--scale-from", scale=scale != 1.0)
            scale, sigma_scale = _measured_scale(shape, scale_from, mask, camera)
        origin = None if middle is None else tuple((scale * middle).tolist())
        facts = Facts(
            name=name,
            origin_file=origin,
            sigma_scale=sigma_scale,
            mass=mass,
            center_of_mass=center_of_mass,
            sigma_center_of_mass=sigma_center_of_mass,
            licence=licence,
        )
        symmetries = Symmetries()
        if symmetry:
            try:
                symmetries = declared_symmetries(ObjectModel.from_file(shape, scale), symmetry)
            except InvalidInput as error:
                raise InvalidInput(f"--symmetry: {str(error).removeprefix('symmetry: ')}") from None
        opened = _opened(library)
        entry = opened.add(shape, facts, scale=scale, symmetries=symmetries)
    size = f"diameter {millimetres(entry.diameter)} mm, symmetries: {_symmetries(entry.symmetries)}"
    say(f"added {entry.name} to {opened.place} as {entry.file}: {size}")
    if origin is not None:
        place = _metres(origin)
        say(f"its origin is {place} of {file.name}: a point of that frame, less this, is one of the object's")
        return
    points = scale * read_shape(file).vertices
    away = float(np.linalg.norm(np.nanmean(points, axis=0)))
    if away > FAR * entry.diameter:
        say(
            f"it is {away:.3g} m from the origin of its frame, whose poses are answered; --recentre moves it there"
        )


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

    A library at a URL is read from its copy, and the network is used only for what the copy lacks. It needs
    `pip install 'handsight[library]'`.

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
    """Estimate an object's mass and centre of mass from a recording, and write them to the library.

    In the recording, the hand must lift the object, tilt it by 20° about two axes, and hold still for half a second
    each time. The uncertainty of the object's pose in the hand is part of the uncertainty of the centre. The mass is
    written if it is known to a tenth, the centre if it is known to 10 mm (one standard deviation per axis); what is not
    written stays as it was, and the reason is said.

    ```
    handsight objects weigh lifted.mcap --object mustard
    ```
    """
    from handsight.tracking import best_weight

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
    mass = f"{_grams(found.mass)} ± {1000 * found.sigma_mass:.2g} g"
    if found.sigma_mass > MAX_SHARE * found.mass:
        raise InvalidInput(
            f"{recording.name}: expected a mass known to {MAX_SHARE:.0%}, got {mass}: not written"
        )
    center, sigma = found.kept_by_symmetries(model)
    reason = reason or _why_uncertain(found, sigma)
    if reason:
        opened.weigh(name, found.mass)
        say(f"{model.name}: {mass}, by {found.directions} directions of gravity")
        say(f"wrote the mass to {opened.place}; the centre of mass is not written: {reason}")
        return
    opened.weigh(name, found.mass, center, sigma)
    place = f"[{millimetres(center)}] ± {millimetres(sigma)} mm per axis"
    say(f"{model.name}: {mass}, centre {place}, by {found.directions} directions of gravity")
    say(f"wrote mass and centre of mass to {opened.place}")


def _why_uncertain(found: "ObjectWeight", sigma: float) -> str:
    """Returns why a centre of mass is too uncertain to be used, empty where it is not; `sigma`: in the object [m]."""
    import numpy as np

    if sigma <= MAX_SIGMA:
        return ""
    by_loads = float(np.sqrt(np.linalg.eigvalsh(found.covariance_palm)[-1]))
    known = f"expected it known to {millimetres(MAX_SIGMA)} mm, got {millimetres(sigma)} mm"
    if by_loads > MAX_SIGMA:
        hint = "tilt the hand further, about two axes, and hold still"
        return f"{known}; the sensors tell it to {millimetres(by_loads)} mm in the palm: {hint}"
    hint = "more contacts or vision are needed"
    return f"{known}; the sensors tell it to {millimetres(by_loads)} mm, but not where the object is: {hint}"


def _measured_scale(
    file: Path, measured: Path, mask: Path | None, camera: Path | None
) -> tuple[float, float]:
    """Returns the metres per unit of a mesh, and their standard deviation as a share, by a depth image or touches."""
    from handsight.objects import ObjectModel
    from handsight.objects.files import read_shape
    from handsight.objects.surface import diameter
    from handsight.vision.scale import ScaleUnknown, scale_by_depth, scale_by_touch

    usual = USUAL_SIZE / diameter(read_shape(file).vertices)
    model = ObjectModel.from_file(file, usual)
    try:
        if measured.suffix.lower() in (".jsonl", ".json"):
            from handsight.batch.problems import read_touches

            refuse("touches", mask=mask, camera=camera)
            contacts, vision = read_touches(measured)
            found = scale_by_touch(model, contacts, vision=vision)
        else:
            from handsight.recording.frames import Beside, Frame, open_frames

            if mask is None:
                raise InvalidInput("--mask: expected an image of where the object is, got nothing")
            frames = open_frames(measured, Beside(camera=camera, mask=mask))
            frame = next(frames.each)
            if frames.total != 1 or not isinstance(frame, Frame) or frame.wanted is None:
                raise InvalidInput(f"--scale-from: expected one depth image, got {frames.total}")
            say(*frame.notes)
            found = scale_by_depth(model, frame.depth, frame.camera, frame.wanted)
    except ScaleUnknown as error:
        candidates = " or ".join(f"{usual * each:.3g}" for each in error.candidates)
        hint = f" (candidates: {candidates} m per unit; --scale takes one)" if candidates else ""
        raise InvalidInput(f"--scale-from: {error}{hint}") from None
    metres = usual * found.factor
    share = found.sigma / found.factor
    size = f"{millimetres(USUAL_SIZE * found.factor)} mm in diameter"
    say(f"1 unit of {file.name} is {metres:.4g} m, ± {share * metres:.2g} (one standard deviation): {size}")
    return metres, share


def _opened(place: str | None) -> "Library":
    from handsight.objects import Library

    return Library(place)


def _metres(place: "Iterable[float]") -> str:
    """Returns a place [m] to a tenth of a millimetre, however far away."""
    return f"[{', '.join(f'{value:.4f}' for value in place)}] m"


def _grams(mass: float) -> str:
    return f"{1000 * mass:.4g}"


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
