"""What a change has cost is told problem by problem: the same, within noise, worse, or lacking."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import price
from experiments.shared import price_answers
from experiments.shared.price_kinds import KINDS

ROOT = Path(__file__).parents[2]
KIND = "gripped box"


@pytest.fixture(scope="module")
def problems():
    return list(KINDS[KIND].problems(0, 24))


@pytest.fixture(scope="module")
def answers(problems):
    return [price_answers.corrected(problem) for problem in problems]


def shifted(answers, millimetres):
    """The answers, each of them off by so much more along the world's axes."""
    pushed = json.loads(json.dumps(answers))
    for answer in pushed:
        for row in answer["pose"][:3]:
            row[3] += 1e-3 * millimetres
    return pushed


def test_the_same_answers_are_the_same(problems, answers):
    row = price.compared(KIND, problems, answers, answers)
    assert (row.verdict, row.n, row.identical, row.most) == ("same", len(problems), 1.0, 0.0)


def test_answers_that_are_off_are_worse_and_the_other_way_round_better(problems, answers):
    off = shifted(answers, 200)
    worse, better = (price.compared(KIND, problems, *pair) for pair in ((answers, off), (off, answers)))
    assert (worse.verdict, better.verdict) == ("worse", "better")
    assert worse.error[1] > worse.error[0] == better.error[1]
    assert worse.identical == 0


def test_rounding_is_not_the_same_but_within_noise(problems, answers):
    row = price.compared(KIND, problems, answers, shifted(answers, 1e-9))
    assert (row.verdict, row.identical) == ("within noise", 0.0)


def test_what_a_tree_lacks_is_named_and_one_failure_is_a_wrong_answer(problems, answers):
    lacking = [{"error": "ImportError: cannot import name 'best'"}] * len(answers)
    assert price.compared(KIND, problems, lacking, answers).verdict.startswith("the old tree: ImportError")
    one = price.compared(KIND, problems, answers, [*answers[:-1], lacking[0]])
    assert one.right == (1.0, pytest.approx(1 - 1 / len(answers)))
    assert one.most == np.inf


def test_regions_that_hold_too_much_are_no_better_than_those_that_hold_too_little():
    assert price.verdict_of([price.loss((0.95, 1.0), wanted=0.95)]) == "worse"
    assert price.verdict_of([price.loss((0.90, 0.94), wanted=0.95)]) == "better"


def test_a_problem_has_numbers_and_texts_alone_and_hides_its_truth(tmp_path):
    assert price.drawn(tmp_path, KIND, 2) == ""
    problem = price_answers.read(tmp_path / KIND / "000001.npz")
    assert all(value.dtype != object for value in problem.values())
    assert "truth.pose" in problem
    (answer, _) = price_answers.answers(tmp_path / KIND, "corrected")
    assert "error" not in answer


@pytest.mark.slow
def test_a_tree_against_itself_is_the_same():
    rows = price.priced(ROOT, [KIND, "skin"], quick=True)
    assert [row.verdict for row in rows] == ["same", "same"]
