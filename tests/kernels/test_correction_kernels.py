"""The correction's kernels, judged by plain residuals (`oracles.correction`) and what SciPy makes of them."""

import dataclasses
import functools
import os
import subprocess
import sys
import threading

import numba
import numpy as np
import pytest
import trimesh
from scipy.special import chdtrc

import handsight as hs
from handsight import se3
from handsight._compiled import records
from handsight._compiled.jit import entry
from handsight._compiled.stack import local
from handsight._compiled.symmetry import pose_of
from handsight._compiled.threads import alone, in_parts
from handsight.correction import WeightEvidence, correct, modes, solve
from handsight.correction.kernels import batch, doubt, prior_term, terms
from handsight.correction.outside import NO_OUTSIDE, OUTSIDE
from handsight.correction.problem import Problem, descents_at, poses_of
from handsight.objects import Symmetries
from handsight.objects.symmetry import kept_center, nearest
from oracles import correction as oracle
from testbed import scenes

MEASURED, PRIOR_TERM, TERM, UNCERTAINTY = (
    records.MEASURED,
    records.PRIOR_TERM,
    records.TERM,
    records.UNCERTAINTY,
)
NOISE = 1e-3, np.deg2rad(3)
NAMES = ["can", "box", "egg", "ball"]


@functools.cache
def model(name):
    """Three exact fields, without an axis, with one and round, a mesh with an error of its own, one off its origin."""
    if name == "ball":
        return hs.ObjectModel.sphere(0.04)
    if name == "off":
        ball = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
        ball.apply_translation([0.08, 0.03, -0.02])
        return hs.ObjectModel.from_mesh(ball.vertices, ball.faces)
    if name == "egg":
        ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        u = ball.vertices
        egg = u * (0.04 + 0.004 * np.sin(3 * u[:, :1]) + 0.01 * u[:, 2:] ** 2 + 0.006 * u[:, :1] * u[:, 1:2])
        rng = np.random.default_rng(5)
        return hs.ObjectModel.from_mesh(egg + 2e-4 * rng.normal(size=egg.shape), ball.faces)
    return {"box": scenes.box, "can": scenes.can}[name]()


def problem(name, seed, *, n=5, blind=False, bare=False, outside=0, wide=False, weighed=False):
    """A grasp of the object with full covariances; `bare`: some contacts without a normal."""
    rng = np.random.default_rng([seed, [*NAMES, "off"].index(name)])
    points, normals = model(name).sample(n, seed)
    T = se3.random(rng, spread=0.1)
    sizes = np.repeat(NOISE, 3)
    roots = sizes[:, None] * (np.eye(6) + 0.2 * rng.normal(size=(n, 6, 6)))
    drawn = np.einsum("nij,nj->ni", roots, rng.normal(size=(n, 6)))
    normals = (se3.rotation_exp(drawn[:, 3:]) @ (normals @ T[:3, :3].T)[..., None])[..., 0]
    palm = se3.apply(T, points) + drawn[:, :3]
    felt = [None if bare and i % 2 == 0 else normal for i, normal in enumerate(normals)]
    contacts = hs.Contacts(palm, felt, covariance=roots @ roots.transpose(0, 2, 1))
    mixed = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    error = np.repeat([0.05, 0.5] if wide else [0.008, 0.12], 3)
    root = error[:, None] * mixed * np.linspace(0.7, 1.0, 6)
    vision = hs.PosePrior(se3.moved(T, root @ rng.normal(size=6)), root @ root.T)
    hand = NO_OUTSIDE
    if outside:
        hand = np.zeros(outside, dtype=OUTSIDE)
        hand["point"] = palm[rng.integers(n, size=outside)] + rng.normal(0, 0.01, (outside, 3))
        hand["sigma"] = rng.uniform(1e-3, 3e-3, outside)
        hand["link"] = np.sort(rng.integers(7, size=outside))
        hand["slack"] = 1e-3 * (hand["link"] % 3)
    weight = None
    if weighed:
        root = 2e-3 * (np.eye(3) + 0.3 * rng.normal(size=(3, 3)))
        center = kept_center(model(name).symmetries, model(name).center_object + 0.01 * rng.normal(size=3))
        place = se3.apply(T, center[None])[0] + root @ rng.normal(size=3)
        weight = WeightEvidence(center, place, root @ root.T)
    return Problem(model(name), contacts, None if blind else vision, hand, weight)


