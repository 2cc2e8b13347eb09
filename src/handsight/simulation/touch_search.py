"""The complete task without a camera: a search by touch, then a grasp at the estimated pose.

One finger of the hand is stretched, and its tip is swept along lines over the table.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.errors import InvalidInput, NotFound
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import MountedCamera, Rig, Table
from handsight.search import Area, Belief, Sweep, Touch, best_sweep, with_symmetries_of_touch
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.motion import Grasp, least_jerk
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import STEPS_PER_SECOND, Nuisances, Phase, Sample, Scenario
from handsight.simulation.scene import PALM, T_MOUNT_PALM, bounds, rows
from handsight.simulation.simulate import Sensors, samples
from handsight.simulation.tables import tables
from handsight.simulation.world import World
from handsight.tracking import FingertipSensors

FINGER = "ff"  # the stretched finger


REACH = 0.06
"""How far the tip's middle may be below the object's top [m]: the lowest knuckle of the fist is 71 mm above it. The
finger's first link, 31 mm above it and 1 mm wider than the tip, trails by its lean."""
TIP_RADIUS = 0.009
"""Of the tip's sides [m]."""
SIGMA_TIP = 0.0025
"""Of the tip's position, per axis [m]: a degree at each joint of the finger."""
SIGMA_HEIGHT = 0.0005
"""Of the tip's height at one place relative to that at another [m]."""
LEAN = math.radians(12.0)
"""Angle of the finger from the vertical, its tip ahead, so that the tip is first to meet a wall [rad]."""
SPEED = 0.06
"""Of the tip in a sweep [m/s]."""
ACCELERATION_TIME = 0.1
"""How long the tip takes to reach its speed [s]: a sudden start shakes it, which would pass for a contact."""
STOP_FORCE = 0.15
"""At which a sweep ends [N]."""
MIN_HEIGHT = 0.022
"""Least height of the tip's middle above the table [m]; the table is known to some millimetres and a degree."""
TABLE_START = 0.05
"""Height above the expected table at which the tip starts to search for it [m]."""
TABLE_UNEVENNESS = 0.015
"""Largest difference of height on a table tilted by a degree [m]. A lower contact is one of the finger's side with the
table's edge."""


