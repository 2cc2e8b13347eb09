"""Contacts are placed by the kernel as by its meaning, and as moving each by itself does."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight import se3
from handsight._kernels import placing as kernel
from handsight.tracking import placing as plain


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 22))
def test_contacts_are_placed_as_numpy_places_them(seed, count, joints):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    root = rng.normal(size=(count, 6, 6))
    contacts = rng.normal(size=(count, 3)), normals, root @ root.swapaxes(1, 2)
    Ts, own = se3.random(rng, count), rng.uniform(0.1, 1, size=(count, 2))
    by_joint = rng.normal(size=(count, 6, joints))
    found = []
    for place in (kernel.place, plain.place):
        arrays = [array.copy() for array in contacts]
        place(*arrays, Ts, own, by_joint.copy(), 0.3)
        found.append(arrays)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    points, turned, covariance = found[0]
    np.testing.assert_allclose(
        points, [se3.apply(T, p[None])[0] for T, p in zip(Ts, contacts[0], strict=True)]
    )
    along = np.einsum("kij,kj->ki", covariance[:, 3:, 3:], turned)
    np.testing.assert_allclose(along, 0, atol=1e-10)
    assert np.linalg.eigvalsh(covariance).min() > -1e-10
