"""A robot hand: joint positions in, poses of the fingertips in the palm out."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.hand.chains import HINGE, SLIDE, Chains, ancestors, chains, check_positions, joints_of
from handsight.hand.description import Description, read
from handsight.hand.surface import HandSurface, sample, triangles_of

BEYOND = {HINGE: 0.35, SLIDE: 0.02}
"""[rad], [m]: a position this far beyond a limit is an error of units or names; calibration makes less."""
DEGREES = 6.5
"""[rad]; more than a whole turn."""
_WORLD = 0


@dataclass(frozen=True, slots=True, eq=False)
class HandPose:
    """A hand with its joints at certain positions."""

    Ts_palm_tip: Array
    """(t, 4, 4) in the order of the hand's tips."""
    moving_joints: tuple[str, ...]
    """The joints that move any of the tips in the palm."""
    axes_palm: Array
    """(s, 6) for each joint of each chain its axis and a point on it [m], as they lie now."""
    chains: Chains

    def jacobians(self, points_palm: ArrayLike, tips: Sequence[int] | None = None) -> Array:
        """(k, 6, j) how points fixed on the tips move [m] and turn [rad] in the palm by each of `moving_joints`.

        `points_palm` (k, 3): where they are now [m]. `tips` (k,): the number of the tip of each; without it there is
        one point for each tip. A column is zero where the joint does not move the tip. Per radian, for a slide per
        metre. Raises InvalidInput.
        """
        count = len(self.Ts_palm_tip)
        rows = np.asarray(range(count) if tips is None else tips, dtype=np.int64)
        points = checks.finite(points_palm, "points_palm", (len(rows), 3))
        if not all(0 <= row < count for row in rows.tolist()):
            raise InvalidInput(f"tips: expected numbers from 0 to {count - 1}, got {checks.brief(rows)}")
        return self.chains.jacobians(points, rows, self.axes_palm)


