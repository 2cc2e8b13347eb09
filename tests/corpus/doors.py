"""All doors and all cases, room by room."""

from tests.corpus import (
    arguments,
    caches,
    commands,
    libraries,
    lines,
    networks,
    object_files,
    observations,
    pictures,
    recordings,
    rigs,
    robots,
    searches,
)

ROOMS = [
    arguments,
    caches,
    commands,
    libraries,
    lines,
    networks,
    object_files,
    observations,
    pictures,
    recordings,
    robots,
    rigs,
    searches,
]
DOORS = [door for room in ROOMS for door in room.DOORS]
CASES = [case for room in ROOMS for case in room.CASES]
