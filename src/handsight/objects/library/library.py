"""Objects by name, with their symmetries and facts, in a folder or at a URL in the format of the BOP benchmark.

`models/obj_000001.ply` in millimetres and `models/models_info.json` are as BOP defines them, so that a folder of a BOP
data set is a library, and tools for BOP read a library. Names, masses, licences and checksums are in
`models/handsight.json`.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import msgspec
import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.objects.files import read_shape
from handsight.objects.library.documents import METRES, SURFACE_TOLERANCE, Entry, Facts, entries
from handsight.objects.library.folder import Folder, check_inside, new_object
from handsight.objects.library.remote import Remote, without_password
from handsight.objects.model import ObjectModel
from handsight.objects.surface import diameter
from handsight.objects.symmetry import Symmetries
from handsight.objects.symmetry_search import check_symmetries


def default_place() -> str:
    """Returns `$HANDSIGHT_LIBRARY`, else `handsight/library` in `$XDG_DATA_HOME`, else in `~/.local/share`."""
    if named := os.environ.get("HANDSIGHT_LIBRARY"):
        return named
    base = os.environ.get("XDG_DATA_HOME", "")
    if not os.path.isabs(base):  # the XDG specification says to ignore a relative path
        base = os.path.expanduser("~/.local/share")
    return os.path.join(base, "handsight", "library")


class Library:
    """Set of objects by name, in a folder or at a URL; each call reads the documents anew."""

    def __init__(self, place: str | os.PathLike[str] | None = None) -> None:
        """`place`: a folder or a URL of http, https or file; None: `default_place`. Raises InvalidInput for others."""
        place = default_place() if place is None else place
        named = os.fspath(place) if isinstance(place, str | os.PathLike) else "\0"
        kind = named.partition("://")[0].lower() if "://" in named else ""
        self.place = without_password(named)
        if "\0" in named or kind not in ("", "file", "http", "https"):
            came = without_password(checks.brief(place))
            raise InvalidInput(f"library: expected a folder or a URL of http, https or file, got {came!r}")
        if kind == "file":
            named = url2pathname(urlsplit(named).path)
        self._source: Folder | Remote = Remote(named) if kind.startswith("http") else Folder(Path(named))

    def __repr__(self) -> str:
        return f"<Library {self.place}>"

    def entries(self) -> tuple[Entry, ...]:
        """Returns all objects in the order of their numbers; raises InvalidFile for no library, or a damaged one."""
        return entries(self._source.documents(), self.place)

    def entry(self, name: str) -> Entry:
        """Returns the object with that name or number (`5`, `obj_000005`); raises InvalidInput where there is none."""
        known = self.entries()
        for entry in known:
            if entry.is_called(name):
                return entry
        near = checks.suggestion(str(name), [entry.name for entry in known])
        raise InvalidInput(f"name: expected an object of {self.place}, got {checks.brief(name)!r}{near}")

    def file(self, entry: Entry) -> Path:
        """Returns the path of the object's model on this machine; raises InvalidFile where it is not the added file."""
        return self._source.file(entry)

    def model(self, name: str | Entry) -> ObjectModel:
        """Returns the object of that name or entry, with symmetries and weight; raises as `entry` and `file`."""
        entry = name if isinstance(name, Entry) else self.entry(name)
        model = ObjectModel.from_file(self.file(entry), scale=METRES)
        model = replace(model, name=entry.name, symmetries=entry.symmetries)
        where = f"{entry.place}: {entry.file}: symmetries"
        check_symmetries(model, model.symmetries, where, tolerance=SURFACE_TOLERANCE)
        if facts := entry.facts:
            model = replace(model, sigma_scale=facts.sigma_scale).with_weight(
                mass=facts.mass,
                center_of_mass=facts.center_of_mass,
                sigma_center_of_mass=facts.sigma_center_of_mass,
            )
        return model

    def wrong(self, entries: Iterable[Entry]) -> Iterator[str]:
        """Reads the files of these objects, and yields a sentence for each object with a fault."""
        for entry in entries:
            try:
                points = read_shape(self.file(entry)).vertices
                if np.isfinite(points).all() and np.ptp(points, axis=0).max() > 0:
                    measured = diameter(points)
                    declared = entry.info.diameter
                    # Some documents state the diagonal of the bounding box, which is at most √3 times too large.
                    if not 1 / 3 < measured / declared < 3:
                        where = f"{entry.place}: {entry.file}"
                        raise InvalidFile(
                            f"{where}: expected the diameter {declared:.4g} mm, got {measured:.4g}: another unit?"
                        )
                if not entry.symmetries.trivial:
                    self.model(str(entry.number))
            except HandsightError as error:
                yield str(error)

    def fetch(self, advance: Callable[..., None] = lambda share, text="": None) -> list[str]:
        """Copies the documents and models at a URL to this machine's cache, from which they are used from then on.

        Returns a sentence for each object that could not be copied. `advance(share, name)` is called before each object
        with the share that is done, from 0 to 1. Raises InvalidInput for a folder.
        """
        if isinstance(self._source, Folder):
            raise InvalidInput(f"{self.place}: expected a URL, such as https://..., got a folder")
        self._source.refresh()
        wrong = []
        wanted = self.entries()
        for k, entry in enumerate(wanted):
            advance(k / len(wanted), entry.name)
            try:
                self._source.file(entry, anew=True)
            except HandsightError as error:
                wrong.append(str(error))
        return wrong

    def add(
        self,
        file: str | os.PathLike[str],
        facts: Facts,
        *,
        scale: float = 1.0,
        symmetries: Symmetries | None = None,
        force: bool = False,
    ) -> Entry:
        """Adds the mesh or cloud in a file under `facts.name`, and returns its entry.

        `scale`: metres per unit of the file. `force`: also an object of a size that no hand holds. The object is in the
        library complete or not at all, whoever else adds meanwhile and however the process ends.
        Raises InvalidInput where the name is taken, the library is at a URL or the symmetries move the surface;
        NotWritten, and the errors of `ObjectModel.from_file`.
        """
        if isinstance(self._source, Remote):
            raise InvalidInput(f"{self.place}: expected a folder to add to, got a URL")
        self._source.add(*new_object(file, facts, scale, symmetries, force))
        return self.entry(facts.name)

    def weigh(
        self,
        name: str,
        mass: float,
        center_of_mass: Array | None = None,
        sigma_center_of_mass: float | None = None,
    ) -> Entry:
        """Writes an object's mass [kg], its centre of mass (3,) [m], and the standard deviation of that per axis [m].

        Without a centre, only the mass. Returns the entry; its other facts stay. Raises InvalidInput for an object that
        was not added with a name, for a library at a URL, and for a centre outside the object; NotWritten.
        """
        if isinstance(self._source, Remote):
            raise InvalidInput(f"{self.place}: expected a folder to write to, got a URL")
        entry = self.entry(name)
        if entry.facts is None:
            raise InvalidInput(f"name: expected an object that was added with a name, got {entry.name!r}")
        facts = msgspec.structs.replace(entry.facts, mass=round(mass, 6))
        if center_of_mass is not None and sigma_center_of_mass is not None:
            facts = msgspec.structs.replace(
                facts,
                center_of_mass=tuple(np.round(center_of_mass, 6).tolist()),
                sigma_center_of_mass=round(float(sigma_center_of_mass), 6),
            )
        check_inside(facts, self.model(name))
        self._source.revise(entry.number, facts)
        return self.entry(name)
