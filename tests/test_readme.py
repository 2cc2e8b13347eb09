"""The numbers that README calls measured are those of the tables in docs/generated."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

MEASURED = [
    ("table_1", r"handsight with normals +cube +0\.1 .* (0\.01)±", "is {}° and 0.0005 cm on the cube"),
    ("table_1", r"handsight with normals +cube +([\d.]+)±", "0.11 cm off after {} steps"),
    ("table_1", r"handsight with normals +cube .* ([\d.]+)±0\.04 ", "cube is 0.01° and {} cm off"),
    ("table_1", r"LM with normals +cube .* ([\d.]+)±1\.79 ", "same starts {}° and"),
    ("vision_errors", r"CosyPose: vision alone +([\d.]+)", "CosyPose {} to"),
    ("vision_errors", r"PoseCNN: vision alone +([\d.]+)", "PoseCNN {} to"),
    ("vision_errors", r"AAE: vision alone +([\d.]+)", "AAE {} to"),
    ("frames", r"whole image +all +\d+ +([\d.]+)", "{} answered right in the whole image"),
    ("frames", r" box +all +\d+ +([\d.]+)", "{} with a detector's box"),
    ("frames", r" mask +all +\d+ +([\d.]+)", "{} with its mask"),
    ("targets", r"20 mm start, median .* (\d+) µs +≤", "takes {} µs in the median"),
    ("targets", r"\(hot\) .* ([\d.]+) µs +≤", "{} µs repeated"),
]
"""The file of docs/generated, where the number stands in it, and README's words around it."""


@pytest.mark.parametrize(("name", "place", "words"), MEASURED)
def test_readme_says_what_was_measured(name, place, words):
    table = (ROOT / "docs" / "generated" / f"{name}.md").read_text(encoding="utf-8")
    found = re.search(place, table)
    assert found is not None
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert words.format(found[1]) in readme
