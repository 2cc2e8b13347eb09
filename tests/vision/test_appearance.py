"""What takes long of an object's appearance is kept on disk, and made anew where it is spoilt."""

import dataclasses

import numpy as np
import pytest

import handsight as hs
from handsight.objects import ObjectWarning, cache
from handsight.vision.object import appearance


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def looked_at():
    """Its visible samples and pairs."""
    # A copy: what is known of an object is kept with it.
    found = appearance.appearance_of(dataclasses.replace(hs.ObjectModel.box((0.05, 0.04, 0.02))))
    return found.sides[2], *found.pairs


def written(folder):
    """When each file was written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


def test_it_is_worked_out_once(folder):
    first, before = looked_at(), written(folder)
    again = looked_at()
    assert len(before) >= 2
    assert written(folder) == before
    same(first, again)
    assert again[0].shape == (appearance.DIRECTIONS, appearance.SAMPLES // 8)


@pytest.mark.parametrize("kind", ["bits-*", "numbers-*"])
@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-1], lambda data: b"", lambda data: data[:50] + b"?" + data[51:]]
)
def test_a_spoilt_file_is_made_anew_and_no_other(folder, spoil, kind):
    first = looked_at()
    (kept,) = folder.glob(kind)
    good, before = kept.read_bytes(), written(folder)
    kept.write_bytes(spoil(good))
    same(first, looked_at())
    assert kept.read_bytes() == good
    after = written(folder)
    assert {name for name in after if after[name] != before[name]} == {kept.name}


def test_where_nothing_can_be_kept_it_is_said_once(folder, monkeypatch):
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr(cache, "write_entry", full)
    with pytest.warns(ObjectWarning):
        looked_at()
