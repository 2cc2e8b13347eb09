"""What takes long of an object's appearance is kept on disk, and made anew where it is spoilt."""

import numpy as np
import pytest

import handsight as hs
from handsight._kernels import look_score
from handsight.objects import ObjectWarning, cache
from handsight.vision import appearance


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_warned", set())
    return tmp_path / "cache"


def looked_at(monkeypatch):
    """Its visible samples, and how often they were worked out."""
    calls, kernel = [], look_score.visible_sets
    with monkeypatch.context() as patch:
        patch.setattr(look_score, "visible_sets", lambda *a: (calls.append(1), kernel(*a)))
        model = hs.ObjectModel.box((0.05, 0.04, 0.02))
        return appearance.appearance_of.__wrapped__(model).sides[2], len(calls)


def test_it_is_worked_out_once(folder, monkeypatch):
    first, calls = looked_at(monkeypatch)
    again, none = looked_at(monkeypatch)
    assert (calls, none) == (1, 0)
    np.testing.assert_array_equal(first, again)
    assert again.dtype == np.bool_
    assert again.shape == (appearance.DIRECTIONS, appearance.SAMPLES)


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-1], lambda data: b"", lambda data: data[:50] + b"?" + data[51:]]
)
def test_a_spoilt_file_is_made_anew(folder, monkeypatch, spoil):
    first, _ = looked_at(monkeypatch)
    (kept,) = folder.glob("bits-*")
    kept.write_bytes(spoil(kept.read_bytes()))
    again, calls = looked_at(monkeypatch)
    assert calls == 1
    np.testing.assert_array_equal(first, again)
    assert looked_at(monkeypatch)[1] == 0


def test_where_nothing_can_be_kept_it_is_said_once(folder, monkeypatch):
    folder.parent.mkdir(exist_ok=True)
    folder.write_text("a file")
    with pytest.warns(ObjectWarning, match="what objects look like cannot be cached there"):
        looked_at(monkeypatch)
