"""The experiments on generated problems run as a user would run them, and find what they are cited for."""

import numpy as np
import pytest

from experiments.experiment_runs import column, run


@pytest.mark.slow
def test_the_gripped_box_is_not_turned_and_its_mean_slides_less(tmp_path):
    rows = run("gripped_box", tmp_path, "--trials", 12)["gripped_box"]
    assert column(rows, "turn", answer="maximum").max() < 20
    assert column(rows, "slide", answer="best").mean() < 0.6 * column(rows, "slide", answer="maximum").mean()
    assert (tmp_path / "gripped_box.png").stat().st_size > 5_000


@pytest.mark.slow
def test_means_are_those_of_samples(tmp_path):
    rows = run("means", tmp_path, "--quick")["means"]
    assert {r["kind"] for r in rows} >= {"box", "box, table", "can"}
    assert np.median(column(rows, "mean")) < 0.2 < np.median(column(rows, "maximum"))


@pytest.mark.slow
def test_outside_evidence_takes_the_hand_out_of_the_box(tmp_path):
    rows = run("penetration", tmp_path, "--trials", 10)["penetration"]
    bare = column(rows, "depth_mm", object="box", evidence="contacts")
    kept = column(rows, "depth_mm", object="box", evidence="contacts + outside")
    assert (bare > 5).sum() > 2
    assert (kept > 5).sum() < 2


@pytest.mark.slow
def test_without_data_can_and_box_converge_and_their_regions_contain_the_truth(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path))
    rows = run("convergence", tmp_path / "convergence", "--trials", 8)["convergence"]
    assert np.mean([r["clean"] == "True" for r in rows]) > 0.9
    rows = run("regions", tmp_path / "regions", "--trials", 30)["regions"]
    assert {r["object"] for r in rows} == {"can", "box"}
    # 60 truths: 95 % less four standard errors.
    assert np.mean([r["in 95%"] == "True" for r in rows]) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 60)


@pytest.mark.slow
def test_latency_is_measured_for_both_objects(tmp_path):
    rows = run("latency", tmp_path, "--trials", 5)["latency"]
    assert {r["object"] for r in rows} == {"can", "box"}
    assert (column(rows, "ms") > 0).all()


def test_information_added_by_a_model_is_that_of_a_circle_on_a_can(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path))
    rows = run("added_by_model", tmp_path, "--trials", 50)["added_by_model"]
    assert len(rows) == 2
    # 1 mm along a circle of 33 mm, about one of two axes.
    bend = np.rad2deg(1 / 33) / np.sqrt(2)
    np.testing.assert_allclose(column(rows, "bend °", object="cylinder, exact"), bend, rtol=1e-3)
    assert column(rows, "bend °", object="box, exact").max() == 0


@pytest.mark.slow
def test_a_scanned_can_is_nearly_as_good_as_the_can_and_its_spin_is_open(tmp_path):
    options = ("--trials", 3, "--grasps", 6, "--only", "can: 1 mm, without")
    rows = run("scans", tmp_path, *options)["scans"]
    assert column(rows, "scan mm").mean() < 1.6 * column(rows, "exact mm").mean()
    assert column(rows, "scan named").sum() > 0.85 * column(rows, "open").sum()
    # With what bumps lend it was one in twenty.
    assert np.mean([row["scan in 95%"] == "True" for row in rows]) > 0.6


@pytest.mark.slow
def test_an_edge_on_the_palms_array_ends_the_slide(tmp_path):
    rows = run("skin", tmp_path, "--trials", 6)["skin"]
    for scene in ("box, an edge on it", "can, an end on it", "hand presses the can"):
        tips, skin = (
            column(rows, "slide", scene=scene, **{"with": name}).mean() for name in ("tips", "+ untouched")
        )
        assert skin < 2.5
        assert skin < tips
    assert (tmp_path / "skin.png").stat().st_size > 5_000
