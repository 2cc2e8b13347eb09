"""The true forces of a simulated object on the fingers."""

import numpy as np

from handsight.simulation import Sample


def forces_object(sample: Sample) -> dict[str, float]:
    """Returns the force of the object on each finger that it touches, by name [N]."""
    total = dict[str, np.ndarray]()
    for contact in sample.contacts_truth:
        if contact.other == "object":
            total[contact.finger] = total.get(contact.finger, np.zeros(3)) + contact.force_palm
    return {finger: float(np.linalg.norm(force)) for finger, force in total.items()}
