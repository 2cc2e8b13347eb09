"""The answer of a correction."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior
from handsight.tracking.skin import NOTHING, SkinContacts


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """The answer of a correction, with its inputs."""

    estimate: PoseEstimate
    contacts: Contacts
    """The n contacts of `fingers` at `stamp`, in the palm frame."""
    by_error: Array | None
    """(n, 6, j) the effect of the joints' errors on the contacts, see `FingertipContacts.by_error`."""
    records: NDArray[np.void] | None
    """See `FingertipContacts.records`."""
    prior: PosePrior
    """The object's pose without touch."""
    fingers: tuple[str, ...]
    """The fingers that touched the object."""
    stamp: float
    """[s]"""
    variance: float
    """Largest variance of the position of the object's middle [m²]."""
    T_world_palm: Array | None = None
    """(4, 4) the palm's pose; None where it was not known."""
    skin: SkinContacts = NOTHING
    """What the tactile arrays measured."""
    modes: Sequence[np.void] = ()
    """ANSWER of each mode of this prior, the estimate's own first, when other modes were last searched for."""
    searched_at: float = -math.inf
    """When that was [s]."""
    disputed_at: float | None = None
    """Since when corrections have contradicted the estimate, which is then an earlier one's [s]; None: they do not."""
