"""A library in a folder: BOP's `models`, or what has it."""

from dataclasses import dataclass
from pathlib import Path

from handsight.files import read_bytes
from handsight.objects.library.index import FACTS, INFO, LARGEST_DOCUMENT, Documents, Entry, NoLibrary
from handsight.objects.library.store import check_content


@dataclass(frozen=True)
class Folder:
    """A `Folder` says where the documents and the models' files lie side by side."""

    place: Path

    @property
    def models(self) -> Path:
        """The folder itself where the documents are in it, else its `models`."""
        return self.place if (self.place / INFO).exists() else self.place / "models"

    def documents(self) -> Documents:
        """Returns both; raises NoLibrary where there is none, InvalidFile."""
        models = self.models
        if not (models / INFO).exists():
            message = f"expected a library, with models/{INFO}, got none; `handsight objects add` makes one"
            raise NoLibrary(f"{self.place}: {message}")
        # In this order: an add writes facts first, and who finds an object finds what is known of it.
        info = read_bytes(models / INFO, LARGEST_DOCUMENT)
        if not (models / FACTS).exists():
            return Documents(info, None)
        return Documents(info, read_bytes(models / FACTS, LARGEST_DOCUMENT))

    def file(self, entry: Entry) -> Path:
        """Returns the model's file; raises InvalidFile where it is not there or not the one that was added."""
        path = self.models / entry.file
        known = entry.facts
        check_content(path, known.sha256 if known else None, known.bytes if known else None)
        return path
