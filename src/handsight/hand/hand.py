"""A robot hand: from joint positions to the poses of its fingertips in the palm."""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput
from handsight.hand.chains import Chains, ancestors, body_joints, build_chains, check_positions
from handsight.hand.couplings import Couplings
from handsight.hand.description import joints_of, read
from handsight.hand.paths import find_file
from handsight.hand.surface import HandShape, HandSurface, LinkMesh, body_triangles, sample_evenly

if TYPE_CHECKING:
    from mujoco import MjModel


@dataclass(frozen=True, slots=True, eq=False)
class HandPose:
    """Hand with its joints at certain positions."""

    Ts_palm_tip: Array
    """(t, 4, 4) poses of the tips in the palm, in the order of the hand's tips."""
    moving_joints: tuple[str, ...]
    """Names of the j joints that move any of the tips in the palm."""
    axes_palm: Array
    """(s, 2, 3) for each joint of each chain its axis and a point on it [m], in this pose."""
    chains: Chains
    """How the tips move in the palm."""
    changes: Array
    """(j, j) derivative of the moving joints' positions by their own; that of a joint which others follow moves them
    too, where their positions were not given."""

    def jacobians(self, points_palm: ArrayLike, tips: Sequence[int] | None = None) -> Array:
        """Returns the Jacobians (k, 6, j) in the palm of points on the tips, by each of `moving_joints`.

        The rows are translation [m] and rotation [rad], per radian, for a slide per metre; a column is zero where the
        joint does not move the tip. `points_palm` (k, 3): the points' positions in this pose [m]. `tips` (k,): the
        number of each point's tip; None: one point for each tip. Raises InvalidInput.
        """
        count = len(self.Ts_palm_tip)
        rows = np.asarray(range(count) if tips is None else tips, dtype=np.int64)
        points = checks.finite(points_palm, "points_palm", (len(rows), 3))
        if ((rows < 0) | (rows >= count)).any():
            raise InvalidInput(f"tips: expected numbers from 0 to {count - 1}, got {checks.brief(rows)}")
        return self.chains.jacobians(points, rows, self.axes_palm, self.changes)


