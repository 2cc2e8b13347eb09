"""Malformed input is refused in a sentence, or answered; `python -m tests.fuzz` tries other seeds."""

import pytest

from handsight.errors import HandsightError
from handsight.tracking.warm import GROUPS
from tests.corpus.door import check_sentence, knock
from tests.corpus.doors import CASES, DOORS


@pytest.fixture(autouse=True, scope="module")
def kernels_are_compiled():
    """Compiles all kernels first, because an alarm in the middle of compiling would make the next input fail too."""
    for warm in GROUPS.values():
        warm()


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_corrupted_input_is_answered_or_refused(door):
    answered = sum(knock(door, seed) for seed in range(door.inputs))
    # A door that refuses every input, or answers every input, is not tested by these inputs.
    assert 0 < answered < door.inputs


def test_the_corpus_is_large():
    assert sum(door.inputs for door in DOORS) + len(CASES) >= 2000


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_an_input_that_once_caused_a_fault_is_answered_or_refused(case):
    if case.says is None:
        case.bring()
        return
    with pytest.raises(HandsightError) as refused:
        case.bring()
    assert case.says in str(refused.value)
    check_sentence(str(refused.value))
