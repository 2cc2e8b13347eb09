"""README keeps its word: numbers are those of the tables in docs/generated, and its example prints what stands below it."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

MEASURED = [
    ("table_1", r"handsight with normals +cube +0\.1 .* (0\.01)±", "is {}° and 0.0005 cm on the cube"),
    ("table_1", r"handsight with normals +cube +([\d.]+)±", "0.11 cm off after {} steps"),
    ("table_1", r"handsight with normals +cube .* ([\d.]+)±0\.04 ", "cube is 0.01° and {} cm off"),
    ("table_1", r"LM with normals +cube .* ([\d.]+)±1\.79 ", "same starts {}° and"),
    ("vision_errors", r"CosyPose: vision alone +([\d.]+)", "CosyPose {} to"),
    ("vision_errors", r"CosyPose: .*\n.*\n +and 5 touches +([\d.]+)", "to {}, PoseCNN"),
    ("vision_errors", r"PoseCNN: vision alone +([\d.]+)", "PoseCNN {} to"),
    ("vision_errors", r"PoseCNN: .*\n.*\n +and 5 touches +([\d.]+)", "to {}, AAE"),
    ("vision_errors", r"AAE: .*\n.*\n +and 5 touches +([\d.]+)", "AAE 11.91 to {}."),
    ("vision_errors", r"AAE: vision alone +([\d.]+)", "AAE {} to"),
    ("three_finger_contacts", r"1 cm, 5°: best mode +([\d.]+)", "1 cm off: {} cm off afterwards"),
    ("three_finger_contacts", r"blind: best mode +([\d.]+)", "without any camera {} cm"),
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
    assert words.format(found[1]) in " ".join(README.split())


def test_the_example_prints_what_stands_below_it(capsys):
    code, shown = re.search(r"```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL).groups()
    exec(code, {})
    printed = capsys.readouterr().out
    assert printed.replace("-0.0", "0.0") == shown.replace("-0.0", "0.0")