@entry
def _evaluate(model, nodes, contacts, constraints, outside, descents, equations):
    """Normal equations at the second of two poses, whitened as at the first; the center."""
    prior, measured, rows = local(PRIOR_TERM), local(MEASURED), np.empty(len(contacts), TERM)
    center = batch.load_evidence(model[0], contacts, constraints[0], rows, prior, measured)
    if not constraints[0].has_prior:
        prior.kind = 0
    evidence = terms.Evidence(model[0], nodes, rows, outside, measured, constraints[0], prior, center)
    for k in range(2):
        equations[:] = 0.0
        pose, frame = pose_of(descents[k].pose), (center, model[0].radius)
        kinds = terms.ALL | terms.REWHITENED if k == 0 else terms.ALL
        terms.add_evidence(evidence, kinds, model[0].fine, pose, frame, equations)
    return center


@entry
def _prior(model, constraints, descents, equations):
    """The prior's cost at a pose, and its equations about the palm's origin."""
    term = local(PRIOR_TERM)
    prior_term.vision_prior(model[0], constraints[0].prior, term, local(UNCERTAINTY))
    pose = pose_of(descents[0].pose)
    equations[:] = 0.0
    prior_term.add_prior(term, pose, ((0.0, 0.0, 0.0), 1.0), equations)
    return prior_term.prior_cost(term, pose)


def same_equations(equations, r, J, rtol=2e-5, more=0.0):
    """Whether [H g; gᵀ c] are of residuals and their Jacobian, each number in units of its row and column; `more`: the
    cost beside the residuals' squares."""
    whole = np.column_stack([J, r])
    expected = whole.T @ whole
    expected[6, 6] += more
    size = np.sqrt(np.maximum(np.diagonal(expected), 1e-9 * np.diagonal(expected).max()))
    scale = size[:, None] * size
    np.testing.assert_allclose(equations[:, :7] / scale, expected / scale, rtol=0, atol=rtol)


WEIGHED = {"weighed": True}
KINDS = [
    {}, {"bare": True}, {"n": 1}, {"n": 12}, {"outside": 40}, {"blind": True, "outside": 7}, WEIGHED, {**WEIGHED, "blind": True},
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("away", [0.003, 0.03])
def test_normal_equations_are_those_of_the_residuals(name, kind, away):
    for seed in range(3):
        given = problem(name, seed, **kind)
        rng = np.random.default_rng(seed)
        if name == "egg" and away > 0.01:
            continue  # beyond a grid the Hessian is not the gradient's derivative
        T = given.vision.T_palm_object if given.vision else problem(name, seed).vision.T_palm_object
        T_weights = se3.moved(T, away * rng.normal(size=6) * np.repeat([1, 10], 3))
        T = se3.moved(T_weights, 0.001 * rng.normal(size=6))
        equations, radius = np.empty((7, 8)), given.model.radius
        center = np.array(
            _evaluate(
                *given.model.record[:2],
                given.contacts.record,
                given.constraints,
                given.outside,
                descents_at(np.stack([T_weights, T])),
                equations,
            )
        )
        np.testing.assert_allclose(center, given.contacts.points_palm.mean(axis=0), atol=1e-12)

        weight, more = oracle.tail(given, T)

        def function(pose, given=given, T_weights=T_weights, weight=weight):
            return oracle.residuals(given, pose, T_weights, by_vision=weight)

        J = oracle.jacobian(function, T, center) / np.repeat([1.0, radius], 3)
        # Beyond the grid of a mesh's own error the kernel stops a thousandth of a cell short.
        same_equations(equations, function(T), J, 5e-4 if name == "egg" else 2e-5, more)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "kind", [{}, {"bare": True}, {"n": 12}, {"outside": 40}, {"blind": True}, WEIGHED], ids=str
)
def test_the_cost_is_minus_two_log_of_the_density(name, kind):
    given, rng = problem(name, 2, **kind), np.random.default_rng(7)
    n = len(given.contacts)
    T = problem(name, 2).vision.T_palm_object
    Ts = se3.moved(np.broadcast_to(T, (20, 4, 4)), 0.02 * rng.normal(size=(20, 6)))
    everyone = np.ones((1, n), dtype=bool)
    fewer = everyone.copy()
    fewer[0, : n // 2] = False
    for used in (everyone, fewer):
        expected = np.array([oracle.posterior_cost(given, T, used[0]) for T in Ts])
        found = solve.cost(given, Ts, used)
        np.testing.assert_allclose(
            found - found[0], expected - expected[0], rtol=2e-4 if name == "egg" else 1e-6, atol=1e-5
        )


@pytest.mark.parametrize("name", ["box", "can", "ball"])
@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-4, 0.3, 2.0, 3.0, np.pi - 1e-4])
def test_a_prior_is_quadratic_in_the_pivots_shift_and_the_turn_up_to_its_tail(name, angle):
    for seed in range(4):
        given, rng = problem(name, seed, wide=True), np.random.default_rng(seed)
        axis = rng.normal(size=3)
        step = np.r_[0.03 * rng.normal(size=3), angle * axis / np.linalg.norm(axis)]
        T, equations = se3.moved(given.vision.T_palm_object, step), np.empty((7, 8))
        cost = _prior(given.model.record.model, given.constraints, descents_at(T[None]), equations)
        weight, more = oracle.tail(given, T)
        r = oracle.of_prior(given, T)
        assert cost == pytest.approx(weight * (r @ r) + more, rel=1e-7, abs=1e-9)
        J = oracle.jacobian(lambda pose, given=given: oracle.of_prior(given, pose), T, np.zeros(3))
        same_equations(equations, np.sqrt(weight) * r, np.sqrt(weight) * J, more=more)


