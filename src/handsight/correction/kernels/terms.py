"""All evidence of a correction, and the sums over all its terms that every solver uses.

A term is of one kind, by how a solver has to treat it:

* CONTACTS lie on the surface. Their covariance depends on the pose, and they alone may be rejected as outliers.
* WALLS are one-sided: they cost where the object is beyond them, and do not tell how far in front it is.
* FIXED_NOISE is measured beside the contacts, with the same noise at every pose: the object's weight.
* PRIOR is the pose known before touch.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.vec3 import Pose, Vec3
from handsight.correction.kernels.contact_term import Frame, add_contacts, contact_cost
from handsight.correction.kernels.outside_term import add_outside, links_within, outside_cost
from handsight.correction.kernels.plane_term import add_planes, plane_cost, planes_crossed
from handsight.correction.kernels.prior_term import add_prior, prior_cost
from handsight.correction.kernels.weight_term import add_weight, weight_cost

# NumPy's integers, which all have one type in a kernel; each of Python's constants has a type of its own.
CONTACTS = np.int64(1)
WALLS = np.int64(2)
FIXED_NOISE = np.int64(4)
PRIOR = np.int64(8)
ALL = CONTACTS | WALLS | FIXED_NOISE | PRIOR
REWHITENED = np.int64(16)
"""Beside CONTACTS: they are weighted by their covariance at the pose; otherwise they keep their last weights, so that
the costs of one descent can be compared."""


class Evidence(NamedTuple):
    """`Evidence` is all evidence on one pose."""

    model: Any
    """MODEL."""
    nodes: Any
    """Nodes of the model's grids, float32."""
    terms: Any
    """(n,) TERM, the contacts."""
    outside: Any
    """(m,) OUTSIDE, points of the hand and then planes; their clearances are written."""
    measured: Any
    """MEASURED: where these were measured."""
    constraints: Any
    """CONSTRAINTS: the weight of it is used here; its prior is in `prior`."""
    prior: Any
    """PRIOR_TERM."""
    center: Vec3
    """Centroid of the contacts: about it shift and turn hardly disturb each other, and one damping serves both."""


@inner
def add_evidence(
    evidence: Evidence, kinds: np.int64, field: Any, pose: Pose, frame: Frame, equations: Any
) -> None:
    """Adds the rows of all terms of some kinds at a pose to normal equations by a step (τ, radius ω) about a frame."""
    if kinds & CONTACTS:
        add_contacts(evidence, field, pose, frame, kinds & REWHITENED != 0, equations)
    if kinds & WALLS:
        add_outside(evidence, field, pose, frame, equations)
        add_planes(evidence, pose, frame, equations)
    if kinds & PRIOR:
        add_prior(evidence.prior, pose, frame, equations)
    if kinds & FIXED_NOISE:
        add_weight(evidence.constraints.weight, pose, frame, equations)


@inner
def walls_met(evidence: Evidence, pose: Pose) -> int:
    """Returns how many links and planes the object is within at a pose: only these are rows of evidence there."""
    links = links_within(evidence, pose)
    return links + planes_crossed(evidence, pose)


@inner
def evidence_cost(evidence: Evidence, kinds: np.int64, pose: Pose) -> float:
    """Returns minus two log of the density of some kinds of evidence at a pose, up to a constant, on the fine field."""
    total = 0.0
    if kinds & WALLS:
        total += outside_cost(evidence, evidence.model.fine, pose)
        total += plane_cost(evidence, pose)
    if kinds & CONTACTS:
        total += contact_cost(evidence, pose)
    if kinds & PRIOR:
        total += prior_cost(evidence.prior, pose)
    if kinds & FIXED_NOISE:
        total += weight_cost(evidence.constraints.weight, pose)
    return total