class Hand:
    """The kinematics of a robot hand; threads may share one."""

    file: str
    """As it was named."""
    palm: str
    """The body that poses are given in."""
    tips: dict[str, str]
    """By finger: the body that its tip moves with."""
    joint_names: tuple[str, ...]
    """All hinges and slides of the file."""
    limits: Array
    """(n, 2) least and greatest position of each [rad] or [m], infinite where there is none."""
    moving: tuple[str, ...]
    """The joints between the palm and the tips: the others may be left out."""
    missing_meshes: tuple[str, ...]
    """Mesh files that are not there or cannot be read; their shapes are left out of the surface."""

    def __init__(self, file: str, description: Description, palm: str, tips: Mapping[str, str]) -> None:
        """Of a description that has been read; `Hand.from_file` is the door."""
        self.file, self.palm, self.tips = file, palm, dict(tips)
        self.missing_meshes = description.missing_meshes
        self._name, self._model = description.name, description.model
        self._bodies = {name: i for i in range(self._model.nbody) if (name := str(self._model.body(i).name))}
        self._palm = self._body(palm, "palm")
        bodies = [self._body(body, f"tips[{finger!r}]") for finger, body in self.tips.items()]
        self._chains = chains(self._model, self._palm, bodies, self._name)
        self.moving = self._chains.joints
        names = [str(self._model.joint(i).name) for i in range(self._model.njnt)]
        used = [i for i, name in enumerate(names) if name and self._model.jnt_type[i] in (HINGE, SLIDE)]
        self._kinds = {names[i]: int(self._model.jnt_type[i]) for i in used}
        self.joint_names = tuple(self._kinds)
        limited = self._model.jnt_limited[used].astype(bool)[:, None]
        self.limits = np.where(limited, self._model.jnt_range[used], [-np.inf, np.inf])
        self._arm: Chains | None = None

    @classmethod
    def from_file(cls, path: str | Path, *, palm: str, tips: Mapping[str, str] | None = None) -> "Hand":
        """The hand of a URDF or MJCF file.

        `path`: a file, or `package://NAME/rest` in a ROS or Python package (see `find_file`). `palm`: name of the body
        (link) that poses are given in. `tips`: by finger, the body that its tip moves with. Raises InvalidFile where
        the file is none of that kind, InvalidInput where it has no such body or the way from palm to a tip leads over
        other joints than hinges and slides, MissingExtra without MuJoCo.
        """
        return cls(str(path), read(path), palm, {} if tips is None else tips)

    def Ts_palm_tip(self, joint_positions: Mapping[str, float]) -> Array:
        """(t, 4, 4) poses of the tips in the palm, in the order of `tips`.

        `joint_positions`: by name [rad], for slides [m]; all of `moving`, others are passed over (robots publish arm
        and hand together). Coupled joints are read as the others are. Raises InvalidInput naming what is missing or
        not finite; `check` looks at more.
        """
        return self._chains.poses(joint_positions)[0]

    def kinematics(self, joint_positions: Mapping[str, float]) -> HandPose:
        """Poses of the tips with what their Jacobians need; raises InvalidInput as `Ts_palm_tip` does."""
        Ts_palm_tip, axes = self._chains.poses(joint_positions)
        return HandPose(Ts_palm_tip, self.moving, axes, self._chains)

    def T_world_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """(4, 4) the palm in the base frame of the file: useful where that has the arm in it.

        Needs the joints between base and palm; raises InvalidInput as `Ts_palm_tip` does, and where one of them is
        neither hinge nor slide.
        """
        if self._arm is None:
            self._arm = chains(self._model, _WORLD, [self._palm], self._name)
        Ts_world_palm, _ = self._arm.poses(joint_positions)
        return np.asarray(Ts_world_palm[0])

    def check(self, joint_positions: Mapping[str, float]) -> None:
        """Nothing, where the positions can be this robot's.

        Raises InvalidInput for a joint that the file does not have, one that is missing for the tips, a position that
        is not finite, and one that is beyond a limit by more than 0.35 rad (2 cm).
        """
        named = joint_positions if isinstance(joint_positions, Mapping) else {}
        for name in named:
            if name not in self._kinds:
                near = checks.among(str(name), self.joint_names)
                raise InvalidInput(f"joint_positions: expected joints of {self._name}, got {name!r}{near}")
        check_positions(joint_positions, [*self.moving, *named])
        for name, (value, low, high) in self.outside_limits(joint_positions, 0.0).items():
            beyond = BEYOND[self._kinds[name]]
            if not low - beyond <= value <= high + beyond:
                hint = " (degrees?)" if self._kinds[name] == HINGE and abs(value) > DEGREES else ""
                expected = f"joint_positions[{name!r}]: expected {low:.4g} to {high:.4g}"
                raise InvalidInput(f"{expected}, got {value:.4g}{hint}")

    def outside_limits(
        self, joint_positions: Mapping[str, float], tolerance: float = 0.02
    ) -> dict[str, tuple[float, float, float]]:
        """By joint: position, least and greatest, where it is outside by more than `tolerance` [rad] or [m].

        Joints that are not the file's are passed over.
        """
        found = {}
        for name, (low, high) in zip(self.joint_names, self.limits.tolist(), strict=True):
            value = joint_positions.get(name)
            if value is not None and not low - tolerance <= value <= high + tolerance:
                found[name] = (float(value), low, high)
        return found

    def surface(
        self, count: int, *, seed: int = 0, shrink: float = 0.0015, without: Collection[str] = ()
    ) -> HandSurface:
        """`count` points on the links that move with the palm or hang on it, evenly by area.

        They lie on the shapes that touch, else on those that are seen, inside by `shrink` [m]; fixed by `seed`.
        `without`: bodies left out, such as tips that have a shape of their own. No points where the file has no
        shapes. Raises InvalidInput.
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise InvalidInput(f"count: expected a whole number from 0 on, got {count!r:.40}")
        inward = float(checks.finite(shrink, "shrink", ()))
        left_out = {self._body(name, "without") for name in without}
        bodies = [body for body in self._links() if body not in left_out]
        triangles = [triangles_of(self._model, body) for body in bodies]
        link, points, normals = sample(triangles, int(count), seed)
        used, body_of = np.unique(link, return_inverse=True)
        with_points = [bodies[i] for i in used]
        return HandSurface(
            bodies=tuple(str(self._model.body(i).name) for i in with_points),
            body_of=body_of.astype(np.int64),
            points_body=points - inward * normals,
            normals=normals,
            chains=chains(self._model, self._palm, with_points, self._name),
        )

    def _links(self) -> list[int]:
        """The palm, what is fixed to it, and all that hangs on these."""
        root = self._palm
        for body in ancestors(self._model, self._palm):
            root = body
            if joints_of(self._model, body):
                break
        return [b for b in range(1, self._model.nbody) if b == root or root in ancestors(self._model, b)]

    def _body(self, name: str, argument: str) -> int:
        if name not in self._bodies:
            near = checks.among(str(name), self._bodies)
            raise InvalidInput(f"{argument}: expected a body of {self._name}, got {name!r}{near}")
        return self._bodies[name]
