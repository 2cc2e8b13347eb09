"""Spurious information: what the bumps of a scanned model add to the information of its contacts.

A scanned model differs from its object by a random slope and curvature at each place. Moved along the surface of the
model, a contact then has residuals that the object itself would not cause, and appears to be information about where
along the surface it is. That part is computed here, and subtracted.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, from_eigen, in_metres
from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_equal_rows
from handsight._compiled.records import UNCERTAINTY
from handsight._compiled.so3 import IDENTITY
from handsight._compiled.stack import local
from handsight._compiled.vec3 import Pose, cross, outer, sub, sub33, vector
from handsight.correction.kernels.contact_term import (
    Surface,
    factored,
    invert_covariance,
    model_error,
    residual_covariance,
    surface_at,
)
from handsight.correction.kernels.terms import Evidence
from handsight.objects.kernels.scan_error import CHI2_95

TRACE = 2.5
"""The trace of a normal's weight in tangential weights: two, and one of half the size along the normal itself."""


@inner
def add_spurious_information(
    model: Any, nodes: Any, term: Any, surface: Surface, pose: Pose, equations: Any
) -> None:
    """Adds the spurious information of a contact, by (δp, δθ), to normal equations: the same in every direction along
    the surface."""
    if model.error.inverse_cell == 0.0:
        return
    slope, curvature = model_error(model.error, nodes, surface[4], 2)
    if slope + curvature == 0.0:
        return
    W = term.weight
    n = surface[2]
    lever = sub(vector(term.contact.point), pose[1])
    # A shift along either tangent axis meets the error of the curvature along it, and that of the mixed curvature,
    # which has half the variance: 1.5 variances.
    tangential = (W[1, 1] + W[2, 2] + W[3, 3]) / TRACE
    spurious = W[0, 0] * slope + 1.5 * tangential * curvature
    along = sub33(IDENTITY, outer(n, n))
    rows = (
        along[0] + cross(lever, along[0]) + (0.0,),
        along[1] + cross(lever, along[1]) + (0.0,),
        along[2] + cross(lever, along[2]) + (0.0,),
    )
    add_equal_rows(spurious, rows, equations)


@inner
def subtract_spurious_information(by_touch: Any, equations: Any, radius: float) -> None:
    """Subtracts the sum of `add_spurious_information` from an information (6, 6) by (δp, δθ), which stays at least zero
    in every direction."""
    u = local(UNCERTAINTY)
    total = 0.0
    for i in range(6):
        total += equations[i, i]
    if total == 0.0:
        return
    for i in range(6):
        for j in range(i + 1):
            by_touch[i, j] = by_touch[j, i] = by_touch[i, j] - equations[i, j]
    in_metres(by_touch, radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for k in range(6):
        u.values[k] = max(u.values[k], 0.0)
    from_eigen(u.values, u.vectors, radius, by_touch)


@inner
def cost_deviation(evidence: Evidence, pose: Pose) -> float:
    """Returns the standard deviation of the contacts' cost from bump to bump along the surface; 0 of a model without
    bumps.

    The finger's error n ~ N(0, S) stays the same, the bumps' e ~ N(0, V) changes from place to place. With
    W = (S + V)⁻¹ the cost (n + e)ᵀ W (n + e) has the variance 4 tr(W V) - 2 tr(W V W V), a mean over n.
    """
    model = evidence.model
    square = 0.0
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
                by_slope = min((W[1, 1] + W[2, 2] + W[3, 3]) / TRACE * slope / CHI2_95, 1.0)
                square += by_height * (4 - 2 * by_height) + 2 * by_slope * (4 - 2 * by_slope)
    return np.sqrt(square)
