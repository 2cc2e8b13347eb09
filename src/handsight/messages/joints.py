"""Positions of joints out of messages: a JointState's, or those at a path into any message."""

from collections.abc import Mapping, Sequence
from math import hypot, isfinite

import numpy as np

from handsight.errors import InvalidInput
from handsight.messages.paths import at, beside, numbers
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.rig.rig import JointReading

MAX_POSITION = 1e6  # of a joint [rad or m]; large, as wheels turn far


def joints_along(message: RosMessage, reading: JointReading) -> tuple[Sequence[str], Sequence[float]]:
    """Returns the names of the joints in a message, none where the rig has them, and the numbers of their positions.

    Raises MessageRejected, InvalidInput.
    """
    found, sizes = numbers(at(message, reading.field))
    if len(sizes) > 1:
        raise MessageRejected(f"expected positions in a row, got {' x '.join(map(str, sizes))} numbers")
    if reading.names:
        return (), found.tolist()
    path = beside(reading.field, "name")
    try:
        names = [str(name) for name in at(message, path)]
    except (InvalidInput, TypeError):
        expected = "expected topics.joint_states.names in the rig"
        raise MessageRejected(f"{expected}, as the message has no names at {path}") from None
    return names, found.tolist()


def positions(
    names: Sequence[str], given: Sequence[float], reading: JointReading | None = None
) -> Mapping[str, float]:
    """Returns the positions of joints by name [rad or m]; raises MessageRejected.

    `given`: the numbers as published. `reading`: what these are, and the names in place of the message's own; None:
    positions of a JointState.
    """
    known: Sequence[str | None] = names
    if reading is not None and reading.names:
        known = reading.names
    if len(known) != len(given):
        raise MessageRejected(f"expected as many positions as names, got {len(given)} for {len(known)}")
    if reading is not None and reading.converts:
        given = (np.asarray(reading.scale) * (np.asarray(given) - reading.offset)).tolist()
    pairs = zip(known, given, strict=True)
    found = {name: position for name, position in pairs if name is not None}
    if len(found) != len(known) - known.count(None):
        raise MessageRejected("expected each joint once, got one name twice")
    if not hypot(*found.values()) <= MAX_POSITION:
        for name, position in found.items():
            _check(name, position)
    return found


def _check(name: str, position: float) -> None:
    """Raises MessageRejected for a position that is not finite, or that no joint has."""
    if not abs(position) <= MAX_POSITION:
        expected = f"expected a position of joint {name} within {MAX_POSITION:g}"
        raise MessageRejected(f"{expected}, got {position:g}", nan=not isfinite(position))
