"""Robot descriptions, URDF and MJCF, to MuJoCo models."""

import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from handsight.errors import InvalidFile, MissingExtra
from handsight.hand.paths import find_file
from handsight.hand.urdf import LEAST_INERTIA, LEAST_MASS, simplified


class HandWarning(UserWarning):
    """Something about a robot's description that costs part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A robot as MuJoCo compiled it."""

    name: str
    """The file's, for messages."""
    source: str
    """The path as it was given."""
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
    return Description(found.name, str(path), model, missing)


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
    urdf = simplified(root, path)
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
