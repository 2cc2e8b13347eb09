"""What passes the public door comes out clean; what does not is named: what was expected, what came."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import checks
from handsight.errors import InvalidInput
from testbed.refusals import refused

vectors = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3)


@pytest.mark.parametrize(
    ("value", "shape"),
    [(1, ()), ([1, 2, 3], (3,)), (((1, 2, 3),), (None, 3)), (np.zeros((0, 3)), (None, 3)), ([], (None,))],
)
def test_numbers_of_the_shape_come_back_as_float64(value, shape):
    array = checks.finite(value, "x", shape)
    assert array.dtype == np.float64
    assert array.shape == np.shape(value)
    np.testing.assert_array_equal(array, value)


def test_the_array_that_comes_back_is_the_callers_no_more():
    given_array = np.zeros(3)
    checks.finite(given_array, "x", (3,))[0] = 1
    assert given_array[0] == 0


@pytest.mark.parametrize(
    ("value", "shape", "field"),
    [
        ([np.nan, 0, 0], (3,), "x"),
        ([0, np.inf, 0], (3,), "x"),
        ([1, 2], (3,), "x"),
        (np.zeros((4, 2)), (None, 3), "x"),
        (np.zeros((9, 2)), (None, 3), "x"),
        (5, (3,), "x"),
        ([1.0], (), "x"),
        ("abc", (3,), "x"),
        (None, (), "x"),
        ([[1], [2, 3]], (None, 3), "x"),
        (["1", "2", "3"], (3,), "x"),
        ([True, False, True], (3,), "x"),
        ([1j, 0, 0], (3,), "x"),
        ([10**30, 0, 0], (3,), "x"),
    ],
)
def test_what_is_not_finite_numbers_of_the_shape_is_refused(value, shape, field):
    with refused(InvalidInput, field):
        checks.finite(value, "x", shape)


def test_a_positive_number_passes():
    assert checks.positive(np.float32(0.5), "sigma") == 0.5
    assert isinstance(checks.positive(1, "sigma"), float)


@pytest.mark.parametrize("value", [0, -1, -0.0])
def test_zero_and_below_are_not_positive(value):
    with refused(InvalidInput, "sigma"):
        checks.positive(value, "sigma")


@pytest.mark.parametrize("value", [np.nan, np.inf, [1.0], None])
def test_what_is_no_number_is_not_positive(value):
    with refused(InvalidInput, "sigma"):
        checks.positive(value, "sigma")


@given(vectors)
def test_a_direction_has_length_one_whatever_its_length_was(vector):
    if not any(vector):
        return
    direction = checks.unit(vector, "normal", (3,))
    np.testing.assert_allclose(np.linalg.norm(direction), 1, rtol=1e-15 * 4)
    largest = np.argmax(np.abs(vector))
    # Parallel: entries keep their ratio to the largest.
    ratio = np.array(vector) / vector[largest]
    np.testing.assert_allclose(direction / direction[largest], ratio, rtol=1e-12, atol=1e-300)
    assert np.sign(direction[largest]) == np.sign(vector[largest])


def test_a_zero_vector_is_no_direction():
    with refused(InvalidInput, "normals"):
        checks.unit([[1, 0, 0], [0, 0, 0]], "normals", (None, 3))


def test_a_covariance_comes_back_exactly_symmetric():
    A = np.random.default_rng(0).normal(size=(6, 6))
    noisy = A @ A.T * (1 + 1e-9 * np.random.default_rng(1).normal(size=(6, 6)))
    array = checks.covariance(noisy, "covariance", (6, 6))
    np.testing.assert_array_equal(array, array.T)
    np.testing.assert_allclose(array, noisy, rtol=1e-8)


def test_a_singular_covariance_is_one():
    v = np.array([1.0, 2, 3, 4, 5, 6])
    for semidefinite in (np.zeros((6, 6)), np.outer(v, v), np.diag([1.0, 0, 0, 0, 0, 0])):
        np.testing.assert_array_equal(checks.covariance(semidefinite, "c", (6, 6)), semidefinite)


def test_a_covariance_is_judged_in_its_own_units():
    # Micrometres beside radians: what is asymmetric or indefinite among the small entries is still seen.
    small = np.diag([1e-12, 1e-12, 1e-12, 1, 1, 1.0])
    checks.covariance(small, "c", (6, 6))
    lopsided = small.copy()
    lopsided[0, 1] = 0.5e-12
    with refused(InvalidInput, "c"):
        checks.covariance(lopsided, "c", (6, 6))
    lopsided[0, 1] = lopsided[1, 0] = 2e-12
    with refused(InvalidInput, "c"):
        checks.covariance(lopsided, "c", (6, 6))


def test_stacks_of_covariances_pass_and_one_bad_one_is_found():
    stack = np.stack([np.eye(6), 2 * np.eye(6)])
    np.testing.assert_array_equal(checks.covariance(stack, "c", (None, 6, 6)), stack)
    stack[1, 0, 0] = -1
    with refused(InvalidInput, "c"):
        checks.covariance(stack, "c", (None, 6, 6))
    assert checks.covariance(np.empty((0, 6, 6)), "c", (None, 6, 6)).shape == (0, 6, 6)


def test_a_variance_of_zero_allows_no_covariance_beside_it():
    singular = np.diag([0.0, 1, 1, 1, 1, 1])
    singular[0, 1] = singular[1, 0] = 0.5
    with refused(InvalidInput, "c"):
        checks.covariance(singular, "c", (6, 6))


@pytest.mark.parametrize(
    ("check", "value", "field"),
    [
        (checks.position, [0, 0, 1001], "x"),
        (checks.position, [0, -1e300, 0], "x"),
        (checks.load, [0, 1e6, 0], "x"),
    ],
)
def test_numbers_beyond_anything_on_a_robot_are_refused_by_name(check, value, field):
    check([1000, 1000, -1000], "x", (3,))
    with refused(InvalidInput, field):
        check(value, "x", (3,))


@pytest.mark.parametrize("value", [9e-10, 1001, 1e155, 1e-200])
def test_a_sigma_that_no_sensor_has_is_refused(value):
    assert checks.sigma(1e-9, "x") == 1e-9
    assert checks.sigma(1000, "x") == 1000
    with refused(InvalidInput, "x"):
        checks.sigma(value, "x")


@pytest.mark.parametrize("value", [9e-10, 1001, 1e150])
def test_a_covariance_that_no_sensor_has_is_refused(value):
    variances = np.array([1.0, 1.0, 1.0, value**2, value**2, value**2])
    with refused(InvalidInput, "x"):
        checks.covariance(np.diag(variances), "x", (6, 6))


def test_a_covariance_may_know_some_or_all_of_its_numbers_exactly():
    checks.covariance(np.zeros((6, 6)), "x", (6, 6))
    checks.covariance(np.diag([1e-6, 1e-38, 0, 0, 0, 0]), "x", (6, 6))
