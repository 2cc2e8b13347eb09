"""Compiled kernels are kept on disk, whatever state the disk is in, and warming up leaves none to compile.

How kernels are kept is one way for all of them, so a small one stands for all: the correction's takes most of a minute.
"""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

KERNEL = """
import sys
import numpy as np
from handsight._kernels.runtime.compilation import entry

@entry
def doubled(values):
    total = 0.0
    for value in values:
        total += 2 * value
    return total

@entry
def tripled(values):
    total = 0.0
    for value in values:
        total += 3 * value
    return total

values = np.ones(3, dtype=sys.argv[1] if len(sys.argv) > 1 else "f8")
hits = sum(sum(kernel.stats.cache_hits.values()) for kernel in (doubled, tripled) for _ in [kernel(values)])
print(doubled(values), tripled(values), hits)
"""
COMPILED, LOADED, HALF = "6.0 9.0 0\n", "6.0 9.0 2\n", "6.0 9.0 1\n"


NAMESAKES = """
import sys
import numpy as np
from handsight._kernels.runtime.compilation import entry, inner

@inner
def summed(row):  # too long to be inlined
    total = 0.0
STATEMENTS
    return total

@entry
def before(rows):
    return summed(rows[0]) + summed(rows[1])

@entry
def after(rows):
    return summed(rows[0]) + summed(rows[1])

kernels = {"before": (before, ["wanted", "other"]), "after": (after, ["other", "wanted"])}
for name in sys.argv[1:]:
    kernel, fields = kernels[name]
    rows = np.zeros(2, dtype=[(field, "f8") for field in fields])
    rows["wanted"] = 1.0
    print(kernel(rows))
""".replace("STATEMENTS", "\n".join(f"    total += np.sin(row.wanted + {k} * total)" for k in range(1, 30)))


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    small, namesakes = (tmp_path_factory.mktemp("program") / name for name in ("small.py", "namesakes.py"))
    small.write_text(KERNEL)
    namesakes.write_text(NAMESAKES)

    def start(folder, *arguments):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONHASHSEED": "0"}
        program = namesakes if {*arguments} & {"before", "after"} else small
        command = [sys.executable, "-W", "always", program, *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, env=environment, text=True, **pipes)

    return start


@pytest.fixture(scope="module")
def ran(started):
    def run(folder, *arguments):
        with started(folder, *arguments) as process:
            out, said = process.communicate(timeout=100)
        assert process.returncode == 0, said
        return out, said

    return run


@pytest.fixture(scope="module")
def compiled_once(ran, tmp_path_factory):
    folder = tmp_path_factory.mktemp("once")
    assert ran(folder) == (COMPILED, "")
    return folder


@pytest.fixture
def kept(compiled_once, tmp_path):
    """A folder of kept kernels, and by kernel its file."""
    shutil.copytree(compiled_once, tmp_path / "kept")
    files = {path.name.split(".")[-3]: path for path in (tmp_path / "kept").rglob("*.nbc")}
    assert sorted(files) == ["doubled", "tripled"]
    return tmp_path / "kept", files


def test_a_kernel_is_compiled_once_and_then_loaded(ran, kept):
    assert ran(kept[0]) == (LOADED, "")


def test_kernels_compiled_in_different_processes_call_functions_of_their_own(ran, tmp_path):
    """In each process the same number, and so the same name of `summed`, is that of another type."""
    (alone, _), (other, _) = ran(tmp_path, "before"), ran(tmp_path, "after")
    assert alone == other
    assert ran(tmp_path, "before", "after")[0] == alone + other


def test_where_kernels_cannot_be_kept_a_temporary_folder_is_used_and_one_warning_says_so(
    ran, tmp_path, monkeypatch
):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for expected in (COMPILED, LOADED):
        out, said = ran(tmp_path / "file" / "below")
        assert out == expected
        assert said.count("cannot be written") == said.count("Warning") == 1


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="modes as POSIX has them")
def test_kernels_that_others_can_write_are_not_run(ran, kept, tmp_path, monkeypatch):
    next(kept[0].glob("kernels-*")).chmod(0o777)
    for file in kept[1].values():
        file.write_bytes(b"theirs")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for expected in (COMPILED, LOADED):
        out, said = ran(kept[0])
        assert out == expected
        assert said.count("others can write to") == said.count("Warning") == 1
    assert all(file.read_bytes() == b"theirs" for file in kept[1].values())


