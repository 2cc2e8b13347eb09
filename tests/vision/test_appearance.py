"""What takes long of an object's appearance is kept on disk, and made anew where it is spoilt."""

import numpy as np
import pytest

import handsight as hs
from handsight._kernels.image import votes
from handsight.objects import ObjectWarning, cache
from handsight.vision.object import appearance


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_warned", set())
    return tmp_path / "cache"


def looked_at(monkeypatch):
    """Its visible samples and pairs, and how often each were worked out."""
    calls = []
    with monkeypatch.context() as patch:
        for room, name in ((appearance, "visible_sets"), (votes, "pairs_of")):
            kernel = getattr(room, name)
            patch.setattr(room, name, lambda *a, kernel=kernel, name=name: calls.append(name) or kernel(*a))
        model = hs.ObjectModel.box((0.05, 0.04, 0.02))
        found = appearance.appearance_of.__wrapped__(model)
    return (found.sides[2], *found.pairs), [calls.count(name) for name in ("visible_sets", "pairs_of")]


def same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


def test_it_is_worked_out_once(folder, monkeypatch):
    first, calls = looked_at(monkeypatch)
    again, none = looked_at(monkeypatch)
    assert (calls, none) == ([1, 1], [0, 0])
    same(first, again)
    assert again[0].shape == (appearance.DIRECTIONS, appearance.SAMPLES // 8)


@pytest.mark.parametrize(("kind", "made"), [("bits-*", [1, 0]), ("numbers-*", [0, 1])])
@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-1], lambda data: b"", lambda data: data[:50] + b"?" + data[51:]]
)
def test_a_spoilt_file_is_made_anew(folder, monkeypatch, spoil, kind, made):
    first, _ = looked_at(monkeypatch)
    (kept,) = folder.glob(kind)
    kept.write_bytes(spoil(kept.read_bytes()))
    again, calls = looked_at(monkeypatch)
    assert calls == made
    same(first, again)
    assert looked_at(monkeypatch)[1] == [0, 0]


def test_where_nothing_can_be_kept_it_is_said_once(folder, monkeypatch):
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr(cache, "write_entry", full)
    with pytest.warns(ObjectWarning, match="appearances of objects cannot be cached there"):
        looked_at(monkeypatch)
