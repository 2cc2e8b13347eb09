"""A URDF as MuJoCo is given it: the tree of links and joints, and one set of shapes for each link.

Inertias, materials, transmissions, couplings and simulators' extensions do not matter for kinematics, and each is a way
in which a file for another program fails to load.
"""

import itertools
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.hand.meshes import Meshes, read_mesh
from handsight.hand.paths import find_file
from handsight.hand.xml_file import Part, check_count, check_depth

LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""What links without inertia get [kg], [kg m²]: MuJoCo makes no robot of such, and kinematics does not ask."""
_COMPILER = {
    "fusestatic": "false",
    "discardvisual": "false",
    "strippath": "false",
    "balanceinertia": "true",
    "boundmass": str(LEAST_MASS),
    "boundinertia": str(LEAST_INERTIA),
}
_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
_LOOSE = ("planar", "floating", "spherical")
_OF_JOINT = ("origin", "parent", "child", "axis", "limit")
_STL_HEAD, _STL_FACE = 84, 50  # bytes; how many faces there are is told in the head's last four


class Urdf:
    """The links, joints and shapes of a `<robot>`; raises InvalidFile where one of its parts is not understood."""

    robot: Part
    """For MuJoCo."""
    meshes: Meshes
    missing: dict[str, list[str]]
    """Names of mesh files that are not there or cannot be read, by the kind of shape."""

    def __init__(self, root: Part, path: Path, *, visual: bool = False) -> None:
        """`visual`: a link's shapes are those that are seen, else those that touch; without it the other way round."""
        if any("xacro" in part.tag.partition("}")[0] for part in root.walk() if part.tag.startswith("{")):
            hint = f"`xacro {path.name}` makes a URDF of it"
            raise InvalidFile(f"{path.name}: expected a URDF, got a xacro file; {hint}")
        self._first = "visual" if visual else "collision"
        self._path, self._links, self._joints = path, dict[str, Part](), dict[str, Part]()
        self._above: dict[str, str] = {}
        self.robot, self.meshes = Part("robot", {"name": "hand"}, root.file, root.line), Meshes()
        self.missing = {"visual": [], "collision": []}
        self.robot.new("mujoco", {}).new("compiler", _COMPILER)
        check_count(0, len(root.all("link")), path.name)
        for link in root.all("link"):
            self._add_link(link)
        for joint in root.all("joint"):
            self._add_joint(joint)
        self._check_tree()

    def _add_link(self, link: Part) -> None:
        name = _named(link, self._links)
        new = self.robot.new("link", {"name": name}, link)
        shapes = {kind: self._shapes(link, kind) for kind in self.missing}
        new.parts = shapes.pop(self._first) or shapes.popitem()[1]

    def _add_joint(self, joint: Part) -> None:
        name, kind = _named(joint, self._joints), joint.get("type")
        if kind not in _JOINTS + _LOOSE:
            raise joint.wrong(f"joint {name!r}: expected a type among {', '.join(_JOINTS)}, got {kind!r}")
        # A ball stands for all that is neither hinge nor slide, and is refused where it matters.
        new = self.robot.new("joint", {"name": name, "type": "spherical" if kind in _LOOSE else kind}, joint)
        parent, child = (self._end(joint, tag) for tag in ("parent", "child"))
        if child in self._above:
            raise joint.wrong(f"joint {name!r}: expected one parent for each link, got another for {child!r}")
        self._above[child] = parent
        new.parts += [part for tag in _OF_JOINT if (part := joint.find(tag)) is not None]

    def _end(self, joint: Part, tag: str) -> str:
        """The link that a joint has as its parent or child."""
        name, part = joint.get("name"), joint.find(tag)
        if part is None:
            raise joint.wrong(f"joint {name!r}: expected a {tag}, got none")
        if part.get("link") not in self._links:
            raise joint.wrong(
                f"joint {name!r}: expected a link of the file as {tag}, got {part.get('link')!r}"
            )
        return part.get("link")

    def _check_tree(self) -> None:
        """Raises InvalidFile unless all links hang on one."""
        below = dict[str, list[str]]()
        for child, parent in self._above.items():
            below.setdefault(parent, []).append(child)
        roots = [name for name in self._links if name not in self._above]
        if len(roots) > 1:
            said = f"expected one link that all others hang on, got {roots[0]!r} and {roots[1]!r}"
            raise self._links[roots[1]].wrong(said)
        reached, level = set[str](), roots
        for depth in itertools.count():
            check_depth(depth, self._path.name)
            reached |= set(level)
            level = [child for link in level for child in below.get(link, ())]
            if not level:
                break
        for name, link in self._links.items():
            if name not in reached:
                raise link.wrong(f"expected a tree of links, got a circle of joints at {name!r}")

    def _shapes(self, link: Part, tag: str) -> list[Part]:
        found = []
        for shape in link.all(tag):
            geometry = shape.find("geometry")
            if geometry is None or not geometry.parts:
                continue
            mesh = geometry.find("mesh")
            if mesh is not None:
                name = self._asset(mesh)
                if name is None:
                    self.missing[tag].append(mesh.get("filename"))
                    continue
                mesh.attributes["filename"] = name
            # Touching shapes would have their hulls built, which are of no use here.
            parts = [part for part in (shape.find("origin"), geometry) if part is not None]
            found.append(Part("visual", {}, shape.file, shape.line, parts))
        return found

    def _asset(self, mesh: Part) -> str | None:
        """The name among the meshes of a mesh in its scale; None where MuJoCo cannot read it."""
        try:
            path = find_file(mesh.get("filename"), self._path.parent)
            content = read_mesh(path)
        except (InvalidFile, OSError, ValueError):
            return None
        kind = path.suffix.lower()
        binary = len(content) == _STL_HEAD + _STL_FACE * int.from_bytes(content[80:_STL_HEAD], "little")
        if not (kind == ".obj" or (kind == ".stl" and binary)):
            return None
        return self.meshes.add(path, content, mesh.get("scale"))


def _named(part: Part, others: dict[str, Part]) -> str:
    """The name of a link or joint, which is put among the others; raises InvalidFile where it has none of its own."""
    name = part.get("name")
    if not name:
        raise part.wrong(f"expected a name for each {part.tag}, got none")
    if name in others:
        raise part.wrong(f"expected each {part.tag} once, got {name!r} twice")
    others[name] = part
    return name
