"""`handsight objects weigh`: an object's mass and its centre, from a recording into a library."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cli.commands import called
from cli.tracks import recorded
from handsight.forces import ObjectWeight
from handsight.objects import Facts, Library
from handsight.rig.save import write as write_rig
from handsight.simulation import Scenario, rig_of

SCENARIO = Scenario(object="box", seed=2, motion="weigh", rate=50)


@pytest.fixture
def lifted(simulated, tmp_path):
    """A recording of a box that is lifted and tilted, its rig, and a library with the box."""
    samples = [sample.observation for sample in simulated(SCENARIO) if sample.observation.stamp < 8.8]
    write_rig(rig_of(SCENARIO), tmp_path / "lifted.rig.yaml")
    recorded(tmp_path / "lifted.mcap", samples, rig_of(SCENARIO))
    trimesh.creation.box((0.06, 0.09, 0.14)).export(tmp_path / "box.stl")
    Library(tmp_path / "things").add(tmp_path / "box.stl", Facts(name="tea", licence="mine"))
    return tmp_path, samples


@pytest.mark.slow
def test_an_object_is_weighed_into_its_library(lifted, monkeypatch, capsys):
    folder, samples = lifted
    command = "objects", "weigh", "lifted.mcap", "--object", "tea", "--library", "things"
    assert called(monkeypatch, folder, *command) == 0
    said = capsys.readouterr()
    facts = Library(folder / "things").entry("tea").facts
    assert facts.mass == pytest.approx(0.15, rel=0.05)
    # The centre is written if it is known well enough, and the reason is said if it is not.
    assert (facts.center_of_mass is None) == ("centre of mass is not written: " in said.err)
    if facts.center_of_mass is not None:
        assert np.linalg.norm(facts.center_of_mass) < 4 * facts.sigma_center_of_mass
    assert facts.licence == "mine"
    assert list(Library(folder / "things").wrong(Library(folder / "things").entries())) == []
    assert "tea: 14" in said.err or "tea: 15" in said.err
    table = [sample for sample in samples if sample.stamp < 1.9]
    recorded(folder / "table.mcap", [replace(sample) for sample in table], rig_of(SCENARIO))
    write_rig(rig_of(SCENARIO), folder / "table.rig.yaml")
    again = "objects", "weigh", "table.mcap", "--object", "tea", "--library", "things"
    assert called(monkeypatch, folder, *again) == 2
    assert "got none: the object was never in the air" in capsys.readouterr().err


def weighed(sigma_mass=0.005, sigma_palm=0.002, sigma=0.004, directions=3):
    """A weighing of 280 g with these standard deviations [kg, m]: of the centre in the palm, and in the object."""
    center = np.array([0.0, 0.0, 0.01])
    return ObjectWeight(
        mass=0.28,
        sigma_mass=sigma_mass,
        center_object=center,
        covariance=sigma**2 * np.eye(3),
        center_palm=center,
        covariance_palm=sigma_palm**2 * np.eye(3),
        directions=directions,
        reason="",
        biased=(),
    )


@pytest.mark.parametrize(
    ("weight", "reason", "written", "why"),
    [
        (weighed(), "", ("mass", "centre"), ""),
        (weighed(sigma=0.03), "", ("mass",), "where the object is"),
        (weighed(sigma_palm=0.03, sigma=0.04), "", ("mass",), "tilt the hand"),
        (weighed(directions=1), "gravity had one direction", ("mass",), "gravity had one direction"),
        (weighed(sigma_mass=0.05), "", (), "expected a mass known to 10%"),
    ],
    ids=["both known", "pose unknown", "loads unknown", "one direction", "mass unknown"],
)
def test_mass_and_centre_are_written_each_by_itself_with_the_true_reason(
    lifted, monkeypatch, capsys, weight, reason, written, why
):
    folder, _ = lifted
    monkeypatch.setattr("handsight.tracking.best_weight", lambda *_: (weight, reason))
    command = "objects", "weigh", "lifted.mcap", "--object", "tea", "--library", "things"
    assert called(monkeypatch, folder, *command) == (0 if written else 2)
    facts = Library(folder / "things").entry("tea").facts
    known = {"mass": facts.mass is not None, "centre": facts.center_of_mass is not None}
    assert [name for name, there in known.items() if there] == list(written)
    assert why in capsys.readouterr().err


def test_what_is_known_of_an_object_is_replaced_and_the_rest_stays(tmp_path):
    trimesh.creation.box((0.06, 0.09, 0.14)).export(tmp_path / "box.stl")
    library = Library(tmp_path / "things")
    library.add(tmp_path / "box.stl", Facts(name="tea", source="a shop", mass=0.3))
    library.add(tmp_path / "box.stl", Facts(name="other"))
    before = library.entry("other").facts
    entry = library.weigh("tea", 0.151234567, np.array([0.001, 0.0, 0.01]), 0.002)
    assert (entry.facts.mass, entry.facts.source) == (0.151235, "a shop")
    assert entry.facts.center_of_mass == (0.001, 0.0, 0.01)
    assert library.entry("other").facts == before
    assert library.model("tea").sigma_center_of_mass == 0.002
    assert list(library.wrong(library.entries())) == []