def test_a_prior_knows_nothing_of_a_spin_about_an_axis_that_misses_the_origin():
    point, direction = np.array([0.03, -0.02, 0.0]), np.array([0.0, 0, 1])
    thing = dataclasses.replace(scenes.can(), symmetries=Symmetries(axes=((point, direction),)))
    rng = np.random.default_rng(1)
    given = problem("can", 1, wide=True)
    about = se3.compose(np.eye(3), point) @ se3.compose(se3.rotation_exp(0.8 * direction), np.zeros(3))
    about = about @ se3.compose(np.eye(3), -point)
    for _ in range(5):
        T = se3.random(rng, spread=0.1)
        equations = np.empty((7, 8))
        costs = [
            _prior(thing.record.model, given.constraints, descents_at(pose[None]), equations)
            for pose in (T @ about, T)
        ]
        assert costs[0] == pytest.approx(costs[1], rel=1e-9)
        # A spin at the vision's own pose: no information at all.
        T = given.vision.T_palm_object
        _prior(thing.record.model, given.constraints, descents_at(T[None]), equations)
        axis, through = T[:3, :3] @ direction, se3.apply(T, point[None])[0]
        spin = np.r_[np.cross(through, axis), axis]
        assert np.abs(equations[:6, :6] @ spin).max() < 1e-8 * np.abs(equations[:6, :6]).max()
        # Near by, what vision says of the nearest of all spins; its covariance is of the object's origin.
        spin[:3] = np.cross(through - T[:3, 3], axis)
        information = np.linalg.inv(given.vision.covariance)
        delta = 1e-5 * rng.normal(size=6)
        nearest = delta - spin * (spin @ information @ delta) / (spin @ information @ spin)
        near = descents_at(se3.moved(T, delta)[None])
        cost = _prior(thing.record.model, given.constraints, near, equations)
        assert cost == pytest.approx(nearest @ information @ nearest, rel=1e-3)


def left_to_descend(given, T_start):
    """By a Gauss-Newton step of the oracle from where a descent ended: how far χ² would fall, the step [radii]."""
    # Followed from a start: the fine field alone, whitened as there.
    answer = correct.solve_single_start(given, T_start)
    if answer is None:
        return None
    T, radius = answer.T_palm_object, given.model.radius
    J = oracle.jacobian(lambda pose: oracle.residuals(given, pose, T_start), T, T[:3, 3])
    J, r = J / np.repeat([1.0, radius], 3), oracle.residuals(given, T, T_start)
    step = -np.linalg.lstsq(J, r, rcond=1e-6)[0]  # none along a spin
    return -(J.T @ r) @ step, np.abs(step).max() / radius


