"""Information that a model's bumps lend to its contacts, and what is left without it.

A model that is off its object by a random slope and curvature turns a slide into residuals that the object itself would
not show: of that slide a contact then seems to know what is worked out here, and knows nothing.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import (
    Pose,
    Surface,
    factored,
    invert_covariance,
    model_error,
    residual_covariance,
    surface_at,
)
from handsight._kernels.evidence.terms import Evidence
from handsight._kernels.math.dense6 import eigen, in_metres
from handsight._kernels.math.simd import accumulate, local
from handsight._kernels.math.vec3 import cross, outer, sub, sub33, vector
from handsight._kernels.records import UNCERTAINTY
from handsight._kernels.runtime.compilation import inner

LEND = 3.84
"""Of a slope's or a bend's variance, 95 % of the χ² of one: few are met at once, and their mean is not enough."""
TRACE = 2.5
"""Tangential weights in the trace of a normal's: two, and one along itself of half the size."""
CURVATURE_SHARE = 1.5 / TRACE
"""Each way of a slide meets one own and one mixed term of the curvature's error, the latter half as uncertain: 1.5
variances."""
UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@inner
def add_spurious_information(
    model: Any, nodes: Any, term: Any, surface: Surface, pose: Pose, equations: Any
) -> None:
    """Adds to normal equations by (δp, δθ) what bumps lend to a contact: the same for every slide along the surface."""
    if model.error.inverse_cell == 0.0:
        return
    slope, curvature = model_error(model.error, nodes, surface[4], 2)
    if slope + curvature == 0.0:
        return
    W, n, lever = term.weight, surface[2], sub(vector(term.contact.point), pose[1])
    spurious = W[0, 0] * slope + CURVATURE_SHARE * (W[1, 1] + W[2, 2] + W[3, 3]) * curvature
    along = sub33(UNIT, outer(n, n))
    rows = (
        along[0] + cross(lever, along[0]) + (0.0,),
        along[1] + cross(lever, along[1]) + (0.0,),
        along[2] + cross(lever, along[2]) + (0.0,),
    )
    accumulate((spurious, spurious, spurious), rows, equations)


@inner
def subtract_spurious_information(by_touch: Any, equations: Any, radius: float) -> None:
    """Lowers an information (6, 6) by (δp, δθ) by the sum of `add_spurious_information`."""
    u, all_of_it = local(UNCERTAINTY), 0.0
    for i in range(6):
        all_of_it += equations[i, i]
    if all_of_it == 0.0:
        return
    for i in range(6):
        for j in range(i + 1):
            by_touch[i, j] = by_touch[j, i] = by_touch[i, j] - equations[i, j]
    in_metres(by_touch, radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for i in range(6):
        for j in range(6):
            value = 0.0
            for k in range(6):
                value += u.vectors[i, k] * max(u.values[k], 0.0) * u.vectors[j, k]
            by_touch[i, j] = value * ((1.0 if i < 3 else radius) * (1.0 if j < 3 else radius))


@inner
def cost_deviation(evidence: Evidence, pose: Pose) -> float:
    """Returns how far touch's cost moves from bump to bump along a slide, as a standard deviation; 0 where there are
    none.

    The finger's error n ~ N(0, S) stays what it is, the bumps' e ~ N(0, V) changes from place to place. With
    W = (S + V)⁻¹ the cost (n + e)ᵀ W (n + e) has the variance 4 tr(W V) - 2 tr(W V W V), a mean over n.
    """
    model, square = evidence.model, 0.0
    if model.error.inverse_cell == 0.0:
        return 0.0
    for i in range(len(evidence.terms)):
        term = evidence.terms[i]
        if term.contact.used:
            surface = surface_at(evidence.nodes, model.fine, vector(term.contact.point), pose)
            slope, _ = model_error(model.error, evidence.nodes, surface[4], 2)
            if slope > 0.0:
                height, _ = model_error(model.error, evidence.nodes, surface[4], 0)
                S = residual_covariance(model, evidence.nodes, model.fine, term, surface)
                invert_covariance(factored(S), term.contact.has_normal != 0, term.weight)
                W = term.weight
                by_height = min(W[0, 0] * height, 1.0)
                by_slope = min((W[1, 1] + W[2, 2] + W[3, 3]) / TRACE * slope / LEND, 1.0)
                square += by_height * (4 - 2 * by_height) + 2 * by_slope * (4 - 2 * by_slope)
    return np.sqrt(square)
