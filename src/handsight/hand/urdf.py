"""URDF files as MuJoCo gets them: the tree of links and joints, and one set of shapes for each link.

Inertias, materials, transmissions and simulators' extensions are dropped: kinematics does not need them, and each of
them can keep a file that was written for another program from loading. Couplings of joints are kept apart.
"""

import itertools
import re
from pathlib import Path

from handsight.errors import HandsightError, InvalidFile
from handsight.hand.couplings import Coupling, of_urdf
from handsight.hand.paths import find_file
from handsight.hand.robot_xml import Element, Meshes, as_stl, check_count, check_depth, read_mesh

MIN_MASS = 1e-6
MIN_INERTIA = 1e-9
"""Mass [kg] and inertia [kg m²] of links without any: MuJoCo refuses such links, and kinematics needs neither."""


class Urdf:
    """Links, joints and shapes of a `<robot>`; raises InvalidFile for what it does not understand."""

    robot: Element  # the tree for MuJoCo
    meshes: Meshes  # the mesh files that the tree names
    couplings: tuple[Coupling, ...]
    """Of joints that mimic others."""
    missing: dict[str, dict[str, str]]
    """By the kind of shape (`visual`, `collision`), the names of mesh files that are left out: why each cannot be read;
    empty: it is not there."""

    def __init__(self, root: Element, path: Path, *, visual: bool = False) -> None:
        """Each link gets its collision shapes, else its visual ones; with `visual` the other way round."""
        if any(re.match(r"\{[^}]*xacro", each.tag) for each in root.descendants()):
            raise InvalidFile(
                f"{path.name}: expected a URDF, got a xacro file; `xacro {path.name}` makes a URDF of it"
            )
        self._path = path
        self._links = dict[str, Element]()
        self._joints = dict[str, Element]()
        self._parents: dict[str, str] = {}
        self.robot = Element("robot", {"name": "hand"}, root.file, root.line)
        self.meshes = Meshes()
        self.missing = {"visual": {}, "collision": {}}
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
        self.couplings = tuple(of_urdf(root.all("joint")))
        self._check_tree()

    def _add_joint(self, joint: Element) -> None:
        name = _unique_name(joint, self._joints)
        kind = joint.get("type")
        kinds = ("revolute", "continuous", "prismatic", "fixed")
        others = ("planar", "floating", "spherical")
        if kind not in kinds + others:
            raise joint.error(f"joint {name!r}: expected a type among {', '.join(kinds)}, got {kind!r}")
        # A ball joint stands for all that are neither hinge nor slide; it is refused where it is between palm and tips.
        kind = "spherical" if kind in others else kind
        new = self.robot.add("joint", {"name": name, "type": kind}, joint)
        ends = []
        for tag in ("parent", "child"):
            end = joint.find(tag)
            link = "" if end is None else end.get("link")
            if link not in self._links:
                raise joint.error(f"joint {name!r}: expected a link of the file as {tag}, got {link!r}")
            ends.append(link)
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
            raise self._links[roots[1]].error(
                f"expected one link that all others hang on, got {roots[0]!r} and {roots[1]!r}"
            )
        unreached = dict(self._links)
        level = roots
        for depth in itertools.count():
            check_depth(depth, self._path.name)
            for name in level:
                del unreached[name]
            level = [child for link in level for child in children.get(link, ())]
            if not level:
                break
        for name, link in unreached.items():
            raise link.error(f"expected a tree of links, got a circle of joints at {name!r}")

    def _shapes(self, link: Element, kind: str) -> list[Element]:
        """Returns a link's shapes of one kind, as visual ones: of collision shapes MuJoCo would build the hulls."""
        shapes = []
        for shape in link.all(kind):
            geometry = shape.find("geometry")
            if geometry is None or not geometry.children:
                continue
            if mesh := geometry.find("mesh"):
                file = mesh.get("filename")
                try:
                    path = find_file(file, self._path.parent)
                except (HandsightError, OSError, ValueError):
                    self.missing[kind][file] = ""
                    continue
                try:
                    mesh.attributes["filename"] = self._mesh_name(path, mesh.get("scale"))
                except (HandsightError, OSError, ValueError) as error:
                    self.missing[kind][file] = str(error)
                    continue
            parts = [part for part in (shape.find("origin"), geometry) if part is not None]
            shapes.append(Element("visual", {}, shape.file, shape.line, parts))
        return shapes

    def _mesh_name(self, path: Path, scale: str) -> str:
        """Returns the name of a file's mesh of that scale among the meshes; raises where it cannot be read."""
        content = read_mesh(path)
        kind = path.suffix.lower()
        # A binary STL has a head of 84 bytes, whose last four are the number of faces, and 50 bytes a face.
        binary = len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")
        if kind != ".obj" and not (kind == ".stl" and binary):
            content = as_stl(path, content)  # the two kinds are MuJoCo's own
            path = path.with_suffix(f"{kind}.stl")
        return self.meshes.add(path, content, scale)


def _unique_name(element: Element, others: dict[str, Element]) -> str:
    """Returns the name of a link or joint, which is added to the others; raises InvalidFile without a new name."""
    name = element.get("name")
    if not name:
        raise element.error(f"expected a name for each {element.tag}, got none")
    if name in others:
        raise element.error(f"expected each {element.tag} once, got {name!r} twice")
    others[name] = element
    return name
