"""The answer where a mode is no Gaussian: the mean of what contacts allow, against many posterior samples."""

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

import handsight as hs
from handsight import se3
from handsight._compiled.records import ANSWER
from handsight.correction import Outside, Plane
from handsight.correction.mean import merged
from handsight.correction.modes import in_metres
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.objects import ObjectWarning, Symmetries
from handsight.objects.symmetry import tangents
from testbed.sampled import sampled
from testbed.scenes import (
    ERROR,
    across_box,
    anywhere_on,
    at_maximum,
    box,
    can,
    can_contacts,
    chi2,
    grasp,
    on_box_edges,
    on_box_faces,
    on_can_side,
    opposed,
    random_scene,
    touched,
)

NOISE = (1.6e-3, float(np.deg2rad(4)))
"""Of a contact in a hand whose joints are off by a degree."""
VISION = np.repeat([0.064, np.deg2rad(10) / np.sqrt(3)], 3)
OBSERVED = 1e-9


def gripped(seed, kind):
    """A model, contacts, vision and what is outside, of a grip that is bounded and not fixed; another size each time."""
    rng = np.random.default_rng([seed, sorted(KINDS).index(kind)])
    half = np.array([0.03, 0.045, 0.07]) if seed % 2 else rng.uniform(0.015, 0.075, 3)
    model, surface = hs.ObjectModel.box(2 * half), opposed(rng, half[1], flat=True)
    if kind == "can":
        model, surface = hs.ObjectModel.cylinder(half[1], 2 * half[2]), opposed(rng, half[1], flat=False)
    inside = np.abs(surface[0]) <= half
    surface = np.where(inside, surface[0], 0.9 * np.sign(surface[0]) * half), surface[1]
    if kind == "edges":
        scene = random_scene(on_box_edges(rng, near=True), rng)
        return box(), scene.contacts, scene.vision, None
    T, sigma = se3.random(rng, spread=0.1), VISION.copy()
    R = T[:3, :3]
    sigma[2] = 0.003 if kind == "narrow" else sigma[2]
    wrong = sigma * rng.normal(size=6)
    T_vision = se3.moved(T, np.concatenate([R @ wrong[:3], R @ wrong[3:]]))
    vision = hs.PosePrior(T_vision, se3.rotate_covariance(R, np.diag(sigma**2)))
    planes = [Plane(se3.apply(T, np.array([[0, 0, -half[2]]]))[0], R[:, 2], 0.003)] if kind == "table" else []
    aside = np.column_stack([np.full(40, -half[0] - 0.004), *rng.uniform(-0.05, 0.05, (2, 40))])
    points = se3.apply(T, aside) if kind == "beside" else ()
    return model, touched(T, surface, NOISE, rng), vision, Outside(points, planes)


KINDS = ("free", "narrow", "table", "beside", "can", "edges")


def off_by(model, estimate, sampled):
    """How far a mean is from another [its deviations], and the deviations as shares of its, along its own axes."""
    radius = model.radius
    scale = np.repeat([1.0, radius], 3)
    values, vectors = np.linalg.eigh(in_metres(sampled.information, radius))
    known = values > OBSERVED * values[-1]
    values, vectors = values[known], vectors[:, known]
    shift = (
        vectors.T @ (se3.difference(estimate.T_palm_object, sampled.T_palm_object) * scale) * np.sqrt(values)
    )
    own = np.linalg.pinv(in_metres(estimate.information, radius), rcond=OBSERVED, hermitian=True)
    return np.abs(shift).max(), np.sqrt(np.einsum("ia,ij,ja,a->a", vectors, own, vectors, values))


def compared(seeds, samples):
    """`off_by` of the default's answer and of the maximum from that many samples, over grips of all kinds."""
    rows = []
    for kind in KINDS:
        for seed in seeds:
            model, contacts, vision, outside = gripped(seed, kind)
            given = {"vision": vision, "outside": outside}
            best = hs.correct_pose(model, contacts, **given)
            if np.any(best.T_palm_object != best.T_palm_object_maximum) and best.hypotheses[0].weight > 0.99:
                reference = sampled(model, contacts, samples=samples, **given)
                off_maximum, _ = off_by(model, at_maximum(best), reference)
                rows.append((*off_by(model, best, reference), off_maximum))
    return rows


@pytest.mark.slow
def test_a_mean_and_its_covariance_are_those_of_many_samples():
    rows = compared(range(3), 100_000)
    shifts = np.array([shift for shift, *_ in rows])
    ratios = np.concatenate([ratio for _, ratio, _ in rows])
    print(
        f"{len(rows)} grips: mean off by {np.median(shifts):.3f} deviations (median), {np.quantile(shifts, 0.9):.2f} "
        f"(90 %); deviations {np.quantile(ratios, 0.05):.2f} to {np.quantile(ratios, 0.95):.2f} of the samples' (90 %)"
    )
    assert len(rows) >= 12
    assert np.median(shifts) < 0.1
    assert np.median([shift for *_, shift in rows]) > 0.5  # the maximum's
    assert np.mean(np.abs(ratios - 1) < 0.1) > 0.9


