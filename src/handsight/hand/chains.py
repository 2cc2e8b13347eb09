"""Forward kinematics of bodies on chains of joints, as flat arrays for the kernels: a product of exponentials each.

MuJoCo reads the robot, but its kinematics is not used: with the change to the palm's axes in NumPy it takes four times
as long (65 µs with Jacobians against 15), and needs memory of its own for each thread.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._compiled import chain
from handsight._compiled.records import CHAIN_JOINT
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput

if TYPE_CHECKING:
    from mujoco import MjModel


class JointKind(IntEnum):
    """MuJoCo's kinds of joints with one position, which it calls slide and hinge."""

    PRISMATIC = 2
    REVOLUTE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """How some bodies move in a base frame with the joints between."""

    joints: tuple[str, ...]  # names of the j joints that move any of the bodies, in the file's order
    starts: Indices  # (t + 1,) the joints from the base to body i are `steps[starts[i] : starts[i + 1]]`
    steps: NDArray[np.void]  # (s,) joints of all chains, records CHAIN_JOINT
    homes: Array  # (t, 4, 4) poses of the bodies in the base with all joints at zero

    def poses(
        self, joint_positions: Mapping[str, float], offsets: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Returns the poses (t, 4, 4) of the bodies in the base, and each joint's axis and a point on it (s, 2, 3) [m].

        `offsets` (j,): by how much the given positions are too large. Raises an InvalidInput that names joints without
        a position, or with one that is not a finite number.
        """
        Ts = np.empty_like(self.homes)
        axes = np.empty((len(self.steps), 2, 3))
        try:
            values = np.array([joint_positions[name] for name in self.joints])
        except (LookupError, TypeError, ValueError):  # one is missing, no mapping, one of arrays
            check_positions(joint_positions, self.joints)
            raise
        numeric = values.ndim == 1 and values.dtype.kind in "iuf"  # not strings
        parts = self.starts, self.steps, self.homes
        if not numeric or not chain.poses(values - offsets, *parts, Ts, axes):
            check_positions(joint_positions, self.joints)
            raise InvalidInput("joint_positions: expected a finite number for each joint")
        return Ts, axes

    def jacobians(self, points: Array, bodies: Indices, axes: Array, changes: Array | None = None) -> Array:
        """Returns the Jacobians (k, 6, j) of points (k, 3), each fixed on one of the `bodies` (k,), by each joint; or
        by each of m `changes` (j, m) of the joints' positions."""
        changes = np.eye(len(self.joints)) if changes is None else changes
        out = np.empty((len(points), 6, changes.shape[1]))
        chain.jacobians(points, bodies, self.starts, self.steps, axes, changes, out)
        return out

    def errors(self, sigma_joint: ArrayLike) -> Array:
        """Returns the joints' errors (j, m), as they are given, or of one number: each joint's own."""
        sigmas = np.asarray(sigma_joint, dtype=np.float64)
        return sigmas if sigmas.ndim else sigmas * np.eye(len(self.joints))


def transform_points(points: Array, bodies: Indices, Ts: Array) -> Array:
    """Returns points (k, 3) in the base, each given in the axes of one of the `bodies` (k,) with poses (t, 4, 4)."""
    out = np.empty_like(points)
    chain.transform_points(points, bodies, Ts, out)
    return out


def check_positions(joint_positions: object, joints: Iterable[str]) -> None:
    """Raises InvalidInput where the position of one of the joints is missing or not a finite number."""
    if not isinstance(joint_positions, Mapping):
        raise InvalidInput(
            f"joint_positions: expected a mapping from joint to position, got {checks.brief(joint_positions)}"
        )
    if absent := [name for name in joints if name not in joint_positions]:
        came = checks.brief(", ".join(map(str, joint_positions))) or "none"
        raise InvalidInput(f"joint_positions: expected a position for {', '.join(absent)}; got {came}")
    for name in joints:
        checks.finite(joint_positions[name], f"joint_positions[{name!r}]", ())


def build_chains(model: "MjModel", base: int, bodies: Sequence[int], file: str) -> Chains:
    """Returns how `bodies` of a MuJoCo model move with respect to the body `base`. Raises InvalidInput where a joint
    between them is neither hinge nor slide, or has no name."""
    Rs = se3.rotation_from_quaternion(model.body_quat[:, [1, 2, 3, 0]])
    Ts_world_body = se3.compose(Rs, model.body_pos)
    for body in range(1, model.nbody):  # with all joints at zero; parents come first
        Ts_world_body[body] = Ts_world_body[model.body_parentid[body]] @ Ts_world_body[body]
    Ts_base_body = se3.inverse(Ts_world_body[base]) @ Ts_world_body
    paths = list[list[tuple[int, float]]]()
    for body in bodies:
        # The joints from base to body, with a sign of -1 where they are passed towards their parent.
        up = ancestors(model, base)
        down = ancestors(model, body)
        up, down = [b for b in up if b not in down], [b for b in down if b not in up]
        upward = [(joint, -1.0) for b in up for joint in reversed(body_joints(model, b))]
        paths.append(upward + [(joint, 1.0) for b in reversed(down) for joint in body_joints(model, b)])
    on_path = sorted({joint for path in paths for joint, _ in path})
    for joint in on_path:
        name = model.joint(joint).name
        body_name = model.body(model.jnt_bodyid[joint]).name
        if model.jnt_type[joint] not in list(JointKind):
            raise InvalidInput(
                f"{file}: expected hinges and slides on the way, got joint {name!r} of {body_name!r}, which moves in "
                "more than one direction"
            )
        if not name:
            raise InvalidInput(
                f"{file}: expected a name for each joint on the way, got none at {body_name!r}"
            )
    rows = []
    for joint, sign in (step for path in paths for step in path):
        T = Ts_base_body[model.jnt_bodyid[joint]]
        axis = sign * T[:3, :3] @ model.jnt_axis[joint]
        point = se3.apply(T, model.jnt_pos[joint][None])[0]
        zero = model.qpos0[model.jnt_qposadr[joint]]
        kind = model.jnt_type[joint]
        rows.append((axis, point, zero, kind == JointKind.PRISMATIC, on_path.index(joint)))
    return Chains(
        joints=tuple(str(model.joint(joint).name) for joint in on_path),
        starts=np.cumsum([0, *map(len, paths)]),
        steps=np.array(rows, dtype=CHAIN_JOINT),
        homes=Ts_base_body[list(bodies)],
    )


def ancestors(model: "MjModel", body: int) -> list[int]:
    """Returns the body, its parent, and so on, without the world."""
    bodies = []
    while body:
        bodies.append(body)
        body = int(model.body_parentid[body])
    return bodies


def body_joints(model: "MjModel", body: int) -> range:
    """Returns the numbers of the joints between a body and its parent, in order."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))