class Probe(World):
    """The hand above the table, one finger stretched; the object stands free at the scene's origin."""

    def __init__(
        self, scenario: Scenario, R_scene_object: Array, T_world_table: Array, *, recording: bool = False
    ) -> None:
        """Starts with the object at rotation `R_scene_object` (3, 3) in the scene.

        `T_world_table` (4, 4) is the scene's origin but for the table's errors. With `recording` all samples are
        kept in `recorded`, those on the way to a sweep too. Raises as `World` does.
        """
        rig = rig_of(scenario)
        self._tips = FingertipSensors(rig)
        self._finger = rig.fingers[FINGER]
        self._T_palm_finger = self._finger_in_palm(dict.fromkeys(rig.hand.moving, 0.0))
        R_world_palm = self._turned(np.array([1.0, 0.0, 0.0]))
        self.top = float(np.abs(R_scene_object[2]) @ np.ptp(bounds(scenario.object), axis=0))
        """Height of the object above the table [m]."""
        below = R_world_palm.T @ [0.0, 0.0, -0.5]
        grasp = Grasp(
            T_palm_middle=se3.compose(R_world_palm.T @ R_scene_object, below),
            opening=tables()["fist"],
            closed={},
            height=self.top / 2,
            R_world_palm=R_world_palm,
        )
        super().__init__(replace(scenario, motion="grasp", images=False), grasp)
        self._hold_object(self._start)
        self.refresh()
        # A robot that searches waits for a message until it has it.
        certain = replace(scenario.nuisances, message_loss=0.0)
        self._sensors = Sensors(replace(scenario, nuisances=certain), self)
        self._sensors.T_world_scene = T_world_table @ self._sensors.T_world_scene
        self._on_table = False
        self._recording = recording
        self.recorded = list[Sample]()
        self._every = round(STEPS_PER_SECOND / scenario.rate)
        self._T_world_palm = self._sensors.T_world_scene @ self.pose(PALM)

    @property
    def phase(self) -> Phase:
        """Always `touch`."""
        return "touch"

    @property
    def T_world_object(self) -> Array:
        """True pose (4, 4) in the robot's world."""
        return self._sensors.T_world_scene @ self.pose("object")

    @property
    def heights(self) -> Array:
        """(n,) middles of the tip above the table at which it alone meets the object, the lowest first [m]."""
        lowest = max(MIN_HEIGHT, self.top - REACH)
        return np.linspace(lowest, max(lowest, self.top - 0.012), 4)

    def measure_table(self, places: ArrayLike) -> tuple[float, Array]:
        """Returns the table's height along its normal [m], and its axes R_world_table (3, 3), by touching it.

        `places` (n, 2) are in the world [m]. Those beside the table are left out; raises InvalidInput where all are.
        """
        found = []
        down = _distances(2 * TABLE_START)[:, None] * [0.0, 0.0, -1.0]
        for x, y in np.atleast_2d(places):
            begin = self._palm(self._turned(np.eye(3)[0]), np.array([x, y, TABLE_START]))
            self._travel(begin)
            for sample in self._along(_shifted(begin, down)):
                sensed = self._tips.contacts(sample.observation)
                if FINGER in sensed.fingers or sensed.reasons[FINGER] == "on the table":
                    T = self._tip(sample.observation)
                    # The lowest point of the tip's ellipsoid.
                    low = T[2, 3] - np.linalg.norm(T[2, :3] * self._finger.tip.semi_axes)
                    found.append([*T[:2, 3], low])
                    break
        if not found:
            raise InvalidInput("places: expected some over the table, touched nothing at any of them")
        points = np.array(found)
        heights = points[:, 2]
        even = np.abs(heights - np.median(heights)) < TABLE_UNEVENNESS
        # The slopes are near 0, by the table's prior. An error that all touches share moves the height only.
        prior = SIGMA_HEIGHT / Nuisances().table_tilt
        rows = np.vstack([np.insert(points[even, :2], 0, 1, axis=1), prior * np.eye(3)[1:]])
        height, *slopes = np.linalg.lstsq(rows, np.append(heights[even], [0.0, 0.0]), rcond=None)[0]
        R_world_table = se3.axes_along(np.array([1.0, 0.0, slopes[0]]), np.array([0.0, 1.0, slopes[1]]))
        return float(height * R_world_table[2, 2]), R_world_table

    def touch(self, sweep: Sweep) -> Touch:
        """Returns the result of a sweep: the hand travels to its start, and along it until it touches something."""
        start = self._palm(self._turned(sweep.direction_world), sweep.start_world)
        self._travel(start)
        free: list[Array] = []
        contact = None
        for sample in self._along(_shifted(start, _distances(sweep.length)[:, None] * sweep.direction_world)):
            contact = self._sensed_contact(sample.observation)
            if contact is not None or self._on_table:
                break
            tip = self._tip(sample.observation)[:3, 3]
            if not free or np.linalg.norm(tip - free[-1]) >= 0.005:
                free.append(tip)
        if contact is not None:
            # The mean wrench of a hand at rest is more accurate, unless the contact is lost.
            resting = np.tile(self._T_world_palm, (round(0.15 * STEPS_PER_SECOND), 1, 1))
            last = [sample.observation for sample in self._along(resting)][-10:]
            mean = np.mean([observation.wrenches[FINGER] for observation in last], axis=0)
            contact = self._sensed_contact(replace(last[-1], wrenches={FINGER: mean})) or contact
        back = 0.015 if contact is not None else 0.0
        self._straight(_shifted(self._T_world_palm, -back * sweep.direction_world))
        return Touch(np.array(free).reshape(-1, 3), TIP_RADIUS, SIGMA_TIP, contact)

    def _sensed_contact(self, observation: Observation) -> Contacts | None:
        """Returns the contact of the stretched finger in the world; None where its force is below `STOP_FORCE`."""
        sensed = self._tips.contacts(observation)
        self._on_table = sensed.reasons.get(FINGER) == "on the table"
        if FINGER not in sensed.fingers or sensed.contacts is None or sensed.loads is None:
            return None
        k = sensed.fingers.index(FINGER)
        if np.linalg.norm(sensed.loads[k, :4]) < STOP_FORCE:
            return None
        return sensed.contacts.select([k]).moved(np.asarray(observation.T_world_palm))

    def _along(self, Ts_world_palm: Array, *, needed: bool = True) -> Iterator[Sample]:
        """Yields samples while the palm moves through poses (n, 4, 4), two milliseconds from one to the next. Unless
        they are `needed` or recorded it yields none, for a sample takes longer than the simulation."""
        arm = rows(se3.inverse(self._sensors.T_world_scene) @ Ts_world_palm @ se3.inverse(T_MOUNT_PALM))
        for i, T in enumerate(Ts_world_palm):
            self._arm = arm[i : i + 1]
            self._T_world_palm = T
            self.step()
            if (needed or self._recording) and self.steps % self._every == 0:
                self.refresh()
                sample = self._sensors.sample()
                sample = replace(sample, observation=replace(sample.observation, vision=None))
                if self._recording:
                    self.recorded.append(sample)
                yield sample

    def _travel(self, T_goal: Array) -> None:
        """Moves up, over the table and down to a palm pose (4, 4)."""
        safe = self.top + 0.05 - (T_goal @ self._T_palm_finger)[2, 3]
        up = self._T_world_palm.copy()
        up[2, 3] = max(up[2, 3], T_goal[2, 3] + safe)
        over = T_goal.copy()
        over[2, 3] = up[2, 3]
        for goal in (up, over, T_goal):
            self._straight(goal)

    def _straight(self, T_goal: Array) -> None:
        """Moves the palm straight to a pose (4, 4), at rest at both ends."""
        T_begin = self._T_world_palm
        way = se3.difference(T_goal, T_begin)
        seconds = np.linalg.norm(way[:3]) / 0.4 + np.linalg.norm(way[3:]) / 3.0
        s = np.linspace(0, 1, max(round(seconds * STEPS_PER_SECOND), 1) + 1)[1:, None]
        for _ in self._along(se3.moved(T_begin, least_jerk(s) * way), needed=False):
            pass

    def _turned(self, direction_world: Array) -> Array:
        """Returns R_world_palm (3, 3) with the finger down, its tip and the palm's front in a direction."""
        finger = self._T_palm_finger[:3, 2]
        front = np.array([0.0, -1.0, 0.0])
        down = np.sin(LEAN) * direction_world - np.cos(LEAN) * np.array([0.0, 0.0, 1.0])
        return se3.axes_along(down, direction_world) @ se3.axes_along(finger, front).T

    def _palm(self, R_world_palm: Array, middle_world: Array) -> Array:
        """Returns T_world_palm (4, 4) with the middle of the finger's tip at a point (3,) [m]."""
        return se3.compose(R_world_palm, middle_world - R_world_palm @ self._T_palm_finger[:3, 3])

    def _tip(self, observation: Observation) -> Array:
        """Returns T_world_tip (4, 4) of the stretched finger's tip as the robot measures it."""
        T_palm_tip = self._finger_in_palm(observation.joint_positions or {})
        return np.asarray(observation.T_world_palm) @ T_palm_tip

    def _finger_in_palm(self, joints: Mapping[str, float]) -> Array:
        """Returns T_palm_tip (4, 4) of the stretched finger at joints [rad]; its origin is the tip's middle."""
        hand = self._tips.rig.hand
        T_palm_frame = hand.Ts_palm_tip(joints)[list(hand.tips).index(FINGER)]
        return np.asarray(T_palm_frame @ self._finger.T_frame_surface)


