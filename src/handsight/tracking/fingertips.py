"""Contacts in the palm, with their complete covariance, from joint positions and raw wrenches."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import REASON_NAMES, Contacts
from handsight.contact.kernels import contacts_to_palm as kernels
from handsight.contact.kernels.sensing_records import FINGER, PALM_CONTACT
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.observation import ContactMeasurement, Observation
from handsight.rig import Finger, Rig
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.skin import NOTHING, SkinContacts

REASONS = (*("silent" if name == "invalid" else name for name in REASON_NAMES), "on the table")
"""Why a finger has no contact, by the kernel's number; number 0 is a contact."""
CONFLICT = 21.1
"""χ² of the distance of a tip's patch and its wrench's contact, of level 1e-4 for three numbers, above which they
contradict each other."""
FREE = REASON_NAMES.index("free")
ON_TABLE = len(REASONS) - 1
NO_READING = REASONS.index("silent")


@dataclass(frozen=True, slots=True, eq=False)
class FingertipContacts:
    """What the fingertips measure at one instant."""

    fingers: tuple[str, ...]
    """The n fingers that touch, in the contacts' order."""
    contacts: Contacts | None
    """In the palm frame; None where no finger touches. Their covariance holds the sensor's noise, the finger's sigmas
    and the joints' errors through the hand's Jacobian."""
    reasons: Mapping[str, str]
    """Why each of the other fingers has no contact: no joint positions, silent (no reading), on the table, or the
    `Reason` that its wrench gives."""
    by_error: Array | None = None
    """(n, 6, j) the change of each contact's point and normal for one standard deviation of each of j independent
    errors of the joints (`JointOffsets.root`)."""
    loads: Array | None = None
    """(n, 5) load of the object on each tip: tangential force (3,) along the palm's axes and normal force [N], torque
    about the normal [N m]; NaN where a tip does not measure it."""
    doubts: Mapping[str, str] = field(default_factory=dict)
    """By finger, how far its taxels and its wrench are from each other where they contradict each other."""
    by_taxels: tuple[str, ...] = ()
    """Fingers whose loads, if any, are their taxels', as they have no wrench."""
    records: NDArray[np.void] | None = None
    """PALM_CONTACT of each of the rig's fingers; None where no finger touches."""

    def rejected_by(self, estimate: PoseEstimate) -> tuple[str, ...]:
        """Returns the fingers whose contacts are outliers of an estimate."""
        return tuple(self.fingers[i] for i in estimate.outliers if i < len(self.fingers))


