"""The object slips when every finger is at the limit of friction, and only then."""

import copy
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.shared import slips
from forces.loads import FINGERS, Clock, load, push, rig, sliding, steady
from handsight.forces import SLIP, SlipDetector
from handsight.simulation import Nuisances, Scenario, rig_of, simulate
from handsight.tracking import FingertipSensors

MUS = st.floats(0.2, 1.5)


def knowing(mu):
    """Returns a detector that has learnt friction from one sliding finger."""
    clock = Clock(SlipDetector(rig()))
    clock.run(sliding(mu))
    return clock


@settings(deadline=None, max_examples=30)
@given(st.floats(0.3, 1.5), st.floats(0, 0.96), st.floats(1.0, 20.0), st.floats(0, 1), st.integers(0, 2))
def test_one_finger_within_the_cone_holds_the_object(mu, ratio, normal, twist, which):
    """However the others are loaded, and however hard it presses."""
    clock = knowing(mu)
    loads = [load(mu, twist=twist) for _ in FINGERS]
    loads[which] = load(ratio * mu, normal, twist=twist)
    said = clock.run(steady(loads, 0.1))[-1]
    assert not said.slipping
    assert said.least == pytest.approx(ratio, rel=0.02, abs=5e-3)


@settings(deadline=None, max_examples=30)
@given(st.floats(0.3, 1.5), st.floats(1.0, 20.0), st.floats(0, 1), st.floats(0, 2 * math.pi))
def test_all_fingers_on_the_cone_let_it_slip_within_some_milliseconds(mu, normal, twist, angle):
    clock = knowing(mu)
    clock.run(steady([load(0.3 * mu)] * 3, 0.2))
    said = clock.run(steady([load(mu, normal, angle + k, twist) for k in range(3)], 0.06))
    assert said[-1].slipping
    assert said[-1].began == pytest.approx(clock.now - 0.03, abs=0.03)


def test_declared_friction_is_used_at_once():
    clock = Clock(SlipDetector(rig(), (0.5, 0.05)))
    said = clock.run(steady([load(0.4)] * 3, 0.1))[-1]
    assert (said.slipping, said.friction, said.sigma_friction) == (False, 0.5, 0.05)
    assert said.least == pytest.approx(0.8, rel=1e-6)
    assert clock.run(steady([load(0.5)] * 3, 0.1))[-1].slipping


def pushed(mu, declared, seeds=3):
    """Returns precision and recall over pushes by one finger, and the last detector."""
    told, true = [], []
    for seed in range(seeds):
        loads, slides = push(mu, np.random.default_rng(seed))
        clock = Clock(SlipDetector(rig(0.02, ("p",)), declared), ("p",), 250.0)
        told += [said.slipping for said in clock.run(loads[:, None])]
        true += slides.tolist()
    told, true = np.array(told), np.array(true)
    return (told & true).sum() / told.sum(), (told & true).sum() / true.sum(), clock.detector


@pytest.mark.parametrize("mu", [0.15, 0.26, 0.4, 0.6])
def test_a_declared_friction_speaks_with_its_default_sigma(mu):
    precision, recall, _ = pushed(mu, (mu, 0.1))
    assert precision > 0.9
    assert recall > 0.9


def test_straight_slides_teach_a_declared_friction():
    """From above and from below, each one sigma off."""
    for declared in (0.2, 0.4):
        _, _, detector = pushed(0.3, (declared, 0.1))
        assert detector.now.friction == pytest.approx(0.3, rel=0.06)
        assert detector.now.doubt == ""


def test_a_doubt_is_said_where_loads_are_nearer_to_the_limit_than_friction_is_known():
    clock = Clock(SlipDetector(rig(), (0.26, 0.1)))
    assert clock.run(steady([load(0.1)] * 3, 0.1))[-1].doubt == ""
    assert clock.run(steady([load(0.2)] * 3, 0.1))[-1].doubt
    undeclared = Clock(SlipDetector(rig()))
    assert undeclared.run(steady([load(0.2)] * 3, 0.1))[-1].doubt
    assert undeclared.detector.update(undeclared.now + 0.002, (), None).doubt == ""


def test_what_is_held_while_its_load_changes_does_not_slip():
    """Declared well: a grip that tightens, and a load that comes and goes, well within the cone."""
    clock = Clock(SlipDetector(rig(), (0.6, 0.1)))
    grips = 3 + np.sin(np.arange(2000) / 100)
    weights = 0.5 + 0.2 * np.sin(np.arange(2000) / 37)
    held = [[load(w / g, g, k) for k in range(3)] for g, w in zip(grips, weights, strict=True)]
    assert not any(said.slipping for said in clock.run(np.array(held)))


