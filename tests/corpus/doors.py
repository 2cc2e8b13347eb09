"""All doors and all cases, room by room."""

from tests.corpus import arguments, object_files, recordings

ROOMS = [arguments, object_files, recordings]
DOORS = [door for room in ROOMS for door in room.DOORS]
CASES = [case for room in ROOMS for case in room.CASES]