@pytest.mark.parametrize("name", ["box", "can", "egg"])
def test_a_descent_ends_at_a_minimum_of_the_residuals(name):
    given = [problem(name, 50 + seed) for seed in range(12)]
    left = [left_to_descend(p, p.vision.T_palm_object) for p in given]
    drop, step = np.array([pair for pair in left if pair is not None]).T
    assert len(drop) >= 4
    # Steps below 0.03 deviations end a descent; on a rough scan they are shorter than what is left.
    assert np.median(drop) < (1e-3 if name == "egg" else 1e-6)
    assert np.median(step) < (1e-3 if name == "egg" else 1e-5)
    if name == "box":
        assert step.max() < 1e-4


def on_faces(seed, error=(0.006, 0.06)):
    """A box that five contacts on its faces fix; vision as wrong as it says."""
    contacts, vision, _ = scenes.grasp(scenes.BOX_POINTS, scenes.BOX_NORMALS, seed, error=error)
    return Problem(scenes.box(), contacts, vision, NO_OUTSIDE)


def minimum(given):
    """Where the oracle's residuals have their minimum, near where the kernels say; and that as a descent."""
    T, scale = correct.solve_single_start(given).T_palm_object, np.repeat([1e-3, 1e-2], 3)
    for _ in range(10):
        J = oracle.jacobian(lambda pose: oracle.residuals(given, pose), T, T[:3, 3])
        step = scale * np.linalg.lstsq(J * scale, -oracle.residuals(given, T), rcond=None)[0]
        T = se3.moved(T, step)
    assert np.abs(step).max() < 1e-7
    return T, descents_at(T[None])


def test_information_is_the_residuals_where_faces_are_touched():
    for seed in range(5):
        given = on_faces(seed)
        T, descent = minimum(given)
        J = oracle.jacobian(lambda pose, given=given: oracle.residuals(given, pose), T, T[:3, 3])
        estimate = solve.summarize_pose(given, descent)
        expected = J.T @ J
        size = np.sqrt(np.diagonal(expected))
        scale = size[:, None] * size
        np.testing.assert_allclose(estimate.information / scale, expected / scale, atol=1e-5)
        np.testing.assert_allclose(estimate.covariance @ expected, np.eye(6), atol=1e-3)
        # With the second order, wider by little where all is known well.
        everyone = np.ones((1, 5), dtype=bool)
        full = solve.summaries(given, descent, everyone)[0]
        np.testing.assert_allclose(full["information"] / scale, expected / scale, atol=0.05)
        np.testing.assert_allclose(full["covariance"] @ full["information"], np.eye(6), atol=1e-8)


def test_many_problems_are_answered_as_each_alone():
    for name in ("can", "box", "ball"):
        given = [problem(name, seed, n=2 + seed % 7, wide=seed % 4 == 3) for seed in range(24)]
        many = hs.correct_poses(model(name), [(p.contacts, p.vision) for p in given])
        for p, answer in zip(given, many, strict=True):
            single = hs.correct_pose(p.model, p.contacts, vision=p.vision)
            np.testing.assert_array_equal(answer.T_palm_object, single.T_palm_object)
            np.testing.assert_array_equal(answer.information, single.information)
            np.testing.assert_array_equal(answer.residual_rows, single.residual_rows)
            assert answer.outliers == single.outliers


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

        def work(part, same):
            assert len(part) == len(same)
            part += 1

        in_parts(work, (count, count), least)
        assert (count == 1).all()

    parts = []
    with alone():
        in_parts(lambda part: parts.append((len(part), threading.get_ident())), (np.zeros(1000),), 10)
    assert parts == [(1000, threading.get_ident())]

    def fails(part):
        raise ValueError("part")

    with pytest.raises(ValueError):
        in_parts(fails, (np.zeros(1000),), 10)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread")
