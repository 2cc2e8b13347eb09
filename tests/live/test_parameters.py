"""A node's parameters are those that it knows, of their types, or there is no node."""

import pytest

from handsight.errors import InvalidInput
from handsight.live.node import parameters
from testbed.refusals import refused


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


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({}, "rig"),
        ({"rig": ""}, "rig"),
        ({"rig": "a", "objekt": "can"}, "objekt"),
        ({"rig": "a", "zzz": 1}, "zzz"),
        ({"rig": "a", "images": "maybe"}, "images"),
        ({"rig": "a", "images": 1}, "images"),
        ({"rig": "a", "rate": -1}, "rate"),
        ({"rig": "a", "rate": float("nan")}, "rate"),
        ({"rig": "a", "rate": True}, "rate"),
        ({"rig": "a", "view": 70000}, "view"),
        ({"rig": True}, "rig"),
    ],
)
def test_anything_else_is_refused_by_name(given, name):
    with refused(InvalidInput, f"parameter {name}"):
        parameters(given)
