"""An MJCF as MuJoCo is given it: one text with what it includes, without what kinematics does not ask for.

MuJoCo would read whatever files a text names, allocate whatever sizes it states, and crash over a model that holds
itself.
"""

import os
import re
from pathlib import Path

from handsight.hand.meshes import Meshes, read_mesh
from handsight.hand.xml_file import Part, check_count, check_depth, read_xml

_UNUSED = frozenset([
    *("size", "option", "visual", "statistic", "custom", "extension", "deformable", "contact", "equality"),
    *("tendon", "actuator", "sensor", "keyframe", "texture", "material", "hfield", "skin", "site"),
    *("camera", "light", "composite", "flexcomp", "plugin", "lengthrange", "pair", "general", "motor"),
    *("position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion"),
])  # fmt: skip
"""Elements that say nothing of bodies, joints and shapes, wherever they stand."""
_UNUSED_NAMES = frozenset(["material", "user", "meshdir", "assetdir", "texturedir", "strippath"])
"""Attributes that refer to these, or to where files are."""
_COUNT = re.compile(r"\s*\d{1,6}\s*")


class Mjcf:
    """The bodies, joints and shapes of a `<mujoco>`; raises InvalidFile where a part of it is no hand's."""

    robot: Part
    """For MuJoCo."""
    meshes: Meshes
    missing: dict[str, str]
    """Mesh files that are not there, by the name of their mesh in `robot`."""

    def __init__(self, root: Part, path: Path) -> None:
        self._folder, self._included = path.parent, {path.resolve()}
        self._parts = self._bodies = 0
        self._compiler: dict[str, str] = {}
        self.meshes, self.missing = Meshes(), {}
        self.robot = Part(root.tag, root.attributes, root.file, root.line)
        self._fill(self.robot, root, 1, 1)
        for asset in self.robot.all("asset"):
            for mesh in asset.all("mesh"):
                self._supply(mesh)

    def _fill(self, new: Part, old: Part, copies: int, depth: int) -> None:
        """Puts the parts of `old` that are used into `new`, of which MuJoCo will make so many copies."""
        check_depth(depth, old.file)
        for part in old.parts:
            self._parts += copies
            self._bodies += copies * (part.tag == "body")
            check_count(self._parts, self._bodies, part.file)
            if part.tag == "include":
                self._fill(new, self._read(part), copies, depth + 1)
            elif part.tag in ("model", "attach"):
                raise part.wrong(f"expected a robot in one model with its includes, got <{part.tag}>")
            elif part.tag not in _UNUSED:
                if part.tag == "compiler":
                    self._compiler |= part.attributes
                given = {name: said for name, said in part.attributes.items() if name not in _UNUSED_NAMES}
                self._fill(new.new(part.tag, given, part), part, copies * _copies(part), depth + 1)

    def _read(self, include: Part) -> Part:
        """The outermost element of an included file."""
        name = include.get("file")
        path = self._folder / name
        if not os.path.isfile(path):
            raise include.wrong(f"include: expected a file, got {name!r}")
        if path.resolve() in self._included:
            raise include.wrong(f"include: expected each file once, got {name!r} again")
        self._included.add(path.resolve())
        return read_xml(path)

    def _supply(self, mesh: Part) -> None:
        """Has a mesh's file among the meshes."""
        if "file" not in mesh.attributes:
            return
        file = mesh.get("file")
        mesh.attributes.setdefault("name", Path(file).stem)
        folder = self._compiler.get("meshdir", self._compiler.get("assetdir", ""))
        stripped = self._compiler.get("strippath") == "true"
        path = self._folder / folder / (Path(file).name if stripped else file)
        if os.path.isfile(path):
            mesh.attributes["file"] = self.meshes.add(path, read_mesh(path))
        else:
            self.missing[mesh.get("name")] = file


def _copies(part: Part) -> int:
    if part.tag != "replicate":
        return 1
    if not _COUNT.fullmatch(part.get("count")):
        raise part.wrong(f"replicate: expected a count below a million, got {part.get('count')!r:.40}")
    return int(part.get("count"))
