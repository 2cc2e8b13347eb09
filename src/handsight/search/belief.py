"""The posterior of a search by touch: particles, drawn anew after each touch and weighted by all touches so far."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction.modes import distinct, pose_distances
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.rig import Table
from handsight.search.area import Area, Touch, tip_center

DRAWN = 8192  # placements that are drawn after a touch
KEPT = 1024  # particles that are resampled from them
MAX_LOG_RATIO = 30.0  # a placement so much less likely than the best is dropped at once
METROPOLIS_STEPS = 8
STEP = (0.004, 0.004, float(np.deg2rad(4.0)))
"""Largest standard deviation of a Metropolis step: x, y [m] and yaw [rad]."""
MAX_MODES = 8
CONTACT_DRAWS = 2048  # placements that decide whether a contact can be one with the object
MIN_INSIDE = 8  # so many of them must be within the area
TIP_POSITIONS = 20_000  # random tip positions about each stable pose; those that touch it are used
SHELL = 0.003  # a tip within this distance of touching the surface counts as touching [m]
WIDENING = 1.5  # factor on a contact's sigmas for placements about it: a proposal needs wide tails


PUSH = 0.0005
"""How far each touch pushes the object, one standard deviation per axis, which displaces older contacts [m]."""
FREEDOM = 5.0  # of Student's t: errors of contacts at an edge are larger than their covariance
OTHER_SHARE = 0.02  # of contacts that are with something else, such as the table or a cable
OTHER_RANGE = 0.3  # over which the distance of such a contact from the object is uniform [m]
MIN_SIGMA_YAW = float(np.deg2rad(0.1))  # least standard deviation of the yaw [rad]


CERTAIN_PROBABILITY = 0.95  # least probability of an error of position and rotation within both limits
CERTAIN_POSITION = 0.008  # of the object's middle [m]
CERTAIN_ROTATION = float(np.deg2rad(8.0))  # modulo the symmetries of the model [rad]


MAX_SEED = 2**32


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """Particles within 15 mm and 20° of each other, modulo symmetry, as one Gaussian."""

    pose_world_object: GaussianPose  # mean and covariance, with the errors of the table's height and tilt
    probability: float  # the mode's share of all particles
    certainty: float  # probability that the object is within 8 mm and 8° of its pose: the share of particles
    sigma_position: float  # standard deviation of the object's middle in the table's plane [m]

    @property
    def is_certain(self) -> bool:
        """Whether the mode is so likely and so narrow that the object can be grasped there."""
        return self.certainty > CERTAIN_PROBABILITY


@dataclass(frozen=True, eq=False)
class Belief:
    """The posterior of the object's pose given all touches so far, as equally likely particles."""

    model: ObjectModel
    area: Area
    seed: int = 0
    """Seed of all random draws: the same touches give the same belief."""
    touches: tuple[Touch, ...] = ()
    placements: Array = field(init=False)
    """(n, 4) the particles: x, y [m], yaw [rad] and the index of the stable pose, see `Area`."""

    def __post_init__(self) -> None:
        """Draws the particles; raises InvalidInput."""
        if not isinstance(self.model, ObjectModel) or not isinstance(self.area, Area):
            came = f"{type(self.model).__name__} and {type(self.area).__name__}"
            raise InvalidInput(f"belief: expected an ObjectModel and an Area, got {came}")
        checks.integer(self.seed, "belief.seed", MAX_SEED)
        rng = np.random.default_rng((self.seed, len(self.touches)))
        placements, log_weights = self._draw(rng)
        probabilities = np.exp(log_weights - log_weights.max())
        chosen = rng.choice(len(placements), KEPT, p=probabilities / probabilities.sum())
        particles = placements[chosen]
        if self.touches:  # Metropolis steps separate copies of one that was resampled often
            log_posterior = self._log_posterior(particles)
            for _ in range(METROPOLIS_STEPS):
                size = np.array(STEP) * rng.uniform(size=(len(particles), 1)) ** 2
                proposed = particles.copy()
                proposed[:, :3] += size * rng.normal(size=(len(particles), 3))
                proposed_log = self._log_posterior(proposed)
                accepted = np.log(rng.uniform(size=len(particles))) < proposed_log - log_posterior
                particles = np.where(accepted[:, None], proposed, particles)
                log_posterior = np.where(accepted, proposed_log, log_posterior)
        object.__setattr__(self, "placements", particles)

    def after(self, touch: Touch) -> "Belief":
        """Returns the belief after one more touch; raises InvalidInput.

        A contact that no placement of the object in its area explains is with something else, and is left out.
        """
        if not isinstance(touch, Touch):
            raise InvalidInput(f"touch: expected a Touch, got {type(touch).__name__}")
        contact = touch.contact_world
        rng = np.random.default_rng(self.seed)
        if contact is not None:
            n = CONTACT_DRAWS
            about = placements_about(self.model, self.area, contact, touch.radius, n, rng)
            if self.area.contains(about).sum() < MIN_INSIDE:
                touch = replace(touch, contact_world=None)
        return replace(self, touches=(*self.touches, touch))

    @cached_property
    def Ts_world_object(self) -> Array:
        """(n, 4, 4) the poses of the particles."""
        return self.area.poses(self.model, self.placements)

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The modes of the posterior, the likeliest first."""
        model, Ts = self.model, self.Ts_world_object
        order = np.argsort(-self._log_posterior(self.placements), kind="stable")
        chosen = distinct(model, Ts, order, MAX_MODES)
        distances = []
        for i in chosen:
            shift, turn = pose_distances(model, Ts, Ts[i])
            distances.append(np.hypot(shift, model.radius * turn))
        mode_of = np.argmin(np.array(distances), axis=0)
        modes = [self._mode(Ts[i], Ts[mode_of == k]) for k, i in enumerate(chosen)]
        return tuple(sorted(modes, key=lambda mode: -mode.probability))

    @property
    def pose(self) -> GaussianPose:
        """The object's pose in the world by the likeliest mode."""
        return self.modes[0].pose_world_object

    def _draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Returns random placements (m, 4) and the logarithms (m,) of their importance weights.

        Before the first contact they are drawn from the area, later from a proposal density q_a about each contact a. A
        placement drawn from any of these has the weight p / Σ q_a (the balance heuristic, Veach and Guibas 1995).
        """
        model, area = self.model, self.area
        contacts = [(t.contact_world, t.radius) for t in self.touches if t.contact_world is not None]
        if not contacts:
            placements = area.draw(DRAWN, rng)
            return placements, free_log_likelihood(model, self.touches, area.poses(model, placements))
        n = DRAWN // len(contacts)
        drawn = [placements_about(model, area, contact, radius, n, rng) for contact, radius in contacts]
        placements = np.vstack(drawn)
        Ts = area.poses(model, placements)
        by_contact = contact_log_likelihoods(model, self.touches, area.table, Ts)
        log_weight = by_contact.sum(axis=1) - np.logaddexp.reduce(by_contact, axis=1)
        log_weight[~area.contains(placements)] = -np.inf
        likely = log_weight > log_weight.max() - MAX_LOG_RATIO
        placements, log_weight = placements[likely], log_weight[likely]
        return placements, log_weight + free_log_likelihood(model, self.touches, Ts[likely])

    def _log_posterior(self, placements: Array) -> Array:
        """Returns (n,) the log posterior density at placements (n, 4), up to a constant."""
        Ts = self.area.poses(self.model, placements)
        log_likelihood = contact_log_likelihoods(self.model, self.touches, self.area.table, Ts).sum(axis=1)
        log_likelihood += free_log_likelihood(self.model, self.touches, Ts)
        return np.where(self.area.contains(placements), log_likelihood, -np.inf)

    def _mode(self, T: Array, Ts: Array) -> Mode:
        """Returns the mode of particles with poses `Ts` (n, 4, 4), linearised at `T` (4, 4), one of these."""
        model = self.model
        table = self.area.table
        equivalent = nearest(model.symmetries, Ts, T, model.radius)
        center = model.center_object[None]
        shifts = se3.apply(equivalent, center)[:, 0] - se3.apply(T, center)
        offsets = np.hstack([shifts, se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)])
        mean = offsets.mean(axis=0)
        R = se3.rotation_exp(mean[3:]) @ T[:3, :3]
        middle = se3.apply(T, center)[0] + mean[:3]
        sigmas = [0.0, 0.0, table.sigma_height, table.sigma_tilt, table.sigma_tilt, MIN_SIGMA_YAW]
        covariance = (offsets - mean).T @ (offsets - mean) / len(offsets) + np.diag(np.square(sigmas))
        at_center = GaussianPose(se3.compose(R, middle), covariance)
        # The table's errors are independent of the touches.
        off2 = ((offsets - mean) ** 2).reshape(-1, 2, 3).sum(axis=2)
        off2 += [table.sigma_height**2, 2 * table.sigma_tilt**2]
        near = (off2 < np.square([CERTAIN_POSITION, CERTAIN_ROTATION])).all(axis=1)
        n = len(self.placements)
        return Mode(
            pose_world_object=at_center.at_point(-model.center_object),
            probability=len(Ts) / n,
            certainty=float(near.sum()) / n,
            sigma_position=float(np.hypot(*np.sqrt(np.diag(covariance)[:2]))),
        )


def placements_about(
    model: ObjectModel, area: Area, contact_world: Contacts, radius: float, n: int, rng: np.random.Generator
) -> Array:
    """Returns `n` random placements (n, 4) with a contact on the object's surface, at a yaw that fits its normal.

    A placement at a given yaw is the tip's position less its position relative to the object. So placements are uniform
    along the object's outline if the relative positions of the tip are. `radius` is the tip's [m]. The result is empty,
    (0, 4), where the object is not as high as the contact in any stable pose.
    """
    covariance = contact_world.covariance[0]
    on_table = contact_world.moved(se3.compose(area.R_world_table.T, np.zeros(3)))  # along the table's axes
    normal = on_table.normals_palm[0]
    middle = tip_center(on_table, radius)
    # Random positions relative to the object's middle, at yaw 0 and the contact's height, at which a tip touches it.
    Rs = area.Rs_world_object
    reach = model.radius + radius
    arms = rng.uniform(-reach, reach, (len(Rs), TIP_POSITIONS, 3))
    arms[:, :, 2] = float(middle[2]) - area.center_heights(model)[:, None]
    arms[:, :, 2] += area.table.sigma_height * rng.normal(size=arms.shape[:2])
    values = model.evaluate((arms @ Rs).reshape(-1, 3) + model.center_object)  # Rᵀ arm
    touching = np.abs(values.distance - radius) < SHELL
    stable = np.repeat(np.arange(len(Rs), dtype=np.int64), TIP_POSITIONS)[touching]
    outward = np.einsum("nij,nj->ni", Rs[stable], values.gradient[touching])
    arms = arms.reshape(-1, 3)[touching]
    if not len(arms):
        return np.empty((0, 4))
    chosen = rng.integers(len(arms), size=n)
    arm, out = arms[chosen], outward[chosen]
    # A normal that is nearly vertical hardly determines the yaw.
    lateral = max(float(np.hypot(*normal[:2])), 1e-3)
    spread = WIDENING * np.sqrt(np.trace(covariance[3:, 3:]) / 2) / lateral
    yaw = np.arctan2(normal[1], normal[0]) - np.arctan2(out[:, 1], out[:, 0]) + spread * rng.normal(size=n)
    c, s = np.cos(yaw), np.sin(yaw)
    shift = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    noise = WIDENING * np.sqrt(np.trace(covariance[:3, :3]) / 3) * rng.normal(size=(n, 2))
    yaw = np.mod(yaw + np.pi, 2 * np.pi) - np.pi
    return np.column_stack([middle[:2] + noise - shift, yaw, stable[chosen]])


def contact_log_likelihoods(
    model: ObjectModel, touches: Sequence[Touch], table: Table, Ts_world_object: Array
) -> Array:
    """Returns (n, k) the log likelihood at each pose (n, 4, 4) of each of the k contacts among the touches.

    It is that of the contact's distance to the surface and of its normal, by Student's t, or, with a small probability,
    of a contact with something else. The errors of the table's height and tilt are marginalised.
    """
    met = [(k, touch.contact_world, touch.radius) for k, touch in enumerate(reversed(touches))]
    contacts = [(later, contact, radius) for later, contact, radius in reversed(met) if contact]
    R = Ts_world_object[:, :3, :3]
    freedom = FREEDOM
    constant = math.lgamma((freedom + 3) / 2) - math.lgamma(freedom / 2) - 1.5 * math.log(freedom * math.pi)
    middle = se3.apply(Ts_world_object, model.center_object[None])[:, 0]
    log_likelihoods = np.empty((len(Ts_world_object), len(contacts)))
    for k, (later, contact, radius) in enumerate(contacts):
        normal, covariance = contact.normals_palm[0], contact.covariance[0]
        point = tip_center(contact, radius)
        values = model.evaluate(np.einsum("nji,nj->ni", R, point - Ts_world_object[:, :3, 3]))
        n = np.einsum("nij,nj->ni", R, values.gradient)
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
        lever = np.cross(point - middle, n)
        of_point = np.trace(covariance[:3, :3]) / 3 + later * PUSH**2 + model.sigma_point**2
        of_distance = of_point + (table.sigma_height * n[:, 2]) ** 2
        of_distance += table.sigma_tilt**2 * (lever[:, :2] ** 2).sum(axis=1)
        curvature2 = (values.hessian**2).sum(axis=(1, 2)) / 2
        of_normal = np.trace(covariance[3:, 3:]) / 2 + model.sigma_normal**2 + table.sigma_tilt**2
        of_normal = of_normal + curvature2 * of_point
        angle = 2 * np.arcsin(np.clip(np.linalg.norm(n - normal, axis=1) / 2, 0, 1))
        chi2 = (values.distance - radius) ** 2 / of_distance + angle**2 / of_normal
        log_likelihoods[:, k] = constant - (freedom + 3) / 2 * np.log1p(chi2 / freedom)
        log_likelihoods[:, k] -= np.log(of_distance) / 2 + np.log(of_normal)
    # A contact with something else is at any distance, and its normal in any direction.
    other = np.log(OTHER_SHARE / (OTHER_RANGE * 4 * np.pi))
    return np.logaddexp(log_likelihoods, other)


def free_log_likelihood(model: ObjectModel, touches: Sequence[Touch], Ts_world_object: Array) -> Array:
    """Returns (n,) the log likelihood at each pose (n, 4, 4) of the free parts of all sweeps, where tips met nothing.
    All positions of a sweep have one error in common, so each sweep counts once, by its deepest penetration."""
    log_likelihood = np.zeros(len(Ts_world_object))
    if not model.closed:
        return log_likelihood
    Ts_object_world = se3.inverse(Ts_world_object)
    for i, touch in enumerate(touches):
        if not len(touch.free_world):
            continue
        points = se3.apply(Ts_object_world, touch.free_world)
        distance = model.evaluate(points.reshape(-1, 3)).distance.reshape(points.shape[:2])
        depth = np.maximum(touch.radius - distance.min(axis=1), 0.0)
        variance = touch.sigma**2 + (len(touches) - 1 - i) * PUSH**2
        log_likelihood -= depth**2 / (2 * variance)
    return log_likelihood
