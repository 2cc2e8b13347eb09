"""Former public names work for one release, and a warning names the new one."""

import importlib

import pytest

FORMER = {
    "handsight": ["PinholeCamera"],
    "handsight.rig": ["Camera", "ObjectEntry"],
    "handsight.blind": ["Area", "Belief", "Sweep", "Touch", "best_sweep", "candidates", "cast", "resting"],
    "handsight.dynamics": [
        "Carried",
        "Slip",
        "SlipDetector",
        "Unknowns",
        "Weigher",
        "Weighing",
        "slip_twist",
        "weigh",
    ],
    "handsight.vision": [
        "Found",
        "HandLook",
        "HandNotSeen",
        "SeenHand",
        "followed_hand",
        "seen_hand",
        "Drawn",
        "PinholeCamera",
    ],
    "handsight.simulation": ["Found", "blind_rig", "looking", "simulate_blind"],
}


@pytest.mark.parametrize(("room", "name"), [(room, name) for room, names in FORMER.items() for name in names])
def test_a_former_name_is_the_new_object_and_says_its_name(room, name):
    module = importlib.import_module(room)
    with pytest.warns(
        DeprecationWarning, match=rf"^{room}\.{name} is now handsight\.\w+\.\w+; the old name"
    ) as caught:
        value = getattr(module, name)
    new = str(caught[0].message).split(" is now ")[1].split(";")[0]
    home, _, attribute = new.rpartition(".")
    assert value is getattr(importlib.import_module(home), attribute)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("room", FORMER)
def test_what_never_was_is_an_attribute_error(room):
    with pytest.raises(AttributeError, match=f"module '{room}' has no attribute 'nothing'"):
        _ = importlib.import_module(room).nothing
