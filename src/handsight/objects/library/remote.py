"""A library at a URL, used from its copy in the cache: a file that is already there is not fetched again.

Documents are kept by their URL, models' files by their SHA-256: a file that is not the one in the documents is fetched
again, and two libraries with the same file share it.
"""

import contextlib
import hashlib
import os
import re
import threading
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import urlsplit

import msgspec

from handsight import checks
from handsight.cache_folder import cache_folder, read_entry, write_entry
from handsight.errors import HandsightError, InvalidFile, needing
from handsight.files import write_errors
from handsight.objects.files.read import LARGEST_FILE
from handsight.objects.library.documents import FACTS, INFO, LARGEST_DOCUMENT, Documents, Entry, NoLibrary
from handsight.objects.library.folder import check_content, check_sha256, write_file

PATIENCE, SLOWEST = 60.0, 250e3
"""How long a fetch may take [s], and the bytes that it must bring per second of any longer time."""
REDIRECTS = "HANDSIGHT_REDIRECTS"
"""The environment variable with the hosts, separated by blanks, to which a server may redirect."""


class _Copy(msgspec.Struct):
    """The documents of a library as they were fetched, and the checksums of fetched files."""

    base: str  # the URL of the folder with the documents and the models
    info: bytes
    facts: bytes | None
    sha256: dict[int, str]  # SHA-256, by the object's number, of fetched files for which no document has one


@dataclass(frozen=True)
class Remote:
    """A `Remote` is a library at a URL."""

    url: str

    def documents(self) -> Documents:
        """Returns both documents as they were last fetched; raises InvalidFile where there is no library."""
        copy = self._kept() or self.refresh()
        return copy.info, copy.facts

    def refresh(self) -> _Copy:
        """Fetches the documents and keeps them; where it raises InvalidFile, those fetched before stay."""
        for base in (_under(self.url, "models"), self.url):
            info = fetched(_under(base, INFO), LARGEST_DOCUMENT)
            if info is not None:
                kept = self._kept()
                facts = fetched(_under(base, FACTS), LARGEST_DOCUMENT)
                return self._keep(_Copy(base, info, facts, kept.sha256 if kept else {}))
        raise NoLibrary(f"{without_password(self.url)}: expected a library, with models/{INFO}, got none")

    def file(self, entry: Entry, *, anew: bool = False) -> Path:
        """Returns the model's file in the cache, fetched if it is not yet there; raises InvalidFile, NotWritten.

        `anew`: fetch it also where no document states a checksum by which the cached file is known to be current.
        """
        copy, known = self._kept() or self.refresh(), entry.facts.sha256 if entry.facts else None
        if not entry.facts and not anew:
            known = copy.sha256.get(entry.number)
        if known is not None:
            path = _folder() / known / entry.file
            with contextlib.suppress(HandsightError):  # a missing or damaged file is fetched again
                check_content(path, known, None)
                return path
        where = _under(copy.base, entry.file)
        data = fetched(where, entry.facts.bytes if entry.facts else LARGEST_FILE)
        if data is None:
            raise InvalidFile(f"{without_password(where)}: cannot be read: no such file")
        found = hashlib.sha256(data).hexdigest()
        if entry.facts:
            check_sha256(without_password(where), entry.facts.sha256, found)
        path = _folder() / found / entry.file
        write_file(path, data)
        now = self._kept() or self.refresh()
        if not entry.facts and now.info == copy.info:  # otherwise another process has fetched other documents
            self._keep(msgspec.structs.replace(now, sha256={**now.sha256, entry.number: found}))
        return path

    def _kept(self) -> _Copy | None:
        """Returns the copy in the cache; None where it is missing or damaged."""
        with contextlib.suppress(OSError, ValueError, msgspec.MsgspecError):
            return msgspec.msgpack.decode(read_entry(self._path, self.url), type=_Copy)
        return None

    def _keep(self, copy: _Copy) -> _Copy:
        with write_errors(self._path.parent):
            write_entry(self._path, self.url, msgspec.msgpack.encode(copy))
        return copy

    @property
    def _path(self) -> Path:
        return _folder() / f"{hashlib.sha256(self.url.encode(errors='replace')).hexdigest()}.msgpack"


