"""A library at a URL is used from its copy, which is the library that was added there; otherwise an error says why not."""

import sys

import numpy as np
import pytest

from handsight.errors import HandsightError, InvalidFile, InvalidInput, MissingExtra, NotWritten
from handsight.objects import Facts, Library, ObjectWarning
from objects.libraries import block, bop, served

pytest.importorskip("pooch", reason="a library at a URL needs pip install 'handsight[library]'")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache of the test's own, so that files of other tests are not found in it."""
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def ours(tmp_path):
    """A library of two objects in a folder."""
    library = Library(tmp_path / "ours")
    library.add(block(tmp_path), Facts(name="block", licence="CC0"))
    library.add(block(tmp_path, (0.03, 0.04, 0.05)), Facts(name="small"))
    return tmp_path / "ours"


def files(cache):
    return sorted(path for path in cache.glob("library/**/*.ply") if path.is_file())


def test_a_requested_object_is_fetched_once_and_nothing_else_is(ours, cache):
    with served(ours) as (url, asked):
        model = Library(url).model("block")
        np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), [0.06, 0.09, 0.14])
        assert asked == [
            f"/models/{name}" for name in ("models_info.json", "handsight.json", "obj_000001.ply")
        ]
        assert Library(url).entry("block").facts.licence == "CC0"
        assert len(asked) == 3
    assert len(files(cache)) == 1


def test_a_fetched_library_works_without_the_network(ours, cache):
    with served(ours) as (url, _):
        said = []
        assert Library(url).fetch(lambda share, name="": said.append((share, name))) == []
        assert said == [(0, "block"), (0.5, "small")]
    for name in ("block", "small"):
        assert Library(url).model(name).closed
    assert not list(Library(url).wrong(Library(url).entries()))


def test_fetching_again_requests_only_changed_files(ours, tmp_path):
    with served(ours) as (url, asked):
        Library(url).fetch()
        Library(ours).add(block(tmp_path, (0.02, 0.03, 0.04)), Facts(name="third"))
        with pytest.raises(InvalidInput):
            Library(url).entry("third")
        asked.clear()
        assert Library(url).fetch() == []
        assert asked[2:] == ["/models/obj_000003.ply"]
        assert Library(url).model("third").closed


def test_a_bop_data_set_is_trusted_once_and_said(tmp_path):
    with served(bop(tmp_path / "bop")) as (url, asked):
        for place in (f"{url}/", f"{url}/models"):
            with pytest.warns(ObjectWarning):
                assert Library(place).model("obj_000005").closed
        count = len(asked)
        assert Library(f"{url}/").model("5").closed
        assert len(asked) == count


@pytest.mark.parametrize(
    "answer", [(b"ply\n", 4), (b"x" * 10**5, 10**5), 404, 500, (b"ply\n", 400)],
    ids=["other", "larger", "none", "failure", "cut"],
)  # fmt: skip
def test_a_model_that_is_not_the_added_one_is_refused_and_the_others_are_read(ours, cache, answer):
    with served(ours, {"1.ply": answer}) as (url, _):
        with pytest.raises(InvalidFile) as refused:
            Library(url).model("block")
        assert str(refused.value).startswith(f"{url}/models/obj_000001.ply: ")
        (sentence,) = Library(url).fetch()
        assert sentence.startswith(url)
        assert Library(url).model("small").closed
    assert [path.name for path in files(cache)] == ["obj_000002.ply"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"models_info.json": 404},
        {"models_info.json": 500},
        {"models_info.json": (b"{", 1)},
        {"models_info.json": (b"[]", 2)},
        {"models_info.json": (b'{"../../x": {"diameter": 1}}', 28)},
        {"models_info.json": (b"[" + b" " * 30_000_000 + b"]", 30_000_002)},
        {"handsight.json": (b'{"version": 2, "objects": {}}', 29)},
        {"handsight.json": 500},
    ],
)  # fmt: skip
def test_malformed_documents_are_refused(ours, wrong):
    with served(ours, wrong) as (url, _), pytest.raises(InvalidFile) as refused:
        Library(url).entries()
    assert str(refused.value).startswith(url)


def test_a_fetched_library_stays_if_fetching_it_again_fails(ours):
    with served(ours) as (url, _):
        Library(url).fetch()
    with pytest.raises(InvalidFile):
        Library(url).fetch()
    assert Library(url).model("block").closed


@pytest.mark.filterwarnings("ignore:.*trusted as they come first")
def test_a_file_without_a_checksum_is_fetched_again_and_stays_if_that_fails(tmp_path):
    theirs = bop(tmp_path / "bop")
    with served(theirs) as (url, _):
        Library(url).fetch()
        bop(theirs, ((60, 90, 140), (20, 30, 40)))
        assert Library(url).model("5").bounds_object[1, 0] == pytest.approx(0.025)
        Library(url).fetch()
        assert Library(url).model("5").bounds_object[1, 0] == pytest.approx(0.01)
        (theirs / "models/obj_000005.ply").unlink()
        assert len(Library(url).fetch()) == 1
        assert Library(url).model("5").bounds_object[1, 0] == pytest.approx(0.01)


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-9], lambda data: b"", lambda data: data[:60] + b"x" + data[61:]]
)
def test_a_damaged_model_is_fetched_again(ours, cache, spoil):
    with served(ours) as (url, asked):
        Library(url).fetch()
        for path in files(cache):
            path.write_bytes(spoil(path.read_bytes()))
        asked.clear()
        assert Library(url).model("block").closed
        assert asked == ["/models/obj_000001.ply"]


def test_a_cache_that_cannot_be_written_is_reported(ours, cache):
    cache.mkdir(exist_ok=True)
    (cache / "library").write_text("a file where a folder should be")
    with served(ours) as (url, _), pytest.raises(NotWritten):
        Library(url).model("block")


@pytest.mark.parametrize("url", ["s3://bucket/ycbv", "zip://::file:///a.zip", "ftp://a", "nonsense://a"])
def test_another_kind_of_url_is_refused(url):
    with pytest.raises(InvalidInput):
        Library(url)


def test_without_pooch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(MissingExtra) as refused:
        Library("http://127.0.0.1:1/other").entries()
    assert "handsight[library]" in str(refused.value)


@pytest.mark.filterwarnings("ignore:.*trusted as they come first")
def test_a_redirect_is_followed(ours):
    moved = {"/moved/models/models_info.json": "/models/models_info.json"}
    with served(ours, moved) as (url, _):
        assert [entry.number for entry in Library(f"{url}/moved").entries()] == [1, 2]


@pytest.mark.parametrize("kind", ["http", "https"])
def test_no_message_has_a_password(kind):
    library = Library(f"{kind}://user:secret@127.0.0.1:1/lab")
    said = [repr(library), library.place]
    for call in (library.entries, library.fetch, lambda: library.add("a.stl", Facts(name="a"))):
        with pytest.raises(HandsightError) as refused:
            call()
        said.append(str(refused.value))
    assert all("127.0.0.1:1/lab" in each and "secret" not in each and "user" not in each for each in said), (
        said
    )
