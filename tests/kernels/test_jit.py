"""Kernels are compiled by need, kept on disk whatever state the disk is in, and warming up leaves none to compile.

How kernels are kept is one way for all of them, so small ones stand for all: the correction's takes most of a minute.
"""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import handsight as hs
from handsight._compiled.jit import FOLDER, KEPT_VERSIONS, entry

KERNEL = """
import sys
import numpy as np
from handsight._compiled.jit import entry, on_compile

on_compile.append(lambda name: print(name, end=" "))

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
print(doubled(values), tripled(values))
"""
COMPILED, LOADED = "__main__.doubled  __main__.tripled  6.0 9.0\n", "6.0 9.0\n"


NAMESAKES = """
import sys
import numpy as np
from handsight._compiled.jit import entry, inner

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


@entry
def doubled_into(values, out):
    for i in range(len(values)):
        for j in range(len(values[i])):
            out[i, j] = 2 * values[i, j]
    return len(values)


@pytest.mark.parametrize(
    "values",
    [
        np.arange(12.0).reshape(3, 4),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.arange(24.0).reshape(3, 8)[:, ::2],
        np.broadcast_to(np.arange(4.0), (3, 4)),  # read-only
        np.arange(12).reshape(3, 4),
        np.arange(12, dtype=np.float32).reshape(3, 4),
    ],
    ids=["contiguous", "columns first", "strided", "read-only", "whole numbers", "single precision"],
)
def test_arrays_of_any_type_and_layout_are_read(values):
    out = np.zeros(values.shape)
    assert doubled_into(values, out) == 3
    assert np.array_equal(out, 2 * values)


def test_arrays_of_any_layout_are_written_to():
    out = np.zeros((3, 8))
    doubled_into(np.ones((3, 4)), out[:, ::2])
    assert np.array_equal(out, np.tile([2.0, 0.0], (3, 4)))


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


def test_a_kernel_is_compiled_once_and_then_loaded(ran, compiled_once):
    assert ran(compiled_once) == (LOADED, "")


def test_kernels_compiled_in_different_processes_call_functions_of_their_own(ran, tmp_path):
    (alone, _), (other, _) = ran(tmp_path, "before"), ran(tmp_path, "after")
    assert alone == other
    assert ran(tmp_path, "before", "after")[0] == alone + other


def test_processes_that_compile_at_once_keep_what_each_compiled(started, ran, tmp_path):
    kinds = ["f8", "f4", "i8", "i4", "u1", "f8", "f4", "i8"]
    processes = [started(tmp_path / "kept", kind) for kind in kinds]
    for process in processes:
        with process:
            out, said = process.communicate(timeout=300)
        assert (out[-len(LOADED) :], said) == (LOADED, "")
    files = sorted((tmp_path / "kept").rglob("*.nb?"))
    times = [file.stat().st_mtime_ns for file in files]
    assert len(files) == 2 * (1 + 5)  # of each kernel an index, and its code for each type
    for kind in kinds[:5]:
        assert ran(tmp_path / "kept", kind) == (LOADED, "")
    assert sorted((tmp_path / "kept").rglob("*.nb?")) == files
    assert [file.stat().st_mtime_ns for file in files] == times


CALLEE = """
from handsight._compiled.jit import inner

@inner
def factor():
    return {factor}
"""
CALLER = """
from handsight._compiled.callee import factor
from handsight._compiled.jit import entry

@entry
def multiplied(value):
    return factor() * value

print(multiplied(1.0))
"""


def test_a_kernel_whose_callee_has_changed_is_compiled_again(tmp_path):
    package = tmp_path / "handsight"
    shutil.copytree(Path(hs.__file__).parent, package, ignore=shutil.ignore_patterns("data"))
    (package / "_compiled/caller.py").write_text(CALLER)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-m", "handsight._compiled.caller"]
    for factor in (2.0, 3.0, 2.0):
        (package / "_compiled/callee.py").write_text(CALLEE.format(factor=factor))
        out = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout
        assert float(out) == factor
    assert len(list((tmp_path / "kept").glob("kernels-*"))) == 2


def test_a_few_versions_of_kernels_are_kept(ran, tmp_path):
    for k in range(6):
        (tmp_path / f"kernels-{k}").mkdir()
        os.utime(tmp_path / f"kernels-{k}", (k, k))
    ran(tmp_path)
    assert len(list(tmp_path.glob("kernels-*"))) == KEPT_VERSIONS
    assert not any((tmp_path / f"kernels-{k}").exists() for k in range(3))


def test_where_kernels_cannot_be_kept_a_temporary_folder_is_used_and_one_warning_says_so(
    ran, tmp_path, monkeypatch
):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for expected in (COMPILED, LOADED):
        out, said = ran(tmp_path / "file" / "below")
        assert out == expected
        assert said.count("Warning") == 1


def test_where_no_folder_can_be_made_each_process_compiles_and_one_warning_says_so(ran, tmp_path):
    for _ in range(2):
        out, said = ran(tmp_path / ("too long" * 100))
        assert out == COMPILED
        assert said.count("Warning") == said.count("KernelWarning") == 1


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="modes as POSIX has them")
def test_kernels_that_others_can_write_are_not_run(ran, compiled_once, tmp_path, monkeypatch):
    shutil.copytree(compiled_once, tmp_path / "kept")
    next((tmp_path / "kept").glob("kernels-*")).chmod(0o777)
    for file in (tmp_path / "kept").rglob("*.nbi"):
        file.write_bytes(b"theirs")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for expected in (COMPILED, LOADED):
        out, said = ran(tmp_path / "kept")
        assert out == expected
        assert said.count("Warning") == 1


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="modes as POSIX has them")
def test_others_cannot_write_kernels_whatever_the_umask(ran, tmp_path):
    before = os.umask(0)
    try:
        ran(tmp_path / "kept")
    finally:
        os.umask(before)
    assert all(path.stat().st_mode & 0o022 == 0 for path in (tmp_path / "kept").rglob("*"))


COPIED = """
import sys
from handsight._compiled.jit import FOLDER, on_compile
from handsight.contact import Sphere, contact_from_wrench