def test_where_the_mode_is_a_gaussian_the_answer_is_its_maximum():
    points = np.array([[0.03, 0, 0.01], [0, 0.045, 0], [0, 0, 0.07], [0, -0.045, 0.02], [-0.03, 0.01, 0]])
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [-1, 0, 0]])
    for seed in range(20):
        contacts, vision, _ = grasp(points, normals, seed)
        best = hs.correct_pose(box(), contacts, vision=vision)
        np.testing.assert_array_equal(best.T_palm_object, best.T_palm_object_maximum)


def test_a_slide_between_edges_has_the_mean_and_the_deviation_of_a_truncated_gaussian():
    """Two fingers on opposite faces of a box of 6 cm: vision knows all but the slide along x better than by 1 mm."""
    points, normals = np.array([[0, 0.045, 0], [0, -0.045, 0]]), np.array([[0, 1.0, 0], [0, -1.0, 0]])
    contacts = hs.Contacts(points, normals, sigma_point=1e-4, sigma_normal=0.02)
    x, rows = np.linspace(-0.03, 0.03, 6001), []
    for slide in (0.004, 0.01, 0.02, 0.05):
        for off in np.arange(-0.08, 0.0801, 0.005):
            if abs(off) > 0.03 + 2 * slide:  # that far beyond an edge vision contradicts the contacts
                continue
            sigma = np.array([slide, 1e-3, 1e-3, 0.01, 0.01, 0.01])
            T = se3.compose(np.eye(3), np.array([off, 0, 0]))
            vision = hs.PosePrior(T, np.diag(sigma**2))
            estimate = hs.correct_pose(box(), contacts, vision=vision)
            if np.array_equal(estimate.T_palm_object, estimate.T_palm_object_maximum):
                continue  # it counts as a Gaussian
            density = np.exp(-0.5 * ((x - off) / slide) ** 2)
            density /= density.sum()
            mean = density @ x
            deviation = np.sqrt(density @ (x - mean) ** 2)
            ratio = np.sqrt(estimate.covariance[0, 0]) / deviation
            rows.append((abs(estimate.T_palm_object[0, 3] - mean) / deviation, abs(ratio - 1)))
    shift, ratio = np.quantile(rows, [0.5, 0.9, 1.0], axis=0).T
    print(
        f"{len(rows)} slides: mean off by {shift[0]:.3f} deviations (median), {shift[1]:.3f} (90 %), {shift[2]:.3f} "
        f"(most); deviation off by {100 * ratio[0]:.1f}, {100 * ratio[1]:.1f}, {100 * ratio[2]:.1f} %"
    )
    assert len(rows) > 30
    assert (shift < [0.02, 0.05, 0.1]).all()
    assert (ratio < [0.02, 0.04, 0.06]).all()


def test_a_spin_about_a_declared_axis_is_not_integrated_over():
    for seed in range(4):
        model, contacts, vision, _ = gripped(seed, "can")
        estimate = hs.correct_pose(model, contacts, vision=vision)
        spin = tangents(model.symmetries, estimate.T_palm_object)[0]
        assert estimate.covariance is None
        assert np.abs(estimate.information @ spin).max() < 1e-4 * np.abs(estimate.information).max()
        spun = se3.compose(se3.rotation_exp(np.array([0, 0, 1.0])), np.zeros(3))
        turned = hs.PosePrior(vision.T_palm_object @ spun, vision.covariance)
        other = hs.correct_pose(model, contacts, vision=turned)
        np.testing.assert_allclose(other.T_palm_object[:3, 3], estimate.T_palm_object[:3, 3], atol=1e-3)


def test_without_vision_an_open_slide_has_no_covariance():
    contacts, _, _ = grasp(*can_contacts(), seed=3)
    estimate = hs.correct_pose(can(), contacts)
    assert estimate.covariance is None
    assert np.abs(estimate.residuals.distance).max() < 0.004
    rng = np.random.default_rng(5)
    scene = random_scene(across_box(rng), rng, error=ERROR)
    best = hs.correct_pose(box(), scene.contacts)
    assert best.covariance is None
    assert len(best.unobservable)


def test_without_vision_maxima_along_an_open_slide_are_hypotheses():
    several = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        contacts = random_scene(across_box(rng), rng).contacts
        best = hs.correct_pose(box(), contacts)
        unknown = best.hypotheses[0].covariance is None
        several += unknown and len(best.hypotheses) >= 5
    assert several


