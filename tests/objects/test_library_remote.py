"""A library at a URL is used from its copy, which is the library that was added there; otherwise an error says why not."""

import shutil
import time

import numpy as np
import pytest

from handsight.errors import HandsightError, InvalidFile, InvalidInput, MissingExtra, NotWritten
from handsight.objects import Facts, Library, ObjectModel
from handsight.objects.library import remote
from objects.libraries import block, bop, served


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
    return sorted(path for path in cache.glob("library/*/*") if path.is_file())


def test_a_requested_object_is_fetched_once_and_nothing_else_is(ours, cache):
    with served(ours) as (url, asked):
        model = Library(url).model("block")
        np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), [0.06, 0.09, 0.14])
        assert asked == [
            f"/models/{name}" for name in ("models_info.json", "handsight.json", "obj_000001.ply")
        ]
        assert Library(url).entry("block").facts.licence == "CC0"
        assert ObjectModel.from_library("block", url).name == "block"
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
        with pytest.raises(InvalidInput, match="expected an object of http"):
            Library(url).entry("third")
        asked.clear()
        assert Library(url).fetch() == []
        assert asked[2:] == ["/models/obj_000003.ply"]
        assert Library(url).model("third").closed


def test_a_bop_data_set_is_used_from_a_url_too(tmp_path, cache):
    with served(bop(tmp_path / "bop")) as (url, asked):
        assert Library(f"{url}/").model("obj_000005").closed
        assert Library(f"{url}/models").model("5").closed
        count = len(asked)
        assert Library(f"{url}/").model("5").closed
        assert len(asked) == count
    assert len(files(cache)) == 1, "the same file of two libraries is kept once"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            {"1.ply": (b"ply\n", 4)},
            r"obj_000001\.ply: expected the SHA-256 \w+…, got \w+…: changed since it was added",
        ),
        ({"1.ply": (b"x" * 10**5, 10**5)}, r"obj_000001\.ply: expected at most \d+ bytes, got more"),
        ({"1.ply": 404}, r"obj_000001\.ply: cannot be read: no such file"),
        ({"1.ply": 500}, r"obj_000001\.ply: cannot be fetched: Internal Server Error"),
        (
            {"1.ply": (b"ply\n", 400)},
            r"obj_000001\.ply: cannot be fetched: it ended 396 bytes early|IncompleteRead",
        ),
    ],
)
def test_a_model_that_is_not_the_added_one_is_refused_and_the_others_are_read(ours, cache, wrong, said):
    with served(ours, wrong) as (url, _):
        with pytest.raises(InvalidFile, match=said):
            Library(url).model("block")
        (sentence,) = Library(url).fetch()
        assert sentence.startswith(url)
        assert Library(url).model("small").closed
    assert [path.name for path in files(cache)] == ["obj_000002.ply"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"models_info.json": 404}, r"^http\S+: expected a library, with models/models_info\.json, got none$"),
        ({"models_info.json": 500}, r"models_info\.json: cannot be fetched: Internal Server Error"),
        ({"models_info.json": (b"{", 1)}, r"models_info\.json: expected JSON, got other text"),
        ({"models_info.json": (b"[]", 2)}, r"models_info\.json: expected an object \{\.\.\.\}, got \[\]"),
        ({"models_info.json": (b'{"../../x": {"diameter": 1}}', 28)}, "expected numbers of objects as keys, got '../../x'"),
        ({"handsight.json": (b'{"version": 2, "objects": {}}', 29)}, r"handsight\.json: version: expected 1, got 2"),
        ({"handsight.json": 500}, r"handsight\.json: cannot be fetched"),
    ],
)  # fmt: skip
def test_malformed_documents_are_refused(ours, wrong, said):
    with served(ours, wrong) as (url, _), pytest.raises(InvalidFile, match=said):
        Library(url).entries()


def test_documents_above_the_size_limit_are_refused(ours, monkeypatch):
    monkeypatch.setattr(remote, "LARGEST_DOCUMENT", 100)
    with (
        served(ours) as (url, _),
        pytest.raises(InvalidFile, match=r"info\.json: expected at most 100 bytes, got more"),
    ):
        Library(url).entries()


def test_a_model_of_a_bop_data_set_above_the_size_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(remote, "LARGEST_FILE", 100)
    with (
        served(bop(tmp_path)) as (url, _),
        pytest.raises(InvalidFile, match=r"1\.ply: expected at most 100 bytes, got more"),
    ):
        Library(url).model("1")


def test_a_fetched_library_stays_if_fetching_it_again_fails(ours):
    with served(ours) as (url, _):
        Library(url).fetch()
    with pytest.raises(InvalidFile, match="cannot be fetched: .*refused"):
        Library(url).fetch()
    assert Library(url).model("block").closed


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
def test_a_damaged_copy_is_fetched_again(ours, cache, spoil):
    with served(ours) as (url, asked):
        Library(url).fetch()
        for path in [*files(cache), *cache.glob("library/*.msgpack")]:
            path.write_bytes(spoil(path.read_bytes()))
        asked.clear()
        assert Library(url).model("block").closed
        assert len(asked) == 3


