"""What passes the public door comes out clean; what does not is named: what was expected, what came."""

import re
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import checks
from handsight.errors import HandsightError, InvalidInput

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
    ("value", "shape", "message"),
    [
        ([np.nan, 0, 0], (3,), r"x: expected 3 finite numbers, got \[nan, 0, 0\]"),
        ([0, np.inf, 0], (3,), r"x: expected 3 finite numbers, got \[0, inf, 0\]"),
        ([1, 2], (3,), r"x: expected 3 finite numbers, got \[1, 2\]"),
        (np.zeros((4, 2)), (None, 3), r"x: expected finite numbers of shape \(n, 3\), got \[\[0.0, 0.0\], "),
        (np.zeros((9, 2)), (None, 3), r"x: expected finite numbers of shape \(n, 3\), got shape \(9, 2\)"),
        (5, (3,), "x: expected 3 finite numbers, got 5"),
        ([1.0], (), r"x: expected a finite number, got \[1.0\]"),
        ("abc", (3,), "x: expected 3 finite numbers, got abc"),
        (None, (), "x: expected a finite number, got None"),
        ([[1], [2, 3]], (None, 3), r"x: expected finite numbers of shape \(n, 3\), got \[\[1\], \[2, 3\]\]"),
        (["1", "2", "3"], (3,), r"x: expected 3 finite numbers, got \['1', '2', '3'\]"),
        ([True, False, True], (3,), r"x: expected 3 finite numbers, got \[True, False, True\]"),
        ([1j, 0, 0], (3,), "x: expected 3 finite numbers, got "),
        ([10**30, 0, 0], (3,), r"x: expected 3 finite numbers, got \[10+, 0, 0\]"),
    ],
)
def test_what_is_not_finite_numbers_of_the_shape_is_refused(value, shape, message):
    with pytest.raises(InvalidInput, match=f"^{message}"):
        checks.finite(value, "x", shape)


def test_a_refusal_is_caught_as_handsights_and_as_a_value_error():
    for kind in (HandsightError, ValueError):
        with pytest.raises(kind):
            checks.finite("x", "x", ())


def test_a_positive_number_passes():
    assert checks.positive(np.float32(0.5), "sigma") == 0.5
    assert isinstance(checks.positive(1, "sigma"), float)


@pytest.mark.parametrize("value", [0, -1, -0.0])
def test_zero_and_below_are_not_positive(value):
    with pytest.raises(InvalidInput, match=f"^sigma: expected a number above 0, got {value}$"):
        checks.positive(value, "sigma")


@pytest.mark.parametrize("value", [np.nan, np.inf, [1.0], None])
def test_what_is_no_number_is_not_positive(value):
    with pytest.raises(InvalidInput, match=r"^sigma: expected a finite number, got "):
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


def test_stacks_of_directions_are_scaled_row_by_row_and_may_be_empty():
    rows = checks.unit([[3, 0, 4], [0, -2, 0]], "normals", (None, 3))
    np.testing.assert_allclose(rows, [[0.6, 0, 0.8], [0, -1, 0]])
    assert checks.unit(np.empty((0, 3)), "normals", (None, 3)).shape == (0, 3)


def test_a_zero_vector_is_no_direction():
    with pytest.raises(InvalidInput, match=r"^normals: expected a direction, got a zero vector$"):
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
    with pytest.raises(InvalidInput, match=r"^c: expected a symmetric covariance, got one that is not$"):
        checks.covariance(lopsided, "c", (6, 6))
    lopsided[0, 1] = lopsided[1, 0] = 2e-12
    with pytest.raises(
        InvalidInput, match=r"^c: expected a positive semidefinite covariance, got a negative"
    ):
        checks.covariance(lopsided, "c", (6, 6))


def test_stacks_of_covariances_pass_and_one_bad_one_is_found():
    stack = np.stack([np.eye(6), 2 * np.eye(6)])
    np.testing.assert_array_equal(checks.covariance(stack, "c", (None, 6, 6)), stack)
    stack[1, 0, 0] = -1
    with pytest.raises(InvalidInput, match=r"^c: expected a positive semidefinite covariance"):
        checks.covariance(stack, "c", (None, 6, 6))
    assert checks.covariance(np.empty((0, 6, 6)), "c", (None, 6, 6)).shape == (0, 6, 6)


