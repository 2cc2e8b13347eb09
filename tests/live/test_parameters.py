"""A node's parameters are those that it knows, of their types, or there is no node."""

import pytest

from handsight.errors import InvalidInput
from handsight.live.node import PARAMETERS, parameters


def test_what_is_given_is_taken_and_the_rest_has_defaults():
    given = {"rig": "robot.yaml", "object": 7, "rate": 20, "images": False}
    found = parameters(given)
    assert found == {
        "rig": "robot.yaml",
        "object": "7",
        "rate": 20.0,
        "images": False,
        "equal": False,
        "view": 0,
    }
    assert found.keys() == PARAMETERS.keys()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "parameter rig: expected the rig file, got nothing"),
        ({"rig": ""}, "parameter rig: expected the rig file, got nothing"),
        ({"rig": "a", "objekt": "can"}, "parameter objekt: unknown; the nearest valid one is 'object'"),
        ({"rig": "a", "zzz": 1}, "parameter zzz: unknown; valid: equal, images, object, rate, rig, view"),
        ({"rig": "a", "images": "maybe"}, "parameter images: expected true or false, got 'maybe'"),
        ({"rig": "a", "images": 1}, "parameter images: expected true or false, got 1"),
        ({"rig": "a", "rate": -1}, "parameter rate: expected a number of 0 or more, got -1"),
        ({"rig": "a", "rate": float("nan")}, "parameter rate: expected a number of 0 or more, got nan"),
        ({"rig": "a", "rate": True}, "parameter rate: expected a number of 0 or more, got True"),
        ({"rig": "a", "view": 70000}, "parameter view: expected a port or 0, got 70000"),
        ({"rig": True}, "parameter rig: expected a text, got True"),
    ],
)
def test_anything_else_is_refused_in_a_sentence(given, expected):
    with pytest.raises(InvalidInput) as error:
        parameters(given)
    assert str(error.value) == expected
