"""All doors and all cases, room by room."""

from tests.corpus import arguments, caches, observations, rigs

ROOMS = [arguments, caches, observations, rigs]
DOORS = [door for room in ROOMS for door in room.DOORS]
CASES = [case for room in ROOMS for case in room.CASES]
