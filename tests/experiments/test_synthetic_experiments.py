"""The experiments on generated problems run as a user would run them; what they find, tests of the library hold."""

import pytest

from testbed.experiment_runs import column, run

FEW = ("--trials", 2)
SCAN = ("--grasps", 2, "--only", "can: 1 mm, without")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("touch.convergence", FEW),
        ("touch.gripped_box", FEW),
        ("touch.penetration", FEW),
        ("touch.regions", FEW),
        ("data.scans", (*FEW, *SCAN)),
        ("tracking.taxel_tips", FEW),
    ],
)
def test_an_experiment_writes_a_row_of_each_trial(name, options, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path / "none"))
    stem = name.rpartition(".")[2]
    rows = run(name, tmp_path / "results", *options)[stem]
    assert len(rows) >= 2


@pytest.mark.slow
def test_an_edge_on_the_palms_array_ends_the_slide(tmp_path):
    rows = run("touch.skin", tmp_path, "--trials", 6)["skin"]
    for scene in ("box, an edge on it", "can, an end on it", "hand presses the can"):
        tips, skin = (
            column(rows, "slide", scene=scene, **{"with": name}).mean() for name in ("tips", "+ untouched")
        )
        assert skin < min(2.5, tips)