def marker():
    """A pen of 12 cm with a step, a groove and a tip: a surface whose detail is as small as a contact's error."""
    radius = np.array([0, 4, 4, 9, 9, 6.5, 6.5, 11, 11, 0]) / 1000
    height = np.array([-60, -60, -50, -50, 0, 0, 12, 12, 60, 60]) / 1000
    around = 2 * np.pi * np.arange(48) / 48
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    vertices = [np.column_stack([r * ring, np.full(48, z)]) for r, z in zip(radius, height, strict=True)]
    here = np.arange(48 * (len(radius) - 1))
    after = here - here % 48 + (here + 1) % 48
    faces = [np.stack([here, after, after + 48], axis=1), np.stack([here, after + 48, here + 48], axis=1)]
    with pytest.warns(ObjectWarning):  # at both ends
        return hs.ObjectModel.from_mesh(np.concatenate(vertices), np.concatenate(faces))


def left_out(model, rng, contacts, count, error):
    """Share of truths in less than a thousandth of the posterior, over all hypotheses by their weights."""
    beyond = 0
    scenes = [random_scene(anywhere_on(model)(rng, contacts), rng, error=error) for _ in range(count)]
    found = hs.correct_poses(model, [(scene.contacts, scene.vision) for scene in scenes])
    for scene, estimate in zip(scenes, found, strict=True):
        probability = 0.0
        for mode in estimate.hypotheses:
            square, freedom = chi2(model, mode.T_palm_object, mode.information, scene.T_palm_object)
            probability += mode.weight * chdtrc(freedom, square)
        beyond += probability < 1e-3
    return beyond / count


def test_three_and_four_contacts_on_small_detail_seldom_leave_the_truth_out():
    """Of 600 answers each 0.2 % and 0.3 % did when this was written, and 3 % with starts on the coarse field alone and
    modes of its minima."""
    model, near = marker(), (0.005, np.deg2rad(4))
    for contacts in (3, 4):
        assert left_out(model, np.random.default_rng([12, contacts]), contacts, 300, near) < 0.015


@pytest.mark.parametrize("draw", [on_box_faces, on_can_side])
def test_three_contacts_on_a_plain_object_hold_the_truth(draw):
    model, rng, beyond = box() if draw is on_box_faces else can(), np.random.default_rng(12), 0
    scenes = [random_scene(draw(rng, 3), rng) for _ in range(800)]
    found = hs.correct_poses(model, [(scene.contacts, scene.vision) for scene in scenes])
    for scene, estimate in zip(scenes, found, strict=True):
        square, freedom = chi2(model, estimate.T_palm_object, estimate.information, scene.T_palm_object)
        beyond += bool(square > chdtri(freedom, 1e-3))
    assert beyond < 0.015 * len(scenes)


def test_minima_beside_a_mode_are_in_its_region():
    """Two modes of a density on an L, 1 cm apart: the mean is between them, and its covariance spans both."""
    model = box()
    rows = np.zeros(3, dtype=ANSWER)
    sigma = np.repeat([1e-3, 1e-2], 3)
    for row, shift, log_weight in zip(rows, (0.0, 0.01, 0.1), (0.0, 0.0, -1.0), strict=True):
        row["T_palm_object"] = se3.moved(np.eye(4), np.array([shift, 0, 0, 0, 0, 0]))
        row["pose"]["rotation"], row["pose"]["position"] = np.eye(3), row["T_palm_object"][:3, 3]
        row["covariance"], row["complete"], row["log_weight"] = np.diag(sigma**2), 1, log_weight
        row["information"] = np.diag(1 / sigma**2)
    contacts, vision, _ = grasp(np.eye(3)[:1] * 0.03, np.eye(3)[:1], 0)
    problem = Problem(model.with_symmetries(Symmetries()), contacts, vision, NO_OUTSIDE)
    means = merged(problem, rows.copy(), means=True)
    assert len(means) == 2
    np.testing.assert_allclose(means[0]["T_palm_object"][0, 3], 0.005, atol=1e-12)
    np.testing.assert_allclose(means[0]["covariance"][0, 0], 1e-6 + 0.005**2)
    np.testing.assert_allclose(means[0]["information"] @ means[0]["covariance"], np.eye(6), atol=1e-9)
    assert means[0]["log_weight"] == pytest.approx(np.log(2))
    maxima = merged(problem, rows.copy(), means=False)
    np.testing.assert_array_equal(maxima[0]["T_palm_object"], np.eye(4))


def test_a_pose_from_vision_that_is_metres_off_is_contradicted_and_no_more():
    """Its cost is so large that differences of logarithms of the density are lost in rounding."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        contacts, vision, T = grasp(*across_box(rng), seed)
        T_far = T.copy()
        T_far[:3, 3] += [4.0, 0, 0]
        far = hs.PosePrior.from_sigmas(T_far, 10 ** rng.uniform(-9, -3), 10 ** rng.uniform(-9, -3))
        outside = Outside(se3.apply(T, np.zeros((1, 3))))
        estimate = hs.correct_pose(box(), contacts, vision=far, outside=outside)
        assert not estimate.consistent
        assert np.isfinite(estimate.T_palm_object).all()
