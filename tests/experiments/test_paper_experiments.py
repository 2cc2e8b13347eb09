"""The experiments on the paper run, and their findings have the direction that they are cited for.

Bounds come from the full runs: each leaves at least four standard errors at the trials of `--quick`.
"""

import numpy as np
import pytest

from experiments.paper import table_1
from experiments.shared import grasp_errors
from testbed import report, scenes
from testbed.experiment_runs import column, run

SHAPES = ("cube", "cylinder")


@pytest.mark.slow
def test_table_1_has_the_papers_findings_and_handsights_target(tmp_path):
    rows = run("paper.table_1", tmp_path, "--quick")["table_1"]
    assert len(rows) == 12
    assert sum(row["its_published"] != "" for row in rows) == 8

    def mean(name, method, shape):
        return column(rows, f"{name}_mean", method=method, shape=shape)[0]

    for shape in SHAPES:
        # 174 to 200 against 20 to 26 iterations, errors below 10 for 12 trials.
        for kind in ("", " with normals"):
            assert mean("its", "LM" + kind, shape) < 0.5 * mean("its", "GD" + kind, shape)
        assert mean("mae_deg_observable", "handsight with normals", shape) <= 0.5
        assert mean("rme_cm_observable", "handsight with normals", shape) <= 0.02
    # Over GD and LM and both shapes normals gain 0.99 cm and 13.4°, with errors of 0.18 cm and 2.2° here.
    for name in ("rme_cm_symmetric", "mae_deg_symmetric"):
        pairs = [(mean(name, m, s), mean(name, f"{m} with normals", s)) for m in ("GD", "LM") for s in SHAPES]
        assert np.mean([without - having for without, having in pairs]) > 0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table_and_another_seed_another(tmp_path):
    found = []
    for seed in (1, 1, 2):
        # Two trials: a stream that depends on what ran before differs in the second at the latest.
        rows = table_1.run(report.Options(True, tmp_path, trials=2, seed=seed), scenes.START)
        found.append([{name: value for name, value in row.items() if name != "seconds"} for row in rows])
    assert found[0] == found[1]
    assert found[0] != found[2]


@pytest.mark.slow
def test_figure_2_larger_regions_miss_fewer_of_the_points_touched(tmp_path):
    rows = run("paper.figure_2", tmp_path, "--quick")["figure_2"]
    for shape in SHAPES:
        held = column(rows, "holds_true_point_mean", shape=shape)
        # A larger region holds the smaller one, so this is no matter of luck.
        assert (np.diff(held) >= 0).all()
        assert held[0] < 0.6 < 0.99 < held[-1]
        share = column(rows, "cloud_share_mean", shape=shape, least_points="200")
        assert 0.1 <= share[0] < 0.15


@pytest.mark.slow
def test_figure_3_shows_a_median_trial_and_handsight_nearer_to_the_truth(tmp_path):
    rows = run("paper.figure_3", tmp_path, "--quick")["figure_3"]
    assert len(rows) == 6
    for shape in SHAPES:
        start, paper, ours = column(rows, "surface_cm_mean", shape=shape)
        # 3.5, 1.6 and at most 0.1 cm over 100 trials, with errors of 0.3, 0.4 and 0.1 cm for 15.
        assert ours < paper < start
        name = "LM with normals (paper)"
        shown = column(rows, "surface_cm_shown", shape=shape, method=name)
        np.testing.assert_allclose(
            shown, column(rows, "surface_cm_median", shape=shape, method=name), rtol=1e-9
        )


@pytest.mark.slow
def test_figure_6_the_centre_is_off_by_root_three_of_a_corner(tmp_path):
    rows = run("paper.figure_6", tmp_path, "--quick")["figure_6"]
    meant = [row for row in rows if row["corners"] == "as meant"]
    # 4000 numbers each: a standard deviation is known to 1.1 %.
    np.testing.assert_allclose(
        column(meant, "error_per_axis_mm"), column(meant, "predicted_per_axis_mm"), rtol=0.05
    )
    assert (column(rows, "distance_mean_mm", corners="swapped") > 100).all()


# Equation 8


def test_eq_8_by_hand():
    # A unit square with the centre at its lower left corner, walked counterclockwise (0, 0), (1, 0), (1, 1).
    np.testing.assert_allclose(grasp_errors.centre_from_corners([1, 1], [1, 0]), [0, 0])
    # Its other neighbour of the centre, (0, 1), is walked clockwise: two sides off.
    np.testing.assert_allclose(grasp_errors.centre_from_corners([1, 1], [0, 1]), [0, 2])


@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 7))
def test_eq_8_finds_the_centre_from_any_of_the_four_squares_however_turned(angle):
    centre = np.array([0.3, -0.2])
    for p1, p2 in grasp_errors.corners(centre, angle, side=0.05):
        assert np.linalg.norm(p2 - centre) == pytest.approx(0.05)
        assert np.linalg.norm(p1 - centre) == pytest.approx(0.05 * np.sqrt(2))
        np.testing.assert_allclose(grasp_errors.centre_from_corners(p1, p2), centre, atol=1e-15)
