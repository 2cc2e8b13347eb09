"""What `handsight track` says of slips."""

import itertools
from types import SimpleNamespace

import pytest

from handsight.cli.track import TrackResult
from handsight.forces import Slip
from handsight.tracking import Tally


def steps():
    """Ten a second; two slips, the first of four samples, the second of one."""
    said = [Slip(False, {"ff": 0.5, "th": 0.7}, 0.8)] * 3
    said += [Slip(True, {"ff": 0.97}, 0.8, 1000.3)] * 4
    said += [Slip(False, {"ff": 0.5}, 0.8, 1000.3, 1000.7)] * 2
    said += [Slip(True, {"ff": 1.0}, 0.8, 1000.9, 1000.7), Slip(False, {"ff": 0.4}, 0.81, 1000.9, 1001.0)]
    nothing = {"fingers": (), "rejected": (), "pressed": False}
    return [SimpleNamespace(stamp=1000 + k / 10, slip=slip, **nothing) for k, slip in enumerate(said)]


def tracker():
    """A tracker that has done nothing but follow."""
    nothing = {
        "corrections": 0,
        "images": {},
        "skin": SimpleNamespace(faults={}),
        "rig": SimpleNamespace(fingers={}),
        "model": SimpleNamespace(sigma_scale=None),
    }
    return SimpleNamespace(**nothing)


def result_of(steps):
    result = TrackResult("pulled", Tally(), [], tracker())
    for step in steps:
        result.add(step)
    return result


def test_a_long_track_keeps_some_thousands_of_its_steps_evenly():
    step = steps()[0]
    result = result_of(SimpleNamespace(**{**vars(step), "stamp": float(k)}) for k in range(50_000))
    assert result.poses == 50_000
    assert 2000 <= len(result.steps) < 4000
    assert {b.stamp - a.stamp for a, b in itertools.pairwise(result.steps)} == {16.0}


def test_slips_are_counted_and_said():
    run = result_of(steps())
    assert run.slips == {1000.3: pytest.approx(0.3, abs=1e-6), 1000.9: pytest.approx(0.0, abs=1e-6)}
    assert "the object slipped 2x, 0.30 s in all, first at 0.30 s; friction 0.81" in run.sentences()
    once = result_of(steps()[:9])
    assert any(sentence.startswith("the object slipped 1x, 0.30 s") for sentence in once.sentences())
    summary = run.summary()
    assert summary["friction"] == 0.81
    assert summary["slips"] == [{"began": 1000.3, "seconds": 0.3}, {"began": 1000.9, "seconds": 0.0}]


def test_where_nothing_slipped_nothing_is_said():
    run = result_of(steps()[:3])
    assert not run.slips
    assert not any("slip" in sentence for sentence in run.sentences())
    assert TrackResult("nothing", Tally(), [], tracker()).friction is None
