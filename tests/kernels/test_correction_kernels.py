"""The correction's kernels against their twin in plain NumPy (`handsight.correction.plain`)."""

import functools
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import trimesh
from handsight.correction.two_phase import Problem
from handsight.objects.pack import packed_field

import handsight as hs
import scenes
from handsight import se3
from handsight._kernels import field, layout
from handsight._kernels.threads import alone, in_parts
from handsight.correction import compiled, plain, starts
from handsight.objects.symmetry import nearest
from oracles import fields as field_oracle

NOISE = 1e-3, np.deg2rad(3)
NAMES = ["can", "box", "egg", "cone", "ball"]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@functools.cache
def model(name):
    """Two exact fields, a mesh without symmetry and with roughness, one with an axis, one the kernels' match defers."""
    if name == "ball":
        return hs.ObjectModel.sphere(0.04)
    if name == "cone":
        cone = trimesh.creation.cone(radius=0.03, height=0.1, sections=64)
        return hs.ObjectModel.from_mesh(cone.vertices, cone.faces)
    if name == "egg":
        ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        u = ball.vertices
        egg = u * (0.04 + 0.004 * np.sin(3 * u[:, :1]) + 0.01 * u[:, 2:] ** 2 + 0.006 * u[:, :1] * u[:, 1:2])
        rng = np.random.default_rng(5)
        return hs.ObjectModel.from_mesh(egg + 2e-4 * rng.normal(size=egg.shape), ball.faces)
    return {"box": scenes.box, "can": scenes.can}[name]()


def problem(name, seed, *, n=5, blind=False, bare=False, outside=0, wide=False):
    """A grasp of the object with full covariances; `bare`: some contacts without a normal."""
    rng = np.random.default_rng([seed, NAMES.index(name)])
    points, normals = model(name).sample(n, seed)
    T = se3.random(rng, spread=0.1)
    sizes = np.repeat(NOISE, 3)
    roots = sizes[:, None] * (np.eye(6) + 0.2 * rng.normal(size=(n, 6, 6)))
    drawn = np.einsum("nij,nj->ni", roots, rng.normal(size=(n, 6)))
    normals = (se3.rotation_exp(drawn[:, 3:]) @ (normals @ T[:3, :3].T)[..., None])[..., 0]
    if bare:
        normals[::2] = np.nan
    palm = se3.apply(T, points) + drawn[:, :3]
    felt = [None if bare and i % 2 == 0 else normal for i, normal in enumerate(normals)]
    contacts = hs.Contacts(palm, felt, covariance=roots @ roots.transpose(0, 2, 1))
    error = np.repeat([0.05, 0.5] if wide else [0.008, 0.12], 3)
    vision = hs.PosePrior(se3.moved(T, error * rng.normal(size=6)), np.diag(error**2))
    hand = palm[rng.integers(n, size=outside)] + rng.normal(0, 0.01, (outside, 3))
    return Problem(model(name), contacts, None if blind else vision, hand)


KINDS = [
    {},
    {"bare": True},
    {"n": 1},
    {"n": 12, "wide": True},
    {"outside": 40},
    {"outside": 7, "bare": True},
    {"blind": True},
    {"blind": True, "outside": 20},
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("which", ["coarse", "fine"])
def test_a_field_is_what_its_twin_says_inside_and_far_outside(name, which, rng):
    surface = getattr(model(name), which)
    numbers, nodes = packed_field(surface, 0)
    around = rng.normal(0, 2 * model(name).radius, (500, 3))
    onto = model(name).sample(500)[0] + 1e-4 * rng.normal(size=(500, 3))
    on_axes = np.vstack([np.zeros(3), 0.01 * np.eye(3), -0.2 * np.eye(3)])
    points = np.vstack([around, onto, on_axes, 1e6 * around[:5]])
    values = np.empty((len(points), 13))
    field.evaluate(np.append(numbers, np.zeros(layout.MODEL)), nodes, 0, points, values, 0, len(points))
    twin = field_oracle.evaluate(surface, points)
    size = 1 + np.linalg.norm(points, axis=1) / model(name).radius
    np.testing.assert_allclose(values[:, 0] / size, twin.distance / size, rtol=0, atol=1e-12)
    np.testing.assert_allclose(values[:, 1:4], twin.gradient, rtol=0, atol=1e-9)
    scale = 1 + np.abs(twin.hessian).max(axis=(1, 2), keepdims=True)
    hessian = values[:, 4:].reshape(-1, 3, 3)
    np.testing.assert_allclose(hessian / scale, twin.hessian / scale, rtol=0, atol=1e-9)


def test_a_field_of_what_is_no_number_is_no_number():
    numbers, nodes = packed_field(model("egg").fine, 0)
    points = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]])
    values = np.zeros((3, 13))
    field.evaluate(numbers, nodes, 0, points, values, 0, 3)
    assert not np.isfinite(values[:, 0]).any()


