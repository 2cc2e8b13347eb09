"""Grasps of the Shadow hand: opposed points of an object for thumb and fingers, and the hand around them.

The thumb presses from one side and the fingers, in a row, from the other; the hand comes from the side or from above.
Palm and joints bring the tips to their points, and the targets of the servos give the forces.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array
from handsight.simulation.motion import Grasp
from handsight.simulation.scene import FINGERS, PALM, T_MOUNT_PALM, SimulatedScene, mujoco_module, tip_shape


class GraspOptions(NamedTuple):
    """`GraspOptions` say which grasps of an object on a table are candidates."""

    finger_spacing: float = 0.021  # from finger to finger [m]
    even_directions: int = 12  # of the grip's axis in the table's plane, evenly distributed
    max_directions: int = 24  # these and the directions across the object's sides
    max_width: float = 0.135  # between thumb and fingers [m]
    min_cosine: float = 0.75  # between normals and the grip's axis
    tip_radius: float = 0.0105  # of a tip around its contact, which the table must leave free [m]
    reach: float = 0.08  # how far below the palm tips can be [m]
    friction: float = 0.6  # of contacts that the balance relies on, well below the simulated 1
    cone_edges: int = 8  # of the pyramid that approximates the friction cone
    thumb_force: float = 6.0  # of the thumb [N]
    thumb_force_thin: float = 3.0  # of the thumb on a thin object [N]
    lever: float = 0.04  # arm at which a torque counts as much as a force [m]
    hull_directions: int = 400  # directions whose extreme vertices represent a hull
    examined: int = 60  # candidates of each rest whose forces are balanced, those of the best shape
    same_side_cosine: float = np.cos(np.deg2rad(15.0))  # between normals of one side
    flat_cosine: float = np.cos(np.deg2rad(4.0))  # between normals of a plane side
    stable_margin: float = 0.001  # how far outside a side the centre of mass may be above it [m]
    max_rests: int = 6  # stable poses that are tried
    thin: float = 0.018
    """Half the width of a thin object, across row and grip [m]: fingers alternate between its sides, lest it rolls."""
    wide: float = 0.08  # between thumb and fingers [m]: a wider grip is worse
    reached: float = 0.105  # between thumb and fingers [m]: a wider grip hardly reaches unless it is slanted


GRASP = GraspOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A `Body` is the convex hull of an object in some pose, reduced to few faces."""

    vertices: Array  # (k, 3) [m]
    normals: Array  # (m, 3) outward, of its faces
    offsets: Array  # (m,): inside, normals @ p < offsets [m]
    areas: Array  # (m,) of the faces [m²]
    mass: Array  # (3,) the centre of mass [m]
    middle: Array  # (3,) the middle of the bounds in the object's own frame [m]

    def turned(self, R: Array) -> "Body":
        """Returns the body turned by R (3, 3) and standing on the table, its middle above the origin."""
        vertices = (self.vertices - self.middle) @ R.T
        up = np.array([0.0, 0.0, -vertices[:, 2].min()])
        normals = self.normals @ R.T
        offsets = self.offsets - self.normals @ self.middle + normals @ up
        return Body(vertices + up, normals, offsets, self.areas, (self.mass - self.middle) @ R.T + up, up)


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """A `Hold` is where fingertips are to press on a resting object, in the world; the grip's axis is x."""

    R_world_object: Array  # (3, 3) rotation of the object at rest
    body: Body  # the object as it rests there
    points: Mapping[str, Array]  # (3,) by finger [m]
    normals: Mapping[str, Array]  # (3,) outward normals of the object there
    roll: float  # of the hand about x [rad]
    merit: float  # its rank: about 1 for the best, without a lower bound
    kin: tuple[int, float, float]  # number of its rest, roll and offset: equal ones tend to fail together


