"""Robot descriptions, URDF and MJCF, compiled to MuJoCo models.

MuJoCo is given a checked text and the contents of the meshes that it names, and reads no file itself: a broken
description can make it allocate without bounds, loop or crash.
"""

import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidFile, needing
from handsight.hand.chains import JointKind
from handsight.hand.mjcf import Mjcf
from handsight.hand.paths import find_file
from handsight.hand.robot_xml import read_xml, to_text
from handsight.hand.surface import ShapeKind
from handsight.hand.urdf import MIN_INERTIA, MIN_MASS, Urdf

if TYPE_CHECKING:
    from mujoco import MjModel, MjSpec


class HandWarning(UserWarning):
    """A part of a robot's description, such as a mesh, cannot be used."""


def read(path: str | Path, *, visual: bool = False) -> tuple["MjModel", tuple[str, ...]]:
    """Returns the MuJoCo model of a URDF or MJCF file, and the mesh files whose shapes were left out.

    A URDF's link has its collision shapes, else its visual ones; with `visual` the other way round. Raises InvalidFile,
    MissingExtra; warns where meshes of a URDF's collision shapes are left out.
    """
    found = find_file(path)
    parsed = _parsed(found, visual=visual)
    _, model = _compile(parsed, found.name)
    _check_numbers(model, found.name)
    if isinstance(parsed, Mjcf):
        return model, tuple(parsed.missing.values())
    missing = parsed.missing["collision"]
    if missing and not visual:
        why, which = "not there or neither OBJ nor binary STL", f"{missing[0]}{', ...' * (len(missing) > 1)}"
        message = f"{len(missing)} collision meshes left out, {why}: {which}"
        warnings.warn(f"{found.name}: {message}", HandWarning, stacklevel=4)
    return model, tuple(dict.fromkeys(parsed.missing["visual"] + missing))


def read_spec(path: str | Path) -> tuple["MjSpec", "MjModel"]:
    """Returns what MuJoCo builds of a URDF or MJCF file, to be put into a scene, and its model; raises as `read`."""
    found = find_file(path)
    return _compile(_parsed(found), found.name)


def _parsed(found: Path, *, visual: bool = False) -> Mjcf | Urdf:
    """Returns the checked content of a file; raises InvalidFile."""
    root = read_xml(found)
    if root.tag not in ("mujoco", "robot"):
        expected = "expected a URDF (<robot>) or an MJCF (<mujoco>)"
        raise InvalidFile(f"{found.name}: {expected}, got <{root.tag:.40}>")
    return Mjcf(root, found) if root.tag == "mujoco" else Urdf(root, found, visual=visual)


def _compile(parsed: Mjcf | Urdf, name: str) -> tuple["MjSpec", "MjModel"]:
    """Returns spec and model; raises InvalidFile where MuJoCo refuses the text, with the line of the user's file."""
    with needing(f"{name}: needs MuJoCo", "robot"):
        import mujoco
    text, elements = to_text(parsed.robot)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MuJoCo's are about simulation
            spec = mujoco.MjSpec.from_string(text, assets=parsed.meshes.contents)
            if isinstance(parsed, Mjcf):
                # All bodies and shapes are kept, but those of missing meshes.
                spec.compiler.fusestatic = spec.compiler.discardvisual = False
                spec.compiler.boundmass, spec.compiler.boundinertia = MIN_MASS, MIN_INERTIA
                missing = [geom for geom in spec.geoms if geom.meshname in parsed.missing]
                for part in missing + [mesh for mesh in spec.meshes if mesh.name in parsed.missing]:
                    spec.delete(part)
            else:
                for mesh in spec.meshes:  # open and flat ones have no volume
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            return spec, spec.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        message = " ".join(str(error).split())
        found = re.search(r",? line (\d+)", message)
        if found and 0 < int(found[1]) <= len(elements):
            element = elements[int(found[1]) - 1]
            line = f", {element.file} line {element.line}"
            message = message[: found.start()] + line + message[found.end() :]
        raise InvalidFile(f"{name}: MuJoCo cannot make a robot of it: {message}") from None


def _check_numbers(model: "MjModel", name: str) -> None:
    """Raises InvalidFile for a robot without links, or with numbers that are not finite or no robot's."""
    if model.nbody < 2:
        raise InvalidFile(f"{name}: expected a robot with links, got none")
    shapes, moving = np.isin(model.geom_type, list(ShapeKind)), np.isin(model.jnt_type, list(JointKind))
    sizes = (model.geom_pos[shapes], model.geom_size[shapes], model.mesh_vert)
    lengths = (model.body_pos, model.jnt_pos, *sizes)
    directions = (model.body_quat, model.jnt_axis[moving], model.geom_quat[shapes])
    if not all(np.isfinite(part).all() for part in (*lengths, *directions, model.qpos0, model.jnt_range)):
        raise InvalidFile(f"{name}: expected finite numbers for all links and joints, got NaN")
    farthest = max(np.abs(part).max(initial=0.0) for part in lengths)
    if farthest > MAX_DISTANCE:
        raise InvalidFile(f"{name}: expected lengths within {MAX_DISTANCE:g} m, got {farthest:g}")
    if any(np.abs(np.linalg.norm(part, axis=1) - 1).max(initial=0.0) > 1e-6 for part in directions):
        expected = "expected axes and rotations of some length"
        raise InvalidFile(f"{name}: {expected}, got one of none or beyond numbers")
