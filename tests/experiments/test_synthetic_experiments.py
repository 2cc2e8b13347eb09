"""The experiments on generated problems run as a user would run them, and find what they are cited for."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def rows_of(name, folder, *options):
    """The rows of the CSV file that an experiment writes."""
    done = subprocess.run(
        [sys.executable, str(EXPERIMENTS / f"{name}.py"), "--output", str(folder), *options],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "HANDSIGHT_DATA": str(folder)},
    )
    assert done.returncode == 0, done.stderr
    assert f"{name}.csv" in done.stdout.replace("\n", "")
    with (folder / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def numbers(rows, key, **where):
    """A column of the rows that match."""
    return np.array([float(r[key]) for r in rows if all(r[k] == v for k, v in where.items())])


@pytest.mark.slow
def test_the_gripped_box_is_not_turned_and_its_mean_slides_less(tmp_path):
    rows = rows_of("gripped_box", tmp_path, "--trials", "12")
    assert numbers(rows, "turn", answer="maximum").max() < 20
    assert (
        numbers(rows, "slide", answer="mean").mean() < 0.6 * numbers(rows, "slide", answer="maximum").mean()
    )
    assert (tmp_path / "gripped_box.png").stat().st_size > 5_000


@pytest.mark.slow
def test_outside_evidence_takes_the_hand_out_of_the_box(tmp_path):
    rows = rows_of("penetration", tmp_path, "--trials", "10")
    bare = numbers(rows, "depth_mm", object="box", evidence="contacts")
    kept = numbers(rows, "depth_mm", object="box", evidence="contacts + outside")
    assert (bare > 5).sum() > 2
    assert (kept > 5).sum() < 2


@pytest.mark.slow
def test_can_and_box_converge_and_the_regions_hold_without_the_scans(tmp_path):
    rows = rows_of("convergence", tmp_path, "--trials", "8")
    assert np.mean([r["clean"] == "True" for r in rows]) > 0.9
    rows = rows_of("regions", tmp_path, "--trials", "30")
    assert {r["object"] for r in rows} == {"can", "box"}
    # 60 truths: 95 % less four standard errors.
    assert np.mean([r["in 95%"] == "True" for r in rows]) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 60)


@pytest.mark.slow
def test_latency_is_measured_for_both_objects(tmp_path):
    rows = rows_of("latency", tmp_path, "--trials", "5")
    assert {r["object"] for r in rows} == {"can", "box"}
    assert (numbers(rows, "ms") > 0).all()