def _folder() -> Path:
    return cache_folder() / "library"


def without_password(url: str) -> str:
    """Returns a URL for messages: without user and password."""
    return re.sub(r"(://)[^/]*@", r"\1", url)


def fetched(url: str, most: int) -> bytes | None:
    """Returns the bytes at a URL, or None where there is nothing.

    Raises InvalidFile, also for more than `most` bytes or where they take longer than at `SLOWEST`, and MissingExtra
    where the kind of URL needs fsspec.
    """
    got, seconds = list[bytes | HandsightError | None](), PATIENCE + most / SLOWEST

    def fetch() -> None:
        try:
            got.append(_fetched(url, most))
        except HandsightError as error:
            got.append(error)

    # In a thread of its own, as a server that sends a byte now and then keeps no read waiting for long.
    thread = threading.Thread(target=fetch, daemon=True)
    thread.start()
    thread.join(seconds)
    if not got:
        raise InvalidFile(f"{without_password(url)}: cannot be fetched: it took more than {seconds:.0f} s")
    if isinstance(got[0], HandsightError):
        raise got[0]
    return got[0]


def _fetched(url: str, most: int) -> bytes | None:
    name, data = without_password(url), bytearray()
    try:
        with _opened(url) as stream:
            while chunk := stream.read(1 << 20):
                data += chunk
                if len(data) > most:
                    raise InvalidFile(f"{name}: expected at most {most} bytes, got more")
            left = getattr(stream, "length", None)  # bytes that an HTTP server announced and did not send
    except HandsightError:
        raise
    except Exception as error:  # each kind of URL raises errors of its own
        getattr(error, "close", bool)()  # an HTTPError is the open answer
        reason = getattr(error, "reason", None) or error
        # Some file servers answer 403 where there is no file.
        if isinstance(reason, FileNotFoundError) or getattr(error, "code", None) in (403, 404, 410):
            return None
        text = str(reason) if name == url else ""  # a message may repeat a password
        raise InvalidFile(f"{name}: cannot be fetched: {text or type(error).__name__}") from None
    if left:
        raise InvalidFile(f"{name}: cannot be fetched: it ended {left} bytes early")
    return bytes(data)


def _opened(url: str) -> AbstractContextManager[BinaryIO]:
    """Opens a URL: http, https and file by the standard library, any other kind by fsspec."""
    opened: AbstractContextManager[BinaryIO]
    kind = url.partition("://")[0].lower()
    if kind in ("http", "https", "file"):
        from urllib.request import HTTPRedirectHandler, Request, build_opener

        class SameHost(HTTPRedirectHandler):
            """A `SameHost` follows redirects within a host, and to those that the user has named."""

            def redirect_request(self, req: Request, *given: Any) -> Request | None:
                """Returns the request for the new address, the last of those given; raises InvalidFile."""
                old, new = urlsplit(req.full_url), urlsplit(given[-1])
                known = new.scheme in (old.scheme, "https") and new.netloc == old.netloc
                if not known and new.netloc not in os.environ.get(REDIRECTS, "").split():
                    given[0].close()
                    expected = f"expected no redirect to another host than those of ${REDIRECTS}"
                    raise InvalidFile(f"{req.full_url}: {expected}, got {checks.brief(new.netloc)}")
                return super().redirect_request(req, *given)

        request = Request(url, headers={"User-Agent": "handsight"})
        opened = build_opener(SameHost).open(request, timeout=30)  # seconds without a byte
        return opened
    with needing(f"{without_password(url)}: {kind}:// needs fsspec", "library"):
        import fsspec
    opened = fsspec.open(url, "rb")
    return opened


def _under(url: str, name: str) -> str:
    """Returns the URL of a file below another URL.

    A chained URL, such as `zip://models::file:///ycbv.zip`, is extended in its first link.
    """
    first, chain, rest = url.partition("::")
    if not first.endswith("://"):
        first = first.rstrip("/") + "/"
    return f"{first}{name}{chain}{rest}"