def flipped(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        flipped,
        lambda data: b"",
        lambda data: data[:4] + bytes(len(data) - 4),
    ],
    ids=["cut", "flipped", "empty", "zeros"],
)
def test_a_damaged_kernel_is_compiled_again_and_no_other(ran, kept, damage):
    folder, files = kept
    whole = files["doubled"].read_bytes()
    files["doubled"].write_bytes(damage(whole))
    assert ran(folder) == (HALF, "")
    assert ran(folder) == (LOADED, "")


def test_a_kernel_in_anothers_place_is_compiled_again(ran, kept):
    folder, files = kept
    doubled, tripled = (files[name].read_bytes() for name in ("doubled", "tripled"))
    files["doubled"].write_bytes(tripled)
    files["tripled"].write_bytes(doubled)
    assert ran(folder) == (COMPILED, "")
    assert ran(folder) == (LOADED, "")


def test_a_kernel_that_cannot_be_read_is_compiled_each_time(ran, kept):
    folder, files = kept
    files["doubled"].unlink()
    files["doubled"].mkdir()
    out, said = ran(folder)
    assert out == HALF
    assert said.count("compiled kernels cannot be kept there") == 1


def test_processes_that_compile_at_once_keep_what_each_compiled(started, ran, tmp_path):
    kinds = ["f8", "f4", "i8", "f8"]
    processes = [started(tmp_path / "kept", kind) for kind in kinds]
    for process in processes:
        with process:
            out, said = process.communicate(timeout=200)
        assert (out[:8], said) == ("6.0 9.0 ", "")
    for kind in kinds[:3]:
        assert ran(tmp_path / "kept", kind) == (LOADED, "")
    assert len(list((tmp_path / "kept").rglob("*.*"))) == 6


COPIED = """
import sys, handsight
from handsight._kernels.runtime import kernel_cache
from handsight.contact import Sphere, contact_from_wrench

kernel_cache.on_compile.append(lambda name: sys.exit(f"compiled {name}"))
contact_from_wrench([0, 0, -1], [0, 0, 0], Sphere(0.01))
print(kernel_cache.folder(), handsight.__file__)
"""


