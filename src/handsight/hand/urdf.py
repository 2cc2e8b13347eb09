"""URDF to what MuJoCo needs of it: the tree of links and joints, and one set of shapes for each link.

Inertias, materials, transmissions, couplings and simulators' extensions do not matter for kinematics, and each is a
way in which a file for another program fails to load.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.hand.paths import find_file

LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""What links without inertia get [kg], [kg m²]: MuJoCo makes no robot of such, and kinematics does not ask."""
COMPILER = {
    "fusestatic": "false",
    "discardvisual": "false",
    "strippath": "false",
    "balanceinertia": "true",
    "boundmass": str(LEAST_MASS),
    "boundinertia": str(LEAST_INERTIA),
}
JOINTS = ("revolute", "continuous", "prismatic", "fixed")
LOOSE = ("planar", "floating", "spherical")
_STL_HEAD, _STL_FACE = 84, 50


@dataclass(slots=True)
class Urdf:
    """A URDF without what MuJoCo does not need, while it is being written."""

    folder: Path
    """Of the file; relative names start there."""
    assets: dict[str, bytes] = field(default_factory=dict)
    """The meshes by the names they have in `robot`: MuJoCo would take two of one name in two folders for one."""
    names: dict[tuple[Path, str], str] = field(default_factory=dict)
    """Of each mesh file in each scale the name among the assets."""
    missing_visual: list[str] = field(default_factory=list)
    """Names of mesh files that are not there or cannot be read."""
    missing_collision: list[str] = field(default_factory=list)
    robot: ET.Element = field(default_factory=lambda: ET.Element("robot", name="hand"))

    @property
    def text(self) -> str:
        """The XML for MuJoCo."""
        return ET.tostring(self.robot, encoding="unicode")


def simplified(root: ET.Element, path: Path) -> Urdf:
    """The links, joints and shapes of a `<robot>`; raises InvalidFile where one of its parts is not understood."""
    if any("xacro" in part.tag.partition("}")[0] for part in root.iter() if part.tag.startswith("{")):
        raise InvalidFile(
            f"{path.name}: expected a URDF, got a xacro file; `xacro {path.name}` makes a URDF of it"
        )
    urdf = Urdf(path.parent)
    ET.SubElement(ET.SubElement(urdf.robot, "mujoco"), "compiler", COMPILER)
    for link in root.findall("link"):
        new = ET.SubElement(urdf.robot, "link", name=_name(link, path))
        collision = list(_shapes(link, "collision", urdf, urdf.missing_collision))
        # Touching shapes would have their hulls built, which are of no use here.
        visual = list(_shapes(link, "visual", urdf, urdf.missing_visual))
        new.extend(collision or visual)
    for joint in root.findall("joint"):
        _add_joint(joint, urdf, path)
    return urdf


def _name(element: ET.Element, path: Path) -> str:
    name = element.get("name")
    if not name:
        raise InvalidFile(f"{path.name}: expected a name for each {element.tag}, got none")
    return name


def _add_joint(joint: ET.Element, urdf: Urdf, path: Path) -> None:
    name, kind = _name(joint, path), joint.get("type", "")
    if kind not in JOINTS + LOOSE:
        raise InvalidFile(
            f"{path.name}: joint {name!r}: expected a type among {', '.join(JOINTS)}, got {kind!r}"
        )
    # A ball stands for all that is neither hinge nor slide, and is refused where it matters.
    new = ET.SubElement(urdf.robot, "joint", name=name, type="spherical" if kind in LOOSE else kind)
    for tag in ("origin", "parent", "child", "axis", "limit"):
        part = joint.find(tag)
        if part is not None:
            new.append(part)
        elif tag in ("parent", "child"):
            raise InvalidFile(f"{path.name}: joint {name!r}: expected a {tag}, got none")


def _shapes(link: ET.Element, tag: str, urdf: Urdf, missing: list[str]) -> Iterator[ET.Element]:
    for shape in link.findall(tag):
        geometry = shape.find("geometry")
        mesh = None if geometry is None else geometry.find("mesh")
        if geometry is None or (mesh is None and not len(geometry)):
            continue
        if mesh is not None:
            name = _kept(mesh.get("filename", ""), mesh.get("scale", ""), urdf)
            if name is None:
                missing.append(mesh.get("filename", ""))
                continue
            mesh.set("filename", name)
        new = ET.Element("visual")
        new.extend(part for part in (shape.find("origin"), geometry) if part is not None)
        yield new


def _kept(file: str, scale: str, urdf: Urdf) -> str | None:
    """The name among the assets of a mesh in one scale; None where MuJoCo cannot read it."""
    try:
        path = find_file(file, urdf.folder)
        content = path.read_bytes()
    except (InvalidFile, OSError, ValueError):
        return None
    kind = path.suffix.lower()
    if not (kind == ".obj" or (kind == ".stl" and _is_binary_stl(content))):
        return None
    name = urdf.names.setdefault((path.resolve(), scale), f"{len(urdf.names)}{kind}")
    urdf.assets[name] = content
    return name


def _is_binary_stl(content: bytes) -> bool:
    faces = int.from_bytes(content[_STL_HEAD - 4 : _STL_HEAD], "little")
    return len(content) == _STL_HEAD + _STL_FACE * faces
