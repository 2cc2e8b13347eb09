"""An index over shape names the few objects of a library that a depth image may show, and loads no others."""

import numpy as np
import pytest

from handsight import se3
from handsight.cli.options import find_models
from handsight.errors import InvalidFile
from handsight.objects import Library
from handsight.vision import ShapeIndex, recognise
from handsight.vision.object import shape_index
from handsight.vision.object.region import scene_of
from objects.libraries import bop
from objects.object_shapes import box_mesh
from sight_scenes import CAMERA, noisy

SIZES = np.random.default_rng(1).uniform(30, 120, (40, 3)).round()


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Forty boxes."""
    return Library(bop(tmp_path_factory.mktemp("boxes"), SIZES))


@pytest.fixture(autouse=True)
def fewer_views(monkeypatch):
    """A third of them, in a third of the time."""
    monkeypatch.setattr(shape_index, "SHAPE_INDEX", shape_index.SHAPE_INDEX._replace(views=33))


@pytest.fixture
def names_alone(monkeypatch):
    """Models are not loaded: only their names are asked for."""
    monkeypatch.setattr(ShapeIndex, "__getitem__", lambda self, name: name)


def ranked(index, pictures):
    """The place of each box in what the index names for its picture; 99: not named."""
    found = [list(index.nearest(scene_of(CAMERA, depth))) for depth in pictures]
    return np.array([n.index(name) if name in n else 99 for n, name in zip(found, index, strict=True)])


def picture(size, rng, hidden=0.0):
    """A depth image of a box of that size [mm], alone and turned at random; a share is hidden beyond an edge."""
    T, (vertices, faces) = se3.random(rng, 1)[0], box_mesh(size / 1000)
    T[:3, 3] = [0.03, -0.02, rng.uniform(0.4, 0.6)]
    depth = CAMERA.draw(se3.apply(T, vertices), faces).depth
    along = np.where(np.isfinite(depth), np.indices(depth.shape)[rng.integers(2)], np.nan)
    depth[~(along >= np.nanquantile(along, hidden))] = 0
    return noisy(depth.astype(np.float32), rng)


def test_a_descriptor_is_in_metres_and_the_same_however_the_camera_is_turned_about_the_ray(rng):
    points = rng.normal(size=(500, 3)) * [0.05, 0.03, 0.02] + [0.1, 0.05, 0.6]
    once, ray = shape_index.described(points), points.mean(axis=0) / np.linalg.norm(points.mean(axis=0))
    R = se3.rotation_exp(2.0 * ray)
    np.testing.assert_allclose(shape_index.described(points @ R.T), once, atol=1e-12)
    np.testing.assert_allclose(shape_index.described(2 * points), 2 * once, atol=1e-12)
    assert np.abs(shape_index.described(points * [1.2, 1, 1]) - once).max() > 1e-3


def test_the_object_that_is_there_is_among_the_nearest(library, rng, names_alone):
    index = ShapeIndex(library)
    ranks = ranked(index, [picture(size, rng) for size in SIZES])
    assert index.shortlist == len(SIZES)
    assert np.mean(ranks < len(SIZES) / 4) >= 0.9
    assert np.mean(ranks < len(SIZES)) >= 0.95


def test_a_partly_hidden_object_is_nearer_because_its_views_are_hidden_too(
    library, rng, names_alone, monkeypatch
):
    pictures = [picture(size, rng, hidden=0.2) for size in SIZES]
    ranks = ranked(ShapeIndex(library), pictures)
    assert np.mean(ranks < len(SIZES) / 4) >= 0.8
    monkeypatch.setattr(shape_index, "SHAPE_INDEX", shape_index.SHAPE_INDEX._replace(hidden=()))
    assert np.mean(ranks) < 0.7 * np.mean(ranked(ShapeIndex(library), pictures))


def test_occluders_hide_their_share_of_a_view_and_move_no_point(rng):
    views = rng.normal(size=(3, 50, 3)).astype(np.float32)
    for share, parts in zip((0.12, 0.25), shape_index.partly_hidden(views, rng), strict=True):
        assert parts.shape == (3, shape_index.SHAPE_INDEX.occluders, 50 - int(share * 50), 3)
        for view, each in zip(views, parts, strict=True):
            rows = set(map(tuple, view))
            assert all(len(set(map(tuple, part)) & rows) == len(part) for part in each)


def test_a_sheet_that_is_thinner_than_a_pixel_has_descriptors():
    sheet = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 1e-6, 0], [0, 1e-6, 0]])
    assert np.isfinite(shape_index.described_views(sheet, np.array([[0, 1, 2], [0, 2, 3]]))).all()


def test_recognition_searches_those_alone_and_names_the_right_one(library, rng, monkeypatch):
    monkeypatch.setattr(shape_index, "SHAPE_INDEX", shape_index.SHAPE_INDEX._replace(shortlist=2))
    index = ShapeIndex(library)
    name, built = list(index)[7], []
    model = Library.model
    monkeypatch.setattr(Library, "model", lambda self, entry: built.append(entry.name) or model(self, entry))
    answer = recognise(index, picture(SIZES[7], rng), CAMERA)
    assert answer.name == name
    assert set(answer.scores) == set(built)
    assert len(built) == 2
    assert answer.none + sum(answer.scores.values()) == pytest.approx(1)
    assert recognise(index, np.zeros(CAMERA.size[::-1], dtype=np.float32), CAMERA).name is None
    assert list(find_models((), library=library.place, index=True)) == list(index)  # without building models


def test_views_are_described_once(library, monkeypatch):
    ShapeIndex(library)
    monkeypatch.setattr(shape_index, "described_views", None)
    ShapeIndex(library)


def test_an_empty_library_is_refused(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/models_info.json").write_text("{}")
    with pytest.raises(InvalidFile, match="expected objects, got an empty library"):
        ShapeIndex(Library(tmp_path))
