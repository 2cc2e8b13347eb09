"""Compiled kernels are kept on disk, whatever state the disk is in, and warming up leaves none to compile.

How kernels are kept is one way for all of them, so a small one stands for all: the correction's takes most of a minute.
"""

import os
import subprocess
import sys

import pytest

KERNEL = """
from handsight._kernels.compiled import entry

@entry
def doubled(values):
    total = 0.0
    for value in values:
        total += 2 * value
    return total

import numpy as np
print(doubled(np.ones(3)), doubled(np.ones(4)), doubled.stats.cache_hits)
"""


@pytest.fixture
def ran(tmp_path):
    program = tmp_path / "small_kernel.py"
    program.write_text(KERNEL)

    def run(folder):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
        command = [sys.executable, "-W", "always", program]
        done = subprocess.run(command, capture_output=True, timeout=100, env=environment, text=True)
        assert done.returncode == 0, done.stderr
        return done

    return run


def test_a_kernel_is_compiled_once_and_then_loaded(ran, tmp_path):
    assert ran(tmp_path / "kept").stdout == "6.0 8.0 Counter()\n"
    assert ran(tmp_path / "kept").stdout.startswith("6.0 8.0 Counter({")


def test_where_kernels_cannot_be_kept_one_warning_says_so(ran, tmp_path):
    (tmp_path / "file").write_text("")
    done = ran(tmp_path / "file" / "below")
    assert done.stdout.startswith("6.0 8.0")
    assert done.stderr.count("compiled kernels cannot be kept there") == 1
    assert done.stderr.count("Warning") == 1


def test_a_damaged_kernel_is_compiled_again(ran, tmp_path):
    expected = ran(tmp_path / "kept").stdout
    kept = [path for path in (tmp_path / "kept").rglob("*") if path.is_file()]
    assert len(kept) == 2
    for path in kept:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    for _ in range(2):  # the second time it is loaded again: what was damaged is not added to
        done = ran(tmp_path / "kept")
        assert done.stdout.split()[:2] == expected.split()[:2]
        assert "Warning" not in done.stderr
    assert done.stdout.startswith("6.0 8.0 Counter({")


WARMED = """
import os, sys
from handsight._kernels import compiled
from handsight._kernels.warm import warm
warm(lambda name, seconds: None)

def signatures():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("handsight"):
            kernels = {k: v for k, v in vars(module).items() if hasattr(v, "nopython_signatures")}
            found |= {(v.py_func.__module__, k): v for k, v in kernels.items()}
    return {key: kernel.nopython_signatures for key, kernel in found.items() if kernel.nopython_signatures}

warmed = signatures()
assert len(warmed) > 20, warmed

import numpy as np
import handsight as hs
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
later = {key: set(found) - set(warmed.get(key, ())) for key, found in signatures().items()}
later = {key: found for key, found in later.items() if found}
assert not later, later
"""


@pytest.mark.slow
def test_after_warming_up_nothing_is_left_to_compile(tmp_path):
    environment = {**os.environ, "HANDSIGHT_CACHE": str(tmp_path)}  # so that the mesh's field is built
    command = [sys.executable, "-c", WARMED]
    done = subprocess.run(command, capture_output=True, timeout=500, text=True, env=environment)
    assert done.returncode == 0, done.stderr
