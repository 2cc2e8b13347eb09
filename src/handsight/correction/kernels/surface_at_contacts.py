"""The information that an object at a known pose gives about the points and normals of its contacts."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry
from handsight._compiled.records import TERM
from handsight._compiled.symmetry import pose_of
from handsight._compiled.vec3 import sub, vector
from handsight.correction.kernels.contact_term import load_terms, surface_at, whiten


@entry
def information_by_contact(
    model: Any, nodes: Any, contacts: Any, descent: Any, information: Any, gradient: Any
) -> None:
    """Writes the normal equations of n contacts' residuals by the contacts' points and normals, the pose being fixed.

    A contact whose point and normal change by c (6,) has the residuals r + A c, A = [gᵀ 0; N -I], with the covariance S
    of `contacts` (n,) and field together. Written are `information` (n, 6, 6) = Aᵀ S⁻¹ A and `gradient` (n, 6) = Aᵀ S⁻¹
    r. `descent` (1,) DESCENT has the pose.
    """
    terms = np.empty(len(contacts), TERM)
    pose = pose_of(descent[0].pose)
    field = model[0].fine
    load_terms(contacts, terms)
    A = np.zeros((4, 6))
    r = np.empty(4)
    weighted = np.empty(4)
    for k in range(len(contacts)):
        term = terms[k]
        surface = surface_at(nodes, field, vector(term.contact.point), pose)
        whiten(model[0], nodes, field, term, surface)
        d, g, n, N, _ = surface
        error = sub(n, vector(term.contact.normal))
        r[0] = d
        for i in range(3):
            r[1 + i] = error[i]
            A[0, i] = g[i]
            for j in range(3):
                A[1 + i, j] = N[i][j]
            A[1 + i, 3 + i] = -1.0
        # Loops, as NumPy's matrix products take four seconds to compile, mostly for their error messages.
        for i in range(6):
            for row in range(4):
                weighted[row] = 0.0
                for j in range(4):
                    weighted[row] += A[j, i] * term.weight[j, row]
            gradient[k, i] = 0.0
            for row in range(4):
                gradient[k, i] += weighted[row] * r[row]
            for j in range(6):
                information[k, i, j] = 0.0
                for row in range(4):
                    information[k, i, j] += weighted[row] * A[row, j]
