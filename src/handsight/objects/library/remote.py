"""A library at a URL, by its copy in the cache: nothing is asked of the network that is there already.

Documents are kept by their URL, models' files by their SHA-256, so that a file is what the documents say or is fetched
again, and two libraries with the same file have it once.
"""

import contextlib
import hashlib
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import msgspec

from handsight.cache_folder import cache_folder, read_entry, write_entry
from handsight.errors import HandsightError, InvalidFile, MissingExtra
from handsight.files import write_errors
from handsight.objects.files.read import LARGEST_FILE
from handsight.objects.library.index import FACTS, INFO, LARGEST_DOCUMENT, Documents, Entry, NoLibrary
from handsight.objects.library.store import check_content, check_sha256, new_file

SECONDS = 30
"""Without a byte, after which a server is taken for dead."""
CHUNK = 1 << 20
NOT_THERE = (403, 404, 410)
"""HTTP's words for it; some stores of files refuse to say that they have none (403)."""
NO_COPY = (OSError, ValueError, msgspec.MsgspecError)
"""What reading one raises that is not there, or damaged."""


class _Copy(msgspec.Struct):
    """A `_Copy` is what was fetched of a library."""

    base: str
    """The URL that the documents and the files are under."""
    info: bytes
    facts: bytes | None
    sha256: dict[int, str]
    """By number, of files that no document says it of."""


@dataclass(frozen=True)
class Remote:
    """A `Remote` is a library at a URL."""

    url: str

    def documents(self) -> Documents:
        """Returns both, as they were when they were fetched last; raises InvalidFile where there is no library."""
        copy = self._copy()
        return Documents(copy.info, copy.facts)

    def refresh(self) -> None:
        """Fetches the documents anew; raises InvalidFile, and what was fetched before stays."""
        for base in (_under(self.url, "models"), self.url):
            info = fetched(_under(base, INFO), LARGEST_DOCUMENT)
            if info is not None:
                facts, known = fetched(_under(base, FACTS), LARGEST_DOCUMENT), dict[int, str]()
                with contextlib.suppress(*NO_COPY):
                    known = self._kept().sha256
                self._keep(_Copy(base, info, facts, known))
                return
        raise NoLibrary(f"{self.url}: expected a library, with models/{INFO}, got none")

    def file(self, entry: Entry, *, anew: bool = False) -> Path:
        """Returns the model's file in the cache, fetched where it is not yet there; raises InvalidFile, NotWritten.

        `anew`: also where no document says that it is still the same.
        """
        copy = self._copy()
        known = entry.facts.sha256 if entry.facts else None if anew else copy.sha256.get(entry.number)
        if known is not None:
            path = _by_content(known, entry.file)
            with contextlib.suppress(HandsightError):  # whatever is wrong with it, it can be fetched again
                check_content(path, known, None)
                return path
        where = _under(copy.base, entry.file)
        data = fetched(where, entry.facts.bytes if entry.facts else LARGEST_FILE)
        if data is None:
            raise InvalidFile(f"{where}: cannot be read: no such file")
        found = hashlib.sha256(data).hexdigest()
        if entry.facts:
            check_sha256(where, entry.facts.sha256, found)
        path = _by_content(found, entry.file)
        with new_file(path) as file:
            file.write(data)
        now = self._copy()  # which another process may have fetched anew
        if not entry.facts and now.info == copy.info:
            self._keep(msgspec.structs.replace(now, sha256={**now.sha256, entry.number: found}))
        return path

    def _copy(self) -> _Copy:
        """Returns what was fetched, or is now for the first time."""
        with contextlib.suppress(*NO_COPY):
            return self._kept()
        self.refresh()
        return self._kept()

    def _kept(self) -> _Copy:
        return msgspec.msgpack.decode(read_entry(self._path, self.url), type=_Copy)

    def _keep(self, copy: _Copy) -> None:
        with write_errors(self._path.parent):
            write_entry(self._path, self.url, msgspec.msgpack.encode(copy))

    @property
    def _path(self) -> Path:
        return _folder() / f"{hashlib.sha256(self.url.encode(errors='replace')).hexdigest()}.msgpack"


def fetched(url: str, most: int) -> bytes | None:
    """Returns all that is at a URL, of at most so many bytes; None where nothing is. Raises InvalidFile,
    MissingExtra."""
    data = bytearray()
    try:
        with _opened(url) as stream:
            while chunk := stream.read(CHUNK):
                data += chunk
                if len(data) > most:
                    raise InvalidFile(f"{url}: expected at most {most} bytes, got more")
            left = getattr(stream, "length", None)  # of what an HTTP server has announced
    except HandsightError:
        raise
    except Exception as error:  # each kind of URL has errors of its own
        if _says_not_there(error):
            return None
        reason = getattr(error, "reason", None) or error
        raise InvalidFile(f"{url}: cannot be fetched: {reason or type(error).__name__}") from None
    if left:
        raise InvalidFile(f"{url}: cannot be fetched: it ended {left} bytes early")
    return bytes(data)


def _opened(url: str) -> AbstractContextManager[BinaryIO]:
    """Returns what is at a URL: of http, https and file by the standard library, of any other kind by fsspec."""
    kind = url.partition("://")[0].lower()
    if kind in ("http", "https", "file"):
        from urllib.request import Request, urlopen

        opened: AbstractContextManager[BinaryIO] = urlopen(
            Request(url, headers={"User-Agent": "handsight"}), timeout=SECONDS
        )
        return opened
    try:
        import fsspec
    except ImportError:
        raise MissingExtra(f"{url}: {kind}:// needs fsspec: pip install 'handsight[library]'") from None
    there: AbstractContextManager[BinaryIO] = fsspec.open(url, "rb")
    return there


def _under(url: str, name: str) -> str:
    """Returns the URL of what is so called in another; of a chain, as `zip://models::file:///ycbv.zip`, in its first
    link."""
    first, chain, rest = url.partition("::")
    between = "" if first.endswith("://") else "/"
    return f"{first if not between else first.rstrip('/')}{between}{name}{chain}{rest}"


def _says_not_there(error: Exception) -> bool:
    reason = getattr(error, "reason", None)
    return (
        isinstance(error, FileNotFoundError)
        or isinstance(reason, FileNotFoundError)
        or getattr(error, "code", None) in NOT_THERE
    )


def _folder() -> Path:
    return cache_folder() / "library"


def _by_content(sha256: str, name: str) -> Path:
    """Returns where a file is kept: under its own name, which what is said of it begins with."""
    return _folder() / sha256 / name