class Hand:
    """Kinematics of a robot hand; threads may share one."""

    file: str
    """The name of its file, as it was given."""
    palm: str
    """The body in whose frame poses are given."""
    tips: dict[str, str]
    """By finger, the body to which its tip is fixed."""
    joint_names: tuple[str, ...]
    """Names of all n hinges and slides of the file."""
    limits: Array
    """(n, 2) least and greatest position of each joint [rad] or [m], infinite without a limit."""
    moving: tuple[str, ...]
    """Names of the joints between the palm and the tips, coupled ones among them."""
    needed: tuple[str, ...]
    """Names of the joints whose positions are needed for the tips: those that drive the moving ones."""
    couplings: Couplings
    """The joints that follow others."""
    chains: Chains
    """How the tips move in the palm."""
    missing_meshes: tuple[str, ...]
    """Mesh files that do not exist or cannot be read; their shapes are left out of the surface."""

    def __init__(self, path: str | Path, palm: str, tips: Mapping[str, str]) -> None:
        """Reads the file; see `from_file`."""
        self.file = str(path)
        self.palm = palm
        self.tips = dict(tips)
        self._name = Path(path).name
        self._model, self.missing_meshes, self.couplings = read(path)
        self._bodies = {name: i for i in range(self._model.nbody) if (name := str(self._model.body(i).name))}
        self._palm = self._body(palm, "palm")
        bodies = [self._body(body, f"tips[{finger!r}]") for finger, body in self.tips.items()]
        self.chains = build_chains(self._model, self._palm, bodies, self._name)
        self.moving = self.chains.joints
        self.needed = self.couplings.leaders(self.moving)
        joints = joints_of(self._model)
        self.joint_names = tuple(str(joint.name) for joint in joints)
        limits = [joint.range if joint.limited else (-np.inf, np.inf) for joint in joints]
        self.limits = np.array(limits, dtype=np.float64).reshape(-1, 2)

    def __repr__(self) -> str:
        """Returns its file and palm, and the numbers of fingers and joints."""
        return f"<Hand {self._name}: palm {self.palm}, {len(self.tips)} fingers, {len(self.moving)} joints>"

    @classmethod
    def from_file(cls, path: str | Path, *, palm: str, tips: Mapping[str, str] | None = None) -> "Hand":
        """Returns the hand of a URDF or MJCF file.

        `path`: a file, or `package://NAME/rest` in a ROS or Python package (see `find_file`). `palm`: name of the body
        (link) in whose frame poses are given. `tips`: by finger, the body to which its tip is fixed. Raises InvalidFile
        for a file of another kind, InvalidInput where it has no such body or where other joints than hinges and slides
        are between the palm and a tip, MissingExtra without MuJoCo.
        """
        return cls(path, palm, tips or {})

    def Ts_palm_tip(self, joint_positions: Mapping[str, float]) -> Array:
        """Returns the poses (t, 4, 4) of the tips in the palm, in the order of `tips`.

        `joint_positions`: by name [rad], for slides [m], of all joints in `needed`. Coupled joints follow those, unless
        their own positions are given. Others are ignored, as robots publish arm and hand together. Raises an
        InvalidInput that names what is missing or not finite.
        """
        return self.chains.poses(self.completed(joint_positions))[0]

    def completed(self, joint_positions: Mapping[str, float]) -> Mapping[str, float]:
        """Returns joint positions with those of the coupled joints that are not among them; raises InvalidInput."""
        if not self.couplings.laws or not isinstance(joint_positions, Mapping):
            return joint_positions
        leaders = [name for name in self.needed if name in joint_positions]
        check_positions(joint_positions, leaders)  # before numbers are made of them
        known = self.couplings.completed(joint_positions)
        absent = [name for name in self.moving if name not in known]
        check_positions(joint_positions, self.couplings.leaders(absent))
        return known

    def kinematics(self, joint_positions: Mapping[str, float]) -> HandPose:
        """Returns the poses of the tips with what their Jacobians need; raises InvalidInput as `Ts_palm_tip` does."""
        positions = self.completed(joint_positions)
        Ts_palm_tip, axes = self.chains.poses(positions)
        changes = self.couplings.changes(self.moving, joint_positions)
        return HandPose(Ts_palm_tip, self.moving, axes, self.chains, changes)

    def T_world_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """Returns the pose (4, 4) of the palm in the base frame of the file, for a file that has the arm in it.

        The positions of the joints between base and palm are needed; raises InvalidInput as `Ts_palm_tip` does, and
        where one of them is neither hinge nor slide.
        """
        return np.asarray(self._arm.poses(self.couplings.completed(joint_positions))[0][0])

    def chains_to(self, links: Mapping[str, str]) -> Chains:
        """Returns how bodies move in the palm; the keys of `links` are the bodies' names in an InvalidInput."""
        bodies = [self._body(body, argument) for argument, body in links.items()]
        return build_chains(self._model, self._palm, bodies, self._name)

    def surface(
        self, count: int, *, seed: int = 0, shrink: float = 0.0015, without: Collection[str] = ()
    ) -> HandSurface:
        """Returns `count` points, evenly spread over the links that move with the palm or hang on it.

        They are on the collision shapes, else on the visual ones, moved inside by `shrink` [m], and depend on `seed`
        only. `without`: bodies without points, such as tips that have a shape of their own. A file without shapes gives
        no points. Raises InvalidInput.
        """
        number = checks.integer(count, "count", 10_000_000)
        inward = float(checks.finite(shrink, "shrink", ()))
        bodies = self._links(without)
        triangles = [body_triangles(self._model, body) for body in bodies]
        link, points, normals = sample_evenly(triangles, number, seed)
        used, body_of = np.unique(link, return_inverse=True)
        with_points = [bodies[i] for i in used]
        inside = points - inward * normals
        return HandSurface(
            bodies=self._names(with_points),
            body_of=body_of.astype(np.int64),
            points_body=inside,
            normals=normals,
            chains=build_chains(self._model, self._palm, with_points, self._name),
            middles=np.array([inside[body_of == i].mean(axis=0) for i in range(len(used))]).reshape(-1, 3),
        )

    def shape(self, *, without: Collection[str] = ()) -> HandShape:
        """Returns the visual shapes, else the collision shapes, of all links that move with the palm or hang on it.

        `without`: bodies left out. A file without shapes gives no triangles. Raises InvalidInput.
        """
        return self._shape_of(self._model, self._links(without))

    def link_meshes(self) -> dict[str, LinkMesh]:
        """Returns by name the visual shapes, else the collision shapes, of each link in its own frame.

        The links are those that move with the palm or hang on it and have a shape; `link_poses` gives their poses. The
        file is read again; raises InvalidFile where it no longer exists.
        """
        try:
            model = read(self.file, visual=True).model
        except InvalidFile:  # MuJoCo refuses a visual mesh, where it took the collision meshes
            find_file(self.file)
            model = self._model
        return self._shape_of(model, self._links()).meshes

    def link_poses(self, joint_positions: Mapping[str, float]) -> dict[str, Array]:
        """Returns by name the poses T_palm_link (4, 4) of the links that move with the palm or hang on it.

        `joint_positions` as `Ts_palm_tip` takes them; links with a joint that has no position, or is neither hinge nor
        slide, are left out. Raises InvalidInput for positions that are not finite numbers.
        """
        names, joints, chains = self._link_chains
        known = self.couplings.completed(joint_positions)
        positions = {name: known.get(name, 0.0) for name in chains.joints}
        links = zip(names, joints, chains.poses(positions)[0], strict=True)
        return {name: T for name, needed, T in links if all(joint in known for joint in needed)}

    def _shape_of(self, model: "MjModel", links: list[int]) -> HandShape:
        """Returns the visual shapes, else the collision shapes, that the model has of some links."""
        parts = [(body, body_triangles(model, body, visual=True)) for body in links]
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
    def _arm(self) -> Chains:
        """How the palm moves in the base frame of the file."""
        return build_chains(self._model, 0, [self._palm], self._name)  # 0: MuJoCo's world

    @cached_property
    def _link_chains(self) -> tuple[tuple[str, ...], list[tuple[str, ...]], Chains]:
        """Names of the links, the joints between each and the palm, and their chains; without links on other joints."""
        joints = {}
        for body in self._links():
            with contextlib.suppress(InvalidInput):
                joints[body] = build_chains(self._model, self._palm, [body], self._name).joints
        chains = build_chains(self._model, self._palm, list(joints), self._name)
        return self._names(joints), list(joints.values()), chains

    def _names(self, bodies: Iterable[int]) -> tuple[str, ...]:
        return tuple(str(self._model.body(i).name) for i in bodies)

    def _links(self, without: Collection[str] = ()) -> list[int]:
        """Returns the palm, the bodies that are fixed to it, and all that hang on these, but for some bodies."""
        left_out = {self._body(name, "without") for name in without}
        upward = ancestors(self._model, self._palm) or [self._palm]
        root = next((body for body in upward if body_joints(self._model, body)), upward[-1])
        below = (b for b in range(1, self._model.nbody) if root in ancestors(self._model, b))
        return [body for body in below if body not in left_out]

    def _body(self, name: str, argument: str) -> int:
        if name not in self._bodies:
            hint = checks.suggestion(str(name), self._bodies)
            raise InvalidInput(f"{argument}: expected a body of {self._name}, got {name!r}{hint}")
        return self._bodies[name]
