"""XML as a tree whose parts know their lines, from a file of bounded size, and as a text again."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from handsight.errors import InvalidFile
from handsight.files import read_bytes

LARGEST_FILE = 16 << 20
"""Bytes; a hand's description has some ten thousand."""
MOST_PARTS, MOST_LINKS = 50_000, 1_000
"""Elements, and bodies among them, those of all included files together; a robot has some thousand and some ten."""
DEEPEST = 200
"""Elements in elements, or links on links."""
_NO_NUMBER = re.compile(r"(?i)(?<![^\s+-])(nan|inf|infinity)\b")
_NAMES = frozenset(["name", "class", "childclass", "mesh", "file", "filename", "link", "prefix", "model"])
"""Attributes that are no numbers, whatever they say."""


@dataclass(slots=True)
class Part:
    """An element, what is in it, and where it stands."""

    tag: str
    """With its namespace before it as `{...}`, where it has one."""
    attributes: dict[str, str]
    file: str
    line: int
    parts: list["Part"] = field(default_factory=list)

    def get(self, name: str) -> str:
        """An attribute; empty where it is not there."""
        return self.attributes.get(name, "")

    def all(self, tag: str) -> list["Part"]:
        """The elements of that tag in this one."""
        return [part for part in self.parts if part.tag == tag]

    def find(self, tag: str) -> "Part | None":
        """The first of them; None where there is none."""
        return next(iter(self.all(tag)), None)

    def walk(self) -> Iterator["Part"]:
        """Itself and all in it."""
        yield self
        for part in self.parts:
            yield from part.walk()

    def new(self, tag: str, attributes: dict[str, str], of: "Part | None" = None) -> "Part":
        """A new element at the end of this one; it stands where `of` does, or this one."""
        of = of or self
        self.parts.append(Part(tag, attributes, of.file, of.line))
        return self.parts[-1]

    def wrong(self, said: str) -> InvalidFile:
        """The error that tells what is wrong with it, and its line."""
        return InvalidFile(f"{self.file}: {said}, line {self.line}")


def read_xml(path: Path) -> Part:
    """The outermost element of a file; raises InvalidFile, also for a DOCTYPE, which could declare entities."""
    content = read_bytes(path, LARGEST_FILE, path.name)
    if not content.strip():
        raise InvalidFile(f"{path.name}: expected a URDF or an MJCF, got an empty file")
    tree = _Tree(path.name)
    try:
        tree.parser.Parse(content, True)
    except InvalidFile:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InvalidFile(f"{path.name}: expected XML (URDF or MJCF), got {error}") from None
    return tree.top.parts[0]


class _Tree:
    """What a parser has met so far."""

    def __init__(self, file: str) -> None:
        self.top = Part("", {}, file, 0)
        self._open, self._count = [self.top], 0
        self.parser = expat.ParserCreate(namespace_separator="}")
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = lambda tag: self._open.pop()
        self.parser.StartDoctypeDeclHandler = self._doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        check_count(self._count, 0, self.top.file)
        check_depth(len(self._open), self.top.file)
        part = self._open[-1].new("{" + tag if "}" in tag else tag, attributes)
        part.line = self.parser.CurrentLineNumber
        self._open.append(part)

    def _doctype(self, *_: object) -> NoReturn:
        raise InvalidFile(f"{self.top.file}: expected a document without DOCTYPE, got one")


def check_count(parts: int, links: int, file: str) -> None:
    """Raises InvalidFile for more elements, or links, than a robot has."""
    if parts > MOST_PARTS:
        raise InvalidFile(f"{file}: expected a robot of at most {MOST_PARTS} elements, got more")
    if links > MOST_LINKS:
        raise InvalidFile(f"{file}: expected a robot of at most {MOST_LINKS} links, got more")


def check_depth(depth: int, file: str) -> None:
    """Raises InvalidFile for more elements in elements, or links on links, than a robot has."""
    if depth > DEEPEST:
        raise InvalidFile(f"{file}: expected elements and links at most {DEEPEST} deep, got deeper")


def check_numbers(part: Part) -> None:
    """Raises InvalidFile where one of an element's numbers is not finite: MuJoCo would print what it thinks of that."""
    for name, said in part.attributes.items():
        if name not in _NAMES and _NO_NUMBER.search(said):
            raise part.wrong(f"expected finite numbers for all links and joints, got {name}={said!r:.80}")


def text_of(root: Part) -> tuple[str, list[Part]]:
    """The text of a tree, in which each element begins a line, and the elements in that order; raises InvalidFile."""
    lines, parts = list[str](), list[Part]()

    def write(part: Part) -> None:
        """An element and, after it, those in it."""
        check_numbers(part)
        given = "".join(f" {name}={quoteattr(value)}" for name, value in part.attributes.items())
        lines.append(f"<{part.tag}{given}>")
        parts.append(part)
        for inner in part.parts:
            write(inner)
        lines[-1] += f"</{part.tag}>"

    write(root)
    return "\n".join(lines), parts
