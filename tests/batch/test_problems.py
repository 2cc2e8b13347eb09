"""Problems as lines of JSON: their answers, and what is said of a line that is wrong."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

import handsight as hs
from batch.box_problem import BOX, KEYS, changed
from handsight.batch import problems


def corrected(*lines):
    """The answers to problems, or to lines as they stand."""
    reader = problems.Reader(Path())
    texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    return [json.loads(problems.answer_text(reader, text.encode())) for text in texts]


def test_the_box_with_five_contacts_is_put_right():
    (answer,) = corrected(BOX)
    assert list(answer) == KEYS
    np.testing.assert_allclose(answer["position"], 0, atol=2e-3)
    np.testing.assert_allclose(answer["quaternion_xyzw"][:3], 0, atol=0.03)
    assert np.shape(answer["covariance"]) == np.shape(answer["information"]) == (6, 6)
    np.testing.assert_allclose(np.array(answer["covariance"]) @ answer["information"], np.eye(6), atol=1e-6)
    assert answer["converged"]
    assert answer["consistent"]
    assert answer["outliers"] == answer["unobservable"] == []
    assert len(answer["residuals"]["distance"]) == len(answer["residuals"]["normal_deg"]) == 5
    assert answer["hypotheses"][0]["position"] == answer["position"]


NAN = float("nan")


@pytest.mark.parametrize(
    ("problem", "error"),
    [
        (
            changed("contacts[0].point", [NAN, 0, 0]),
            "contacts[0].point: expected 3 finite numbers, got [nan, 0, 0]",
        ),
        (changed("contacts[0].point", ["a", 0, 0]), "contacts[0].point: expected 3 finite numbers"),
        (
            changed("contacts[0].point", [True, 0, 0]),
            "contacts[0].point: expected 3 finite numbers, got [True, 0, 0]",
        ),
        (changed("contacts[0].point", [10**400, 0, 0]), "contacts[0].point: expected 3 finite numbers"),
        (changed("contacts[1].point", [1e300, 0, 0]), "contacts[1].point: "),
        (
            changed("contacts[1].normal", [0, 0, 0]),
            "contacts[1].normal: expected a direction, got a zero vector",
        ),
        (changed("contacts[2].sigma_point", 0), "contacts[2].sigma_point: expected a number above 0, got 0"),
        (
            changed("contacts[2].sigma_normal_deg", -5),
            "contacts[2].sigma_normal_deg: expected a number above 0, got -5",
        ),
        (
            changed("contacts[2].colour", "red"),
            "contacts[2].colour: unknown key; valid: covariance, group, normal, ",
        ),
        (changed("contacts", []), "contacts: expected at least one contact, got none"),
        (changed("contacts", {}), "contacts: expected a list, got {}"),
        (
            changed("contacts[0].covariance", np.eye(6).tolist()),
            "contacts[0]: expected sigmas or a covariance, got both",
        ),
        (
            changed("contacts[1].covariance", (-np.eye(6)).tolist()),
            "contacts[1].covariance: expected a positive semidefinite",
        ),
        (
            changed("vision.quaternion_xyzw", [0, 0, 0, 0]),
            "vision.quaternion_xyzw: expected a direction, got a zero vector",
        ),
        (
            changed("vision.sigma_position", ...),
            "vision.sigma_position: expected a number above 0, got nothing",
        ),
        (
            changed("vision.sigma_position", float("inf")),
            "vision.sigma_position: expected a finite number, got inf",
        ),
        (
            changed("vision.covariance", np.eye(6).tolist()),
            "vision: expected sigma_position and sigma_rotation_deg or a covariance, got both",
        ),
        (changed("object", {}), "object: expected one of box, cylinder, mesh, name, got none"),
        (
            changed("object", {"box": [0.1, 0.1, -0.1]}),
            "object.box[2]: expected a number above 0, got -0.1",
        ),
        (changed("object", {"mesh": "no-such-file.ply"}), "object.mesh: "),
        (changed("object", {"box": [0.1, 0.1, 0.1], "scale": 2}), "object.scale: expected beside mesh only"),
        (changed("method", "magic"), "method: expected one of handsight, paper-lm, paper-gd"),
        (changed("samples", -1), "samples: expected a whole number from 0 to 1000000, got -1"),
        (
            changed("samples", 999_999_999),
            "samples: expected a whole number from 0 to 1000000, got 999999999",
        ),
        (changed("samples", 1.5), "samples: expected a whole number from 0 to 1000000, got 1.5"),
        (changed("budget", 0), "budget: expected a number above 0, got 0"),
        (changed("budget", "soon"), "budget: expected a finite number, got soon"),
        (changed("outside", [[0, 0]]), "outside: expected finite numbers of shape (n, 3), got [[0, 0]]"),
        (changed("object", ...), "object: expected keys and values, got nothing"),
        ({**BOX, "extra": 1}, "extra: unknown key; "),
        ("[1, 2]", "line: expected an object {...}, got [1, 2]"),
        ('{"object": {"box": [1,1,1]}, "object": {"box": [2,2,2]}, "contacts": []}', "object: expected once"),
        ("[" * 100_000, "line: "),
    ],
)
def test_each_wrong_line_names_field_expectation_and_what_came(problem, error):
    (answer,) = corrected(problem)
    assert list(answer) == ["error"]
    assert error in answer["error"]


def test_a_contact_without_a_normal_has_no_angle():
    (answer,) = corrected(changed("contacts[4].normal", ...))
    assert answer["residuals"]["normal_deg"][4] is None
    assert answer["residuals"]["normal_deg"][0] is not None


def test_blind_is_a_problem_without_vision():
    problem = changed("vision", ...)
    (answer,) = corrected(problem)
    assert answer["consistent"]
    assert max(map(abs, answer["residuals"]["distance"])) < 0.003
    assert sum(h["weight"] for h in answer["hypotheses"]) == pytest.approx(1)


def test_a_budget_that_is_over_says_so_in_converged():
    blind = changed("vision", ...)
    cut, whole = corrected({**blind, "budget": 1e-9}, {**blind, "budget": 60})
    assert not cut["converged"]
    assert whole["converged"]


@pytest.mark.parametrize("method", ["paper-lm", "paper-gd", "paper-lm-distance", "paper-gd-distance"])
def test_the_papers_methods_answer_in_the_same_form(method):
    (answer,) = corrected({**BOX, "method": method})
    assert list(answer) == KEYS


def test_the_papers_methods_ask_for_two_contacts_and_ours_for_one():
    one = changed("contacts", BOX["contacts"][:1])
    ours, papers = corrected(one, {**one, "method": "paper-lm"})
    assert len(ours["unobservable"]) == 3
    assert "at least 2 fingers" in papers["error"]


def test_a_fault_of_ours_costs_its_line_only(monkeypatch):
    def faulty(problem):
        raise ZeroDivisionError("no")

    monkeypatch.setattr(problems, "answer", faulty)
    text = problems.answer_text(problems.Reader(Path()), json.dumps(BOX).encode())
    assert "line: expected an answer, got ZeroDivisionError: no" in json.loads(text)["error"]


def test_planes_and_weight_count_as_they_do_in_correct_pose():
    """A table under the box and its centre of mass, each of which the pose that vision alone gives contradicts."""
    plane = {"point": [0, 0, -0.07], "normal": [0, 0, 2.0], "sigma": 0.002}
    weight = {"center_object": [0, 0, 0], "center_palm": [0, 0, 0.001], "sigma": 0.002}
    alone = changed("contacts", BOX["contacts"][:1])
    (bare,), (with_plane,), (with_weight,) = (
        corrected(problem) for problem in (alone, {**alone, "planes": [plane]}, {**alone, "weight": weight})
    )
    vision = hs.PosePrior.from_sigmas(
        hs.se3.from_position_quaternion(BOX["vision"]["position"], BOX["vision"]["quaternion_xyzw"]),
        0.03,
        np.deg2rad(15),
    )
    contacts = hs.Contacts(
        [BOX["contacts"][0]["point"]], [[1.0, 0, 0]], sigma_point=1e-3, sigma_normal=np.deg2rad(5)
    )
    model = hs.ObjectModel.box(BOX["object"]["box"])
    outside = hs.Outside(planes=[hs.Plane(plane["point"], plane["normal"], plane["sigma"])])
    evidence = hs.WeightEvidence(weight["center_object"], weight["center_palm"], 4e-6 * np.eye(3))
    for answer, given in (
        (bare, {}),
        (with_plane, {"outside": outside}),
        (with_weight, {"weight": evidence}),
    ):
        expected = hs.correct_pose(model, contacts, vision=vision, **given)
        np.testing.assert_allclose(answer["position"], expected.T_palm_object[:3, 3], atol=1e-12)
    assert np.linalg.norm(with_weight["position"]) < 0.2 * np.linalg.norm(bare["position"])


def test_a_line_takes_depth_points_and_taxels(tmp_path):
    T, six = np.eye(4), [5e-4, 5e-4, 5e-4, 0.02, 0.02, 0.02]
    rows = {
        "depth": {"points_palm": [[0.0, 0.0, 0.061], [0.01, 0.0, 0.061]], "sigma": 0.002},
        "skin": {
            "contacts": [{"point": [-0.03, 0.0, 0.0]}],
            "untouched_palm": [[0.0, 0.05, 0.0]],
            "sigmas": six,
        },
    }
    line = {
        "object": {"box": [0.06, 0.08, 0.12]},
        "contacts": [{"point": [0.031, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}],
        "vision": {
            "position": [0, 0, 0],
            "quaternion_xyzw": [0, 0, 0, 1],
            "sigma_position": 0.01,
            "sigma_rotation_deg": 5,
        },
    }
    values = {
        "depth": hs.DepthPoints(rows["depth"]["points_palm"], 0.002),
        "skin": hs.SkinEvidence(hs.Contacts([[-0.03, 0.0, 0.0]]), [[0.0, 0.05, 0.0]], six),
    }
    vision = hs.PosePrior.from_sigmas(T, 0.01, np.deg2rad(5))
    for name, row in rows.items():
        problem = problems.Reader(tmp_path).read(json.dumps({**line, name: row}).encode())
        expected = hs.correct_pose(problem.model, problem.contacts, vision=vision, **{name: values[name]})
        found = problems.answer(problem)
        np.testing.assert_allclose(found["position"], expected.T_palm_object[:3, 3], atol=1e-12)


def test_a_line_takes_all_that_correct_pose_takes():
    """The model is its `object`; `outside` is points and planes; two keys are of the contacts."""
    import inspect

    keys = {field.name for field in msgspec.structs.fields(problems.ProblemFields)}
    arguments = set(inspect.signature(hs.correct_pose).parameters)
    assert keys - {"planes", "contacts_of_residual", "shared_covariance"} == arguments - {"model"} | {
        "object"
    }


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (
            {"planes": [{"point": [0, 0, 0], "normal": [0, 0, 0], "sigma": 1e-3}]},
            "planes[0].normal: expected a direction",
        ),
        (
            {"planes": [{"point": [0, 0, 0], "normal": [0, 0, 1], "sigma": 0}]},
            "planes[0].sigma: expected a number above 0",
        ),
        (
            {"weight": {"center_object": [0, 0, 0], "center_palm": [0, 0, 0]}},
            "weight: expected a sigma or a covariance",
        ),
        (
            {"weight": {"center_object": [0, 0, 0], "center_palm": [0, 0, "x"], "sigma": 1e-3}},
            "weight.center_palm: expected 3 finite numbers",
        ),
    ],
)
def test_wrong_planes_and_weights_are_named(change, error):
    (answer,) = corrected({**BOX, **change})
    assert answer["error"].startswith(error)
