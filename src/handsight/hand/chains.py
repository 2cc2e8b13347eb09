"""Bodies on chains of joints, as flat arrays for the kernels: a product of exponentials each.

MuJoCo reads the robot and does not move it: its kinematics with the change to the palm's axes in NumPy takes four times
as long (65 µs with Jacobians against 15), and needs memory of its own for each thread.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels.math import chain
from handsight._kernels.records import CHAIN_JOINT
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput

SLIDE, HINGE = 2, 3
"""MuJoCo's kinds of joints that have one position."""


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """How some bodies move with the joints between them and a base."""

    joints: tuple[str, ...]
    """Names of the joints that move any of the bodies, in the file's order."""
    starts: Indices
    """(t + 1,) body i hangs on `steps[starts[i] : starts[i + 1]]`, counted from the base."""
    steps: NDArray[np.void]
    """(s,) CHAIN_JOINT."""
    homes: Array
    """(t, 4, 4) poses in the base with all joints at their zero."""

    def poses(self, joint_positions: Mapping[str, float]) -> tuple[Array, Array]:
        """Poses (t, 4, 4) of the bodies in the base, and (s, 2, 3) the joints' axes and points on them [m] now.

        Raises InvalidInput naming joints that are missing or whose position is no finite number.
        """
        Ts, axes = np.empty_like(self.homes), np.empty((len(self.steps), 2, 3))
        try:
            values = np.array([joint_positions[name] for name in self.joints])
        except (LookupError, TypeError, ValueError):  # one is missing, no mapping, one of arrays
            _check_positions(joint_positions, self.joints)
            raise
        # Numbers in strings are no numbers.
        numbers = values.ndim == 1 and values.dtype.kind in "iuf"
        if not numbers or not chain.poses(
            values.astype(float), self.starts, self.steps, self.homes, Ts, axes
        ):
            _check_positions(joint_positions, self.joints)
            raise InvalidInput("joint_positions: expected a finite number for each joint")
        return Ts, axes

    def jacobians(self, points: Array, bodies: Indices, axes: Array) -> Array:
        """(k, 6, j) how points (k, 3), each fixed on one of the `bodies` (k,), move and turn by each joint."""
        out = np.zeros((len(points), 6, len(self.joints)))
        chain.jacobians(points, bodies, self.starts, self.steps, axes, out)
        return out


def transform_points(points: Array, bodies: Indices, Ts: Array) -> Array:
    """(k, 3) where points (k, 3), each fixed on one of the `bodies` (k,), are with these at their poses (t, 4, 4)."""
    out = np.empty_like(points)
    chain.transform_points(points, bodies, Ts, out)
    return out


def _check_positions(joint_positions: object, joints: Iterable[str]) -> None:
    """Raises InvalidInput where the position of one of the joints is missing or no finite number."""
    if not isinstance(joint_positions, Mapping):
        came = checks.brief(joint_positions)
        raise InvalidInput(f"joint_positions: expected a mapping from joint to position, got {came}")
    if absent := [name for name in joints if name not in joint_positions]:
        there = checks.brief(", ".join(map(str, joint_positions))) or "none"
        raise InvalidInput(f"joint_positions: expected a position for {', '.join(absent)}; got {there}")
    for name in joints:
        checks.finite(joint_positions[name], f"joint_positions[{name!r}]", ())


def build_chains(model: Any, base: int, bodies: Sequence[int], file: str) -> Chains:
    """How `bodies` of a compiled MuJoCo model move with respect to the body `base`.

    Raises InvalidInput where a joint on the way is neither hinge nor slide, or has no name.
    """
    Ts_world_body = _at_zero(model)
    Ts_base_body = se3.inverse(Ts_world_body[base]) @ Ts_world_body
    paths = [_path(model, base, body) for body in bodies]
    on_path = sorted({joint for path in paths for joint, _ in path})
    for joint in on_path:
        _check(model, joint, file)
    rows = [
        _step(model, joint, sign, Ts_base_body, on_path.index(joint))
        for path in paths
        for joint, sign in path
    ]
    return Chains(
        joints=tuple(str(model.joint(joint).name) for joint in on_path),
        starts=np.cumsum([0, *map(len, paths)]),
        steps=np.array(rows, dtype=CHAIN_JOINT),
        homes=Ts_base_body[list(bodies)],
    )


def ancestors(model: Any, body: int) -> list[int]:
    """The body, its parent, and so on without the world."""
    found = []
    while body:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def body_joints(model: Any, body: int) -> range:
    """The joints between a body and its parent, as they follow each other."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _at_zero(model: Any) -> Array:
    """Poses (bodies, 4, 4) in the world of all bodies with every joint at its zero."""
    Ts = se3.compose(se3.rotation_from_quaternion(model.body_quat[:, [1, 2, 3, 0]]), model.body_pos)
    for body in range(1, model.nbody):  # parents come first
        Ts[body] = Ts[model.body_parentid[body]] @ Ts[body]
    return Ts


def _path(model: Any, base: int, body: int) -> list[tuple[int, float]]:
    """Joints from base to body; those that are passed towards their parent turn the other way round."""
    up, down = ancestors(model, base), ancestors(model, body)
    up, down = [b for b in up if b not in down], [b for b in down if b not in up]
    against = [(joint, -1.0) for b in up for joint in reversed(body_joints(model, b))]
    return against + [(joint, 1.0) for b in reversed(down) for joint in body_joints(model, b)]


def _step(model: Any, joint: int, sign: float, Ts_base_body: Array, place: int) -> tuple[Any, ...]:
    T = Ts_base_body[model.jnt_bodyid[joint]]
    axis, point = sign * T[:3, :3] @ model.jnt_axis[joint], se3.apply(T, model.jnt_pos[joint][None])[0]
    zero = model.qpos0[model.jnt_qposadr[joint]]
    return axis, point, zero, model.jnt_type[joint] == SLIDE, place


def _check(model: Any, joint: int, file: str) -> None:
    name, body = model.joint(joint).name, model.body(model.jnt_bodyid[joint]).name
    if model.jnt_type[joint] not in (SLIDE, HINGE):
        raise InvalidInput(
            f"{file}: expected hinges and slides on the way, got joint {name!r} of {body!r}, which moves in more "
            "than one direction"
        )
    if not name:
        raise InvalidInput(f"{file}: expected a name for each joint on the way, got none at {body!r}")