def test_fingers_with_different_friction_are_each_at_their_own_limit():
    slippery, rough = rig().fingers["ff"], copy.copy(rig().fingers["ff"])
    slippery.friction, rough.friction = 0.3, 0.9
    fingers = {"ff": slippery, "mf": rough, "th": rough}
    clock = Clock(SlipDetector(SimpleNamespace(fingers=fingers, skin={})))
    assert not clock.run(steady([load(0.3), load(0.3), load(0.3)], 0.1))[-1].slipping
    said = clock.run(steady([load(0.3), load(0.9), load(0.9)], 0.1))[-1]
    assert said.slipping
    assert said.least == pytest.approx(1.0, rel=1e-6)


def test_a_declaration_far_too_low_gives_way_to_what_two_fingers_keep_up():
    clock = Clock(SlipDetector(rig(), (0.3, 0.03)))
    assert clock.run(steady([load(0.6)] * 3, 1.0))[-1].friction == pytest.approx(0.59, rel=0.03)


def test_contacts_that_chatter_slip_though_their_mean_load_is_within_the_cone():
    """Each reading is on the cone, but the force turns from one to the next: a mean over vectors is at half of it."""
    clock = Clock(SlipDetector(rig(), (0.5, 0.02)), rate=250.0)
    clock.run(steady([load(0.1)] * 3, 0.2))
    turning = [[load(0.5, angle=a), load(0.5, angle=a), load(0.5, angle=a)] for a in (0, 2.0) * 20]
    assert clock.run(np.array(turning))[-1].slipping


def test_an_object_that_turns_about_one_finger_slips_where_the_others_bounce():
    """And not where the others have come to rest at their limit."""
    hand = ("ff", "mf", "rf", "lf", "th")
    at_rest = [load(0.5)] * 4 + [load(0.3, 7.0)]
    bounce = [
        [load(0.5, 1.5 + 0.3 * (-1) ** (k + i)) for i in range(4)] + [load(0.3, 7.0)] for k in range(20)
    ]
    clock = Clock(SlipDetector(rig(fingers=hand), (0.5, 0.02)), hand, 250.0)
    assert not any(each.slipping for each in clock.run(steady(at_rest, 0.2)))
    assert clock.run(np.array(bounce))[-1].slipping


@pytest.mark.slow
@pytest.mark.parametrize("name", ["box", "can"])
def test_pulls_and_jerks_of_a_simulated_object_are_detected(name):
    """Those of seeds on which no threshold was chosen, friction 0.4 to 0.7."""
    totals = dict.fromkeys(("alarmed", "right", "slipped", "found"), 0)
    for seed, motion, mu in ((701, "ramp", 0.7), (703, "jerks", 0.4)):
        pull = Nuisances(friction=mu, pull_force=9.0 if name == "box" else 18.0)
        run = list(simulate(Scenario(object=name, seed=seed, motion=motion, rate=250.0, nuisances=pull)))
        robot = rig_of(Scenario())
        sensors, detector, alarms = FingertipSensors(robot), SlipDetector(robot), []
        run = [sample for sample in run if not sample.dropped]
        for sample in run:
            touch = sensors.contacts(sample.observation)
            alarms.append(detector.update(sample.observation.stamp, touch.fingers, touch.loads).slipping)
        assert detector.now.friction == pytest.approx(mu, rel=0.05)
        free = np.array([sample.phase != "close" for sample in run])
        speeds = np.array([slips.speed(sample) for sample in run])
        counted = slips.counted(np.array(alarms)[free], speeds[free], 1 / 250.0)
        totals = {key: totals[key] + counted[key] for key in totals}
    assert totals["right"] > 0.95 * totals["alarmed"]
    # Recall differs from pull to pull: .65 to .94 of those of the can. `experiments/tracking/slip.py` has the mean of many.
    assert totals["found"] > (0.9 if name == "box" else 0.7) * totals["slipped"]


def test_before_friction_is_known_nothing_slips():
    clock = Clock(SlipDetector(rig()))
    said = clock.run(steady([load(0.8)] * 3, 1.0))
    assert {each.friction for each in said} == {None}
    assert not any(each.slipping or each.ratios for each in said)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), MUS)
def test_loads_within_the_cone_never_raise_friction_above_its_true_value(seed, mu):
    """Loads anywhere within the cone, on the move: from below, noise and all."""
    rng, clock = np.random.default_rng(seed), Clock(SlipDetector(rig()))
    knots = rng.uniform(0, 1, (8, 3)), rng.uniform(0, 2 * np.pi, (8, 3)), rng.uniform(0.5, 4, (8, 3))
    for k in np.arange(0, 7, 0.01):
        ratio, angle, normal = (_between(each, k) for each in knots)
        loads = np.array([load(mu * r, n, a) for r, a, n in zip(ratio, angle, normal, strict=True)])
        said = clock.run([loads], rng, 0.01)[0]
    assert said.friction is None or said.friction < 1.05 * mu


def _between(knots, k):
    first, share = int(k), k - int(k)
    return (1 - share) * knots[first] + share * knots[first + 1]


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.2))
def test_friction_is_learnt_from_one_finger_that_slides(seed, mu):
    rng, clock = np.random.default_rng(seed), Clock(SlipDetector(rig()))
    friction = clock.run(sliding(mu), rng, 0.01)[-1].friction
    assert friction == pytest.approx(mu, rel=0.03)


