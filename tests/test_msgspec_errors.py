"""What msgspec refuses is told with its field, what was expected, and what came."""

from typing import Annotated, Literal

import msgspec
import pytest
from msgspec import Meta

from handsight.msgspec_errors import explain, field_name


class Leaf(msgspec.Struct, forbid_unknown_fields=True):
    size: Annotated[float, Meta(gt=0)] = 1.0
    kind: Literal["round", "flat"] = "round"
    point: tuple[float, float, float] | None = None
    angle: Annotated[
        Annotated[float, Meta(ge=0, le=180)] | None, Meta(description="with its bounds inside")
    ] = None

    def __post_init__(self):
        if self.size > 10:
            raise ValueError(f"size: expected metres, got {self.size:g}")


class Tree(msgspec.Struct, forbid_unknown_fields=True):
    leaf: Leaf
    leaves: list[Leaf] = []
    by_name: dict[str, Leaf | None] = {}
    notes: dict[str, dict[str, str]] = {}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({}, "leaf: expected keys and values, got nothing"),
        ({"leaf": 5}, "leaf: expected keys and values, got 5"),
        ({"leaf": {"sise": 1}}, "leaf.sise: unknown key; the nearest valid one is 'size'"),
        ({"leaf": {"x": 1}}, "leaf.x: unknown key; valid: angle, kind, point, size"),
        ({"leaf": {"size": 0}}, "leaf.size: expected a number above 0, got 0"),
        ({"leaf": {"size": "1"}}, "leaf.size: expected a finite number, got 1 (a text)"),
        ({"leaf": {"angle": -1}}, "leaf.angle: expected a number of at least 0, got -1"),
        ({"leaf": {"angle": 200}}, "leaf.angle: expected a number of at most 180, got 200"),
        ({"leaf": {"size": 11}}, "leaf.size: expected metres, got 11"),
        ({"leaf": {"kind": "rund"}}, "leaf.kind: expected one of round, flat, got 'rund'; the nearest valid one is 'round'"),
        ({"leaf": {"point": [1, 2]}}, "leaf.point: expected 3 finite numbers, got [1, 2]"),
        ({"leaf": {"point": [1, None, 2]}}, "leaf.point[1]: expected a finite number, got None"),
        ({"leaf": {}, "leaves": 1}, "leaves: expected a list, got 1"),
        ({"leaf": {}, "leaves": [{}, {"size": -1}]}, "leaves[1].size: expected a number above 0, got -1"),
        ({"leaf": {}, "by_name": {"a": {}, "b": {"size": -1}}}, "by_name.b.size: expected a number above 0, got -1"),
        ({"leaf": {}, "notes": {"a": {"b": "c"}, "d": {"e": 1}}}, "notes.d.e: expected a text, got 1"),
    ],
)  # fmt: skip
def test_the_field_the_expectation_and_what_came_are_named(value, message):
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(value, Tree)
    path, sentence = explain(Tree, value)
    assert f"{field_name(path)}: {sentence}" == message


@pytest.mark.parametrize("key", ["x - at `$.foo", "x` - at `$.leaf`", "x - at `$.leaves[3]", "`", ""])
def test_no_key_brings_the_explanation_down(key):
    for value in ({"leaf": {}, key: 1}, {"leaf": {key: 1}}, {"leaf": {}, "leaves": [{key: 1}]}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(value, Tree)
        assert "unknown key" in explain(Tree, value)[1]
