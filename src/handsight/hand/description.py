"""Robot descriptions, URDF and MJCF, to MuJoCo models.

Of a URDF MuJoCo gets the tree of links and joints, and one set of shapes for each link: inertias, materials,
transmissions, couplings and simulators' extensions do not matter for kinematics, and each is a way in which a file for
another program fails to load.
"""

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from handsight.errors import InvalidFile, MissingExtra
from handsight.hand.paths import find_file

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
_STL_HEAD, _STL_FACE = 84, 50


class HandWarning(UserWarning):
    """Something about a robot's description that costs part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A robot as MuJoCo compiled it."""

    name: str
    """The file's, for messages."""
    model: Any
    """mujoco.MjModel."""
    missing_meshes: tuple[str, ...]
    """Files of shapes that were left out."""


def read(path: str | Path) -> Description:
    """The robot of a URDF or MJCF file.

    Raises InvalidFile, MissingExtra; warns where meshes of a URDF's collision shapes are left out.
    """
    found = find_file(path)
    try:
        import mujoco
    except ImportError:
        raise MissingExtra(f"{found.name}: needs MuJoCo: pip install 'handsight[robot]'") from None
    root = _root(found)
    if root.tag == "mujoco":
        model, missing = _mjcf(mujoco, found)
    elif root.tag == "robot":
        model, missing = _urdf(mujoco, root, found)
    else:
        raise InvalidFile(
            f"{found.name}: expected a URDF (<robot>) or an MJCF (<mujoco>), got <{root.tag:.40}>"
        )
    numbers = (model.body_pos, model.body_quat, model.jnt_axis, model.jnt_pos, model.qpos0)
    if not all(np.isfinite(part).all() for part in numbers):
        raise InvalidFile(f"{found.name}: expected finite numbers for all links and joints, got NaN")
    if model.nbody < 2:
        raise InvalidFile(f"{found.name}: expected a robot with links, got none")
    return Description(found.name, model, missing)


class _Builder(ET.TreeBuilder):
    """Builds a tree of a document that declares no entities."""

    def doctype(self, *_: object) -> NoReturn:
        raise InvalidFile("expected a document without DOCTYPE, got one")


def _root(path: Path) -> ET.Element:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidFile(f"{path.name}: cannot be read: {error.strerror}") from None
    if not content.strip():
        raise InvalidFile(f"{path.name}: expected a URDF or an MJCF, got an empty file")
    try:
        return ET.fromstring(content, ET.XMLParser(target=_Builder()))
    except InvalidFile as error:
        raise InvalidFile(f"{path.name}: {error}") from None
    except (ET.ParseError, LookupError, ValueError) as error:
        raise InvalidFile(f"{path.name}: expected XML (URDF or MJCF), got {error}") from None


def _urdf(mujoco: Any, root: ET.Element, path: Path) -> tuple[Any, tuple[str, ...]]:
    urdf = _simplified(root, path)
    if urdf.missing_collision:
        first, count = urdf.missing_collision[0], len(urdf.missing_collision)
        message = f"{path.name}: {count} collision meshes left out, not there or neither OBJ nor binary STL: {first}"
        warnings.warn(message + (", ..." if count > 1 else ""), HandWarning, stacklevel=4)
    try:
        spec = mujoco.MjSpec.from_string(urdf.text, assets=urdf.assets)
        for mesh in spec.meshes:  # open and flat ones have no volume
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidFile(_refused(path, error)) from None
    return model, tuple(dict.fromkeys(urdf.missing_visual + urdf.missing_collision))


def _mjcf(mujoco: Any, path: Path) -> tuple[Any, tuple[str, ...]]:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False
        spec.compiler.discardvisual = False
        spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS, LEAST_INERTIA
        missing = _missing_meshes(spec, path)
        if missing:
            for geom in [geom for geom in spec.geoms if geom.meshname in missing]:
                spec.delete(geom)
            for mesh in [mesh for mesh in spec.meshes if mesh.name in missing]:
                spec.delete(mesh)
        return spec.compile(), tuple(missing.values())
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidFile(_refused(path, error)) from None


def _missing_meshes(spec: Any, path: Path) -> dict[str, str]:
    """Mesh files that are not there, by mesh."""
    folder = path.parent / spec.compiler.meshdir
    files = {mesh.name: Path(mesh.file) for mesh in spec.meshes if mesh.file}
    return {
        name: str(file)
        for name, file in files.items()
        if not (folder / (file.name if spec.strippath else file)).is_file()
    }


def _refused(path: Path, error: Exception) -> str:
    return f"{path.name}: MuJoCo cannot make a robot of it: {' '.join(str(error).split())}"


@dataclass(slots=True)
class _Urdf:
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


def _simplified(root: ET.Element, path: Path) -> _Urdf:
    """The links, joints and shapes of a `<robot>`; raises InvalidFile where one of its parts is not understood."""
    if any("xacro" in part.tag.partition("}")[0] for part in root.iter() if part.tag.startswith("{")):
        raise InvalidFile(
            f"{path.name}: expected a URDF, got a xacro file; `xacro {path.name}` makes a URDF of it"
        )
    urdf = _Urdf(path.parent)
    ET.SubElement(ET.SubElement(urdf.robot, "mujoco"), "compiler", _COMPILER)
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


def _add_joint(joint: ET.Element, urdf: _Urdf, path: Path) -> None:
    name, kind = _name(joint, path), joint.get("type", "")
    if kind not in _JOINTS + _LOOSE:
        raise InvalidFile(
            f"{path.name}: joint {name!r}: expected a type among {', '.join(_JOINTS)}, got {kind!r}"
        )
    # A ball stands for all that is neither hinge nor slide, and is refused where it matters.
    new = ET.SubElement(urdf.robot, "joint", name=name, type="spherical" if kind in _LOOSE else kind)
    for tag in ("origin", "parent", "child", "axis", "limit"):
        part = joint.find(tag)
        if part is not None:
            new.append(part)
        elif tag in ("parent", "child"):
            raise InvalidFile(f"{path.name}: joint {name!r}: expected a {tag}, got none")


def _shapes(link: ET.Element, tag: str, urdf: _Urdf, missing: list[str]) -> Iterator[ET.Element]:
    for shape in link.findall(tag):
        geometry = shape.find("geometry")
        mesh = None if geometry is None else geometry.find("mesh")
        if geometry is None or (mesh is None and not len(geometry)):
            continue
        if mesh is not None:
            name = _asset_name(mesh.get("filename", ""), mesh.get("scale", ""), urdf)
            if name is None:
                missing.append(mesh.get("filename", ""))
                continue
            mesh.set("filename", name)
        new = ET.Element("visual")
        new.extend(part for part in (shape.find("origin"), geometry) if part is not None)
        yield new


def _asset_name(file: str, scale: str, urdf: _Urdf) -> str | None:
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
