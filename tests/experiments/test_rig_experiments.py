"""The repetition of the paper's section III: its measures obey their laws, and it runs as a user would run it."""

import importlib
import importlib.util
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import handsight as hs
from experiments.shared import grasp_errors, grasp_methods, grasp_trials
from handsight import se3
from testbed import scenes
from testbed.experiment_runs import column, printed, rows_of, run

needs_simulator = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("mujoco", "gymnasium_robotics")),
    reason="the simulator is not installed: pip install 'handsight[sim]'",
)


def standing_sample(rng, model):
    """A sample in which an object stands on the table, as far as errors look at it."""
    T_world_object = se3.compose(
        se3.rotation_exp(np.array([0, 0, rng.uniform(-3, 3)])),
        np.append(rng.normal(size=2), model.bounds_object[1, 2]),
    )
    T_world_palm = se3.random(rng, spread=0.3)
    return SimpleNamespace(
        T_world_object=T_world_object,
        T_palm_object=se3.inverse(T_world_palm) @ T_world_object,
        observation=SimpleNamespace(T_world_palm=T_world_palm),
    )


@pytest.fixture(scope="module", params=["can", "box"])
def model(request):
    return (
        hs.ObjectModel.cylinder(0.033, 0.122)
        if request.param == "can"
        else hs.ObjectModel.box((0.06, 0.09, 0.14))
    )


# Measures


def test_observable_and_unobservable_errors_make_up_the_complete_error(model):
    rng = np.random.default_rng(2)
    sample = standing_sample(rng, model)
    T = se3.moved(sample.T_palm_object, 0.02 * rng.normal(size=6))
    directions = np.linalg.qr(rng.normal(size=(6, 2)))[0].T
    whole, parts = (
        grasp_errors.pose_errors(model, T, sample),
        grasp_errors.pose_errors(model, T, sample, directions),
    )
    assert parts["seen"] ** 2 + parts["open"] ** 2 == pytest.approx(whole["seen"] ** 2)
    assert grasp_errors.pose_errors(model, T, sample, np.eye(6))["seen"] == pytest.approx(0, abs=1e-9)


def test_a_symmetric_pose_is_no_error(model):
    sample = standing_sample(np.random.default_rng(3), model)
    half_turn = se3.compose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    found = grasp_errors.pose_errors(model, sample.T_palm_object @ half_turn, sample)
    assert max(found[key] for key in ("base", "middle", "turn", "seen")) < 1e-4


def test_confidence_regions_contain_the_truths_of_their_gaussian():
    box = hs.ObjectModel.box((0.06, 0.09, 0.14))
    rng = np.random.default_rng(4)
    factor = np.diag([0.004, 0.002, 0.001, 0.02, 0.05, 0.01])
    estimate = SimpleNamespace(T_palm_object=np.eye(4), information=np.linalg.inv(factor @ factor))
    rows = [
        scenes.region(box, estimate, se3.moved(np.eye(4), factor @ rng.normal(size=6))) for _ in range(2000)
    ]
    assert {row["freedom"] for row in rows} == {6}
    for level, key in ((0.50, "in 50%"), (0.95, "in 95%")):
        share = np.mean([row[key] for row in rows])
        assert share == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / 2000))


# Grasps


@pytest.fixture(scope="module")
def trial():
    (found,) = grasp_trials.grasps("can", 1, 0, {})
    return found


@needs_simulator
def test_a_trial_has_the_robots_knowledge_and_the_table_gives_height_and_tilt(trial):
    assert len(trial.contacts) == 5
    T_world_palm = trial.sample.observation.T_world_palm
    R = T_world_palm[:3, :3]
    before, after = (
        np.sqrt(np.diag(se3.rotate_covariance(R, p.covariance))) for p in (trial.vision, trial.standing)
    )
    np.testing.assert_allclose(before, [np.hypot(0.064, 0.005)] * 3 + [np.deg2rad(np.hypot(6, 3))] * 3)
    assert after[2] < 0.004
    assert (after[3:5] < np.deg2rad(1.1)).all()
    np.testing.assert_allclose(after[[0, 1, 5]], before[[0, 1, 5]], rtol=0.05)
    T_world_object = T_world_palm @ trial.standing.T_palm_object
    assert T_world_object[2, 3] == pytest.approx(0.061, abs=0.002)
    assert abs(T_world_object[2, 2]) > np.cos(np.deg2rad(1))


@needs_simulator
def test_grasps_that_drop_the_object_are_counted_and_others_take_their_place(monkeypatch):
    true = grasp_trials.last_instant

    def last(scenario):
        return replace(true(scenario), dropped=scenario.seed == 7)

    monkeypatch.setattr(grasp_trials, "last_instant", last)
    left_out = {"dropped": 0}
    found = list(grasp_trials.grasps("box", 2, 7, left_out))
    assert left_out == {"dropped": 1}
    assert [t.scenario.seed for t in found] == [8, 9]


