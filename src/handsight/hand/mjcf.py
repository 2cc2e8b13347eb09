"""MJCF files as MuJoCo gets them: one text with all that it includes, without what kinematics does not need.

MuJoCo would read any file that a text names, allocate any size that a text states, and crash for a model that includes
itself.
"""

import os
import re
from pathlib import Path

from handsight.hand.robot_xml import Element, Meshes, check_count, check_depth, read_mesh, read_xml

_UNUSED = frozenset([
    *("size", "option", "visual", "statistic", "custom", "extension", "deformable", "contact", "equality"),
    *("tendon", "actuator", "sensor", "keyframe", "texture", "material", "hfield", "skin", "site"),
    *("camera", "light", "composite", "flexcomp", "plugin", "lengthrange", "pair", "general", "motor"),
    *("position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion"),
])  # fmt: skip
"""Tags of elements that are dropped wherever they are: they hold no bodies, joints or shapes."""
_UNUSED_ATTRIBUTES = frozenset(["material", "user", "meshdir", "assetdir", "texturedir", "strippath"])
"""Attributes that are dropped: they refer to such elements, or to folders."""


class Mjcf:
    """Bodies, joints and shapes of a `<mujoco>`; raises InvalidFile for a model that is no robot."""

    robot: Element  # the tree for MuJoCo
    meshes: Meshes  # the mesh files that the tree names
    missing: dict[str, str]  # mesh files that do not exist, by the name of their mesh in `robot`
    constraints: list[Element]  # what is in `<equality>`
    tendons: list[Element]  # the fixed ones

    def __init__(self, root: Element, path: Path) -> None:
        self._folder = path.parent
        self._included = {path.resolve()}
        self._elements = self._bodies = 0
        self._compiler: dict[str, str] = {}
        self.meshes = Meshes()
        self.missing = {}
        self.constraints = []
        self.tendons = []
        self.robot = Element(root.tag, root.attributes, root.file, root.line)
        self._copy(root, self.robot, 1, 1)
        folder = path.parent / self._compiler.get("meshdir", self._compiler.get("assetdir", ""))
        for mesh in (mesh for asset in self.robot.all("asset") for mesh in asset.all("mesh")):
            if "file" in mesh.attributes:
                file = mesh.get("file")
                mesh.attributes.setdefault("name", Path(file).stem)
                found = folder / (Path(file).name if self._compiler.get("strippath") == "true" else file)
                if os.path.isfile(found):
                    mesh.attributes["file"] = self.meshes.add(found, read_mesh(found))
                else:
                    self.missing[mesh.get("name")] = file

    def _copy(self, old: Element, new: Element, copies: int, depth: int) -> None:
        """Copies the used children of `old` to `new`, of which MuJoCo will make that many copies."""
        check_depth(depth, old.file)
        for child in old.children:
            self._elements += copies
            self._bodies += copies * (child.tag == "body")
            check_count(self._elements, self._bodies, child.file)
            if child.tag == "include":
                name = child.get("file")
                path = self._folder / name
                if not os.path.isfile(path):
                    raise child.error(f"include: expected a file, got {name!r}")
                if path.resolve() in self._included:
                    raise child.error(f"include: expected each file once, got {name!r} again")
                self._included.add(path.resolve())
                self._copy(read_xml(path), new, copies, depth + 1)
            elif child.tag in ("model", "attach"):
                raise child.error(f"expected a robot in one model with its includes, got <{child.tag}>")
            elif child.tag == "equality" and old.tag == "mujoco":
                self.constraints += child.all("joint") + child.all("tendon")
            elif child.tag == "tendon" and old.tag == "mujoco":
                self.tendons += child.all("fixed")
            elif child.tag not in _UNUSED:
                if child.tag == "compiler":
                    self._compiler |= child.attributes
                repeats = 1
                if child.tag == "replicate":
                    text = child.get("count")
                    if not re.fullmatch(r"\s*\d{1,6}\s*", text):
                        raise child.error(f"replicate: expected a count below a million, got {text!r:.40}")
                    repeats = int(text)
                used = {k: text for k, text in child.attributes.items() if k not in _UNUSED_ATTRIBUTES}
                self._copy(child, new.add(child.tag, used, child), copies * repeats, depth + 1)
