"""The experiments on real pictures run, and what they are cited for holds; without the data they say so."""

import os
from pathlib import Path

import pytest

from experiments.experiment_runs import printed, run

NAMED = os.environ.get("HANDSIGHT_DATA")
DATA = Path(NAMED) if NAMED else Path(__file__).parents[3] / "shared" / "data"


def test_without_data_the_program_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path))
    told = printed("sight_real", tmp_path / "output")
    assert told.startswith("skipped: ")
    assert told.count("\n") == 1


@pytest.mark.slow
@pytest.mark.skipif(
    not (DATA / "m3t_rgbd").is_dir(),
    reason="the real pictures are not here: set HANDSIGHT_DATA to their folder",
)
def test_a_real_bottle_is_found_without_a_guess(tmp_path, monkeypatch):
    """Within 10 mm and 5° (axis) of the authors' pose; its twin may come first, and is among the poses."""
    monkeypatch.setenv("HANDSIGHT_DATA", str(DATA))
    rows = run("sight_real", tmp_path)["sight_real"]
    for frame in ("200", "201"):
        found = [row["which"] for row in rows if row["frame"] == frame]
        assert found[0] in ("pose", "twin")
        assert {"pose", "twin"} <= set(found)
