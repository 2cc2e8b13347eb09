"""What the object's surface, at a pose, says of the contacts themselves."""

import numpy as np

from handsight._kernels.touch.surface_at_contacts import information_by_contact as kernel
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction.problem import descents_at
from handsight.objects import ObjectModel


def information_by_contact(
    model: ObjectModel, contacts: Contacts, T_palm_object: Array
) -> tuple[Array, Array]:
    """Returns information (n, 6, 6) about (point, normal) of each contact, and the gradient (n, 6) of half its squared
    residuals.

    The object being at `T_palm_object` (4, 4); along the palm's axes, [m] and as a normal changes.
    """
    information, gradient = np.empty((len(contacts), 6, 6)), np.empty((len(contacts), 6))
    kernel(*model.record[:2], contacts.record, descents_at(T_palm_object[None]), information, gradient)
    return information, gradient