def test_an_error_of_a_helper_is_the_callers():
    def fails_elsewhere(part):
        if threading.get_ident() != caller:
            helped.set()
            raise IndexError("helper")
        helped.wait(10)

    caller, helped = threading.get_ident(), threading.Event()
    with pytest.raises(IndexError):
        in_parts(fails_elsewhere, (np.zeros(1000),), 10)


PROGRAM = """
import os, sys, warnings
import numba
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
child = os.fork()
if child == 0:
    os._exit(0 if np.array_equal(solve(), first) else 3)
assert os.waitpid(child, 0)[1] == 0
"""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM + program], capture_output=True, timeout=500, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", [{}, {"bare": True}, {"outside": 40}, {"blind": True}, WEIGHED], ids=str)
def test_modes_are_weighed_by_the_density_there(name, kind):
    given, rng = problem(name, 3, **kind), np.random.default_rng(3)
    T, used = problem(name, 3).vision.T_palm_object, np.ones((1, len(given.contacts)), dtype=bool)
    Ts = se3.moved(np.broadcast_to(T, (8, 4, 4)), 0.01 * rng.normal(size=(8, 6)))
    descents = descents_at(Ts)
    batch.weigh(*given.model.record[:2], given.sets(used), given.constraints, given.outside, descents)
    Ts = poses_of(descents)  # their equivalents nearest to vision
    np.testing.assert_allclose(descents["posterior_cost"], solve.cost(given, Ts, used), rtol=1e-9, atol=1e-9)
    volume = descents["log_weight"] + descents["posterior_cost"] / 2
    answers = solve.summaries(given, descents, used, first_order=True)
    metres = modes.in_metres(answers["information"], given.model.radius)
    floor = (1.0 if given.blind else 1e-9) / given.model.radius**2
    expected = -0.5 * np.log(np.linalg.eigvalsh(metres).clip(floor)).sum(axis=1)
    np.testing.assert_allclose(volume, expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["can", "box", "about a point"])
def test_the_nearest_equivalent_is_that_of_plain_numpy(name):
    thing, rng = scenes.box() if name == "about a point" else model(name), np.random.default_rng(6)
    if name == "about a point":  # three half turns, whose shifts count as much as their turns
        point, turns = (
            np.array([0.03, -0.02, 0.05]),
            [np.diag(d) for d in ([1.0, -1, -1], [-1, 1, -1], [-1, -1, 1])],
        )
        about_it = Symmetries(rotations=[se3.compose(R, point - R @ point) for R in turns])
        thing = dataclasses.replace(thing, symmetries=about_it)
    T = se3.random(rng)
    Ts = se3.random(rng, 200, spread=0.05)
    descents, vision = descents_at(Ts), hs.PosePrior.from_sigmas(T, 0.01, 0.1)
    given = Problem(thing, hs.Contacts([[0.0, 0.0, 0.0]], sigma_point=1e-3), vision, NO_OUTSIDE)
    used = np.ones((1, 1), dtype=bool)
    batch.weigh(*thing.record[:2], given.sets(used), given.constraints, given.outside, descents)
    expected = nearest(thing.symmetries, Ts, T, thing.radius)
    np.testing.assert_allclose(poses_of(descents), expected, atol=1e-9)
    assert name == "can" or 20 < np.isclose(expected, Ts, atol=1e-9).all(axis=(1, 2)).sum() < 180


@entry
def _survivals(chi2, freedom, out):
    for i in range(len(chi2)):
        for j in range(len(freedom)):
            out[i, j] = doubt.chi2_survival(chi2[i], freedom[j])


def test_the_probability_of_a_larger_chi_square_is_scipys():
    chi2, freedom = np.array([0.0, 1e-9, 0.3, 1.0, 7.0, 40.0, 160.0, 400.0]), np.arange(1, 200)
    found = np.empty((len(chi2), len(freedom)))
    _survivals(chi2, freedom, found)
    np.testing.assert_allclose(found, chdtrc(freedom[None], chi2[:, None]), rtol=1e-12)
    never = np.empty((1, len(freedom)))
    _survivals(np.array([np.nan]), freedom, never)
    assert not never.any()  # so that such a descent is doubted