class FingertipSensors:
    """Reads a rig's fingertips with their force/torque sensors."""

    def __init__(self, rig: Rig) -> None:
        """The rig's hand must have a tip for every finger."""
        self.rig = rig
        self.names = tuple(rig.fingers)
        self._tips = np.array([list(rig.hand.tips).index(name) for name in self.names])
        self._fingers = np.array([finger_record(finger) for finger in rig.fingers.values()], dtype=FINGER)
        self._offsets = JointOffsets.of(rig)

    def contacts(
        self, observation: Observation, offsets: JointOffsets | None = None, skin: SkinContacts = NOTHING
    ) -> FingertipContacts:
        """Returns what the fingertips measure; there is no contact where joint positions are missing.

        `offsets`: the estimated constant errors of the joints; None: zero, with the rig's sigma. Without T_world_palm
        the direction of gravity and the table's pose are unknown: the tips' weight (some 40 mN) stays in the readings,
        and a finger that touches the table seems to touch the object. `skin`: what the taxels measure; those on a tip
        say where it touches, and its wrench how much. The observation is one that `check_observation` has returned.
        Raises InvalidInput for wrong joints, wrenches or contacts.
        """
        readings = self._readings(observation.wrenches)
        # A contact that a tip has sensed directly replaces the one of its wrench.
        readings[[name in observation.contacts for name in self.names]] = np.nan
        if observation.joint_positions is None:
            return FingertipContacts((), None, dict.fromkeys(self.names, "no joint positions"))
        offsets = self._offsets if offsets is None else offsets
        chains = self.rig.hand.chains
        Ts_palm_tip, axes = chains.poses(observation.joint_positions, offsets.mean)
        Ts_palm_tip = Ts_palm_tip.take(self._tips, axis=0)
        # Any angle of a hinge is valid, but not a slide so far off that its tip is far from the palm.
        places = Ts_palm_tip[:, :3, 3].copy()
        checks.position(places, "observation.joint_positions: fingertips in the palm", (None, 3))
        by_error = chains.jacobians(places, self._tips, axes, offsets.root)
        T = observation.T_world_palm
        gravity_palm = np.zeros(3) if T is None else self.rig.gravity.dot(T[:3, :3])
        records = np.empty(len(self.names), dtype=PALM_CONTACT)
        by_tip = by_error.copy()
        kernels.contacts_to_palm(self._fingers, readings, Ts_palm_tip, by_error, gravity_palm, records)
        put_sensed(self.rig, observation.contacts, Ts_palm_tip, by_error, records)
        links = {touch.surface.frame for touch, _ in skin.touches.values()}
        for record, finger in zip(records, self.rig.fingers.values(), strict=True):
            if record["reason"] == NO_READING and finger.frame in links:  # by taxels of which none is touched
                record["reason"] = FREE
        doubts = self._put_taxels(skin, Ts_palm_tip, by_tip, by_error, records) if skin.tips else {}
        table = self.rig.table
        if T is not None and table is not None:
            known = np.array([table.height, table.sigma_height, table.sigma_tilt], dtype=float)
            kernels.mark_on_table(np.array(T), known, ON_TABLE, records)
        numbers = zip(self.names, records["reason"].tolist(), strict=True)
        reasons = {name: REASONS[k] for name, k in numbers if k}
        fingers = tuple(name for name in self.names if name not in reasons)
        if not fingers:
            return FingertipContacts((), None, reasons)
        n = len(fingers)
        j = by_error.shape[2]
        points = np.empty((n, 3))
        normals = np.empty((n, 3))
        covariance = np.empty((n, 6, 6))
        loads = np.empty((n, 5))
        moved = np.empty((n, 6, j))
        kernels.gather_contacts(records, by_error, points, normals, covariance, loads, moved)
        contacts = Contacts.trusted(points, normals, covariance)
        by_taxels = tuple(name for name in skin.tips if name not in observation.wrenches)
        return FingertipContacts(fingers, contacts, reasons, moved, loads, doubts, by_taxels, records)

    def _put_taxels(
        self,
        skin: SkinContacts,
        Ts_palm_tip: Array,
        by_tip: Array,
        by_error: Array,
        records: NDArray[np.void],
    ) -> dict[str, str]:
        """Writes the patches of taxels to their fingers' rows, and returns the doubts.

        The joints' errors are common to patch and wrench, so they hardly count in their distance. Where they contradict
        each other, the contact is as uncertain as they are far from each other.
        """
        fingers = list(skin.tips)
        i = np.array([self.names.index(finger) for finger in skin.tips])
        wrench = records[i]
        J_wrench = by_error[i, :3]
        by_error[i] = by_tip[i]
        kernels.put_patches(i, skin.patches(), self._fingers, Ts_palm_tip, by_error, records)
        if not (both := wrench["reason"] == 0).any():
            return {}
        away = np.where(both[:, None], wrench["point"] - records["point"][i], 0.0)
        common = J_wrench @ by_error[i, :3].swapaxes(1, 2)
        S = wrench["covariance"][:, :3, :3] + records["covariance"][i, :3, :3]
        S = S - common - common.swapaxes(1, 2)
        S[~both] = np.eye(3)
        wrong = both & ((away * np.linalg.solve(S, away[:, :, None])[:, :, 0]).sum(axis=1) > CONFLICT)
        for k in np.flatnonzero(wrong):
            records["covariance"][i[k], :3, :3] += np.outer(away[k], away[k])
        distance = 1e3 * np.linalg.norm(away, axis=1)
        named = "its taxels and its wrench are {:.1f} mm from each other"
        return {fingers[k]: named.format(distance[k]) for k in np.flatnonzero(wrong)}

    def _readings(self, wrenches: Mapping[str, Array]) -> Array:
        """Returns (n, 6) the fingers' wrenches, NaN where a sensor has no reading; raises InvalidInput."""
        readings = np.full((len(self.names), 6), np.nan)
        for row, name in zip(readings, self.names, strict=True):
            if name in wrenches:
                row[:] = _reading(wrenches[name], f"observation.wrenches[{name!r}]")
        return readings


