"""XML of a robot's description: a tree of elements that know their lines, and the mesh files that it names.

Files are of bounded size: MuJoCo allocates, loops or crashes for what the text of a broken file asks.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from handsight.errors import InvalidFile
from handsight.files import read_bytes


@dataclass(slots=True)
class Element:
    """One element of an XML file, with its children and its place in the file."""

    tag: str  # name, with the namespace before it as `{...}` where it has one
    attributes: dict[str, str]
    file: str
    line: int
    children: list["Element"] = field(default_factory=list)

    def get(self, name: str) -> str:
        """Returns an attribute, or an empty text where the element does not have it."""
        return self.attributes.get(name, "")

    def all(self, tag: str) -> list["Element"]:
        """Returns the children with that tag."""
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> "Element | None":
        """Returns the first child with that tag, or None."""
        return next(iter(self.all(tag)), None)

    def descendants(self) -> Iterator["Element"]:
        """Yields the element and all elements in it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.descendants()

    def add(self, tag: str, attributes: dict[str, str], source: "Element | None" = None) -> "Element":
        """Returns a new last child, with the place of `source`, or of this element, in the file."""
        source = source or self
        self.children.append(Element(tag, attributes, source.file, source.line))
        return self.children[-1]

    def error(self, message: str) -> InvalidFile:
        """Returns the error of a message about this element, with its file and line."""
        return InvalidFile(f"{self.file}: {message}, line {self.line}")


def read_xml(path: Path) -> Element:
    """Returns the root element of a file; raises InvalidFile, also for a DOCTYPE, which could declare entities."""
    name = path.name
    content = read_bytes(path, 16 << 20, name)
    if not content.strip():
        raise InvalidFile(f"{name}: expected a URDF or an MJCF, got an empty file")
    document = Element("", {}, name, 0)
    ancestors = [document]
    count = 0
    parser = expat.ParserCreate(namespace_separator="}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        """Adds an element to the innermost open one."""
        nonlocal count
        count += 1
        check_count(count, 0, name)
        check_depth(len(ancestors), name)
        element = ancestors[-1].add("{" + tag if "}" in tag else tag, attributes)
        element.line = parser.CurrentLineNumber
        ancestors.append(element)

    def doctype(*_: object) -> NoReturn:
        raise InvalidFile(f"{name}: expected a document without DOCTYPE, got one")

    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = doctype
    parser.EndElementHandler = lambda tag: ancestors.pop()
    try:
        parser.Parse(content, True)
    except InvalidFile:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InvalidFile(f"{name}: expected XML (URDF or MJCF), got {error}") from None
    return document.children[0]


def check_count(elements: int, links: int, file: str) -> None:
    """Raises InvalidFile for more elements or links than a robot has, those of included files with them."""
    for number, most, what in ((elements, 50_000, "elements"), (links, 1_000, "links")):
        if number > most:
            raise InvalidFile(f"{file}: expected a robot of at most {most} {what}, got more")


def check_depth(depth: int, file: str) -> None:
    """Raises InvalidFile for more elements in elements, or links on links, than a robot has."""
    if depth > 200:
        raise InvalidFile(f"{file}: expected elements and links at most 200 deep, got deeper")


def to_text(root: Element) -> tuple[str, list[Element]]:
    """Returns the text of a tree, one element a line, and the element of each line. Raises InvalidFile for a number
    that is not finite, as MuJoCo would only print a warning about it."""
    lines = list[str]()
    elements = list[Element]()
    texts = ("name", "class", "childclass", "mesh", "file", "filename", "link", "prefix", "model")

    def write(element: Element) -> None:
        """Writes an element with all in it."""
        for name, value in element.attributes.items():
            if name not in texts and re.search(r"(?i)(?<![^\s+-])(nan|inf|infinity)\b", value):
                raise element.error(
                    f"expected finite numbers for all links and joints, got {name}={value!r:.80}"
                )
        attributes = "".join(f" {name}={quoteattr(value)}" for name, value in element.attributes.items())
        lines.append(f"<{element.tag}{attributes}>")
        elements.append(element)
        for child in element.children:
            write(child)
        lines[-1] += f"</{element.tag}>"

    write(root)
    return "\n".join(lines), elements


class Meshes:
    """Mesh files under unique names: MuJoCo would take two files of one name in two folders for one."""

    def __init__(self) -> None:
        self.contents: dict[str, bytes] = {}  # contents of the files by the name that a description is to use
        self._names: dict[tuple[Path, str], str] = {}

    def add(self, path: Path, content: bytes, variant: str = "") -> str:
        """Returns the name of a file's content, one for each variant; raises InvalidFile above 256 MiB in all."""
        key = (path.resolve(), variant)
        if key not in self._names:
            most = 256 << 20
            if sum(map(len, self.contents.values())) + len(content) > most:
                raise InvalidFile(f"{path.name}: expected meshes of at most {most} bytes in all, got more")
            self._names[key] = f"{len(self._names)}{path.suffix.lower()}"
            self.contents[self._names[key]] = content
        return self._names[key]


def read_mesh(path: Path) -> bytes:
    """Returns the bytes of a mesh file of at most 32 MiB; raises InvalidFile."""
    content = read_bytes(path, 32 << 20, path.name)
    # Of several objects in an OBJ file MuJoCo reads one alone; without their names they are one.
    return re.sub(rb"(?m)^[og][ \t].*$", b"", content) if path.suffix.lower() == ".obj" else content


def as_stl(path: Path, content: bytes) -> bytes:
    """Returns a mesh file's content as binary STL, in metres where its format states a unit.

    Raises InvalidFile for what is no mesh, MissingExtra for a DAE or 3MF without its extra.
    """
    from handsight.objects.files.read import READERS, shape_of  # brings trimesh, which most hands do not need

    if path.suffix.lower() not in READERS:
        raise InvalidFile(f"{path.name}: expected one of {', '.join(sorted(READERS))}, got another format")
    shape = shape_of(path, content)
    if shape.faces is None:
        raise InvalidFile(f"{path.name}: expected triangles, got a cloud")
    from trimesh import Trimesh

    exported = Trimesh(shape.vertices, shape.faces, process=False).export(file_type="stl")
    if not isinstance(exported, bytes):
        raise InvalidFile(f"{path.name}: expected a mesh that can be written as STL, got another")
    return exported