def body_of(vertices: Array) -> Body:
    """Returns the hull of `vertices` (k, 3) [m] by its extreme ones, within a hundredth of its size if it is smooth."""
    directions = se3.directions(GRASP.hull_directions)
    kept = vertices[np.unique(np.argmax(vertices @ np.vstack([directions, np.eye(3), -np.eye(3)]).T, axis=0))]
    hull = ConvexHull(kept)
    corners = kept[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = kept.mean(axis=0)
    volumes = np.abs(np.linalg.det(corners - inside))
    mass = inside + volumes @ (corners - inside).sum(axis=1) / (4 * volumes.sum())
    areas = np.linalg.norm(across, axis=1) / 2
    middle = (kept.min(axis=0) + kept.max(axis=0)) / 2
    return Body(kept, hull.equations[:, :3], -hull.equations[:, 3], areas, mass, middle)


def least_rotation(first: Array, second: Array) -> Array:
    """Returns the least rotation (3, 3) that turns one direction (3,) to another, both of any length."""
    a, b = first / np.linalg.norm(first), second / np.linalg.norm(second)
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:  # exact: an object that rests as in its file or upside down is not turned by rounding
        axis = np.cross(se3.perpendicular(a), a)
        return np.eye(3) if a @ b > 0 else 2 * np.outer(axis, axis) - np.eye(3)
    return se3.rotation_exp(np.arctan2(sine, a @ b) * axis / sine)


def rests(body: Body) -> list[Array]:
    """Returns rotations Rs_world_object (3, 3) in which the body rests: as in its file, on its largest sides, on end.
    It rests on a side if its centre of mass, projected to the side's plane, is inside all other faces."""
    found = [np.eye(3)]
    heights = body.offsets - body.normals @ body.mass
    sizes = (body.normals @ body.normals.T > GRASP.flat_cosine) @ body.areas
    for i in np.argsort(-sizes, kind="stable"):
        down = body.normals[i]
        stands = (body.normals @ (body.mass + heights[i] * down) - body.offsets).max() < GRASP.stable_margin
        if stands and all(-down @ R[2] < GRASP.same_side_cosine for R in found):
            found.append(least_rotation(down, np.array([0.0, 0, -1])))
    if len(found) > GRASP.max_rests:
        end = max(found[GRASP.max_rests - 1 :], key=lambda R: float(np.ptp(body.vertices @ R[2])))
        found = [*found[: GRASP.max_rests - 1], end]
    return found


def grasp_candidates(body: Body) -> list[Hold]:
    """Returns all holds that geometry and the balance of forces allow, best first."""
    found: list[Hold] = []
    for order, R in enumerate(rests(body)):
        resting: list[Hold] = []
        for direction in _directions(body.turned(R)):
            R_world_object = se3.rotation_exp(np.array([0.0, 0.0, -direction])) @ R
            resting += _holds_along_x(body.turned(R_world_object), R_world_object, order)
        resting.sort(key=lambda hold: -hold.merit)
        for hold in resting[: GRASP.examined]:
            wish = wished(hold.points)
            points, normals = (np.array([*of.values()]) for of in (hold.points, hold.normals))
            pressed, left = forces(points, normals, wish)
            lacking = 1 - np.minimum(np.linalg.norm(pressed, axis=1) / wish, 1.0)
            found.append(replace(hold, merit=hold.merit - left - 0.5 * float(lacking.mean())))
    return sorted(found, key=lambda hold: -hold.merit)


def forces(points: Array, normals: Array, wished: Array) -> tuple[Array, float]:
    """Returns forces (n, 3) of fingers that keep an object at rest, and the unbalanced rest of their wrench [N].

    Fingers press at `points` with outward `normals` (n, 3), each as hard as `wished` (n,) [N] where the balance allows
    it; each force is within the pyramid of friction.
    """
    n, turns = len(points), 2 * np.pi * np.arange(GRASP.cone_edges) / GRASP.cone_edges
    sides = np.linalg.svd(normals[:, None, :])[2][:, 1:]  # two tangents each
    tangents = np.cos(turns)[:, None] * sides[:, None, 0] + np.sin(turns)[:, None] * sides[:, None, 1]
    edges = -normals[:, None] + GRASP.friction * tangents  # (n, cone_edges, 3)
    arms = (points - points.mean(axis=0)) / GRASP.lever
    wrenches = np.concatenate([edges, np.cross(arms[:, None], edges)], axis=2).reshape(-1, 6).T
    each = np.kron(np.eye(n), np.ones(GRASP.cone_edges))
    A = np.vstack([3 * wrenches, 0.5 * each, 0.05 * np.eye(n * GRASP.cone_edges)])
    shares, _ = nnls(A, np.concatenate([np.zeros(6), 0.5 * wished, np.zeros(n * GRASP.cone_edges)]))
    pressed = np.einsum("ne,nek->nk", shares.reshape(n, GRASP.cone_edges), edges)
    return pressed, float(np.linalg.norm(wrenches @ shares))


def wished(points: Mapping[str, Array]) -> Array:
    """Returns (n,) how hard thumb and fingers should press [N]: less on a thin object, which rolls away sooner."""
    width = np.mean([point[0] for finger, point in points.items() if finger != "th"]) - points["th"][0]
    press = GRASP.thumb_force if width > 2 * GRASP.thin else GRASP.thumb_force_thin
    return np.array([press if finger == "th" else press / (len(points) - 1) for finger in points])


def _directions(body: Body) -> list[float]:
    """Returns angles of the grip's axis about the vertical [rad]: across the largest sides, then evenly distributed."""
    upright = np.abs(body.normals[:, 2]) < 0.35
    turns = np.arctan2(body.normals[upright, 1], body.normals[upright, 0])
    order = np.argsort(-body.areas[upright], kind="stable")
    even = 2 * np.pi * np.arange(GRASP.even_directions) / GRASP.even_directions
    found: list[float] = []
    for turn in [*(t for a in turns[order] for t in (a, a + np.pi)), *even]:
        if all(np.cos(turn - other) < GRASP.same_side_cosine for other in found):
            found.append(float(turn))
        if len(found) == GRASP.max_directions:
            break
    return found


def _holds_along_x(body: Body, R: Array, order: int) -> Iterator[Hold]:
    """Yields holds of a body in its `order`-th rest, turned by R (3, 3) from its file; the grip's axis is along x."""
    # The hand's roll about the grip's axis: from thumb up beside the object to palm down above it [rad].
    rolls = np.deg2rad([0.0, 45.0, 90.0])
    # Shifts of the grip from the centre of mass along the row of fingers, as shares of the object's size.
    places = (0.0, -0.25, 0.25)
    # Shifts across, as shares of half the size: back towards the palm, for an object that is too wide in the middle
    # may be narrow enough in front of it; and of the fingers by turns to either side.
    offsets = ((0.0, 0.0), (0.35, 0.0), (0.55, 0.0), (0.0, 0.5))
    # Fingers that oppose the thumb; the first is the upper one, or the one further along the world's y.
    finger_rows = (("ff", "mf", "rf", "lf"), ("ff", "mf", "rf"), ("ff", "mf"))
    size = np.ptp(body.vertices, axis=0)
    for roll, place, (offset, zigzag) in product(rolls, places, offsets):
        row = np.array([0.0, np.sin(roll), np.cos(roll)])
        approach = np.array([0, np.cos(roll), -np.sin(roll)])
        centre = body.mass + place * (size @ np.abs(row)) * row
        half = (size @ np.abs(approach)) / 2 * approach
        if zigzag and np.linalg.norm(half) > GRASP.thin:
            continue
        thumb = _exits(body, (centre - offset * half)[None], -1.0)
        for fingers in finger_rows:
            steps = GRASP.finger_spacing * (np.arange(len(fingers))[::-1] - (len(fingers) - 1) / 2)
            lateral = zigzag * (-1.0) ** np.arange(len(fingers)) - offset
            others = _exits(body, centre + steps[:, None] * row + lateral[:, None] * half, 1.0)
            points, normals = (np.vstack(pair) for pair in zip(thumb, others, strict=True))
            if not np.isfinite(points).all() or (np.abs(normals[:, 0]) < GRASP.min_cosine).any():
                continue
            middle, lowest = points[1:].mean(axis=0), float(points[:, 2].min())
            width, straight = float(middle[0] - points[0, 0]), float(np.abs(normals[:, 0]).mean())
            under = np.sin(roll) * (body.vertices[:, 2].max() - points[0, 2])
            if width > GRASP.max_width or lowest < GRASP.tip_radius - 0.002 or under > GRASP.reach:
                continue
            lever = float(np.linalg.norm((body.mass - (middle + points[0]) / 2)[1:]))
            missing_room = max(GRASP.tip_radius + 0.004 - lowest, 0.0)
            merit = (
                straight + 0.1 * (len(points) - 4) - 4 * lever - 3 * max(width - GRASP.wide, 0.0)
                - 30 * max(width * straight - GRASP.reached, 0.0) - 50 * missing_room - 0.1 * (roll > 0)
                - 0.2 * (order > 0) - 0.1 * (offset > 0) + 0.2 * (zigzag > 0)
            )  # fmt: skip
            if merit > -1:
                names, kin = ("th", *fingers), (order, float(roll), offset + zigzag)
                at, outward = (dict(zip(names, each, strict=True)) for each in (points, normals))
                yield Hold(R, body, at, outward, float(roll), merit, kin)


def _exits(body: Body, starts: Array, sense: float) -> tuple[Array, Array]:
    """Returns points (n, 3) where lines along ±x from `starts` (n, 3) leave the body, and the normals (n, 3) there. A
    line that starts outside has NaN."""
    rate = sense * body.normals[:, 0]
    ahead = rate > 1e-9
    below = body.offsets[None] - starts @ body.normals.T
    steps = np.where(ahead, below / np.where(ahead, rate, 1.0), np.inf)
    k = np.argmin(steps, axis=1)
    points = starts + sense * np.take_along_axis(steps, k[:, None], axis=1) * [1.0, 0, 0]
    points[below.min(axis=1) <= 0] = np.nan
    return points, body.normals[k]


class PostureOptions(NamedTuple):
    """`PostureOptions` configure the search for the joint angles of a grasp."""

    coupling: float = 1.142  # of the tendon of a finger's last two joints: J0 follows J1 by this ratio
    slack: float = 0.142  # behind it by at most this [rad]
    stiffness: float = 1.0  # of the servos [N m/rad]
    tip_clearance: float = 0.022  # of the open tips from their points [m]
    link_clearance: float = 0.004  # of the other links from the object [m]
    table_clearance: float = 0.003  # of all links from the table [m]
    max_miss: float = 0.002  # distance of a tip from its point that is accepted [m]
    min_clearance: float = 0.0005  # smallest clearance that is accepted [m]
    stop_margin: float = 0.01  # of a joint from its stop [rad]
    tolerance: float = 1e-4  # relative change at which the optimiser stops


POSTURE = PostureOptions()


class Posture:
    """A `Posture` is the hand around one hold; `grasp` computes its closing motion."""

    def __init__(self, scene: SimulatedScene, hold: Hold) -> None:
        """Starts from a hand that grips an object of medium width, moved so that its grip is the hold's."""
        self._mujoco, self._model = mujoco_module(), scene.model
        self._data: Any = self._mujoco.MjData(scene.model)
        self.hold, self._scene, self._used = hold, scene, tuple(hold.points)
        joints = [name for name in scene.joints if name[7:9].lower() in self._used]
        self._follows = [(n.replace("J0", "J1"), n) for n in joints if n.endswith("J0") and n[7:9] != "TH"]
        self._names = [name for name in joints if name not in dict(self._follows).values()]
        self._places = np.array([scene.joints[name] for name in self._names])
        ranges = np.array([self._model.joint(name).range for name in self._names])
        self._low, self._high = ranges[:, 0] + POSTURE.stop_margin, ranges[:, 1] - POSTURE.stop_margin
        # Joints of that hand [rad], 0 for the others; then axes of its grip (thumb to fingers, away from the palm,
        # along the row) and the grip's middle in the palm [m].
        bent = {f"{name.upper()}J{k}": {2: 0.75, 1: 0.6}[k] for name in FINGERS[:4] for k in (2, 1)}
        bent |= {"THJ4": 0.2, "THJ3": 1.1, "THJ2": 0.1, "THJ1": -0.25, "THJ0": -0.7}
        R_grip_palm = np.array([[0.0, 0.3, 0.954], [0, -0.954, 0.3], [1, 0, 0]])
        grip_palm = np.array([0.005, -0.09, 0.1])
        self._bent = np.array([bent.get(name[7:], 0.0) for name in self._names])
        c, s = np.cos(hold.roll), np.sin(hold.roll)
        self._R = np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]]) @ R_grip_palm
        fingers = np.mean([point for finger, point in hold.points.items() if finger != "th"], axis=0)
        self._p = (hold.points["th"] + fingers) / 2 - self._R @ grip_palm
        # Links that must touch nothing are covered by balls: geom, centre in it and radius [m] of each.
        kinds = self._mujoco.mjtGeom
        balls: list[tuple[int, Any, float]] = []
        for i in range(self._model.ngeom):
            geom = self._model.geom(i)
            x, y, z = geom.size
            if geom.type[0] == kinds.mjGEOM_CAPSULE and geom.contype[0]:
                balls += [(i, (0, 0, t * y), x) for t in (-1, 0, 1)]
            elif geom.name.startswith("robot0:C_") and geom.type[0] == kinds.mjGEOM_BOX:
                grid = [(a, b) for a in (-1, 0, 1) for b in (-1, -0.33, 0.33, 1)]
                balls += [(i, (a * (x - y), 0, b * (z - y)), y) for a, b in grid]
            elif i in scene.tips and scene.tips[i] not in self._used:
                balls += [(i, (0, 0, t * (z - x)), x) for t in (-1, 1)]
        self._geoms, self._centers, self._radii = (np.array(column) for column in zip(*balls, strict=True))

    def grasp(self) -> tuple[Grasp | None, str]:
        """Returns the grasp, or None and the reason why the hand cannot take this hold."""
        x = self._fitted(self._residuals, np.concatenate([np.zeros(6), self._bent]))
        self._place(x)
        missed = [self._tip(finger)[0] - self.hold.points[finger] for finger in self._used]
        if np.linalg.norm(missed, axis=1).max() > POSTURE.max_miss:
            return None, "out of reach"
        if min(clearance.min() for clearance in self._clearances()) < POSTURE.min_clearance:
            return None, "no room for the hand"
        # The servos' targets [rad] are off the joints by the torques of balanced forces.
        self._mujoco.mj_comPos(self._model, self._data)
        points, normals = (np.array([*of.values()]) for of in (self.hold.points, self.hold.normals))
        pressing, _ = forces(points, normals, wished(self.hold.points))
        torques = np.zeros(self._model.nv)
        for finger, point, force in zip(self._used, points, pressing, strict=True):
            J = np.zeros((3, self._model.nv))
            self._mujoco.mj_jac(self._model, self._data, J, None, point, self._model.body(f"{finger}_tip").id)
            torques += J.T @ force
        of_joint = {name: torques[self._model.joint(name).dofadr[0]] for name in self._scene.joints}
        for leader, follower in self._follows:
            of_joint[leader] += POSTURE.coupling * of_joint[follower]
        closed = x[6:] + np.array([of_joint[name] for name in self._names]) / POSTURE.stiffness
        closed = np.clip(closed, self._low - POSTURE.stop_margin, self._high + POSTURE.stop_margin)
        away = POSTURE.tip_clearance
        opened = self._fitted(lambda joints: self._residuals(np.concatenate([x[:6], joints]), away), x[6:])
        self._place(x)
        palm, height = self._data.body(PALM), float(self.hold.body.middle[2])
        R_world_palm = palm.xmat.reshape(3, 3).copy()
        T_world_middle = se3.compose(self.hold.R_world_object, np.array([0.0, 0.0, height]))
        return Grasp(
            T_palm_middle=se3.inverse(se3.compose(R_world_palm, palm.xpos)) @ T_world_middle,
            opening=dict(zip(self._names, opened.tolist(), strict=True)),
            closed=dict(zip(self._names, closed.tolist(), strict=True)),
            height=height,
            R_world_palm=R_world_palm,
        ), ""

    def _fitted(self, residuals: Callable[[Array], Array], start: Array) -> Array:
        """Returns the minimiser of the sum of squares within the joints' range; its last numbers are the joints."""
        free = np.full(len(start) - len(self._low), np.inf)
        low, high = np.concatenate([-free, self._low]), np.concatenate([free, self._high])
        start = np.clip(start, low + POSTURE.tolerance, high - POSTURE.tolerance)
        scale = np.repeat([0.1, 0.5], [len(free), len(self._low)])
        tolerances = dict.fromkeys(("ftol", "xtol"), POSTURE.tolerance)
        found = least_squares(residuals, start, bounds=(low, high), x_scale=scale, max_nfev=40, **tolerances)
        return np.asarray(found.x)

    def _place(self, x: Array) -> None:
        """Places the hand: x is the palm's shift [m] and rotation [rad] from the start, then the joints [rad]."""
        angles = self._data.qpos
        angles[:] = 0.0
        angles[self._places] = x[6:]
        for leader, follower in self._follows:
            leads = angles[self._scene.joints[leader]]
            angles[self._scene.joints[follower]] = max(0.0, POSTURE.coupling * leads - POSTURE.slack)
        T = se3.compose(se3.rotation_exp(x[3:6]) @ self._R, self._p + x[:3]) @ se3.inverse(T_MOUNT_PALM)
        mount = self._data.joint("mount").qpos
        mount[:3], mount[3:] = T[:3, 3], np.roll(se3.quaternion_from_rotation(T[:3, :3]), 1)
        self._mujoco.mj_kinematics(self._model, self._data)

    def _tip(self, finger: str) -> tuple[Array, Array, float]:
        """Returns a tip's point that meets the object's side [m], its direction in the tip, the tip's height [m]."""
        geom, semi_axes = self._data.geom(f"{finger}_tip"), tip_shape(finger)[0]
        R = geom.xmat.reshape(3, 3)
        towards = -R.T @ self.hold.normals[finger]
        scaled = semi_axes * towards
        return geom.xpos + R @ (semi_axes * scaled / np.sqrt(scaled @ scaled)), towards, float(geom.xpos[2])

    def _residuals(self, x: Array, away: float = 0.0) -> Array:
        """Returns the errors of a posture, weighted; its tips should be at distance `away` from their points [m]."""
        self._place(x)
        parts = [0.15 * (x[6:] - self._bent), 0.5 * x[3:6]]
        for finger in self._used:
            point, towards, height = self._tip(finger)
            goal = self.hold.points[finger] + away * self.hold.normals[finger]
            # Where on the tip the object should be, a direction in the axes of the distal link.
            pad = np.array([-0.85, 0.0, 0.53] if finger == "th" else [0.0, -0.85, 0.53])
            parts += [(point - goal) / 0.002, 0.7 * (towards - pad)]
            parts.append(np.array([max(0.0, 0.009 + POSTURE.table_clearance - height) / 0.002]))
        from_object, from_table = self._clearances()
        parts.append(np.maximum(POSTURE.link_clearance - from_object, 0) / 0.003)
        parts.append(np.maximum(POSTURE.table_clearance - from_table, 0) / 0.003)
        return np.concatenate(parts)

    def _clearances(self) -> tuple[Array, Array]:
        """Returns distances of the links' balls from the planes of the object's faces, and from the table [m]."""
        R = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        at = self._data.geom_xpos[self._geoms] + np.einsum("ijk,ik->ij", R, self._centers)
        body = self.hold.body
        from_object = (at @ body.normals.T - body.offsets).max(axis=1)
        return from_object - self._radii, at[:, 2] - self._radii