@needs_simulator
def test_corrections_of_a_can_beat_vision_and_the_paper_and_one_finger_leaves_vision_to_the_paper(trial):
    ours, paper = grasp_methods.rows_of(trial, ["maximum, table", "paper-lm, w_n 5 cm"])
    assert ours["read"] < 4 < ours["vision read"] == pytest.approx(paper["vision read"])
    assert ours["read"] < paper["read"]
    assert ours["seen"] < 0.1 * ours["vision seen"]
    alone = replace(trial, touch=replace(trial.touch, contacts=trial.contacts.select([0])))
    (row,) = grasp_methods.rows_of(alone, ["paper-lm, w_n 5 cm"])
    assert not row["answered"]
    assert row["read"] == row["vision read"]


@needs_simulator
def test_contacts_are_sensed_to_a_tenth_of_a_millimetre_and_noise_adds_to_it(trial):
    clean, noisy = grasp_trials.sensing_errors(trial.scenario, 20, np.random.default_rng(0))
    assert len(noisy) == 20 * len(clean) > 0
    assert np.mean(clean) < 100e-6
    assert np.mean(clean) < np.mean(noisy) < 300e-6


# As a user would


@pytest.mark.slow
@needs_simulator
def test_section_3_prints_its_tables_and_over_time_halves_visions_error(tmp_path):
    text = printed("paper.section_3", tmp_path, "--quick", "--trials", 2)
    for title in ("one instant, 2 grasps", "over time", "Truths inside", "Contact sensing"):
        assert title in text
    told = json.loads((tmp_path / "section_3.json").read_text(encoding="utf-8"))
    assert told["grasps"] == 2
    can = {line["method"]: line for line in told["instant"]["can"]}
    assert len(can) == 6 + 8
    assert can["maximum, table"]["read"][0] < 4
    assert can["maximum, table"]["read removed"][0] > 90
    assert told["sensing"]["can"]["clean"] < told["sensing"]["can"]["noisy"]
    rows = rows_of(tmp_path / "section_3.csv")
    seen = column(rows, "read", experiment="instant", object="can", method="maximum")
    np.testing.assert_allclose(can["maximum"]["read"][0], np.mean(seen), rtol=1e-4)
    moved = [
        line for lines in told["time"].values() for line in lines if line["method"] == "best, outside, table"
    ]
    assert len(moved) == 2
    for line in moved:
        assert line["read"][0] < 0.5 * line["vision"][0]


def test_without_the_simulator_an_experiment_says_so_and_ends_well(monkeypatch, tmp_path):
    def missing(*_):
        raise hs.errors.MissingExtra("simulation needs mujoco: pip install 'handsight[sim]'")

    # All are imported before any is patched: a name that is imported patched would stay so in later tests.
    modules = ("shared.grasp_trials", "shared.manipulations", "paper.section_3")
    modules = [f"experiments.{module}" for module in modules]
    for loaded in [importlib.import_module(module) for module in modules]:
        for function in ("last_instant", "simulate", "recorded"):
            if hasattr(loaded, function):  # what an earlier test simulated is still there
                monkeypatch.setattr(loaded, function, missing)
    assert printed("paper.section_3", tmp_path, "--quick").startswith("skipped: simulation needs mujoco")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@needs_simulator
def test_the_harsh_table_has_a_row_of_each_run_and_shows_what_a_wrong_table_costs(tmp_path):
    rows = run("tracking.harsh", tmp_path, "--quick", "--only", "box", "--row", "table")["harsh"]
    assert [row["row"] for row in rows] == ["usual"] * 2 + ["table"] * 2
    assert column(rows, "inside", row="usual").mean() > 0.9
    assert column(rows, "speed").min() > 1
    assert column(rows, "tracking").max() <= 1


@pytest.mark.slow
@needs_simulator
def test_a_hand_knows_its_joints_better_after_some_grips_and_says_how_well(tmp_path):
    """Hands differ: it takes eight to show it."""
    rows = run("touch.joint_offsets", tmp_path, "--quick", "--trials", "8")["joint_offsets"]
    new, learnt = (
        [row for row in rows if row["offsets"] == way and int(row["grip"]) >= 4]
        for way in ("as new", "learnt")
    )
    assert column(learnt, "left").mean() < 0.9 * column(new, "left").mean()
    assert 0.7 < column(learnt, "left").mean() / column(learnt, "claimed").mean() < 1.4
    assert column(learnt, "seen").mean() < 0.8 * column(new, "seen").mean()
