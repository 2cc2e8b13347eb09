"""What a recording tells of the values that a rig and an object's model declare, and whether it contradicts them.

While a hand grasps an object in different ways, contacts measure more than its pose: what remains tells of the errors
that all grasps have in common. Contact i of an instant is off the surface by r_i + A_i (M_i x + C_i θ), with x the
instant's own error of the pose and θ the declared values' errors: of each joint, of each fingertip's place and radius,
of the gain of each axis of its sensor (torque and force tell where it is touched), and of the object's size. The loads
of a grasp in the air are those of a weight, whatever the squeeze: they depend on joints, gains and the mass. What is a
grasp's or an instant's own is eliminated (Schur complement), and θ, with the declared sigmas as its prior, is
the solution of one least-squares problem.

Declared is θ = 0 with prior covariance P; estimated is θ̂ with covariance S. If what is declared is right, θ̂ is a
Gaussian with covariance P - S, so θ̂ᵀ (P - S)⁻¹ θ̂ is a χ². The estimate that is shown is that of the recording
alone, without the value's own prior: information S⁻¹ - P⁻¹.
"""

import contextlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate
from handsight.correction.modes import chi2_limit, chi2_survival
from handsight.errors import InvalidInput
from handsight.forces import WEIGHER, Carried, Unknowns, Weighing, common_equations, weigh
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets, contact_equations
from handsight.tracking.table import TableEstimate
from handsight.tracking.tracker import Tracker
from handsight.tracking.verdicts import DIAGNOSIS, Diagnosed, Diagnosis, diagnosed

UNLIKE = (
    "no small errors of hand and object explain the contacts: another object, or a finger that is far off"
)


def diagnose(observations: Iterable[Observation], rig: Rig, model: ObjectModel) -> Diagnosis:
    """Returns what a recording tells of the values that a rig and a model declare; raises InvalidInput.

    Observations that a tracker refuses are left out.
    """
    tracker = Tracker(rig, model)
    diagnoser = Diagnoser(tracker)
    for observation in observations:
        with contextlib.suppress(InvalidInput):
            tracker.update(observation)
            diagnoser.watch()
    return diagnoser.diagnosis()


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """An `Instant` is the contacts of one grasp, and how they depend on what is declared."""

    fingers: tuple[str, ...]
    contacts: Contacts
    """The n contacts of `fingers`, in the palm frame."""
    covariance: Array
    """(n, 6, 6) of each contact, without the joints' constant errors."""
    by_value: Array
    """(n, 6, k) by how much the contacts change with the error of each of k values."""
    T_palm_object: Array
    """(4, 4) the tracked pose."""

    def with_errors(self, errors: Array) -> Contacts:
        """Returns the contacts where the values have errors (k,)."""
        shift, turn = np.split(self.by_value @ errors, 2, axis=1)
        normals = self.contacts.normals_palm + turn
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return Contacts.trusted(self.contacts.points_palm + shift, normals, self.contacts.covariance)


