"""The reference of the rig file, which the documentation includes, has every key that a rig may have."""

from pathlib import Path

from handsight.rig.form import RigForm, keys
from handsight.rig.schema import schema

REFERENCE = Path(__file__).parents[2] / "docs" / "generated" / "rig_file.md"


def rows():
    """The cells of each row: key, value, meaning."""
    lines = [line for line in schema().splitlines() if line.startswith("| ") and "| key |" not in line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_every_key_has_a_meaning_and_a_value():
    found = rows()
    assert len(found) > 100
    assert [cells for cells in found if len(cells) != 3 or not all(cells)] == []


def test_every_section_of_the_file_has_a_table():
    sections = {key.text for key in keys(RigForm)} - {"version"}
    titles = {line.split("`")[1].partition(".")[0] for line in schema().splitlines() if line.startswith("`")}
    assert titles == sections


def test_the_documentation_has_the_reference_as_it_is():
    assert REFERENCE.read_text(encoding="utf-8") == schema()
