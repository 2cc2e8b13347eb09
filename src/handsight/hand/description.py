"""Robot descriptions, URDF and MJCF, to MuJoCo models.

Of a URDF MuJoCo gets the tree of links and joints, and one set of shapes for each link: inertias, materials,
transmissions, couplings and simulators' extensions do not matter for kinematics, and each is a way in which a file for
another program fails to load.
"""

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
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
_STL_HEAD, _STL_FACE = 84, 50  # bytes; how many faces there are is told in the head's last four


class HandWarning(UserWarning):
    """Something about a robot's description that costs part of it."""


def read(path: str | Path) -> tuple[Any, tuple[str, ...]]:
    """The robot of a URDF or MJCF file as a mujoco.MjModel, and the mesh files whose shapes were left out.

    Raises InvalidFile, MissingExtra; warns where meshes of a URDF's collision shapes are left out.
    """
    found = find_file(path)
    try:
        import mujoco
    except ImportError:
        raise MissingExtra(f"{found.name}: needs MuJoCo: pip install 'handsight[robot]'") from None
    root = _root(found)
    if root.tag not in ("mujoco", "robot"):
        expected = "expected a URDF (<robot>) or an MJCF (<mujoco>)"
        raise InvalidFile(f"{found.name}: {expected}, got <{root.tag:.40}>")
    try:
        spec, missing = _mjcf(mujoco, found) if root.tag == "mujoco" else _urdf(mujoco, root, found)
        model = spec.compile()
    except InvalidFile:
        raise
    except (ValueError, mujoco.FatalError) as error:
        said = " ".join(str(error).split())
        raise InvalidFile(f"{found.name}: MuJoCo cannot make a robot of it: {said}") from None
    numbers = (model.body_pos, model.body_quat, model.jnt_axis, model.jnt_pos, model.qpos0)
    if not all(np.isfinite(part).all() for part in numbers):
        raise InvalidFile(f"{found.name}: expected finite numbers for all links and joints, got NaN")
    if model.nbody < 2:
        raise InvalidFile(f"{found.name}: expected a robot with links, got none")
    return model, missing


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
    urdf = _Urdf(root, path)
    missing = urdf.missing["collision"]
    if missing:
        said = f"{path.name}: {len(missing)} collision meshes left out, not there or neither OBJ nor binary STL: "
        more = ", ..." if len(missing) > 1 else ""
        warnings.warn(said + missing[0] + more, HandWarning, stacklevel=5)
    spec = mujoco.MjSpec.from_string(ET.tostring(urdf.robot, encoding="unicode"), assets=urdf.assets)
    for mesh in spec.meshes:  # open and flat ones have no volume
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return spec, tuple(dict.fromkeys(urdf.missing["visual"] + missing))


def _mjcf(mujoco: Any, path: Path) -> tuple[Any, tuple[str, ...]]:
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    spec.compiler.discardvisual = False
    spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS, LEAST_INERTIA
    missing = _missing_meshes(spec, path)
    for geom in [geom for geom in spec.geoms if geom.meshname in missing]:
        spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in missing]:
        spec.delete(mesh)
    return spec, tuple(missing.values())


def _missing_meshes(spec: Any, path: Path) -> dict[str, str]:
    """Mesh files that are not there, by mesh."""
    folder = path.parent / spec.compiler.meshdir
    files = {mesh.name: Path(mesh.file) for mesh in spec.meshes if mesh.file}
    return {
        name: str(file)
        for name, file in files.items()
        if not (folder / (file.name if spec.strippath else file)).is_file()
    }


class _Urdf:
    """The links, joints and shapes of a `<robot>`; raises InvalidFile where one of its parts is not understood."""

    robot: ET.Element
    """For MuJoCo."""
    assets: dict[str, bytes]
    """The meshes by the names they have in `robot`: MuJoCo would take two of one name in two folders for one."""
    missing: dict[str, list[str]]
    """Names of mesh files that are not there or cannot be read, by the kind of shape."""

    def __init__(self, root: ET.Element, path: Path) -> None:
        if any("xacro" in part.tag.partition("}")[0] for part in root.iter() if part.tag.startswith("{")):
            hint = f"`xacro {path.name}` makes a URDF of it"
            raise InvalidFile(f"{path.name}: expected a URDF, got a xacro file; {hint}")
        self._path = path
        self._names: dict[tuple[Path, str], str] = {}  # of each mesh file in each scale
        self.robot, self.assets = ET.Element("robot", name="hand"), {}
        self.missing = {"visual": [], "collision": []}
        ET.SubElement(ET.SubElement(self.robot, "mujoco"), "compiler", _COMPILER)
        for link in root.findall("link"):
            new = ET.SubElement(self.robot, "link", name=self._name(link))
            collision, visual = list(self._shapes(link, "collision")), list(self._shapes(link, "visual"))
            new.extend(collision or visual)
        for joint in root.findall("joint"):
            self._add_joint(joint)

    def _name(self, element: ET.Element) -> str:
        name = element.get("name")
        if not name:
            raise InvalidFile(f"{self._path.name}: expected a name for each {element.tag}, got none")
        return name

    def _add_joint(self, joint: ET.Element) -> None:
        name, kind = self._name(joint), joint.get("type", "")
        where = f"{self._path.name}: joint {name!r}"
        if kind not in _JOINTS + _LOOSE:
            raise InvalidFile(f"{where}: expected a type among {', '.join(_JOINTS)}, got {kind!r}")
        # A ball stands for all that is neither hinge nor slide, and is refused where it matters.
        new = ET.SubElement(self.robot, "joint", name=name, type="spherical" if kind in _LOOSE else kind)
        for tag in ("origin", "parent", "child", "axis", "limit"):
            part = joint.find(tag)
            if part is not None:
                new.append(part)
            elif tag in ("parent", "child"):
                raise InvalidFile(f"{where}: expected a {tag}, got none")

    def _shapes(self, link: ET.Element, tag: str) -> Iterator[ET.Element]:
        for shape in link.findall(tag):
            geometry = shape.find("geometry")
            if geometry is None or not len(geometry):
                continue
            mesh = geometry.find("mesh")
            if mesh is not None:
                name = self._asset(mesh.get("filename", ""), mesh.get("scale", ""))
                if name is None:
                    self.missing[tag].append(mesh.get("filename", ""))
                    continue
                mesh.set("filename", name)
            # Touching shapes would have their hulls built, which are of no use here.
            new = ET.Element("visual")
            new.extend(part for part in (shape.find("origin"), geometry) if part is not None)
            yield new

    def _asset(self, file: str, scale: str) -> str | None:
        """The name among the assets of a mesh in one scale; None where MuJoCo cannot read it."""
        try:
            path = find_file(file, self._path.parent)
            content = path.read_bytes()
        except (InvalidFile, OSError, ValueError):
            return None
        kind = path.suffix.lower()
        binary = len(content) == _STL_HEAD + _STL_FACE * int.from_bytes(content[80:_STL_HEAD], "little")
        if not (kind == ".obj" or (kind == ".stl" and binary)):
            return None
        name = self._names.setdefault((path.resolve(), scale), f"{len(self._names)}{kind}")
        self.assets[name] = content
        return name
