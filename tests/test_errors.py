"""An error says which input it refuses: `HandsightError.field`."""

import pytest

from handsight.errors import InvalidFile, InvalidInput, NotFound, NotWritten
from testbed.refusals import refused


@pytest.mark.parametrize(
    ("error", "field"),
    [
        (InvalidInput("contacts[0].point: expected 3 numbers, got 2"), "contacts[0].point"),
        (InvalidInput("finger ff: gravities: expected 3 orientations, got 2"), "finger ff"),
        (NotFound("the object was not found"), ""),
        (InvalidFile("my robot.yaml:12: skin.palm.layout: expected one of: a, b"), "skin.palm.layout"),
        (InvalidFile("w.csv: line 4, column ty: expected a number, got a"), "line 4, column ty"),
        (InvalidFile("hand.urdf: expected XML, got: nothing"), "hand.urdf"),
        (InvalidFile("hand.urdf: MuJoCo cannot make a robot of it: no mesh"), "hand.urdf"),
        (NotWritten("a/b.ply: cannot be written: No space left on device"), "a/b.ply"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_an_error_names_the_input_that_it_refuses(error, field):
    assert error.field == field


def test_only_an_error_of_that_type_and_field_counts_as_refused():
    with refused(InvalidInput, "mass"):
        raise InvalidInput("mass: expected kilograms, got 300")
    for wrong in (
        InvalidInput("size: expected metres, got 300"),
        InvalidFile("mass: expected a file, got none"),
    ):
        with pytest.raises(AssertionError), refused(InvalidInput, "mass"):
            raise wrong
    with pytest.raises(AssertionError), refused(InvalidInput, "mass"):
        pass
    with refused(InvalidFile, "b.ply"):  # wherever it lies
        raise InvalidFile("/a/b.ply: the file is empty")
