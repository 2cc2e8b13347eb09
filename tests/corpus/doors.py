"""All doors and all cases, room by room."""

from tests.corpus import arguments, searches

ROOMS = [arguments, searches]
DOORS = [door for room in ROOMS for door in room.DOORS]
CASES = [case for room in ROOMS for case in room.CASES]
