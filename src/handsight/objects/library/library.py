"""Objects by name: a folder as the BOP benchmark has them, here or at a URL, and what is known of each besides.

`models/obj_000001.ply` in millimetres and `models/models_info.json` are BOP's, so that folders of others are libraries
as they are, and ours are BOP's; names, masses, licences and checksums lie beside, in `models/handsight.json`.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.objects.files import read_shape
from handsight.objects.library.add import add, check_inside, new_object, revise
from handsight.objects.library.bop import BOP_SYMMETRIES
from handsight.objects.library.facts import Facts
from handsight.objects.library.folder import Folder
from handsight.objects.library.index import Entry, entries
from handsight.objects.library.remote import Remote
from handsight.objects.model import ObjectModel
from handsight.objects.surface import diameter
from handsight.objects.symmetry import Symmetries

OTHER_UNIT = 3.0
"""A diameter so many times off is of another unit; some files have the box' diagonal, at most √3 times too large."""


def default_place() -> str:
    """Returns `$HANDSIGHT_LIBRARY`, else `$XDG_DATA_HOME/handsight/library`, else
    `~/.local/share/handsight/library`."""
    if named := os.environ.get("HANDSIGHT_LIBRARY"):
        return named
    base = os.environ.get("XDG_DATA_HOME", "")
    if not os.path.isabs(base):  # not to be used then, says its specification
        base = os.path.expanduser("~/.local/share")
    return os.path.join(base, "handsight", "library")


class Library:
    """A `Library` is objects by name, in a folder or at a URL; nothing is read before it is asked for, and then as it
    is there."""

    def __init__(self, place: str | os.PathLike[str] | None = None) -> None:
        """`place`: a folder or a URL; None: `default_place`. Raises InvalidInput for what is neither."""
        place = default_place() if place is None else place
        if not isinstance(place, str | os.PathLike) or "\0" in (named := os.fspath(place)):
            raise InvalidInput(f"library: expected a folder or a URL, got {checks.brief(place)!r}")
        self.place = named
        self._source: Folder | Remote
        self._source = Remote(self.place) if "://" in self.place else Folder(Path(self.place))

    def __repr__(self) -> str:
        """Returns where it is."""
        return f"<Library {self.place}>"

    def entries(self) -> tuple[Entry, ...]:
        """Returns all objects by their numbers; raises InvalidFile where there is no library, or what is none."""
        return entries(self._source.documents(), self.place)

    def entry(self, name: str) -> Entry:
        """Returns the object so called, or of that number (`5`, `obj_000005`); raises InvalidInput where there is
        none."""
        known = self.entries()
        for entry in known:
            if name in (entry.name, str(entry.number), entry.file.removesuffix(".ply")):
                return entry
        near = checks.suggestion(str(name), [entry.name for entry in known])
        raise InvalidInput(f"name: expected an object of {self.place}, got {checks.brief(name)!r}{near}")

    def file(self, entry: Entry) -> Path:
        """Returns its model on this machine; raises InvalidFile where that is missing or was changed since it was
        added."""
        return self._source.file(entry)

    def model(self, name: str) -> ObjectModel:
        """Returns the object so called, with its symmetries; raises as `entry` and `file`."""
        entry = self.entry(name)
        model = ObjectModel.from_file(
            self.file(entry), scale=BOP_SYMMETRIES.metres, symmetries=entry.symmetries
        )
        facts = entry.facts
        if facts is not None and (facts.mass is not None or facts.center_of_mass is not None):
            model = model.with_weight(
                mass=facts.mass,
                center_of_mass=facts.center_of_mass,
                sigma_center_of_mass=facts.sigma_center_of_mass,
            )
        return replace(model, name=entry.name)

    def wrong(self, entries: Iterable[Entry]) -> Iterator[str]:
        """Yields a sentence for each of its objects of which something is wrong; their files are read."""
        for entry in entries:
            try:
                path = self.file(entry)
                points = read_shape(path).vertices
                if np.isfinite(points).all() and np.ptp(points, axis=0).max() > 0:
                    _check_unit(diameter(points), entry)
                _ = entry.symmetries
            except HandsightError as error:
                yield str(error)

    def fetch(self, advance: Callable[..., None] = lambda share, text="": None) -> list[str]:
        """Copies a URL's documents and models to this machine's cache; what could not be copied, in a sentence each.

        `advance(share, said)` is told how far it is. From then on they are used from there.
        """
        if isinstance(self._source, Folder):
            raise InvalidInput(f"{self.place}: expected a URL, such as https://..., got a folder")
        self._source.refresh()
        wrong, wanted = [], self.entries()
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
    ) -> Entry:
        """Returns the object of a mesh or a cloud, added under `facts.name`; `scale`: metres per unit of the file.

        It is there with all that belongs to it or not at all, whoever adds at the same time and whatever ends this.
        Raises InvalidInput where the name is taken or the library a URL's, NotWritten, and as `ObjectModel.from_file`.
        """
        if isinstance(self._source, Remote):
            raise InvalidInput(f"{self.place}: expected a folder to add to, got a URL")
        add(self._source, new_object(file, facts, scale, symmetries))
        return self.entry(facts.name)

    def weigh(self, name: str, mass: float, center_of_mass: Array, sigma_center_of_mass: float) -> Entry:
        """Returns the object so called, whose mass [kg] and centre of mass (3,) [m] are now known so; the rest stays.

        Raises InvalidInput for an object that nobody has named, for a library at a URL, and for a centre that is not in
        the object; NotWritten.
        """
        if isinstance(self._source, Remote):
            raise InvalidInput(f"{self.place}: expected a folder to write to, got a URL")
        entry = self.entry(name)
        if entry.facts is None:
            raise InvalidInput(f"name: expected an object that was added with a name, got {entry.name!r}")
        x, y, z = (float(value) for value in np.round(center_of_mass, 6))
        text = {key: getattr(entry.facts, key) for key in ("name", "licence", "source")}
        sigma = round(float(sigma_center_of_mass), 6)
        facts = Facts(**text, mass=round(mass, 6), center_of_mass=(x, y, z), sigma_center_of_mass=sigma)
        check_inside(facts, self.model(name))
        revise(self._source, entry.number, facts)
        return self.entry(name)


def _check_unit(measured: float, entry: Entry) -> None:
    """Raises InvalidFile where a file's diameter [mm] is not the one that is declared."""
    ratio = measured / entry.info.diameter
    if not 1 / OTHER_UNIT < ratio < OTHER_UNIT:
        text = f"expected the diameter {entry.info.diameter:.4g} mm, got {measured:.4g}: another unit?"
        raise InvalidFile(f"{entry.place}: {entry.file}: {text}")
