"""The experiments on real pictures run, and what they are cited for holds; without the data they say so."""

import os
from pathlib import Path

import numpy as np
import pytest

from testbed.experiment_runs import printed, rows_of, run
from testbed.picture_files import bop_with_truths

NAMED = os.environ.get("HANDSIGHT_DATA")
DATA = Path(NAMED) if NAMED else Path(__file__).parents[3] / "shared" / "data"


@pytest.mark.parametrize("name", ["sight.frames", "sight.following"])
def test_without_data_the_program_says_so(name, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path))
    told = printed(name, tmp_path / "output")
    assert told.startswith("skipped: ")
    assert told.count("\n") == 1


@pytest.mark.slow
def test_any_bop_scene_is_scored_by_the_same_command(tmp_path):
    """Drawn: a letter and a brick, each in an image of its own, are found and named."""
    scene, _ = bop_with_truths(tmp_path / "lab")
    (tmp_path / "output").mkdir()
    rows = run("sight.frames", tmp_path / "output", "--scenes", scene)["sight_frames"]
    assert [row["told"] for row in rows].count("absent") == 2
    for row in rows:
        if row["told"].startswith("absent"):  # the brick resembles a part of the letter: it may be claimed
            continue
        assert (row["right_s"], row["wrong"]) == ("1", "0")
        if row["object"] == "obj_000003":  # the data set declares no symmetries of the brick
            assert float(row["ar"]) > 0.9
        if row["told"] in ("box", "mask"):
            assert row["named"] == row["object"]


@pytest.mark.slow
@pytest.mark.skipif(
    not (DATA / "ycbv_frames").is_dir(),
    reason="the real frames are not here: set HANDSIGHT_DATA to their folder",
)
def test_known_objects_are_found_in_real_frames(tmp_path, monkeypatch):
    """At most one answer of fifty is wrong by ADD-S, and the truth scored as an answer has the full recall."""
    monkeypatch.setenv("HANDSIGHT_DATA", str(DATA))
    (tmp_path / "output").mkdir()
    told = printed("sight.frames", tmp_path / "output", "--trials", "2", "--no-recognition")
    assert "The truth scored as an answer: AR 1.000." in told
    rows = rows_of(tmp_path / "output/sight_frames.csv")
    there = [row for row in rows if not row["told"].startswith("absent")]
    assert np.mean([row["wrong"] == "1" for row in there]) <= 0.02
    for told, least in (("whole image", 0.3), ("box", 0.7), ("mask", 0.9)):
        assert np.mean([row["right_s"] == "1" for row in there if row["told"] == told]) >= least