class Diagnoser:
    """A `Diagnoser` watches a tracker through a recording, and gathers what its grasps have in common."""

    def __init__(self, tracker: Tracker) -> None:
        """The tracker's rig and model declare the values."""
        self.tracker = tracker
        rig = tracker.rig
        exact = {name: replace(finger, sigma_gain=0.0) for name, finger in rig.fingers.items()}
        self._offsets, self._sensors = JointOffsets.of(rig), FingertipSensors(replace(rig, fingers=exact))
        """The fingertips' sensors, without the errors of gains, which are values of their own."""
        larger = {name: replace(f, tip=f.tip.larger(DIAGNOSIS.enlarged)) for name, f in exact.items()}
        self._larger = FingertipSensors(replace(rig, fingers=larger))
        """The same fingertips, larger by `DIAGNOSIS.enlarged`."""
        fingers, mass = rig.fingers.values(), tracker.track_state.weight.weigher.sigma_mass
        sigmas = {
            "joint": [self._offsets.sigma] * len(self._offsets.joints),
            "gain": [f.sigma_gain for f in fingers for _ in range(6)],
            "place": [f.sigma_point for f in fingers for _ in range(2)],
            "radius": [f.sigma_point for f in fingers],
            "size": [DIAGNOSIS.sigma_size],
            "compliance": [DIAGNOSIS.sigma_compliance],
            "mass": [mass or DIAGNOSIS.unknown_mass],
        }
        self._sigmas = np.maximum(np.concatenate(list(sigmas.values())), 1e-6)
        """(k,) declared sigmas of the values that all grasps have in common."""
        ends = np.cumsum([len(part) for part in sigmas.values()]).tolist()
        starts = [0, *ends[:-1]]
        self._at = dict(zip(sigmas, map(slice, starts, ends), strict=True))
        """Where the values of each kind are among them."""
        self._grasps = list[tuple[tuple[Carried, ...], Weighing]]()
        """The loads of each grasp in the air, by joints as declared, where gravity had most directions."""
        self._in_hand = False
        """Whether the last of these is of the current grasp."""
        self._instants = list[Instant]()
        self._beginning: Observation | None = None
        """That by which the correction began that goes on, or the last one."""
        self._bias: tuple[Array, Array] | None = None
        """Vision's constant error (6,) and its covariance (6, 6), when they were known best."""
        self._table: TableEstimate | None = None
        """Where the table must be, when its height was known best."""

    def watch(self) -> None:
        """Adds the tracker's last observation, if a finger touches elsewhere than in those that are kept."""
        observation, estimate = self.tracker.processed, self.tracker.estimate
        corrected, progress = self.tracker.track_state.correction, self.tracker.track_state.progress
        if observation is None or estimate is None:
            return
        if progress is not None and progress.started.stamp == observation.stamp:
            self._beginning = observation
        if not estimate.consistent:
            return
        self._add_loads()
        if corrected is None:
            return
        if corrected.stamp != observation.stamp:  # its correction took several updates
            if self._beginning is None or corrected.stamp != self._beginning.stamp:
                return
            observation, estimate, self._beginning = self._beginning, corrected.estimate, None
        table = self.tracker.table
        if table is not None and (self._table is None or table.sigma_height < self._table.sigma_height):
            self._table = table
        bias = self.tracker.vision_bias()
        if bias is not None and (self._bias is None or np.trace(bias[1]) < np.trace(self._bias[1])):
            self._bias = bias
        self._add_contacts(observation, estimate)

    def _add_loads(self) -> None:
        """Keeps the loads of the last weighing, if gravity has had no more directions before in this grasp."""
        state, last = self.tracker.track_state, self._grasps[-1][1] if self._in_hand else None
        found, instants = state.weight.weigher.weighing, state.weight.weigher.instants
        self._in_hand = found is not None
        if any(sensor.taxels for sensor in state.weight.weigher.sensors):
            return  # no value of the rig says what these read
        if found is None or found is last or (last is not None and found.directions < last.directions):
            return
        if last is not None:
            self._grasps.pop()
        # Loads are without the joints' estimated offsets, readings without the tips' weights.
        declared = list[Carried]()
        for instant in instants:
            load, readings = instant.load, instant.load.readings.copy()
            for i, finger in enumerate(self.tracker.rig.fingers.values()):
                own, known = load.by_bias[:3, 6 * i : 6 * i + 3].T @ load.gravity, finger.calibration
                weight = np.concatenate([own, np.cross(known.center_of_mass, own)])
                readings[6 * i : 6 * i + 6] -= known.mass * weight
            wrench = load.wrench + load.by_joint @ state.offsets.mean
            declared.append(replace(instant, load=replace(load, wrench=wrench, readings=readings)))
        self._grasps.append((tuple(declared), found))

    def _add_contacts(self, observation: Observation, estimate: PoseEstimate) -> None:
        """Adds the contacts of an instant with the object at its estimated pose, if they are a new grasp."""
        if len(self._instants) >= DIAGNOSIS.max_instants or observation.contacts:
            return
        touch = self._sensors.contacts(observation)
        contacts, loads = touch.contacts, touch.loads
        if contacts is None or touch.by_error is None or loads is None:
            return
        if len(contacts) < DIAGNOSIS.min_fingers or not loads[:, 3].min() >= DIAGNOSIS.min_force:
            return
        if not self._is_new(touch.fingers, contacts):
            return
        others = [self._larger.contacts(observation)]
        others += [self._sensors.contacts(self._with_gain(observation, axis)) for axis in range(6)]
        alike = [each.contacts for each in others if each.fingers == touch.fingers]
        found = [each for each in alike if each is not None]
        if len(found) < len(others):
            return
        # (7, n, 6) by how much each change moves the point and the normal of each contact.
        changed = np.array([np.hstack([each.points_palm, each.normals_palm]) for each in found])
        changed -= np.hstack([contacts.points_palm, contacts.normals_palm])
        K, alone = self._offsets.separated(contacts, touch.by_error)
        J = np.zeros((len(contacts), 6, len(self._sigmas)))
        J[:, :, self._at["joint"]] = -K  # a joint that reads too much is at a smaller angle
        rig = self.tracker.rig
        place, gain, radius = (self._at[kind].start for kind in ("place", "gain", "radius"))
        Ts = rig.hand.kinematics(dict(observation.joint_positions or {})).Ts_palm_tip
        for i, name in enumerate(touch.fingers):
            n, tip = list(rig.fingers).index(name), list(rig.hand.tips).index(name)
            R = Ts[tip, :3, :3] @ rig.fingers[name].T_frame_surface[:3, :3]
            # Along its axis a shift looks like another radius.
            J[i, :3, place + 2 * n : place + 2 * n + 2] = R[:, :2]
            J[i, :, radius + n] = changed[0, i] / DIAGNOSIS.enlarged
            # A sensor that reads too much measures less.
            J[i, :, gain + 6 * n : gain + 6 * n + 6] = -changed[1:, i].T / DIAGNOSIS.louder
        # A contact with a larger object is nearer to its middle, relative to its surface.
        T = estimate.T_palm_object
        middle = se3.apply(T, self.tracker.model.center_object[None])[0]
        J[:, :3, self._at["size"]] = (middle - contacts.points_palm)[:, :, None]
        J[:, :3, self._at["compliance"]] = (loads[:, 3:4] * contacts.normals_palm)[:, :, None]
        self._instants.append(Instant(touch.fingers, contacts, alone, J, T))

    def _with_gain(self, observation: Observation, axis: int) -> Observation:
        """Returns an observation whose sensors read too much along one of their six axes, by `DIAGNOSIS.louder`."""
        wrenches = {}
        for name, wrench in observation.wrenches.items():
            wrenches[name] = louder = np.array(wrench, dtype=float)
            if (finger := self.tracker.rig.fingers.get(name)) is not None:
                known = finger.calibration
                bias = np.concatenate([known.bias_force, known.bias_torque])
                louder[axis] += DIAGNOSIS.louder * (louder - bias)[axis]
        return replace(observation, wrenches=wrenches)

    def diagnosis(self) -> Diagnosis:
        """Returns the diagnosis of all that was watched."""
        errors, H = self._solve()
        parts = [self._at[kind] for kind in ("joint", "place", "radius", "size")]
        far = max(np.abs(errors / self._sigmas)[part].max() for part in parts) > DIAGNOSIS.max_errors
        rows = [] if far else self._rows()
        others = [*self._vision_values(), *self._other_values()]
        # Bonferroni: that any of n right values is called wrong has at most the stated probability.
        level = DIAGNOSIS.level / max(len(rows) + len(others), 1)
        judged = [replace(v, wrong=chi2_survival(v.chi2, v.freedom) < level) for v in others]
        values = *self._judged(rows, errors, H, level), *judged
        return Diagnosis(values, len(self._instants), UNLIKE if far else "")

    def _rows(self) -> list[tuple[str, str, float, list[int]]]:
        """Returns the table's rows: name, unit, declared value [SI], and of which common values each is the mean."""
        fingers, model, at = self.tracker.rig.fingers, self.tracker.model, self._at
        k = {kind: iter(range(part.start, part.stop)) for kind, part in at.items()}
        rows = [(f"joint {joint}", "°", 0.0, [next(k["joint"])]) for joint in self._offsets.joints]
        for name, finger in fingers.items():
            rows += [(f"tip {name} shift {axis}", "mm", 0.0, [next(k["place"])]) for axis in "xy"]
            radius = float(np.mean(finger.tip.semi_axes))
            rows.append((f"tip {name} radius", "mm", radius, [next(k["radius"])]))
            rows.append((f"sensor {name} gain", "%", 1.0, [next(k["gain"]) for _ in range(6)]))
        rows.append(("object size", "%", 1.0, [next(k["size"])]))
        if model.mass is not None:
            rows.append(("object mass", "g", model.mass, [next(k["mass"])]))
        return rows

    def _judged(
        self, rows: list[tuple[str, str, float, list[int]]], errors: Array, H: Array, level: float
    ) -> list[Diagnosed]:
        """Returns the rows' values, of which those are wrong that are so for a test of this level.

        What is wrong makes everything that depends on it look wrong, too. So what is most unlikely is called wrong
        alone, and the rest is tested again with ten times its declared sigma (Baarda's data snooping, 1968).
        """
        wrong, sigmas = dict[int, float](), self._sigmas.copy()
        while True:
            S, values = np.linalg.inv(H), list[Diagnosed]()
            for k, (name, unit, declared, at) in enumerate(rows):
                prior = sigmas[at[0]] / math.sqrt(len(at))
                sigma = math.sqrt(S[np.ix_(at, at)].sum()) / len(at)
                value = diagnosed(name, unit, declared, float(prior), float(errors[at].mean()), sigma)
                if k in wrong:
                    before = value.sigma / DIAGNOSIS.max_errors
                    value = replace(value, sigma=before, chi2=wrong[k], wrong=True)
                values.append(value)
            k = max(range(len(rows)), key=lambda k: 0.0 if k in wrong else values[k].chi2, default=-1)
            if k < 0 or k in wrong or chi2_survival(values[k].chi2, 1) >= level:
                return values
            wrong[k], at, freed = values[k].chi2, rows[k][3], H.copy()
            freed[at, at] -= (1 - DIAGNOSIS.max_errors**-2) / sigmas[at] ** 2
            sigmas[at] *= DIAGNOSIS.max_errors
            errors, H = np.asarray(np.linalg.solve(freed, H @ errors)), freed

    def _is_new(self, fingers: tuple[str, ...], contacts: Contacts) -> bool:
        """Returns whether a finger touches elsewhere than in all kept instants with the same fingers."""
        least = np.cos(DIAGNOSIS.new_normal)
        for kept in (instant.contacts for instant in self._instants if instant.fingers == fingers):
            shift = np.linalg.norm(contacts.points_palm - kept.points_palm, axis=1).max()
            cosine = (contacts.normals_palm * kept.normals_palm).sum(axis=1).min()
            if shift < DIAGNOSIS.new_contact and cosine > least:
                return False
        return True

    def _solve(self, kept: Sequence[Instant] | None = None) -> tuple[Array, Array]:
        """Returns the errors (k,) that all grasps have in common, and their information (k, k), with the priors.

        A few instants that do not fit the others are left out: a tip may have touched something else, or at two places.
        """
        kept = self._instants if kept is None else kept
        errors, (by_loads, pulled) = np.zeros(len(self._sigmas)), self._load_equations()
        H = by_loads + np.diag(self._sigmas**-2)
        worst = 1.0, -1
        by_pose = np.diag(np.repeat([DIAGNOSIS.sigma_pose, DIAGNOSIS.sigma_turn], 3) ** -2.0)
        Ts, moved = [instant.T_palm_object for instant in kept], np.zeros((len(kept), 6))
        for _ in range(DIAGNOSIS.passes):
            H, parts, worst = by_loads + np.diag(self._sigmas**-2), list[Array](), (1.0, -1)
            slope = H @ errors + pulled
            for instant, T, motion in zip(kept, Ts, moved, strict=True):
                given = instant.with_errors(errors), instant.covariance, instant.by_value, T
                A, b = contact_equations(self.tracker.model, *given)
                A[:6, :6] += by_pose
                b[:6] += by_pose @ motion
                eliminated = np.linalg.solve(A[:6, :6], np.column_stack([A[:6, 6:], b[:6]]))
                own, pull = A[6:, 6:] - A[6:, :6] @ eliminated[:, :-1], b[6:] - A[6:, :6] @ eliminated[:, -1]
                # The values explain any error of a contact, so this is all that is left: 3 numbers each, less a pose.
                scaled = own * np.outer(self._sigmas, self._sigmas)
                left = (self._sigmas * pull) @ np.linalg.pinv(scaled, 1e-9, hermitian=True)
                left = left @ (self._sigmas * pull)
                limit = chi2_limit(max(3 * len(instant.fingers) - 6, 1), DIAGNOSIS.level / len(kept))
                worst = max(worst, (float(left) / limit, len(parts)))
                H, slope = H + own, slope + pull
                parts.append(np.asarray(eliminated))
            step = -np.linalg.solve(H, slope)
            errors = errors + step
            for k, eliminated in enumerate(parts):
                turned = -(eliminated[:, :-1] @ step + eliminated[:, -1])
                moved[k] += turned
                Ts[k] = se3.moved(Ts[k], turned)
        if worst[1] < 0 or len(kept) - 1 < (1 - DIAGNOSIS.unfit) * len(self._instants):
            return errors, H
        return self._solve([*kept[: worst[1]], *kept[worst[1] + 1 :]])

    def _load_equations(self) -> tuple[Array, Array]:
        """Returns what the loads of all grasps add to H (k, k) and to the slope (k,) where nothing is wrong."""
        H, slope = np.zeros((len(self._sigmas), len(self._sigmas))), np.zeros(len(self._sigmas))
        of = np.array([len(H) - 1, *range(self._at["gain"].stop)])
        scale, gains = np.append(1.0, self._sigmas[of[1:]]).astype(float), self._sigmas[self._at["gain"]]
        rig, mass = self.tracker.rig, self.tracker.model.mass
        joints = np.diag(self._sigmas[self._at["joint"]])
        for instants, start in self._grasps:
            # A tip that is elsewhere has another arm: its torque is off by about as much in all directions of gravity.
            forces = np.linalg.norm(instants[-1].load.forces, axis=1).tolist()
            biases = [
                [f.sigma_force] * 3 + [math.hypot(f.sigma_torque, f.sigma_point * force)] * 3
                for f, force in zip(rig.fingers.values(), forces, strict=True)
            ]
            gravity = rig.gravity, WEIGHER.sigma_gravity
            unknowns = Unknowns(joints, np.concatenate(biases), WEIGHER.creep, *gravity, gains)
            wide = replace(unknowns, gains=np.full_like(gains, DIAGNOSIS.wide_gain))
            if (found := weigh(instants, wide, start)).consistent:
                mass = found.mass if mass is None else mass
                own, pull = common_equations(instants, unknowns, found)
                H[np.ix_(of, of)] += own / np.outer(scale, scale)
                slope[of] += (pull + own[0] * (mass - found.mass)) / scale
        return H, slope

    def _vision_values(self) -> Iterator[Diagnosed]:
        """Yields what the palm's motion tells of the camera's constant error, at the object, along its mount's axes."""
        camera = self.tracker.vision.camera
        if self._bias is None:
            return
        bias, covariance = self._bias
        sigmas = np.repeat([camera.sigma_position_constant, camera.sigma_rotation_constant], 3)
        names = [f"camera {what} {axis}" for what in ("shift", "turn") for axis in "xyz"]
        for i, name in enumerate(names):
            unit, found = "mm" if i < 3 else "°", math.sqrt(covariance[i, i])
            yield diagnosed(name, unit, 0.0, float(sigmas[i]), float(bias[i]), found)
        if (latency := self.tracker.vision_latency()) is not None and camera.sigma_latency > 0:
            off = latency[0] - camera.latency
            yield diagnosed("camera latency", "ms", camera.latency, camera.sigma_latency, off, latency[1])

    def _other_values(self) -> Iterator[Diagnosed]:
        """Yields what the table, slips, and sensors in the air tell."""
        rig, model, table = self.tracker.rig, self.tracker.model, self._table
        if rig.table is not None and table is not None:
            off = table.height - rig.table.height
            height, tilt = rig.table.sigma_height, rig.table.sigma_tilt
            yield diagnosed("table height", "mm", rig.table.height, height, off, table.sigma_height)
            value = diagnosed("table tilt", "°", 0.0, tilt, table.tilt, table.sigma_tilt)
            # The sigma is the larger one of two axes: where it is no smaller than declared, χ² of both is not known.
            yield replace(value, chi2=value.chi2 if value.measured else 0.0, freedom=2)
        weigher, slip = self.tracker.track_state.weight.weigher, self.tracker.slip
        if model.friction is not None and slip.friction is not None:
            off, sigma = slip.friction - model.friction, slip.sigma_friction or math.inf
            yield diagnosed("friction", "", model.friction, model.sigma_friction, off, sigma)
        for row, (name, finger) in zip(weigher.tare, rig.fingers.items(), strict=False):
            if row.any():  # a mean of ten readings or so, in which what is declared is not a prior
                force, sigma = float(np.linalg.norm(row[:3])), finger.sigma_force
                information = sigma**-2 + (sigma / 3) ** -2
                error = force / (sigma / 3) ** 2 / information
                value = diagnosed(f"sensor {name} bias", "N", 0.0, sigma, error, information**-0.5)
                yield replace(value, freedom=3)