def test_friction_below_what_two_fingers_keep_up_is_none():
    """Loads that turn at a ratio of .29, and later rest at .56: they were no slides, and friction is not known."""
    clock = Clock(SlipDetector(rig()))
    turning = [np.array([load(0.29, angle=k / 50 + i) for i in range(3)]) for k in range(500)]
    clock.run(turning)
    said = clock.run([np.array([load(r)] * 3) for r in np.linspace(0.29, 0.56, 100)])
    said = clock.run(steady([load(0.56)] * 3, 2.0))
    assert said[-1].friction > 0.5
    assert said[-1].doubt
    assert not any(each.slipping for each in said[-500:])
    again = clock.run(sliding(0.8))[-1]
    assert again.friction == pytest.approx(0.8, rel=0.03)
    assert not again.doubt


def test_a_load_at_rest_shows_no_friction_by_its_noise():
    """At a small ratio noise turns the vector by more than its twentieth."""
    rng, clock = np.random.default_rng(0), Clock(SlipDetector(rig(0.02)))
    assert clock.run(steady([load(0.1)] * 3, 4.0), rng, 0.02)[-1].friction is None


def test_a_load_that_only_grows_or_is_constant_shows_no_friction():
    clock = Clock(SlipDetector(rig()))
    grows = [np.array([load(0.6, normal, 0.3 * k) for k in range(3)]) for normal in np.linspace(0.1, 5, 1000)]
    said = clock.run([*grows, *grows[::-1], *steady(grows[500], 2.0)])
    assert {each.friction for each in said} == {None}


def test_a_spike_above_the_cone_does_not_raise_it():
    """Such as by a tip that touches at two places for a moment: many ratios, none of them for long."""
    clock = knowing(0.6)
    spike = [load(ratio, angle=k) for k, ratio in enumerate(np.linspace(0.9, 2.0, 15))]
    clock.run([np.array([each, load(0.2), load(0.2)]) for each in spike])
    assert clock.run(steady([load(0.3)] * 3, 0.05))[-1].friction == pytest.approx(0.6, rel=0.03)


def test_a_slip_goes_on_near_the_limit_and_ends_at_once_well_below_it():
    mu, clock = 0.7, knowing(0.7)
    assert clock.run(steady([load(mu)] * 3, 0.1))[-1].slipping
    brink = [steady([load(ratio * mu)] * 3, SLIP.min_hold / 2) for ratio in (0.99, 0.95, 1.0, 0.93, 0.99) * 2]
    assert all(each.slipping for each in clock.run(itertools.chain(*brink)))
    began = clock.detector.now.began
    said = clock.run(steady([load(0.85 * mu)] * 3, 3 * SLIP.min_hold))
    assert said[int(0.8 * SLIP.min_hold * clock.rate)].slipping
    assert not said[-1].slipping
    assert said[-1].ended > said[-1].began == began
    clock.run(steady([load(mu)] * 3, 0.1))
    assert not clock.run(steady([load(0.2 * mu)] * 3, 0.04))[-1].slipping


def test_a_slip_begins_only_at_the_higher_threshold():
    clock = knowing(0.7)
    assert not any(each.slipping for each in clock.run(steady([load(0.96 * 0.7)] * 3, 0.5)))
    assert clock.run(steady([load(0.995 * 0.7)] * 3, 0.1))[-1].slipping


def test_there_is_no_slip_without_contacts():
    clock = knowing(0.7)
    clock.run(steady([load(0.7)] * 3, 0.1))
    said = clock.detector.update(clock.now + 0.002, (), None)
    assert not said.slipping
    assert (said.least, said.friction) == (None, pytest.approx(0.7, rel=0.03))


def test_friction_is_not_learnt_from_a_dead_tip():
    clock = Clock(SlipDetector(rig()))
    dead = load(1.1, 3.0)
    moving = [np.array([dead, load(0.2, angle=k / 50), load(0.3, angle=k / 70)]) for k in range(1000)]
    said = clock.run(moving)[-1]
    assert said.friction is None or said.friction < 0.35


def test_after_a_pause_the_loads_begin_anew():
    clock = knowing(0.7)
    clock.run(steady([load(0.7)] * 3, 0.1))
    clock.now += 2 * SLIP.max_gap
    assert not clock.run(steady([load(0.1)] * 3, 0.002))[-1].slipping


@pytest.mark.parametrize("rate", [50.0, 100.0, 1000.0])
def test_the_same_at_any_rate(rate):
    clock = Clock(SlipDetector(rig()), rate=rate)
    clock.run(list(sliding(0.6))[:: max(1, round(500 / rate))])
    assert clock.detector.now.friction == pytest.approx(0.6, rel=0.03)
    assert clock.run([np.array([load(0.6)] * 3)] * round(0.06 * rate))[-1].slipping