def test_a_cache_that_cannot_be_written_is_reported(ours, cache):
    cache.mkdir(exist_ok=True)
    (cache / "library").write_text("a file where a folder should be")
    with served(ours) as (url, _), pytest.raises(NotWritten, match="library: cannot be written: "):
        Library(url).model("block")


def test_a_folder_is_a_url_too(ours):
    assert Library(ours.as_uri()).model("small").closed
    with pytest.raises(InvalidFile, match="nowhere: expected a library"):
        Library((ours / "nowhere").as_uri()).entries()


def test_other_kinds_of_urls_are_opened_by_fsspec(ours, monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="other URLs need fsspec: pip install 'handsight[library]'")
    there = fsspec.filesystem("memory")
    there.put(str(ours), "/shelf", recursive=True)
    try:
        assert Library("memory://shelf").model("small").closed
        with pytest.raises(InvalidFile, match="memory://none: expected a library"):
            Library("memory://none").entries()
    finally:
        there.rm("/shelf", recursive=True)
    with pytest.raises(InvalidFile, match="nonsense://shelf/models/models_info.json: cannot be fetched: "):
        Library("nonsense://shelf").entries()
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    with pytest.raises(MissingExtra, match=r"memory:// needs fsspec: pip install 'handsight\[library\]'"):
        Library("memory://other").entries()


@pytest.mark.parametrize("inner", ["", "data/ycb"])
def test_a_library_may_be_in_an_archive(tmp_path, inner):
    pytest.importorskip("fsspec", reason="other URLs need fsspec: pip install 'handsight[library]'")
    bop(tmp_path / "packed" / inner)
    archive = shutil.make_archive(str(tmp_path / "ycb"), "zip", tmp_path / "packed")
    url = f"zip://{inner}::file://{archive}"
    assert Library(url).model("5").closed
    assert Library(url.replace("::", "/models::" if inner else "models::")).model("5").closed
    with pytest.raises(InvalidFile, match="expected a library"):
        Library(f"zip://nowhere::file://{archive}").entries()


@pytest.mark.parametrize(
    "url",
    [
        "http://",
        "http://[",
        "http://a b/",
        "https://127.0.0.1:1",
        "http://127.0.0.1:x",
        "http://é/",
    ],
)
def test_a_malformed_url_is_refused(url):
    with pytest.raises(InvalidFile, match="models_info.json: cannot be fetched: |expected a library"):
        Library(url).entries()


def test_calls_that_only_a_url_or_only_a_folder_allows_are_refused_for_the_other(ours, tmp_path):
    with pytest.raises(InvalidInput, match=r"ours: expected a URL, such as https://\.\.\., got a folder"):
        Library(ours).fetch()
    with pytest.raises(InvalidInput, match="^https://a: expected a folder to add to, got a URL"):
        Library("https://a").add(block(tmp_path), Facts(name="block"))


def test_threads_that_fetch_at_the_same_time_have_complete_files(ours):
    import threading

    with served(ours) as (url, _):
        found = []
        threads = [threading.Thread(target=lambda: found.append(Library(url).fetch())) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert found == [[]] * 6
        shutil.rmtree(ours)
        assert Library(url).model("block").closed


def test_a_server_that_drips_holds_no_fetch_beyond_its_deadline(ours, monkeypatch):
    monkeypatch.setattr(remote, "PATIENCE", 0.5)
    monkeypatch.setattr(remote, "SLOWEST", 1e9)

    def drip():
        for _ in range(40):
            time.sleep(0.1)
            yield b" "

    with served(ours, {"models_info.json": drip}) as (url, _):
        began = time.monotonic()
        with pytest.raises(InvalidFile, match=r"models_info\.json: cannot be fetched: it took more than 1 s"):
            Library(url).entries()
        assert time.monotonic() - began < 3.0


def test_a_redirect_to_another_host_is_refused_unless_it_was_named(ours, monkeypatch):
    with served(ours) as (url, asked):
        other = url.replace("127.0.0.1", "localhost")
        with served(ours, {"models_info.json": other}) as (redirecting, _):
            with pytest.raises(InvalidFile, match=rf"no redirect to another host .*, got {other[7:]}"):
                Library(redirecting).entries()
            assert asked == []
            monkeypatch.setenv("HANDSIGHT_REDIRECTS", f"example.org {other[7:]}")
            assert Library(redirecting).entry("block").name == "block"


def test_a_redirect_within_a_host_is_followed(ours):
    moved = {"/moved/models/models_info.json": "/models/models_info.json"}
    with served(ours, moved) as (url, _):
        assert [entry.number for entry in Library(f"{url}/moved").entries()] == [1, 2]


@pytest.mark.parametrize("kind", ["http", "https", "ftp", "memory"])
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
