"""Many lines while workers are killed: each is answered once, in its place."""

import pytest

from benchmarks import soak
from handsight.batch.problems import Reader, answer_text


def test_an_answer_says_which_line_it_answers(tmp_path):
    reader = Reader(tmp_path)
    for i in (0, 1, 998, 999, 9_998):
        text = answer_text(reader, soak.line(i).encode())
        assert soak.is_answer(i, text)
        assert not soak.is_answer(i + 1, text)


@pytest.mark.slow
def test_no_line_is_lost_with_a_worker(capsys):
    assert soak.main(["--lines", "1000", "--kill-every", "350"]) == 0
    assert "1 000    1 000      0" in capsys.readouterr().out
