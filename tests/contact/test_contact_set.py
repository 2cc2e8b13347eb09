import copy
import pickle

import numpy as np
import pytest

from contact.contact_cases import PAPER_TIP, touches
from handsight import se3
from handsight.contact import Contacts, Ellipsoid, NoContact, contact_from_wrench
from handsight.errors import InvalidInput
from testbed.refusals import refused

POINTS = np.array([[0.03, 0.01, 0.1], [-0.03, 0, 0.1], [0, 0.02, 0.15]])
NORMALS = [[2, 0, 0], None, [0, 3, 4]]


def some_covariance(rng, n):
    root = 1e-2 * rng.normal(size=(n, 6, 6))
    return root @ root.swapaxes(-1, -2)


def test_contacts_are_stored_clean():
    contacts = Contacts(POINTS.tolist(), NORMALS, sigma_point=[1e-3, 2e-3, 3e-3], sigma_normal=0.2)
    assert len(contacts) == 3
    np.testing.assert_array_equal(contacts.points_palm, POINTS)
    np.testing.assert_allclose(contacts.normals_palm, [[1, 0, 0], [0, 0, 0], [0, 0.6, 0.8]])
    assert contacts.has_normal.tolist() == [True, False, True]
    np.testing.assert_allclose(contacts.covariance[1, :3, :3], 4e-6 * np.eye(3))
    np.testing.assert_allclose(contacts.covariance[0, 3:, 3:], np.diag([0, 0.04, 0.04]), atol=1e-16)
    np.testing.assert_array_equal(contacts.covariance[1, 3:], 0)
    np.testing.assert_allclose(contacts.covariance[2, 3:, 3:] @ [0, 0.6, 0.8], 0, atol=1e-16)


def test_a_given_covariance_is_kept_but_for_the_part_along_the_normal():
    covariance = some_covariance(np.random.default_rng(0), 3)
    contacts = Contacts(POINTS, NORMALS, covariance=covariance)
    np.testing.assert_allclose(contacts.covariance[:, :3, :3], covariance[:, :3, :3], rtol=1e-12)
    np.testing.assert_allclose(contacts.covariance[0, 4:, 4:], covariance[0, 4:, 4:], rtol=1e-12)
    np.testing.assert_allclose(contacts.covariance[0, :3, 4:], covariance[0, :3, 4:], rtol=1e-12)
    for c, n in zip(contacts.covariance, contacts.normals_palm, strict=True):
        np.testing.assert_allclose(c[3:, 3:] @ n, 0, atol=1e-17)
    np.testing.assert_array_equal(contacts.covariance, contacts.covariance.swapaxes(-1, -2))


def test_nothing_can_be_written_and_nothing_is_shared():
    points = POINTS.copy()
    contacts = Contacts(points, NORMALS)
    points[0] = 1
    np.testing.assert_array_equal(contacts.points_palm, POINTS)
    for part in (contacts, contacts.moved(np.eye(4)), contacts.select([0])):
        for name in ("points_palm", "normals_palm", "has_normal", "covariance"):
            assert not getattr(part, name).flags.writeable
    with pytest.raises(AttributeError):
        contacts.points_palm = points


def test_moved_contacts_are_those_of_moved_input():
    rng = np.random.default_rng(1)
    T = se3.random(rng, spread=0.1)
    R = T[:3, :3]
    covariance = some_covariance(rng, 3)
    moved = Contacts(POINTS, NORMALS, covariance=covariance).moved(T)
    normals = [None if n is None else R @ n for n in NORMALS]
    expected = Contacts(se3.apply(T, POINTS), normals, covariance=se3.rotate_covariance(R, covariance))
    for name in ("points_palm", "normals_palm", "has_normal", "covariance"):
        np.testing.assert_allclose(getattr(moved, name), getattr(expected, name), atol=1e-15)


@pytest.mark.parametrize(
    ("which", "rows"),
    [([True, False, True], [0, 2]), ([2, 0, 0], [2, 0, 0]), ([-1], [2]), (np.array([1]), [1])],
)
def test_a_selection_takes_everything_of_its_contacts(which, rows):
    contacts = Contacts(POINTS, NORMALS, sigma_point=[1e-3, 2e-3, 3e-3])
    some = contacts.select(which)
    assert len(some) == len(rows)
    for name in ("points_palm", "normals_palm", "has_normal", "covariance"):
        np.testing.assert_array_equal(getattr(some, name), getattr(contacts, name)[rows])