def _distances(length: float) -> Array:
    """Returns the tip's distance (n,) from the start of a sweep after each step of the simulation [m]."""
    rise = ACCELERATION_TIME
    t = np.arange(0.0, length / SPEED + rise / 2, 1 / STEPS_PER_SECOND)
    return np.asarray(SPEED * np.where(t < rise, t**2 / (2 * rise), t - rise / 2))


def _shifted(T: Array, shift: Array) -> Array:
    """Returns a pose (4, 4) moved by (3,), or by each of (n, 3) [m]."""
    return se3.compose(T[:3, :3], T[:3, 3] + shift)


AREA_SIDE = 0.3
"""Of the square that contains the object [m]."""
MAX_TOUCHES = 12
"""Before the search gives up."""
TABLE_PROBES = np.kron([[0.2], [0.32]], [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""(8, 2) places outside the searched square where the table is touched [m]. Some may be beside it: the table ends near
the object."""


def touch_search_rig(scenario: Scenario) -> Rig:
    """Returns the robot's rig for a search by touch; raises as `rig_of`.

    Its camera represents the search, whose pose is in the world and has no constant error.
    """
    search = MountedCamera(sigma_position_constant=0.0, sigma_rotation_constant=0.0)
    return replace(rig_of(scenario), camera=search)


def start_search(
    scenario: Scenario, model: ObjectModel, R_scene_object: Array | None = None, *, recording: bool = False
) -> tuple[Probe, Belief]:
    """Returns the hand above the table, whose height it has measured, and the belief before the first touch.

    The object is where the scenario's seed puts it, at rotation `R_scene_object` (3, 3), by default that of its file.
    With `recording` the hand keeps all its samples. Raises as `simulate`.
    """
    R = np.eye(3) if R_scene_object is None else R_scene_object
    sides = np.ptp(model.vertices @ R.T, axis=0)
    half = AREA_SIDE / 2 - min(sides[:2]) / 2
    if not half > 0:
        size = " x ".join(f"{1000 * side:.0f}" for side in sides)
        raise InvalidInput(f"object: expected one within {1000 * AREA_SIDE:.0f} mm, got {size} mm")
    most = [half, half, np.pi]
    x, y, turn = scenario.stream(11).uniform(np.negative(most), most)
    T_world_table = se3.compose(se3.rotation_exp(np.array([0.0, 0.0, turn])), np.array([x, y, 0.0]))
    probe = Probe(scenario, R, T_world_table, recording=recording)
    height, R_world_table = probe.measure_table(TABLE_PROBES)
    table = Table(height=height, sigma_height=0.0015, sigma_tilt=math.radians(0.5))
    area = Area(np.full(2, -half), np.full(2, half), table, R[None], R_world_table)
    return probe, Belief(with_symmetries_of_touch(model, SIGMA_TIP), area, int(scenario.seed))


def simulate_touch_search(
    scenario: Scenario, grasp: Grasp | None = None, watch: Callable[[Belief, Array], None] | None = None
) -> Iterator[Sample]:
    """Yields samples of a search by touch, until the object is found, and then of the scenario's own motion.

    No sample has data of a camera. The first sample after the search carries the pose that was found, in the world and
    with its covariance, as vision's. The hand's way from there to the object is not simulated. `grasp` replaces the
    object's own, or the one that is searched. `watch` is called before the first touch and after each one, with the
    belief and the object's true pose T_world_object (4, 4). Raises as `simulate`, and NotFound where
    `MAX_TOUCHES` are too few.
    """
    grasp = grasp or grasp_for(scenario.object, int(scenario.seed))
    R_scene_object = grasp.R_world_palm @ grasp.T_palm_middle[:3, :3]
    probe, belief = start_search(scenario, model_of(scenario), R_scene_object, recording=True)
    watch = watch or (lambda *_: None)
    watch(belief, probe.T_world_object)
    while not belief.modes[0].is_certain:
        if len(belief.touches) == MAX_TOUCHES:
            known = f"its position is known to {1e3 * belief.modes[0].sigma_position:.0f} mm"
            raise NotFound(f"the object was not found by {MAX_TOUCHES} touches: {known}")
        belief = belief.after(probe.touch(best_sweep(belief, probe.heights, TIP_RADIUS)))
        yield from probe.recorded
        probe.recorded.clear()
        watch(belief, probe.T_world_object)
    # The hand closes at the estimated pose, the object is at the true one.
    found = belief.pose
    T_object_middle = se3.translation(belief.model.center_object)
    off = se3.inverse(found.T_a_b @ T_object_middle) @ probe.T_world_object @ T_object_middle
    T_palm_middle = grasp.T_palm_middle @ off
    # The scene has the object upright at its origin, and the hand on the side on which its table ends.
    R_scene_palm = R_scene_object @ T_palm_middle[:3, :3].T
    away = grasp.R_world_palm @ R_scene_palm.T
    turn = np.array([0.0, 0.0, np.arctan2(away[1, 0] - away[0, 1], away[0, 0] + away[1, 1])])
    R_scene_palm = se3.rotation_exp(turn) @ R_scene_palm
    world = World(scenario, replace(grasp, T_palm_middle=T_palm_middle, R_world_palm=R_scene_palm))
    sensors = Sensors(scenario, world)
    sensors.T_world_scene = probe.T_world_object @ se3.inverse(world.pose("object"))
    vision: PoseMeasurement | None = PoseMeasurement(found.T_a_b, "world", found.covariance)
    for (sample,) in samples(scenario, world, [sensors]):
        if sample is None:
            continue
        # The hand's way to the object, of half a second, is not simulated.
        stamp = probe.time + 0.5 + sample.observation.stamp
        yield replace(sample, observation=replace(sample.observation, stamp=stamp, vision=vision))
        vision = None
