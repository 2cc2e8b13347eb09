"""A library at a URL, used from its copy in the cache: a folder of the same form, fetched file by file.

A model whose document states its SHA-256 is compared with it whenever it is used. A library without checksums is
trusted as it came first.
"""

import contextlib
import hashlib
import os
import re
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

from handsight.cache_folder import cache_folder
from handsight.errors import HandsightError, InvalidFile, needing
from handsight.files import write_errors
from handsight.objects.files.read import LARGEST_FILE
from handsight.objects.library.documents import FACTS, INFO, LARGEST_DOCUMENT, Documents, Entry, NoLibrary
from handsight.objects.library.folder import Folder, check_content, write_file
from handsight.objects.surface import ObjectWarning

SILENCE = 30  # after so long without a byte a fetch ends [s]
NOTHING_THERE = (403, 404, 410)  # some file servers answer 403 where there is no file


@dataclass(frozen=True)
class Remote:
    """A library at an http or https URL."""

    url: str

    def documents(self) -> Documents:
        """Returns both documents as they were last fetched; raises InvalidFile where there is no library."""
        with contextlib.suppress(NoLibrary):
            return self._copy.documents()
        self.refresh()
        return self._copy.documents()

    def refresh(self) -> None:
        """Fetches the documents and keeps them; where it raises InvalidFile, those fetched before stay."""
        base = self.url.rstrip("/")
        copy = self._copy.place
        for url, folder in ((f"{base}/models", copy / "models"), (base, copy)):
            with tempfile.TemporaryDirectory() as new:
                info = Path(new, INFO)
                facts = Path(new, FACTS)
                if not fetched(f"{url}/{INFO}", info, LARGEST_DOCUMENT):
                    continue
                has_facts = fetched(f"{url}/{FACTS}", facts, LARGEST_DOCUMENT)
                _replace(folder / FACTS, facts.read_bytes() if has_facts else None)
                _replace(folder / INFO, info.read_bytes())
            if folder != copy:
                _replace(copy / INFO, None)
            if not has_facts:
                warnings.warn(
                    f"{without_password(self.url)}: no checksums are there; its models are trusted as they come first",
                    ObjectWarning,
                    stacklevel=2,
                )
            return
        raise NoLibrary(f"{without_password(self.url)}: expected a library, with models/{INFO}, got none")

    def file(self, entry: Entry, *, anew: bool = False) -> Path:
        """Returns the model's file in the cache, fetched if it is not yet there; raises InvalidFile, NotWritten.

        `anew`: fetch it also where no document states a checksum by which the cached file is known to be current.
        """
        copy = self._copy
        path = copy.models / entry.file
        sha256 = entry.facts.sha256 if entry.facts else None
        if not (anew and sha256 is None):
            with contextlib.suppress(HandsightError):  # a missing or damaged file is fetched again
                check_content(path, sha256, None)
                return path
        base = self.url.rstrip("/") + ("" if copy.models == copy.place else "/models")
        url = f"{base}/{entry.file}"
        if not fetched(url, path, entry.facts.bytes if entry.facts else LARGEST_FILE, sha256):
            raise InvalidFile(f"{without_password(url)}: cannot be read: no such file")
        return path

    @property
    def _copy(self) -> Folder:
        """The copy in the cache."""
        name = hashlib.sha256(self.url.rstrip("/").encode(errors="replace")).hexdigest()
        return Folder(cache_folder() / "library" / name)


def without_password(text: str) -> str:
    """Returns a text for messages: its URLs without user and password."""
    return re.sub(r"(://)[^/\s]*@", r"\1", text)


def fetched(url: str, path: Path, most: int, sha256: str | None = None) -> bool:
    """Returns whether there is a file at a URL, which is then at the path, complete.

    Raises InvalidFile for more than `most` bytes or another SHA-256, NotWritten, MissingExtra.
    """
    name = without_password(url)
    with needing(f"{name}: needs pooch", "library"):
        import pooch
        import requests
    pooch.get_logger().setLevel("WARNING")  # it tells of every file
    known = None if sha256 is None else f"sha256:{sha256}"

    def download(url: str, path: str, _: object) -> None:
        _download(url, path, most)

    with write_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            try:
                new = pooch.retrieve(url, known, fname=path.name, path=folder, downloader=download)
            except (requests.RequestException, ValueError) as error:
                if getattr(getattr(error, "response", None), "status_code", None) in NOTHING_THERE:
                    return False
                raise InvalidFile(f"{name}: cannot be fetched: {without_password(str(error))}") from None
            os.replace(new, path)
    return True


def _download(url: str, path: str, most: int) -> None:
    """Writes what is at a URL to a file; raises RequestException, ValueError for more than `most` bytes, OSError."""
    import requests

    got = 0
    # pooch's own downloader knows no limit, and leaves the connection open after an error.
    with requests.get(url, stream=True, timeout=SILENCE) as response, open(path, "wb") as file:
        response.raise_for_status()
        for part in response.iter_content(1 << 16):
            got += len(part)
            if got > most:
                raise ValueError(f"expected at most {most} bytes, got more")
            file.write(part)


def _replace(path: Path, data: bytes | None) -> None:
    """Writes a file of the copy at once; None: removes it. Raises NotWritten."""
    if data is not None:
        write_file(path, data)
        return
    with write_errors(path), contextlib.suppress(FileNotFoundError):
        path.unlink()
