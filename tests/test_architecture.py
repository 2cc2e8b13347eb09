"""The picture and the table of rooms are those of the sources, and no module imports itself by a detour."""

import importlib.util
from pathlib import Path

import pytest

FILE = Path(__file__).parents[1] / "docs/architecture.py"


@pytest.fixture(scope="module")
def architecture():
    spec = importlib.util.spec_from_file_location("architecture", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_and_the_page_are_those_of_the_sources(architecture):
    message = "run `python docs/architecture.py`"
    assert architecture.PICTURE.read_text(encoding="utf-8") == architecture.picture(), message
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text == architecture.page(text), message


def test_every_room_is_in_a_layer(architecture):
    drawn = {name for row in architecture.layers() for name in row}
    folders = {path.parent.name for path in architecture.SOURCE.glob("*/__init__.py")}
    assert folders <= drawn