@pytest.mark.slow
def test_a_folder_of_warmup_s_serves_another_checkout_of_another_user_elsewhere(
    tmp_path, monkeypatch, capsys
):
    import handsight as hs
    from handsight.cli.main import warmup
    from handsight.tracking import warm

    monkeypatch.setattr(warm, "GROUPS", {"contact sensing": warm.GROUPS["contact sensing"]})
    monkeypatch.setattr(warm, "LATER", ())
    for variable in ("HANDSIGHT_CACHE", "NUMBA_CACHE_DIR"):  # both are set, and are put back
        monkeypatch.setenv(variable, str(tmp_path / "unused"))
    warmup(into=tmp_path / "image")
    out, said = capsys.readouterr()
    assert re.fullmatch(r" +\d+\.\d s  contact sensing\n", said)
    assert f"HANDSIGHT_CACHE={tmp_path / 'image'}" in out
    assert not (tmp_path / "unused").exists()

    copy, source = tmp_path / "robot", tmp_path / "checkout"
    shutil.copytree(tmp_path / "image", copy, copy_function=shutil.copyfile)
    shutil.copytree(Path(hs.__file__).parent, source / "handsight", copy_function=shutil.copyfile)
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"HANDSIGHT_CACHE": str(copy), "HOME": str(tmp_path), "PYTHONPATH": str(source)}
    done = subprocess.run([sys.executable, "-c", COPIED], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{copy}/kernels-" in done.stdout
    assert str(source) in done.stdout


SIGNATURES = """
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
import handsight as hs
from handsight import _kernels
from handsight._kernels.runtime.kernel_cache import KernelCache

def signatures():
    modules = [import_module(module.name) for module in walk_packages(_kernels.__path__, "handsight._kernels.")]
    found = [v for module in modules for v in vars(module).values() if isinstance(getattr(v, "_cache", None), KernelCache)]
    return {kernel._cache.name: tuple(kernel.nopython_signatures) for kernel in found}
"""
WARMED = """
from handsight.tracking.warm import GROUPS

for warm in GROUPS.values():
    warm()

warmed = signatures()
assert len(warmed) > 50, warmed
missing = [name for name, kinds in warmed.items() if not kinds]
assert not missing, missing

import numpy as np
contacts = hs.Contacts(np.array([[0.03, 0, 0.02], [-0.03, 0.01, 0], [0, 0.045, 0.01]]),
                       np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]]), sigma_point=5e-4, sigma_normal=0.03)
T = np.eye(4); T[:3, 3] = 0.004
vision = hs.PosePrior(T, np.diag([1e-4] * 3 + [1e-2] * 3))
far = hs.PosePrior(T, np.diag([0.01] * 3 + [0.3] * 3))
model = hs.ObjectModel.box((0.06, 0.09, 0.14))
hs.correct_poses(model, [(contacts, vision)] * 500)
hs.correct_pose(model, contacts, vision=far, outside=[[0.1, 0, 0], [0, 0, 0]])
hs.correct_pose(model, contacts, vision=far, samples=200)
hs.correct_pose(model, contacts)
bare = hs.Contacts(contacts.points_palm, [None, [-1.0, 0, 0], None])
hs.correct_pose(model, bare, vision=far)
mesh = hs.ObjectModel.from_mesh(model.vertices, model.faces)
mesh.evaluate([[0, 0, 0]])
hs.correct_pose(mesh, contacts, vision=vision)
hs.ObjectModel.from_points(*mesh.sample(2000))
mesh.evaluate(mesh.points_object)
model.evaluate(model.points_object)
hs.contacts_from_wrenches(np.eye(3), np.eye(3), hs.Ellipsoid((0.01, 0.01, 0.012)))
hs.contact_from_wrench([0, 0, -1], [0, 0, 0], hs.Sphere(0.01))
from handsight.vision import DepthTracker, hand_mask
camera = hs.Camera(np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), (64, 48))
depth = np.full((48, 64), 0.6, dtype=np.float32)
depth[14:34, 20:44] = 0.5
hand_mask(camera, depth, model.sample(3)[0], np.array([[0, 1, 2]]), T)
camera.project([[0, 0, 1.0]])
hs.locate(model, depth, camera, table=np.array([0, 0, -1.0, 0.6]))
T[2, 3] = 0.5
DepthTracker(model, camera, start=T).update(0.0, depth, hand=depth < 0, table=np.array([0, 0, -1.0, 0.6]))
later = {key: set(found) - set(warmed[key]) for key, found in signatures().items()}
later = {key: found for key, found in later.items() if found}
assert not later, later
"""
TRACKED = """
from handsight.recording import open_recording

data = Path(hs.__file__).parent / "data"
rig = hs.Rig.from_file(data / "can.rig.yaml")
tracker = hs.Tracker(rig, rig.objects["can"].model())
warmed = signatures()
with open_recording(data / "can.mcap", rig) as recording:
    for observation in recording.observations():
        tracker.update(observation)
assert tracker.corrections > 100
assert signatures() == warmed
"""


@pytest.mark.slow
@pytest.mark.parametrize("program", [WARMED, TRACKED], ids=["warmup", "tracker"])
def test_what_warms_up_leaves_nothing_to_compile(program, tmp_path):
    if program is TRACKED and find_spec("gymnasium_robotics") is None:
        pytest.skip("the recorded hand needs handsight[sim]")
    environment = {**os.environ, "HANDSIGHT_CACHE": str(tmp_path)}  # so that the mesh's field is built
    command = [sys.executable, "-c", SIGNATURES + program]
    done = subprocess.run(command, capture_output=True, timeout=500, text=True, env=environment)
    assert done.returncode == 0, done.stderr


def test_the_first_correction_loads_no_scipy_and_numba_s_linear_algebra_is_there_all_the_same():
    program = (
        "import sys, numpy as np, handsight as hs\n"
        "box = hs.ObjectModel.box((0.06, 0.09, 0.14))\n"
        "contacts = hs.Contacts([[0.03, 0, 0], [-0.03, 0.01, 0], [0, 0.045, 0.02]], [[1, 0, 0], [-1, 0, 0], [0, 1, 0]])\n"
        "hs.correct_pose(box, contacts, vision=hs.PosePrior.from_sigmas(np.eye(4), 0.03, 0.25))\n"
        "assert not {name for name in sys.modules if name.startswith('scipy.')} & {'scipy.linalg', 'scipy.spatial', 'scipy.special'}\n"
        "import numba\n"
        "dot = numba.njit(lambda a, b: a @ b)\n"
        "np.testing.assert_allclose(dot(np.eye(3), 2 * np.eye(3)), 2 * np.eye(3))\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)
