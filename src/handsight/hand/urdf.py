"""URDF files as MuJoCo gets them: the tree of links and joints, and one set of shapes for each link.

Inertias, materials, transmissions, couplings and simulators' extensions are dropped: kinematics does not need them, and
each of them can keep a file that was written for another program from loading.
"""

import itertools
import re
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.hand.paths import find_file
from handsight.hand.robot_xml import Element, Meshes, check_count, check_depth, read_mesh

MIN_MASS, MIN_INERTIA = 1e-6, 1e-9
"""Mass [kg] and inertia [kg m²] of links without any: MuJoCo refuses such links, and kinematics needs neither."""


class Urdf:
    """A `Urdf` has the links, joints and shapes of a `<robot>`; raises InvalidFile for what it does not understand."""

    robot: Element  # the tree for MuJoCo
    meshes: Meshes  # the mesh files that the tree names
    missing: dict[str, list[str]]
    """Names of mesh files that do not exist or cannot be read, by the kind of shape (`visual`, `collision`)."""

    def __init__(self, root: Element, path: Path, *, visual: bool = False) -> None:
        """Each link gets its collision shapes, else its visual ones; with `visual` the other way round."""
        if any(re.match(r"\{[^}]*xacro", each.tag) for each in root.descendants()):
            hint = f"`xacro {path.name}` makes a URDF of it"
            raise InvalidFile(f"{path.name}: expected a URDF, got a xacro file; {hint}")
        self._path, self._links, self._joints = path, dict[str, Element](), dict[str, Element]()
        self._parents: dict[str, str] = {}
        self.robot, self.meshes = Element("robot", {"name": "hand"}, root.file, root.line), Meshes()
        self.missing = {"visual": [], "collision": []}
        options = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
        bounds = {"boundmass": str(MIN_MASS), "boundinertia": str(MIN_INERTIA)}
        self.robot.add("mujoco", {}).add("compiler", {**options, "balanceinertia": "true", **bounds})
        check_count(0, len(root.all("link")), path.name)
        for link in root.all("link"):
            new = self.robot.add("link", {"name": _unique_name(link, self._links)}, link)
            shapes = {kind: self._shapes(link, kind) for kind in self.missing}
            new.children = shapes.pop("visual" if visual else "collision") or shapes.popitem()[1]
        for joint in root.all("joint"):
            self._add_joint(joint)
        self._check_tree()

    def _add_joint(self, joint: Element) -> None:
        name, kind = _unique_name(joint, self._joints), joint.get("type")
        kinds, others = ("revolute", "continuous", "prismatic", "fixed"), ("planar", "floating", "spherical")
        if kind not in kinds + others:
            raise joint.error(f"joint {name!r}: expected a type among {', '.join(kinds)}, got {kind!r}")
        # A ball joint stands for all that are neither hinge nor slide; it is refused where it is between palm and tips.
        kind = "spherical" if kind in others else kind
        new = self.robot.add("joint", {"name": name, "type": kind}, joint)
        ends = []
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is None:
                raise joint.error(f"joint {name!r}: expected a {tag}, got none")
            if end.get("link") not in self._links:
                came = repr(end.get("link"))
                raise joint.error(f"joint {name!r}: expected a link of the file as {tag}, got {came}")
            ends.append(end.get("link"))
        parent, child = ends
        if child in self._parents:
            raise joint.error(f"joint {name!r}: expected one parent for each link, got another for {child!r}")
        self._parents[child] = parent
        used = (joint.find(tag) for tag in ("origin", "parent", "child", "axis", "limit"))
        new.children += [part for part in used if part is not None]

    def _check_tree(self) -> None:
        """Raises InvalidFile unless all links hang on one."""
        children = dict[str, list[str]]()
        for child, parent in self._parents.items():
            children.setdefault(parent, []).append(child)
        roots = [name for name in self._links if name not in self._parents]
        if len(roots) > 1:
            expected = "expected one link that all others hang on"
            raise self._links[roots[1]].error(f"{expected}, got {roots[0]!r} and {roots[1]!r}")
        reached, level = set[str](), roots
        for depth in itertools.count():
            check_depth(depth, self._path.name)
            reached |= set(level)
            level = [child for link in level for child in children.get(link, ())]
            if not level:
                break
        for name, link in self._links.items():
            if name not in reached:
                raise link.error(f"expected a tree of links, got a circle of joints at {name!r}")

    def _shapes(self, link: Element, kind: str) -> list[Element]:
        """Returns a link's shapes of one kind, as visual ones: of collision shapes MuJoCo would build the hulls."""
        shapes = []
        for shape in link.all(kind):
            geometry = shape.find("geometry")
            if geometry is None or not geometry.children:
                continue
            if mesh := geometry.find("mesh"):
                name = self._mesh_name(mesh)
                if name is None:
                    self.missing[kind].append(mesh.get("filename"))
                    continue
                mesh.attributes["filename"] = name
            parts = [part for part in (shape.find("origin"), geometry) if part is not None]
            shapes.append(Element("visual", {}, shape.file, shape.line, parts))
        return shapes

    def _mesh_name(self, mesh: Element) -> str | None:
        """Returns the name of a mesh of that scale among the meshes; None where MuJoCo cannot read its file."""
        try:
            path = find_file(mesh.get("filename"), self._path.parent)
            content = read_mesh(path)
        except (InvalidFile, OSError, ValueError):
            return None
        kind = path.suffix.lower()
        # A binary STL has a head of 84 bytes, whose last four are the number of faces, and 50 bytes a face.
        binary = len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")
        if not (kind == ".obj" or (kind == ".stl" and binary)):
            return None
        return self.meshes.add(path, content, mesh.get("scale"))


def _unique_name(element: Element, others: dict[str, Element]) -> str:
    """Returns the name of a link or joint, which is added to the others; raises InvalidFile without a new name."""
    name = element.get("name")
    if not name:
        raise element.error(f"expected a name for each {element.tag}, got none")
    if name in others:
        raise element.error(f"expected each {element.tag} once, got {name!r} twice")
    others[name] = element
    return name
