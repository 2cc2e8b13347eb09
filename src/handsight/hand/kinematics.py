"""Forward kinematics of bodies of a robot, by MuJoCo, and how their joints move them."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from handsight import checks, se3
from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidInput

SLIDE, HINGE = 2, 3
"""MuJoCo's kinds of joints that have one position."""


class Robot:
    """A compiled MuJoCo model with the memory that its kinematics needs, one for each thread."""

    def __init__(self, model: Any) -> None:
        """`model`: mujoco.MjModel."""
        self.model = model
        self._of_thread = threading.local()

    def __reduce__(self) -> tuple[type["Robot"], tuple[Any]]:
        return Robot, (self.model,)

    def moved(self, addresses: Indices, values: Array) -> Any:
        """mujoco.MjData with some joints at `values` and the others at their zero, until this thread's next call."""
        from mujoco import MjData, mj_kinematics

        data = getattr(self._of_thread, "data", None)
        if data is None:
            data = self._of_thread.data = MjData(self.model)
        data.qpos[:] = self.model.qpos0
        data.qpos[addresses] = values
        mj_kinematics(self.model, data)
        return data


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """How some bodies move with the joints between them and a base; threads may share one."""

    robot: Robot
    base: int
    bodies: Indices
    """(t,) numbers in the model."""
    joints: tuple[str, ...]
    """Names of the joints that move any of the bodies, in the file's order."""
    joint_ids: Indices
    """(j,) numbers of `joints` in the model."""
    addresses: Indices
    """(j,) where the model keeps their positions."""
    slides: Mask
    """(j,)"""
    signs: Array
    """(t, j) 1 where a joint moves the body, -1 where it moves the base instead, else 0."""

    def poses(self, joint_positions: Mapping[str, float]) -> Array:
        """Poses (t, 4, 4) of the bodies in the base.

        Raises InvalidInput naming joints that are missing or whose position is no finite number.
        """
        return self._poses(self.robot.moved(self.addresses, self._values(joint_positions)))

    def poses_and_twists(self, joint_positions: Mapping[str, float]) -> tuple[Array, Array]:
        """Poses as `poses`, and (6, j) the joints' twists about the base's origin, in its axes: the spatial Jacobian."""
        data = self.robot.moved(self.addresses, self._values(joint_positions))
        R = data.xmat[self.base].reshape(3, 3)
        axes = data.xaxis[self.joint_ids] @ R
        anchors = (data.xanchor[self.joint_ids] - data.xpos[self.base]) @ R
        shifts = (se3.skew(anchors) @ axes[..., None])[..., 0]
        shifts[self.slides] = axes[self.slides]
        axes[self.slides] = 0.0
        return self._poses(data), np.concatenate([shifts, axes], axis=1).T

    def jacobians(self, points: Array, bodies: Indices, twists: Array) -> Array:
        """(k, 6, j) how points (k, 3), each fixed on one of the `bodies` (k,), move and turn by each joint."""
        out = np.empty((len(points), 6, len(self.joints)))
        out[:, :3] = twists[:3] - se3.skew(points) @ twists[3:]
        out[:, 3:] = twists[3:]
        out *= self.signs[bodies, None]
        return out

    def _poses(self, data: Any) -> Array:
        R = data.xmat[self.base].reshape(3, 3)
        Ts = np.empty((len(self.bodies), 4, 4))
        Ts[:, :3, :3] = R.T @ data.xmat[self.bodies].reshape(-1, 3, 3)
        Ts[:, :3, 3] = (data.xpos[self.bodies] - data.xpos[self.base]) @ R
        Ts[:, 3] = 0.0, 0.0, 0.0, 1.0
        return Ts

    def _values(self, joint_positions: Mapping[str, float]) -> Array:
        try:
            values = np.array([joint_positions[name] for name in self.joints])
        except KeyError:
            raise InvalidInput(missing(joint_positions, self.joints)) from None
        except (TypeError, ValueError):  # no mapping, or one of arrays
            raise InvalidInput(_not_numbers(joint_positions, self.joints)) from None
        # Numbers in strings are no numbers.
        if values.ndim != 1 or values.dtype.kind not in "iuf" or not np.isfinite(values).all():
            raise InvalidInput(_not_numbers(joint_positions, self.joints))
        return values


def missing(joint_positions: Mapping[str, float], joints: Sequence[str]) -> str:
    """The sentence about joints that are needed and not there."""
    absent = [name for name in joints if name not in joint_positions]
    there = checks.brief(", ".join(map(str, joint_positions))) or "none"
    return f"joint_positions: expected a position for {', '.join(absent)}; got {there}"


def _not_numbers(joint_positions: object, joints: Sequence[str]) -> str:
    """The sentence about the first joint whose position is no finite number."""
    if not isinstance(joint_positions, Mapping):
        return (
            f"joint_positions: expected a mapping from joint to position, got {checks.brief(joint_positions)}"
        )
    for name in joints:
        try:
            checks.finite(joint_positions[name], f"joint_positions[{name!r}]", ())
        except InvalidInput as error:
            return str(error)
    return "joint_positions: expected a finite number for each joint"


def chains(robot: Robot, base: int, bodies: Sequence[int], file: str) -> Chains:
    """How `bodies` of a robot move with respect to the body `base`.

    Raises InvalidInput where a joint on the way is neither hinge nor slide, or has no name.
    """
    model = robot.model
    paths = [_path(model, base, body) for body in bodies]
    joint_ids = np.array(sorted({joint for path in paths for joint in path}), dtype=np.int64)
    for joint in joint_ids:
        _check(model, joint, file)
    return Chains(
        robot=robot,
        base=base,
        bodies=np.array(bodies, dtype=np.int64),
        joints=tuple(str(model.joint(joint).name) for joint in joint_ids),
        joint_ids=joint_ids,
        addresses=model.jnt_qposadr[joint_ids].astype(np.int64),
        slides=model.jnt_type[joint_ids] == SLIDE,
        signs=np.array([[path.get(joint, 0.0) for joint in joint_ids] for path in paths]).reshape(
            len(paths), len(joint_ids)
        ),
    )


def ancestors(model: Any, body: int) -> list[int]:
    """The body, its parent, and so on without the world."""
    found = []
    while body:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def joints_of(model: Any, body: int) -> range:
    """The joints between a body and its parent, as they follow each other."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _path(model: Any, base: int, body: int) -> dict[int, float]:
    """Joints between base and body with the sign of what they do to the body, seen from the base."""
    up, down = ancestors(model, base), ancestors(model, body)
    against = {joint: -1.0 for b in up if b not in down for joint in joints_of(model, b)}
    return against | {joint: 1.0 for b in down if b not in up for joint in joints_of(model, b)}


def _check(model: Any, joint: int, file: str) -> None:
    name, body = model.joint(joint).name, model.body(model.jnt_bodyid[joint]).name
    if model.jnt_type[joint] not in (SLIDE, HINGE):
        raise InvalidInput(
            f"{file}: expected hinges and slides on the way, got joint {name!r} of {body!r}, which moves in more "
            "than one direction"
        )
    if not name:
        raise InvalidInput(f"{file}: expected a name for each joint on the way, got none at {body!r}")
