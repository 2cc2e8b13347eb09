"""Mesh files that a robot's description names, as MuJoCo is given them."""

from pathlib import Path

from handsight.errors import InvalidFile
from handsight.files import read_bytes

LARGEST_MESH = 32 << 20
"""Bytes; MuJoCo reads STL of up to 10 MB."""
MOST_BYTES = 256 << 20
"""Of all meshes of a robot together."""


class Meshes:
    """Mesh files under names of their own: MuJoCo would take two of one name in two folders for one."""

    def __init__(self) -> None:
        self.contents: dict[str, bytes] = {}
        """By the name that a description is to use."""
        self._names: dict[tuple[Path, str], str] = {}
        self._bytes = 0

    def add(self, path: Path, content: bytes, variant: str = "") -> str:
        """The name of a file's content; another one for each variant. Raises InvalidFile where it is too much."""
        key = (path.resolve(), variant)
        if key not in self._names:
            self._names[key] = f"{len(self._names)}{path.suffix.lower()}"
            self._bytes += len(content)
            if self._bytes > MOST_BYTES:
                raise InvalidFile(
                    f"{path.name}: expected meshes of at most {MOST_BYTES} bytes in all, got more"
                )
            self.contents[self._names[key]] = content
        return self._names[key]


def read_mesh(path: Path) -> bytes:
    """What is in a regular file of sensible size; raises InvalidFile."""
    return read_bytes(path, LARGEST_MESH, path.name)
