"""Robot descriptions, URDF and MJCF, compiled to MuJoCo models.

MuJoCo is given a checked text and the contents of the meshes that it names, and reads no file itself: a broken
description can make it allocate without bounds, loop or crash.
"""

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidFile, needing
from handsight.hand.chains import JointKind
from handsight.hand.couplings import Coupling, Couplings, of_mjcf
from handsight.hand.mjcf import Mjcf
from handsight.hand.paths import find_file
from handsight.hand.robot_xml import Element, read_xml, to_text
from handsight.hand.surface import ShapeKind
from handsight.hand.urdf import MIN_INERTIA, MIN_MASS, Urdf

if TYPE_CHECKING:
    from mujoco import MjModel, MjSpec


class HandWarning(UserWarning):
    """A part of a robot's description, such as a mesh, cannot be used."""


class Description(NamedTuple):
    """A robot as its file describes it."""

    model: "MjModel"
    missing: tuple[str, ...]
    """The mesh files whose shapes were left out."""
    couplings: Couplings


def read(path: str | Path, *, visual: bool = False) -> Description:
    """Returns the robot of a URDF or MJCF file.

    A URDF's link has its collision shapes, else its visual ones; with `visual` the other way round. Raises InvalidFile,
    MissingExtra; warns where meshes of a URDF's collision shapes are left out.
    """
    found = find_file(path)
    parsed = _parsed(found, visual=visual)
    _, model = _compile(parsed, found.name)
    _check_numbers(model, found.name)
    if isinstance(parsed, Mjcf):
        zeros = {joint.name: float(joint.qpos0[0]) for joint in joints_of(model)}
        couplings = of_mjcf(parsed.constraints, parsed.tendons, zeros)
        return Description(model, tuple(parsed.missing.values()), _resolved(couplings, found.name))
    # What collides is the hand's shape; links that have nothing else collide by what is seen.
    for kind, missing in parsed.missing.items():
        if visual or (kind == "visual" and model.ngeom):
            continue
        for sentence in _left_out(kind, missing):
            warnings.warn(f"{found.name}: {sentence}", HandWarning, stacklevel=4)
    left_out = tuple(dict.fromkeys([*parsed.missing["visual"], *parsed.missing["collision"]]))
    return Description(model, left_out, _resolved(parsed.couplings, found.name))


def _resolved(couplings: Iterable[Coupling], name: str) -> Couplings:
    """Returns the couplings of a file; warns of those that are left out."""
    resolved, left_out = Couplings.of(couplings)
    for sentence in left_out:
        warnings.warn(f"{name}: {sentence}", HandWarning, stacklevel=5)
    return resolved


def _left_out(kind: str, missing: Mapping[str, str]) -> Iterator[str]:
    """Yields what to say of mesh files of a kind that are left out: those that are not there, and the others."""
    absent = [file for file, reason in missing.items() if not reason]
    if absent:
        yield f"{len(absent)} {kind} meshes are not there and left out, such as {absent[0]}"
    broken = {file: reason for file, reason in missing.items() if reason}
    for file, reason in list(broken.items())[:1]:
        yield f"{len(broken)} {kind} meshes cannot be read and are left out, such as {file}: {reason}"


def joints_of(model: "MjModel") -> list[Any]:
    """Returns the hinges and slides of a model that have a name, in the file's order."""
    joints = [model.joint(i) for i in range(model.njnt)]
    return [joint for joint in joints if joint.name and joint.type in list(JointKind)]


def read_spec(path: str | Path) -> tuple["MjSpec", "MjModel"]:
    """Returns what MuJoCo builds of a URDF or MJCF file, to be put into a scene, and its model; raises as `read`."""
    found = find_file(path)
    return _compile(_parsed(found), found.name)


def _parsed(found: Path, *, visual: bool = False) -> Mjcf | Urdf:
    """Returns the checked content of a file; raises InvalidFile."""
    root = read_xml(found)
    if root.tag not in ("mujoco", "robot"):
        raise InvalidFile(
            f"{found.name}: expected a URDF (<robot>) or an MJCF (<mujoco>), got <{root.tag:.40}>"
        )
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
                spec.compiler.boundmass = MIN_MASS
                spec.compiler.boundinertia = MIN_INERTIA
                missing = [geom for geom in spec.geoms if geom.meshname in parsed.missing]
                for part in missing + [mesh for mesh in spec.meshes if mesh.name in parsed.missing]:
                    spec.delete(part)
            else:
                for mesh in spec.meshes:  # open and flat ones have no volume
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            return spec, spec.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        message = " ".join(str(error).split())
        message = re.sub(r",? line (\d+)", lambda found: _place(elements, int(found[1])), message, count=1)
        raise InvalidFile(f"{name}: MuJoCo cannot make a robot of it: {message}") from None


def _place(elements: list[Element], line: int) -> str:
    """Returns the file and line of the element that is on a line of the text that MuJoCo was given."""
    if not 0 < line <= len(elements):
        return ""
    return f", {elements[line - 1].file} line {elements[line - 1].line}"


def _check_numbers(model: "MjModel", name: str) -> None:
    """Raises InvalidFile for a robot without links, or with numbers that are not finite or no robot's."""
    if model.nbody < 2:
        raise InvalidFile(f"{name}: expected a robot with links, got none")
    shapes = np.isin(model.geom_type, list(ShapeKind))
    moving = np.isin(model.jnt_type, list(JointKind))
    lengths = (
        model.body_pos, model.jnt_pos, model.geom_pos[shapes], model.geom_size[shapes], model.mesh_vert
    )  # fmt: skip
    directions = (model.body_quat, model.jnt_axis[moving], model.geom_quat[shapes])
    if not all(np.isfinite(part).all() for part in (*lengths, *directions, model.qpos0, model.jnt_range)):
        raise InvalidFile(f"{name}: expected finite numbers for all links and joints, got NaN")
    farthest = max(np.abs(part).max(initial=0.0) for part in lengths)
    if farthest > MAX_DISTANCE:
        raise InvalidFile(f"{name}: expected lengths within {MAX_DISTANCE:g} m, got {farthest:g}")
    if any(np.abs(np.linalg.norm(part, axis=1) - 1).max(initial=0.0) > 1e-6 for part in directions):
        raise InvalidFile(
            f"{name}: expected axes and rotations of some length, got one of none or beyond numbers"
        )