def test_a_variance_of_zero_allows_no_covariance_beside_it():
    singular = np.diag([0.0, 1, 1, 1, 1, 1])
    singular[0, 1] = singular[1, 0] = 0.5
    with pytest.raises(InvalidInput, match=r"^c: "):
        checks.covariance(singular, "c", (6, 6))


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((), "a finite number"),
        ((3,), "3 finite numbers"),
        ((None,), "finite numbers of shape (n)"),
        ((None, 3), "finite numbers of shape (n, 3)"),
        ((6, 6), "finite numbers of shape (6, 6)"),
    ],
)
def test_a_shape_is_described_in_words(shape, words):
    assert checks.describe_shape(shape) == words


def test_a_long_value_is_cut_to_eighty_characters():
    assert checks.brief(np.arange(3)) == "[0, 1, 2]"
    text = checks.brief(np.arange(1000))
    assert len(text) == 80
    assert text.endswith("...")


@pytest.mark.parametrize(
    ("check", "value", "message"),
    [
        (checks.position, [0, 0, 1001], "x: expected metres within 1000, got 1001"),
        (checks.position, [0, -1e300, 0], "x: expected metres within 1000, got -1e+300"),
        (checks.load, [0, 1e6, 0], "x: expected newtons and newton metres within 100000, got 1e+06"),
    ],
)
def test_numbers_beyond_anything_on_a_robot_are_refused_by_name(check, value, message):
    check([1000, 1000, -1000], "x", (3,))
    with pytest.raises(InvalidInput, match=re.escape(message)):
        check(value, "x", (3,))


@pytest.mark.parametrize("value", [9e-10, 1001, 1e155, 1e-200])
def test_a_sigma_that_no_sensor_has_is_refused(value):
    assert checks.sigma(1e-9, "x") == 1e-9
    assert checks.sigma(1000, "x") == 1000
    with pytest.raises(InvalidInput, match="x: expected a number from 1e-09 to 1000, got"):
        checks.sigma(value, "x")


@pytest.mark.parametrize("value", [9e-10, 1001, 1e150])
def test_a_covariance_that_no_sensor_has_is_refused(value):
    variances = np.array([1.0, 1.0, 1.0, value**2, value**2, value**2])
    with pytest.raises(InvalidInput, match="x: expected standard deviations from 1e-09 to 1000, got"):
        checks.covariance(np.diag(variances), "x", (6, 6))


def test_a_covariance_may_know_some_or_all_of_its_numbers_exactly():
    checks.covariance(np.zeros((6, 6)), "x", (6, 6))
    checks.covariance(np.diag([1e-6, 1e-38, 0, 0, 0, 0]), "x", (6, 6))


def test_messages_say_no_addresses():
    class Thing:
        pass

    assert checks.brief(Thing()) == checks.brief(Thing())
    assert "0x" not in checks.brief([Thing()] * 9)
    assert str(InvalidInput(f"method: got {Thing()!r}")) == str(InvalidInput(f"method: got {Thing()!r}"))
    # A file's name is its own.
    assert str(InvalidInput("scan at 0x1f.ply: no")) == "scan at 0x1f.ply: no"


def test_integers_are_bounded():
    assert checks.integer(np.int64(3), "samples", 10) == 3
    for value in (-1, 11, 1.0, True, "1", None, 10**5000):
        with pytest.raises(InvalidInput, match="samples: expected a whole number from 0 to 10, got"):
            checks.integer(value, "samples", 10)


def test_the_nearest_name_takes_no_time_among_many_or_for_a_long_one():
    began = time.perf_counter()
    assert checks.suggestion("x" * 10**6, ["xx", "yy"]) == "; valid: xx, yy"
    checks.suggestion("n" * 90, [f"{'n' * 90}{i}" for i in range(40_000)])
    assert time.perf_counter() - began < 10