def sensed(n=3):
    tip = Ellipsoid(PAPER_TIP)
    rng = np.random.default_rng(2)
    truth = touches(rng, tip, n)
    found = [contact_from_wrench(f, m, tip) for f, m in zip(truth.forces, truth.torques, strict=True)]
    return [contact.moved(se3.random(rng, spread=0.1)) for contact in found]


def test_contacts_from_tips_add_the_rest_of_the_chain_s_noise_to_the_sensor_s():
    tips = sensed()
    contacts = Contacts.from_tips(tips, sigma_point=2e-3, sigma_normal=0.05)
    for i, tip in enumerate(tips):
        np.testing.assert_allclose(contacts.points_palm[i], tip.point)
        np.testing.assert_allclose(contacts.normals_palm[i], tip.normal)
        rest = contacts.covariance[i] - tip.covariance
        np.testing.assert_allclose(rest[:3, :3], 4e-6 * np.eye(3), atol=1e-15)
        np.testing.assert_allclose(
            rest[3:, 3:], 0.0025 * (np.eye(3) - np.outer(tip.normal, tip.normal)), atol=1e-12
        )
        np.testing.assert_allclose(contacts.covariance[i, :3, 3:], tip.covariance[:3, 3:], atol=1e-15)


@pytest.mark.parametrize(("tips", "field"), [([], "contacts"), ([NoContact("free")], "contacts[0]")])
def test_what_is_no_contact_makes_no_contacts(tips, field):
    with refused(InvalidInput, field):
        Contacts.from_tips(tips)


def zero_but(i, j):
    covariance = np.tile(1e-6 * np.eye(6), (3, 1, 1))
    covariance[1, i, j] = -1
    return covariance


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"points_palm": []}, "points_palm"),
        ({"points_palm": np.empty((0, 3))}, "points_palm"),
        ({"points_palm": [[np.nan, 0, 0]]}, "points_palm[0]"),
        ({"points_palm": [[0, 0, 0], [1, 2]]}, "points_palm[1]"),
        ({"points_palm": [0, 0, 0]}, "points_palm[0]"),
        ({"points_palm": 3}, "points_palm"),
        ({"points_palm": "abc"}, "points_palm"),
        ({"points_palm": [[0, 0, 0], [0, 30, 100]], "normals_palm": None}, "points_palm[1]"),
        ({"normals_palm": [[0, 0, 1]]}, "normals_palm"),
        ({"normals_palm": 1.0}, "normals_palm"),
        ({"normals_palm": [None, [0, 0, 0], None]}, "normals_palm[1]"),
        ({"normals_palm": [None, None, [0, np.inf, 0]]}, "normals_palm[2]"),
        ({"sigma_point": 0}, "sigma_point"),
        ({"sigma_normal": -0.1}, "sigma_normal"),
        ({"sigma_point": [1e-3, -1, 1e-3]}, "sigma_point[1]"),
        ({"sigma_point": [1e-3, 1e-3]}, "sigma_point"),
        ({"covariance": np.eye(6)[None]}, "covariance"),
        ({"covariance": np.eye(6)}, "covariance[0]"),
        ({"covariance": zero_but(2, 2)}, "covariance[1]"),
        ({"covariance": zero_but(1, 2)}, "covariance[1]"),
    ],
)
def test_a_wrong_set_is_refused_by_entry(arguments, field):
    with refused(InvalidInput, field):
        Contacts(**{"points_palm": POINTS, **arguments})


def test_copies_and_pickles_are_as_read_only_as_what_they_are_of():
    """For kernels a writable array is of another type, which would be compiled in the middle of a track."""
    one = Contacts(np.eye(3), np.eye(3))
    for each in (copy.deepcopy(one), copy.copy(one), pickle.loads(pickle.dumps(one))):
        assert not any(array.flags.writeable for array in vars(each).values())
        np.testing.assert_array_equal(each.covariance, one.covariance)
        assert each.record.tobytes() == one.record.tobytes()
