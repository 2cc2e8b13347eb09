"""Which of a hand's contacts are the table's."""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import block, dot, mul, vector
from handsight._kernels.runtime.compilation import entry
from handsight._kernels.touch.sensing_records import PALM_CONTACT

TABLE_WITHIN = 3.0
"""A contact that is within so many standard deviations on the rig's table, and faces up, is the table's."""


@entry
def mark_on_table(T_world_palm: Any, table: Any, reason: int, contacts: Any) -> None:
    """Gives a `reason` to those of `contacts` (n) PALM_CONTACT that touch the table and not the object: no object's
    surface faces up where it stands. `table` (3): its height and the sigmas of that [m] and of its tilt [rad]."""
    up = vector(T_world_palm[2, :3])
    for i in range(len(contacts)):
        contact = contacts[i]
        if contact.reason != 0:
            continue
        height = dot(vector(contact.point), up) + T_world_palm[2, 3] - table[0]
        angle = np.arccos(min(max(dot(vector(contact.normal), up), -1.0), 1.0))
        C = contact.covariance
        variance_height = dot(up, mul(block(C, 0, 0), up)) + table[1] ** 2
        variance_angle = (C[3, 3] + C[4, 4] + C[5, 5]) / 2 + table[2] ** 2
        near = height**2 < TABLE_WITHIN**2 * variance_height
        if near and angle**2 < TABLE_WITHIN**2 * variance_angle:
            contact.reason = reason


def warm() -> None:
    """Compiles the kernel, or loads it."""
    mark_on_table(np.eye(4), np.ones(3), 1, np.zeros(1, PALM_CONTACT))
