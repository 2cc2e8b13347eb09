"""Forty three-finger grasps of ten YCB objects, simulated by another laboratory: where is the object?

Caddeo et al., "Collision-aware In-hand 6D Object Pose Estimation using Multiple Vision-based Tactile Sensors"
(ICRA 2023) press three tactile fingertips on an object in simulation and report a position error of about 2 cm,
with 87.5 % of the contacts consistent. They also use the tactile images, which we do not have: handsight gets
three points and three normals, and works blind or from a vision pose whose error we draw (1, 3 and 5 cm in a
random direction, with 5, 10 and 15 degrees about a random axis; the prior's sigmas say just that).

All forty have one and the same true pose, so each problem is first moved by a random rigid motion: nothing that
starts at a fixed pose can profit.

  position   distance [cm] of the origin of the object's frame (the middle of its bounding box, about) from the
             truth, as those authors measure it
  ADI        mean distance [mm] from the object's points at the answer to the object's surface at the truth
  AUC        area under the share of ADIs below a threshold, from 0 to 2 cm [%]
  covered    share of problems in which the truth, modulo symmetry, is inside the 95 % region of some mode

Each is given for the mode with the most weight and for the closest of the first five distinct modes: three
contacts often fit several places of an object equally well, and the answer says which.
"""

import numpy as np
from scipy.special import chdtri

import handsight as hs
import report
import scenes
import ycb
from handsight import se3

POINT_QUANTILES, NORMAL_QUANTILES = (0.29e-3, 1.0e-3), np.deg2rad([4.9, 30.7])
"""What the data's description says of the contacts: distance to the true surface [m] and angle to its normal
[rad], median and 90 % quantile."""
LEVELS = {
    "blind": None,
    "1 cm, 5°": (0.01, np.deg2rad(5)),
    "3 cm, 10°": (0.03, np.deg2rad(10)),
    "5 cm, 15°": (0.05, np.deg2rad(15)),
}
"""Length of vision's shift [m] and of its turn [rad]."""
MODES, AUC_LIMIT = 5, 0.02


def contact_sigmas():
    """Standard deviations per axis of point [m] and normal [rad]: for both what the 90 % quantile asks for.

    A distance along the normal is one Gaussian, an angle the length of two (Rayleigh). The errors are far from
    Gaussian: the medians ask for 0.43 mm and 4.2°, but the large angles, at edges, are the ones that mislead.
    """
    return POINT_QUANTILES[1] / 1.645, float(NORMAL_QUANTILES[1]) / np.sqrt(-2 * np.log(0.1))


def vision_prior(T_palm_object, level, rng):
    """The true pose, wrong by exactly that shift and turn, with sigmas per axis that say so."""
    shift, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    T = se3.moved(T_palm_object, np.concatenate([level[0] * shift, level[1] * turn]))
    return hs.PosePrior.from_sigmas(T, level[0] / np.sqrt(3), level[1] / np.sqrt(3))


def covered(model, mode, T_palm_object):
    """Whether a mode's 95 % region holds the truth, modulo symmetry."""
    truth = scenes.nearest_truth(model, T_palm_object, mode.T_palm_object)
    delta = se3.difference(truth, mode.T_palm_object)
    metres = np.repeat([1.0, 1 / model.radius], 3)
    rank = np.linalg.matrix_rank(mode.information * metres[:, None] * metres, hermitian=True)
    return bool(delta @ mode.information @ delta <= chdtri(rank, 0.05))


def solve(folder, seed, problem, k, draw):
    """One row per level: how far the answers to one moved problem are from its truth."""
    name, number, points, normals = problem
    thing, rows = ycb.load(folder, name), []
    for i, (label, level) in enumerate(LEVELS.items()):
        rng = np.random.default_rng([seed, k, draw, i])
        T_palm_world = se3.random(rng, spread=0.1)
        sigma_point, sigma_normal = contact_sigmas()
        contacts = hs.Contacts(points, normals, sigma_point, sigma_normal).moved(T_palm_world)
        T_true = T_palm_world @ ycb.TRIPLET_TRUTH
        vision = None if level is None else vision_prior(T_true, level, rng)
        estimate, seconds = report.timed(lambda c=contacts, v=vision: hs.correct_pose(thing.model, c, vision=v))
        start = {} if vision is None else errors(thing, [vision.T_palm_object], T_true, "vision_")
        modes = [mode.T_palm_object for mode in estimate.hypotheses[:MODES]]
        rows.append(
            {
                "object": name,
                "triplet": number,
                "vision": label,
                "draw": draw,
                **start,
                **errors(thing, modes[:1], T_true, ""),
                **errors(thing, modes, T_true, "five_"),
                "covered": int(any(covered(thing.model, mode, T_true) for mode in estimate.hypotheses)),
                "consistent": int(estimate.consistent),
                "converged": int(estimate.converged),
                "modes": len(estimate.hypotheses),
                "weight": estimate.hypotheses[0].weight,
                "seconds": seconds,
            }
        )
    return rows


def errors(thing, Ts, T_true, prefix):
    """The least position error [cm] and the least ADI [mm] of some poses."""
    position = min(np.linalg.norm(T[:3, 3] - T_true[:3, 3]) for T in Ts)
    adi = min(thing.closest_point_error(T, T_true) for T in Ts)
    return {f"{prefix}position_cm": 100 * float(position), f"{prefix}adi_mm": 1000 * adi}
