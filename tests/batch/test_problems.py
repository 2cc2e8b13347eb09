"""Problems as lines of JSON: their answers, and what is said of a line that is wrong."""

import json
from pathlib import Path

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
    ("change", "field"),
    [
        (("contacts[0].point", [NAN, 0, 0]), "contacts[0].point"),
        (("contacts[0].point", ["a", 0, 0]), "contacts[0].point"),
        (("contacts[0].point", [True, 0, 0]), "contacts[0].point"),
        (("contacts[0].point", [10**400, 0, 0]), "contacts[0].point"),
        (("contacts[1].point", [1e300, 0, 0]), "contacts[1].point"),
        (("contacts[1].normal", [0, 0, 0]), "contacts[1].normal"),
        (("contacts[2].sigma_point", 0), "contacts[2].sigma_point"),
        (("contacts[2].sigma_normal_deg", -5), "contacts[2].sigma_normal_deg"),
        (("contacts[2].colour", "red"), "contacts[2].colour"),
        (("contacts", []), "contacts"),
        (("contacts", {}), "contacts"),
        (("contacts[0].covariance", np.eye(6).tolist()), "contacts[0]"),
        (("contacts[1].covariance", (-np.eye(6)).tolist()), "contacts[1].covariance"),
        (("vision.quaternion_xyzw", [0, 0, 0, 0]), "vision.quaternion_xyzw"),
        (("vision.sigma_position", ...), "vision"),
        (("vision.sigma_position", float("inf")), "vision.sigma_position"),
        (("vision.covariance", np.eye(6).tolist()), "vision"),
        (("object", {}), "object"),
        (("object", {"box": [0.1, 0.1, -0.1]}), "object.box[2]"),
        (("object", {"mesh": "no-such-file.ply"}), "object.mesh"),
        (("object", {"box": [0.1, 0.1, 0.1], "scale": 2}), "object.scale"),
        (("method", "magic"), "method"),
        (("outside", [[0, 0]]), "outside"),
        (("object", ...), "object"),
        (("extra", 1), "extra"),
        (("planes", [{"point": [0, 0, 0], "normal": [0, 0, 0], "sigma": 1e-3}]), "planes[0].normal"),
        (("planes", [{"point": [0, 0, 0], "normal": [0, 0, 1], "sigma": 0}]), "planes[0].sigma"),
        (("weight", {"center_object": [0, 0, 0], "center_palm": [0, 0, 0]}), "weight"),
        (
            ("weight", {"center_object": [0, 0, 0], "center_palm": [0, 0, "x"], "sigma": 1e-3}),
            "weight.center_palm",
        ),
    ],
)
def test_each_wrong_line_names_the_field(change, field):
    (answer,) = corrected(changed(*change))
    assert list(answer) == ["error"]
    assert answer["error"].startswith(f"{field}: ")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[1, 2]", "line"),
        ('{"object": {"box": [1,1,1]}, "object": {"box": [2,2,2]}, "contacts": []}', "object"),
        ("[" * 100_000, "line"),
    ],
)
def test_what_is_no_problem_is_told(text, field):
    (answer,) = corrected(text)
    assert answer["error"].startswith(f"{field}: ")


def test_blind_is_a_problem_without_vision():
    problem = changed("vision", ...)
    (answer,) = corrected(problem)
    assert answer["consistent"]
    assert max(map(abs, answer["residuals"]["distance"])) < 0.003
    assert sum(h["weight"] for h in answer["hypotheses"]) == pytest.approx(1)


@pytest.mark.parametrize("key", ["answer", "samples", "budget", "depth", "contacts_of_residual"])
def test_a_key_that_went_is_refused_with_its_replacement(key):
    (answer,) = corrected({**BOX, key: 1})
    assert list(answer) == ["error"]
    assert answer["error"].startswith(f"{key}: ")
    assert "use" in answer["error"] or "stop" in answer["error"]


def test_an_answer_has_the_maximum_beside_the_mean():
    (answer,) = corrected(BOX)
    assert answer["maximum"].keys() == {"position", "quaternion_xyzw"}


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


def test_a_line_has_groups_as_python_does():
    shared = np.diag([1e-6] * 3 + [1e-4] * 3)
    rows = [row | {"group": k % 2} for k, row in enumerate(BOX["contacts"])]
    line = {**BOX, "contacts": rows, "shared_covariance": shared.tolist()}
    read = problems.Reader(Path()).read(json.dumps(line).encode()).contacts
    np.testing.assert_array_equal(read.group, [0, 1, 0, 1, 0])
    np.testing.assert_allclose(read.shared_covariance, [shared] * 2)


def test_a_line_takes_taxels(tmp_path):
    T, six = np.eye(4), [5e-4, 5e-4, 5e-4, 0.02, 0.02, 0.02]
    rows = {
        "skin": {
            "contacts": [{"point": [-0.03, 0.0, 0.0]}],
            "untouched_palm": [[0.0, 0.05, 0.0]],
            "sigmas": six,
        }
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
    values = {"skin": hs.SkinEvidence(hs.Contacts([[-0.03, 0.0, 0.0]]), [[0.0, 0.05, 0.0]], six)}
    vision = hs.PosePrior.from_sigmas(T, 0.01, np.deg2rad(5))
    for name, row in rows.items():
        problem = problems.Reader(tmp_path).read(json.dumps({**line, name: row}).encode())
        expected = hs.correct_pose(problem.model, problem.contacts, vision=vision, **{name: values[name]})
        found = problems.answer(problem)
        np.testing.assert_allclose(found["position"], expected.T_palm_object[:3, 3], atol=1e-12)
