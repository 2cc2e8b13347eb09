"""A robot hand: joint positions in, poses of the fingertips in the palm out."""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput
from handsight.hand.chains import HINGE, SLIDE, Chains, ancestors, body_joints, build_chains
from handsight.hand.description import read
from handsight.hand.paths import find_file
from handsight.hand.shape import HandShape, LinkMesh
from handsight.hand.surface import HandSurface, collision_triangles, sample_evenly, visual_triangles

_WORLD = 0
MOST_CHAINS = 8
"""Sets of joints that are not heard of, whose links are kept in mind."""


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

    def __init__(self, path: str | Path, palm: str, tips: Mapping[str, str]) -> None:
        """See `from_file`."""
        self.file, self.palm, self.tips = str(path), palm, dict(tips)
        self._name = Path(path).name
        self._model, self.missing_meshes = read(path)
        self._bodies = {name: i for i in range(self._model.nbody) if (name := str(self._model.body(i).name))}
        self._palm = self._body(palm, "palm")
        bodies = [self._body(body, f"tips[{finger!r}]") for finger, body in self.tips.items()]
        self._chains = build_chains(self._model, self._palm, bodies, self._name)
        self.moving = self._chains.joints
        joints = [self._model.joint(i) for i in range(self._model.njnt)]
        joints = [joint for joint in joints if joint.name and joint.type in (HINGE, SLIDE)]
        self.joint_names = tuple(str(joint.name) for joint in joints)
        limits = [joint.range if joint.limited else (-np.inf, np.inf) for joint in joints]
        self.limits = np.array(limits, dtype=np.float64).reshape(-1, 2)
        self._arm: Chains | None = None
        self._link_chains: dict[tuple[str, ...], tuple[tuple[str, ...], Chains]] = {}

    @classmethod
    def from_file(cls, path: str | Path, *, palm: str, tips: Mapping[str, str] | None = None) -> "Hand":
        """The hand of a URDF or MJCF file.

        `path`: a file, or `package://NAME/rest` in a ROS or Python package (see `find_file`). `palm`: name of the body
        (link) that poses are given in. `tips`: by finger, the body that its tip moves with. Raises InvalidFile where
        the file is none of that kind, InvalidInput where it has no such body or the way from palm to a tip leads over
        other joints than hinges and slides, MissingExtra without MuJoCo.
        """
        return cls(path, palm, tips or {})

    def Ts_palm_tip(self, joint_positions: Mapping[str, float]) -> Array:
        """(t, 4, 4) poses of the tips in the palm, in the order of `tips`.

        `joint_positions`: by name [rad], for slides [m]; all of `moving`, others are passed over (robots publish arm
        and hand together). Coupled joints are read as the others are. Raises InvalidInput naming what is missing or
        not finite.
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
            self._arm = build_chains(self._model, _WORLD, [self._palm], self._name)
        Ts_world_palm, _ = self._arm.poses(joint_positions)
        return np.asarray(Ts_world_palm[0])

    def chains_to(self, links: Mapping[str, str]) -> Chains:
        """How links move in the palm; by what they are called in an error, their bodies. Raises InvalidInput."""
        bodies = [self._body(body, argument) for argument, body in links.items()]
        return build_chains(self._model, self._palm, bodies, self._name)

    def surface(
        self, count: int, *, seed: int = 0, shrink: float = 0.0015, without: Collection[str] = ()
    ) -> HandSurface:
        """`count` points on the links that move with the palm or hang on it, by area, evenly on each.

        They lie on the shapes that touch, else on those that are seen, inside by `shrink` [m]; fixed by `seed`.
        `without`: bodies left out, such as tips that have a shape of their own. No points where the file has no
        shapes. Raises InvalidInput.
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise InvalidInput(f"count: expected a whole number from 0 on, got {count!r:.40}")
        inward = float(checks.finite(shrink, "shrink", ()))
        left_out = {self._body(name, "without") for name in without}
        bodies = [body for body in self._links() if body not in left_out]
        triangles = [collision_triangles(self._model, body) for body in bodies]
        link, points, normals = sample_evenly(triangles, int(count), seed)
        used, body_of = np.unique(link, return_inverse=True)
        with_points, inside = [bodies[i] for i in used], points - inward * normals
        return HandSurface(
            bodies=self._names(with_points),
            body_of=body_of.astype(np.int64),
            points_body=inside,
            normals=normals,
            chains=build_chains(self._model, self._palm, with_points, self._name),
            middles=np.array([inside[body_of == i].mean(axis=0) for i in range(len(used))]).reshape(-1, 3),
        )

    def shape(self, *, without: Collection[str] = ()) -> HandShape:
        """The shapes that are seen, else those that touch, of all links that move with the palm or hang on it.

        `without`: bodies left out. No triangles where the file has no shapes. Raises InvalidInput.
        """
        left_out = {self._body(name, "without") for name in without}
        return self._shape_of(self._model, [body for body in self._links() if body not in left_out])

    def link_meshes(self) -> dict[str, LinkMesh]:
        """What each link looks like, in its own frame: by name, its visual shapes, else those that touch.

        Of the links that move with the palm or hang on it; those without a shape are not there. `link_poses` has
        their places. The file is read anew; raises InvalidFile where it is gone.
        """
        try:
            model, _ = read(self.file, visual=True)
        except InvalidFile:  # visual meshes that MuJoCo refuses, where it took those that touch
            find_file(self.file)
            model = self._model
        return self._shape_of(model, self._links()).meshes

    def link_poses(self, joint_positions: Mapping[str, float]) -> dict[str, Array]:
        """Where each link is: by name, T_palm_link (4, 4), of the links that move with the palm or hang on it.

        `joint_positions` as `Ts_palm_tip` takes them, but a link is not there where one of its joints is missing, or
        is neither hinge nor slide. Raises InvalidInput for positions that are no finite numbers.
        """
        missing = tuple(name for name in self._joints_of_links if name not in joint_positions)
        found = self._link_chains.get(missing)
        if found is None:
            bodies = [body for body, joints in self._links_on.items() if not set(joints) & set(missing)]
            found = self._names(bodies), build_chains(self._model, self._palm, bodies, self._name)
            kept = self._link_chains if len(self._link_chains) < MOST_CHAINS else {}
            self._link_chains = {**kept, missing: found}
        names, links = found
        return dict(zip(names, links.poses(joint_positions)[0], strict=True))

    def _shape_of(self, model: Any, links: list[int]) -> HandShape:
        parts = [(body, visual_triangles(model, body)) for body in links]
        parts = [(body, triangles) for body, triangles in parts if len(triangles)]
        bodies = [body for body, _ in parts]
        corners = np.concatenate([np.zeros((0, 3, 3)), *(triangles for _, triangles in parts)]).reshape(-1, 3)
        link = np.repeat(np.arange(len(parts)), [3 * len(triangles) for _, triangles in parts])
        rows, where = np.unique(np.c_[link, corners], axis=0, return_inverse=True)
        return HandShape(
            bodies=self._names(bodies),
            vertices_body=np.ascontiguousarray(rows[:, 1:]),
            body_of=rows[:, 0].astype(np.int64),
            faces=where.reshape(-1, 3).astype(np.int64),
            chains=build_chains(self._model, self._palm, bodies, self._name),
        )

    @cached_property
    def _links_on(self) -> dict[int, tuple[str, ...]]:
        """By link, the joints between it and the palm; without links that hang on joints of another kind."""
        found = {}
        for body in self._links():
            with contextlib.suppress(InvalidInput):
                found[body] = build_chains(self._model, self._palm, [body], self._name).joints
        return found

    @cached_property
    def _joints_of_links(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for joints in self._links_on.values() for name in joints))

    def _names(self, bodies: Iterable[int]) -> tuple[str, ...]:
        return tuple(str(self._model.body(i).name) for i in bodies)

    def _links(self) -> list[int]:
        """The palm, what is fixed to it, and all that hangs on these."""
        root = self._palm
        for body in ancestors(self._model, self._palm):
            root = body
            if body_joints(self._model, body):
                break
        return [b for b in range(1, self._model.nbody) if b == root or root in ancestors(self._model, b)]

    def _body(self, name: str, argument: str) -> int:
        if name not in self._bodies:
            near = checks.suggestion(str(name), self._bodies)
            raise InvalidInput(f"{argument}: expected a body of {self._name}, got {name!r}{near}")
        return self._bodies[name]