on_compile.append(lambda name: sys.exit(f"compiled {name}"))
contact_from_wrench([0, 0, -1], [0, 0, 0], Sphere(0.01))
print(FOLDER)
"""


@pytest.mark.slow
def test_a_folder_of_warmup_s_serves_another_user_elsewhere(tmp_path, monkeypatch):
    for variable in ("HANDSIGHT_CACHE", "NUMBA_CACHE_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / "unused"))
    # But for those of contact sensing, kernels are already there: to compile all takes minutes.
    others = shutil.ignore_patterns("*.lock", "*.done", "sensing.*")
    shutil.copytree(FOLDER, tmp_path / "image" / FOLDER.name, ignore=others)
    command = [sys.executable, "-m", "handsight.cli", "warmup", "--into", str(tmp_path / "image")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^ +\d+\.\d s  contact sensing$", done.stderr, re.MULTILINE)
    assert f"HANDSIGHT_CACHE={tmp_path / 'image'}" in done.stdout
    assert not (tmp_path / "unused").exists()

    copy = tmp_path / "robot"
    shutil.copytree(tmp_path / "image", copy, copy_function=shutil.copyfile)
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"HANDSIGHT_CACHE": str(copy), "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", COPIED], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{copy}/kernels-" in done.stdout


def test_warming_up_into_a_folder_that_cannot_be_written_fails_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    command = [sys.executable, "-m", "handsight.cli", "warmup", "--into", str(tmp_path / "file" / "below")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert "file" in done.stderr
    assert done.stdout == ""


KEPT = """
from importlib import import_module
from pathlib import Path
from types import FunctionType
import handsight as hs
from handsight._compiled.jit import FOLDER, entry

def entries():
    place = Path(hs.__file__).parent
    files = [*place.glob("_compiled/*.py"), *place.glob("*/kernels/*.py")]
    names = [".".join(file.relative_to(place.parent).with_suffix("").parts) for file in files]
    modules = [import_module(name) for name in names]
    found = [value for module in modules for value in vars(module).values() if isinstance(value, FunctionType)]
    wrapped = [kernel for kernel in found if kernel.__code__.co_filename == entry.__code__.co_filename]
    return {f"{kernel.__module__}.{kernel.__qualname__}" for kernel in wrapped if kernel.__module__ != entry.__module__}

def kept():
    return {path.name for path in FOLDER.rglob("*.nbc")}
"""
WARMED = """
from handsight.tracking.warm import GROUPS

for warm in GROUPS.values():
    warm()

warmed = kept()
assert len(entries()) > 40, entries()
missing = entries() - {path.stem for path in FOLDER.glob("*.lock")}
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
assert not kept() - warmed, kept() - warmed
"""
TRACKED = """
from handsight.recording import open_recording

data = Path(hs.__file__).parent / "data"
rig = hs.Rig.from_file(data / "can.rig.yaml")
tracker = hs.Tracker(rig, rig.objects["can"].model())
warmed = kept()
with open_recording(data / "can.mcap", rig) as recording:
    for observation in recording.observations():
        tracker.update(observation)
assert tracker.corrections > 100
assert kept() == warmed
"""


@pytest.mark.slow
@pytest.mark.parametrize("program", [WARMED, TRACKED], ids=["warmup", "tracker"])
def test_what_warms_up_leaves_nothing_to_compile(program, tmp_path):
    if program is TRACKED and find_spec("gymnasium_robotics") is None:
        pytest.skip("the recorded hand needs handsight[sim]")
    assert FOLDER is not None
    shutil.copytree(FOLDER, tmp_path / FOLDER.name, ignore=shutil.ignore_patterns("*.lock"))
    # A cache of its own, so that the mesh's field is built.
    environment = {**os.environ, "HANDSIGHT_CACHE": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", KEPT + program]
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