def _reading(wrench: ArrayLike, name: str) -> Array:
    """Returns a wrench (6,), all NaN if any of its numbers is; raises InvalidInput."""
    try:
        array = np.asarray(wrench)
    except ValueError:  # ragged
        array = np.zeros(0)
    silent = array.shape == (6,) and array.dtype.kind == "f" and np.isnan(array).any()
    return np.full(6, np.nan) if silent else checks.load(wrench, name, (6,))


def finger_record(finger: Finger) -> tuple[object, ...]:
    """Returns the fields of the kernel's FINGER."""
    T, known = finger.T_frame_surface, finger.calibration
    sign = 1.0 if known.reading == "on_sensor" else -1.0
    bias = np.concatenate([known.bias_force, known.bias_torque])
    sigmas = np.repeat([finger.sigma_force, finger.sigma_torque], 3)
    sensor = sign, bias, known.mass, known.center_of_mass, sigmas, finger.sigma_gain
    tip = tuple(finger.tip.record[0])
    return tip, T[:3, :3], T[:3, 3], *sensor, finger.sigma_point**2, finger.sigma_normal**2


def put_sensed(
    rig: Rig,
    contacts: Mapping[str, ContactMeasurement | None],
    Ts_palm_tip: Array,
    by_error: Array,
    records: NDArray[np.void],
) -> None:
    """Writes contacts that fingertips have sensed directly into their fingers' rows of `records` and `by_error`.

    `records` (n) are PALM_CONTACT; these, `Ts_palm_tip` (n, 4, 4) and `by_error` (n, 6, j) are those of
    `contacts_to_palm`, in the order of the rig's fingers. Raises InvalidInput.
    """
    for i, (name, finger) in enumerate(rig.fingers.items()):
        if name not in contacts:
            continue
        contact = contacts[name]
        argument = f"observation.contacts[{name!r}]"
        if not isinstance(contact, ContactMeasurement | None):
            came = type(contact).__name__
            raise InvalidInput(f"{argument}: expected a ContactMeasurement or None, got {came}")
        if contact is None or (contact.force is not None and contact.force < finger.tip.min_force):
            records[i]["reason"] = FREE
            continue
        T_palm_tip = Ts_palm_tip[i]
        T_palm_surface = T_palm_tip @ finger.T_frame_surface
        palm = np.eye(4)
        frames = {"tip": T_palm_surface, "palm": palm, rig.hand.palm: palm, finger.frame: T_palm_tip}
        if contact.frame not in frames:
            known = ", ".join(frames)
            came = checks.brief(repr(contact.frame))
            raise InvalidInput(f"{argument}.frame: expected one of {known}, got {came}")
        T = frames[contact.frame]
        point = T[:3, :3] @ contact.point + T[:3, 3]
        normal = T[:3, :3] @ contact.normal
        if (point - T_palm_surface[:3, 3]) @ normal > 0:
            normal = -normal  # some sensors report the direction in which the tip pushes
        J = by_error[i]
        # From the effect of the joints' errors on the tip's frame to that on the contact's point and normal.
        J[:3] = (se3.point_jacobian(point - T_palm_tip[:3, 3]) @ J)[:3]
        J[3:] = -se3.skew(normal) @ J[3:]
        if contact.covariance is None:
            C = np.diag(np.repeat([finger.sigma_point**2, finger.sigma_normal**2], 3))
        else:
            C = se3.rotate_covariance(T[:3, :3], contact.covariance)
        tangent = np.eye(6)
        tangent[3:, 3:] -= np.outer(normal, normal)
        row = records[i]
        row["reason"] = 0
        row["point"] = point
        row["normal"] = normal
        row["load"] = np.nan
        row["covariance"] = tangent @ (C + J @ J.T) @ tangent
