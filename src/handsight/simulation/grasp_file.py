"""A grasp as a small JSON file beside its recording, and back."""

from collections.abc import Collection
from pathlib import Path

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_bytes, text_file
from handsight.simulation.grasp_search import GraspSearchResult
from handsight.simulation.motion import CAN, Grasp


class _GraspFile(msgspec.Struct, forbid_unknown_fields=True):
    """The fields of the file: lengths in metres, angles in radians, quaternions x, y, z, w. The
    first five are for people."""

    object: str
    hold: str
    succeeded: bool = msgspec.field(name="held")
    trials: int
    failures: str
    position_palm: tuple[float, float, float]
    """The middle of the object's bounds, when the fingers begin to close."""
    quaternion_xyzw_palm: tuple[float, float, float, float]  # the rotation of the object in the palm
    height: float  # of that middle above the table
    quaternion_xyzw_world: tuple[float, float, float, float]  # the rotation of the palm in the world
    opening: dict[str, float]  # targets of the joints' servos at first; 0 for those not named
    closed: dict[str, float]  # their targets at the end


def write_grasp(found: GraspSearchResult, object: str, path: Path) -> None:
    """Writes a grasp that was found; raises NotWritten."""
    grasp = found.grasp
    form = _GraspFile(
        object=object,
        hold=found.hold,
        succeeded=found.succeeded,
        trials=found.trials,
        failures=found.failures,
        position_palm=tuple(grasp.T_palm_middle[:3, 3].tolist()),
        quaternion_xyzw_palm=tuple(se3.quaternion_from_rotation(grasp.T_palm_middle[:3, :3]).tolist()),
        height=float(grasp.height),
        quaternion_xyzw_world=tuple(se3.quaternion_from_rotation(grasp.R_world_palm).tolist()),
        opening=dict(grasp.opening),
        closed=dict(grasp.closed),
    )
    with text_file(path) as file:
        file.write(msgspec.json.format(msgspec.json.encode(form), indent=1).decode() + "\n")


def read_grasp(path: Path, joints: Collection[str] | None = None) -> Grasp:
    """Returns the grasp of a file that `write_grasp` wrote; raises InvalidFile, which begins with the file's name.

    `joints`: those of a rig's own hand; None: the Shadow hand's.
    """
    servos = CAN.closed if joints is None else joints
    try:
        form = msgspec.json.decode(read_bytes(path, 1_000_000), type=_GraspFile)
        position = checks.finite(form.position_palm, "position_palm", (3,))
        if not np.abs(position).max() < 1:
            raise InvalidInput(f"position_palm: expected less than a metre, got {form.position_palm}")
        quaternion = checks.unit(form.quaternion_xyzw_palm, "quaternion_xyzw_palm", (4,))
        quaternion_world = checks.unit(form.quaternion_xyzw_world, "quaternion_xyzw_world", (4,))
        for name, of_joint in (("opening", form.opening), ("closed", form.closed)):
            checks.finite(list(of_joint.values()), name, (len(of_joint),))
            if others := [joint for joint in of_joint if joint not in servos]:
                raise InvalidInput(f"{name}: expected joints of the hand, got {others[0]}")
        height = checks.positive(form.height, "height")
    except (msgspec.DecodeError, InvalidInput) as error:
        raise InvalidFile(f"{path}: {error}") from None
    return Grasp(
        T_palm_middle=se3.from_position_quaternion(position, quaternion),
        opening=form.opening,
        closed=form.closed,
        height=height,
        R_world_palm=se3.from_position_quaternion(np.zeros(3), quaternion_world)[:3, :3],
    )