def same_estimate(a, b, atol=1e-9, information=1e-8):
    np.testing.assert_allclose(a.T_palm_object, b.T_palm_object, rtol=0, atol=atol)
    scale = 1 + np.abs(b.information).max()
    np.testing.assert_allclose(a.information / scale, b.information / scale, rtol=0, atol=information)
    assert (a.covariance is None) == (b.covariance is None)
    assert (a.converged, a.consistent, a.outliers) == (b.converged, b.consistent, b.outliers)
    np.testing.assert_allclose(a.residuals.distance, b.residuals.distance, rtol=0, atol=atol)
    np.testing.assert_allclose(a.residuals.normal, b.residuals.normal, rtol=0, atol=1e-7)
    assert len(a.hypotheses) == len(b.hypotheses)
    for mine, theirs in zip(a.hypotheses, b.hypotheses, strict=True):
        np.testing.assert_allclose(mine.T_palm_object, theirs.T_palm_object, rtol=0, atol=atol)
        assert mine.weight == pytest.approx(theirs.weight, abs=1e-7)
    assert a.unobservable.shape == b.unobservable.shape
    spans = [u.T @ u for u in (a.unobservable, b.unobservable)]
    np.testing.assert_allclose(*spans, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_two_phases_and_the_answer_are_the_twins(name, kind):
    given = problem(name, 1, **kind)
    n = len(given.contacts)
    everyone = np.ones((1, n), dtype=bool)
    if given.vision is None:
        Ts = starts.blind(given.model, given.touch(given.model.coarse, everyone))[:6]
    else:
        Ts = starts.from_prior(given.vision, 6)
    descent, used = compiled.solve(given, Ts, everyone)
    twin, twin_used = plain.solve(given, Ts, everyone)
    np.testing.assert_array_equal(used, twin_used)
    # Rounding grows along directions that nothing fixes until the descent stops.
    np.testing.assert_allclose(descent.cost, twin.cost, rtol=1e-8, atol=1e-8)
    best = twin.cost < twin.cost[0] + 20
    # Blind and against walls that touch from one side, more is left open than by contacts alone.
    free = n == 1 or (given.vision is None and len(given.outside_palm) > 0)
    atol = 1e-6 if free else 1e-8
    # A spin is fixed by nothing at all.
    mine, theirs = descent.Ts_palm_object[best], twin.Ts_palm_object[best]
    mine = nearest(given.model.symmetries, mine, theirs, given.model.radius)
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=atol)
    np.testing.assert_array_equal(descent.converged, twin.converged)
    answers = compiled.explained(given, twin, everyone), plain.explained(given, twin, everyone)
    # One contact leaves two directions that are known equally well: which two, rounding says.
    same_estimate(*answers, information=1e-8 if n > 1 else 1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_cost_and_gain_are_the_twins_whichever_contacts_count(name, kind, rng):
    given = problem(name, 2, **kind)
    n = len(given.contacts)
    T = se3.random(rng, spread=0.1) if given.vision is None else given.vision.T_palm_object
    Ts = se3.moved(np.broadcast_to(T, (20, 4, 4)), 0.02 * rng.normal(size=(20, 6)))
    everyone = np.ones((1, n), dtype=bool)
    fewer = everyone.copy()
    fewer[0, : n // 2] = False
    for used in (everyone, fewer):
        twin = plain.cost(given, Ts, used)
        np.testing.assert_allclose(compiled.cost(given, Ts, used), twin, rtol=1e-9, atol=1e-9)
        gain = compiled.largest_gain(given, Ts[0], used)
        assert gain == pytest.approx(plain.largest_gain(given, Ts[0], used), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", ["can", "box", "egg"])
def test_each_start_may_have_contacts_of_its_own(name):
    given = problem(name, 3, n=6)
    Ts = starts.from_prior(given.vision, 12)
    used = np.ones((12, 6), dtype=bool)
    used[np.arange(12), np.arange(12) // 2] = False
    descent, kept = compiled.solve(given, Ts, used)
    twin, twin_kept = plain.solve(given, Ts, used)
    np.testing.assert_array_equal(kept, twin_kept)
    np.testing.assert_allclose(descent.cost, twin.cost, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_quick_way_answers_as_the_general_one(name):
    quick = 0
    for seed in range(12):
        given = problem(name, 100 + seed, bare=seed % 3 == 2)
        answer = compiled.near(given)
        if answer is None:
            continue
        quick += 1
        slow = hs.correct_pose(
            given.model, given.contacts, vision=given.vision, method=hs.TwoPhase(compiled=False, starts=1)
        )
        same_estimate(answer, slow, atol=1e-8)
    assert (quick == 0) == (name == "ball")


def test_many_problems_are_answered_as_each_alone():
    for name in ("can", "box", "ball"):
        given = [problem(name, seed, n=2 + seed % 7, wide=seed % 4 == 3) for seed in range(40)]
        many = hs.correct_poses(model(name), [(p.contacts, p.vision) for p in given])
        for p, answer in zip(given, many, strict=True):
            alone = hs.correct_pose(p.model, p.contacts, vision=p.vision)
            np.testing.assert_array_equal(answer.T_palm_object, alone.T_palm_object)
            np.testing.assert_array_equal(answer.information, alone.information)
            assert answer.outliers == alone.outliers


def test_threads_of_the_user_do_not_disturb_each_other():
    given = [problem("box", seed, wide=seed % 2 == 1) for seed in range(8)]
    alone = [hs.correct_pose(p.model, p.contacts, vision=p.vision).T_palm_object for p in given]
    found = [None] * 8

    def work(k):
        for _ in range(5):
            p = given[k]
            found[k] = hs.correct_pose(p.model, p.contacts, vision=p.vision).T_palm_object

    threads = [threading.Thread(target=work, args=[k]) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    np.testing.assert_array_equal(found, alone)


def test_parts_cover_the_range_once_and_pass_errors_on():
    for n, least in ((0, 10), (9, 10), (10, 10), (1000, 10), (1003, 1)):
        count = np.zeros(n, dtype=int)

        def work(start, stop, count=count):
            count[start:stop] += 1

        in_parts(work, n, least)
        assert (count == 1).all()

    parts = []
    with alone():
        in_parts(lambda start, stop: parts.append((start, stop, threading.get_ident())), 1000, 10)
    assert parts == [(0, 1000, threading.get_ident())]

    def fails(start, stop):
        raise ValueError("part")

    with pytest.raises(ValueError, match="part"):
        in_parts(fails, 1000, 10)


PROGRAM = """
import os, sys, warnings
import numpy as np
import handsight as hs
contacts = hs.Contacts(np.array([[0.03, 0, 0.02], [-0.03, 0.01, 0], [0, 0.045, 0.01]]),
                       np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]]), sigma_point=5e-4, sigma_normal=0.03)
T = np.eye(4); T[:3, 3] = 0.004
vision = hs.PosePrior(T, np.diag([1e-4] * 3 + [1e-2] * 3))
model = hs.ObjectModel.box((0.06, 0.09, 0.14))
def solve():
    return hs.correct_poses(model, [(contacts, vision)] * 500)[-1].T_palm_object
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_computes_on():
    program = """
first = solve()
warnings.simplefilter("ignore", DeprecationWarning)
child = os.fork()
if child == 0:
    os._exit(0 if np.array_equal(solve(), first) else 3)
assert os.waitpid(child, 0)[1] == 0
"""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM + program], capture_output=True, timeout=500, text=True
    )
    assert done.returncode == 0, done.stderr
