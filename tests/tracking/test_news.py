"""A sight that says nothing new is taken in without a search, and the answer is the search's."""

import numpy as np

from handsight import se3
from handsight.correction import PosePrior
from handsight.tracking import Tracker, propagation, track
from handsight.tracking.propagation import NEWS_CHI2, is_news

SIGMAS = np.repeat([0.02, 0.1], 3)


def prior(T):
    return PosePrior(T, np.diag(SIGMAS**2))


def test_it_is_news_beyond_half_a_deviation_and_not_about_a_symmetry(can, box):
    rng = np.random.default_rng(0)
    for _ in range(50):
        T, direction = se3.random(rng, spread=0.1), rng.normal(size=6)
        step = SIGMAS * direction / np.linalg.norm(direction)
        for far, news in ((0.99, False), (1.01, True)):
            moved = se3.moved(T, far * np.sqrt(NEWS_CHI2) * step)
            assert is_news(box.model, prior(moved), prior(T)) == news
        spun = T @ se3.compose(se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(-3, 3)])), np.zeros(3))
        assert not is_news(can.model, prior(spun), prior(T))
        assert is_news(can.model, prior(se3.moved(spun, 1.5 * np.repeat([0.02, 0.0], 3))), prior(T))


def test_without_the_search_the_answer_is_the_searchs(can, monkeypatch):
    searches, correct_pose = [], track.correct_pose
    monkeypatch.setattr(track, "correct_pose", lambda *a, **k: (searches.append(1), correct_pose(*a, **k))[1])
    found, counts = [], []
    for least in (NEWS_CHI2, -1.0):
        monkeypatch.setattr(propagation, "NEWS_CHI2", least)
        searches.clear()
        tracker = Tracker(can.rig, can.model)
        for seen in can.observations:
            estimate = tracker.update(seen)
        found.append(estimate.T_palm_object)
        counts.append(len(searches))
    assert counts[0] < counts[1]
    assert np.linalg.norm(found[0][:3, 3] - found[1][:3, 3]) < 0.2 * tracker.sigma
