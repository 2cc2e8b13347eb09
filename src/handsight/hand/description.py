"""Robot descriptions, URDF and MJCF, to MuJoCo models.

MuJoCo gets a text that was looked through and the meshes it names, and reads no file itself: what it does with a text
that no person wrote is to allocate, to loop or to crash.
"""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidFile, MissingExtra
from handsight.hand.chains import HINGE, SLIDE
from handsight.hand.mjcf import Mjcf
from handsight.hand.paths import find_file
from handsight.hand.surface import SHAPES
from handsight.hand.urdf import LEAST_INERTIA, LEAST_MASS, Urdf
from handsight.hand.xml_file import Part, read_xml, text_of

_LINE = re.compile(r",? line (\d+)")


class HandWarning(UserWarning):
    """Something about a robot's description that costs part of it."""


def read(path: str | Path, *, visual: bool = False) -> tuple[Any, tuple[str, ...]]:
    """The robot of a URDF or MJCF file as a mujoco.MjModel, and the mesh files whose shapes were left out.

    A URDF's link has the shapes that touch, else those that are seen; with `visual` the other way round.
    Raises InvalidFile, MissingExtra; warns where meshes of a URDF's collision shapes are left out.
    """
    found = find_file(path)
    try:
        import mujoco
    except ImportError:
        raise MissingExtra(f"{found.name}: needs MuJoCo: pip install 'handsight[robot]'") from None
    root = read_xml(found)
    if root.tag not in ("mujoco", "robot"):
        expected = "expected a URDF (<robot>) or an MJCF (<mujoco>)"
        raise InvalidFile(f"{found.name}: {expected}, got <{root.tag:.40}>")
    parsed = Mjcf(root, found) if root.tag == "mujoco" else Urdf(root, found, visual=visual)
    model = _compiled(mujoco, parsed, found.name)
    _check(model, found.name)
    if isinstance(parsed, Mjcf):
        return model, tuple(parsed.missing.values())
    missing = parsed.missing["collision"]
    if missing and not visual:
        said = f"{found.name}: {len(missing)} collision meshes left out, not there or neither OBJ nor binary STL: "
        warnings.warn(said + missing[0] + (", ..." if len(missing) > 1 else ""), HandWarning, stacklevel=4)
    return model, tuple(dict.fromkeys(parsed.missing["visual"] + missing))


def _compiled(mujoco: Any, parsed: Mjcf | Urdf, name: str) -> Any:
    """The mujoco.MjModel of what was read; raises InvalidFile where MuJoCo makes none of it."""
    text, parts = text_of(parsed.robot)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MuJoCo's are of how it would simulate
            spec = mujoco.MjSpec.from_string(text, assets=parsed.meshes.contents)
            if isinstance(parsed, Mjcf):
                _prepare(spec, parsed)
            else:
                for mesh in spec.meshes:  # open and flat ones have no volume
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            return spec.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        said = _placed(error, parts)
        raise InvalidFile(f"{name}: MuJoCo cannot make a robot of it: {said}") from None


def _placed(error: Exception, parts: list[Part]) -> str:
    """What MuJoCo says in one line, told at the line of the file instead of its text's."""
    said = " ".join(str(error).split())
    found = _LINE.search(said)
    if not found or not 0 < int(found[1]) <= len(parts):
        return said
    part = parts[int(found[1]) - 1]
    return f"{said[: found.start()]}, {part.file} line {part.line}{said[found.end() :]}"


def _prepare(spec: Any, mjcf: Mjcf) -> None:
    """Has all bodies and shapes kept, but those of meshes that are not there."""
    spec.compiler.fusestatic = False
    spec.compiler.discardvisual = False
    spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS, LEAST_INERTIA
    for geom in [geom for geom in spec.geoms if geom.meshname in mjcf.missing]:
        spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in mjcf.missing]:
        spec.delete(mesh)


def _check(model: Any, name: str) -> None:
    """Raises InvalidFile for a robot without links, or of numbers that are none or no robot's."""
    if model.nbody < 2:
        raise InvalidFile(f"{name}: expected a robot with links, got none")
    shapes, moves = np.isin(model.geom_type, SHAPES), np.isin(model.jnt_type, (SLIDE, HINGE))
    lengths = (
        model.body_pos,
        model.jnt_pos,
        model.geom_pos[shapes],
        model.geom_size[shapes],
        model.mesh_vert,
    )
    directions = (model.body_quat, model.jnt_axis[moves], model.geom_quat[shapes])
    if not all(np.isfinite(part).all() for part in (*lengths, *directions, model.qpos0, model.jnt_range)):
        raise InvalidFile(f"{name}: expected finite numbers for all links and joints, got NaN")
    farthest = max(np.abs(part).max(initial=0.0) for part in lengths)
    if farthest > MAX_DISTANCE:
        raise InvalidFile(f"{name}: expected lengths within {MAX_DISTANCE:g} m, got {farthest:g}")
    if any(np.abs(np.linalg.norm(part, axis=1) - 1).max(initial=0.0) > 1e-6 for part in directions):
        raise InvalidFile(
            f"{name}: expected axes and rotations of some length, got one of none or beyond numbers"
        )
