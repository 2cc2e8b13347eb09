"""All evidence of a correction, and the sums over all its terms that every solver uses.

A term is of one kind, by how a solver has to treat it:

* CONTACTS lie on the surface. Their covariance depends on the pose, and they alone may be rejected as outliers.
* WALLS are one-sided: they cost where the object is beyond them, and do not tell how far in front it is.
* FIXED_NOISE is measured beside the contacts, with the same noise at every pose: the object's weight, depth points.
* PRIOR is the pose known before touch.
"""

from typing import Any, NamedTuple

from handsight._kernels.evidence.contact_term import Frame, Pose, add_contacts, contact_cost
from handsight._kernels.evidence.depth_points_term import add_depth_points, depth_points_cost
from handsight._kernels.evidence.outside_term import add_outside, outside_cost
from handsight._kernels.evidence.plane_term import add_planes, plane_cost
from handsight._kernels.evidence.prior_term import add_prior, prior_cost
from handsight._kernels.evidence.weight_term import add_weight, weight_cost
from handsight._kernels.math.vec3 import Vec3
from handsight._kernels.runtime.compilation import inner

CONTACTS, WALLS, FIXED_NOISE, PRIOR = 1, 2, 4, 8
ALL = CONTACTS | WALLS | FIXED_NOISE | PRIOR


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
    """CONSTRAINTS: the weight and the depth points of it are used here; its prior is in `prior`."""
    prior: Any
    """PRIOR_TERM."""
    center: Vec3
    """Centroid of the contacts: about it shift and turn hardly disturb each other, and one damping serves both."""


@inner
def add_evidence(
    evidence: Evidence, kinds: int, field: Any, pose: Pose, frame: Frame, rewhiten: bool, equations: Any
) -> None:
    """Adds the rows of all terms of some kinds at a pose to normal equations by a step (τ, radius ω) about a frame.

    `rewhiten`: whether contacts are weighted by their covariance at this pose; otherwise they keep their last weights,
    so that the costs of one descent can be compared.
    """
    if kinds & CONTACTS:
        add_contacts(evidence, field, pose, frame, rewhiten, equations)
    if kinds & WALLS:
        add_outside(evidence, field, pose, frame, equations)
        add_planes(evidence, pose, frame, equations)
    if kinds & PRIOR:
        add_prior(evidence.prior, pose, frame, equations)
    if kinds & FIXED_NOISE:
        add_weight(evidence.constraints.weight, pose, frame, equations)
        add_depth_points(evidence, field, pose, frame, equations)


@inner
def evidence_cost(evidence: Evidence, kinds: int, pose: Pose) -> float:
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
        total += depth_points_cost(evidence, pose)
    return total
