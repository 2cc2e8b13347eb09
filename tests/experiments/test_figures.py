"""The pages' figures: each has an origin, and is what its entry of docs/figures.json has."""

import json

import pytest

from experiments import figures

PAGE = """# Results

<!-- figures: run -->
```
error 0.25 mm
```

<!-- figures: table -->
| a | b |
|---|---|
| 1.5 | 2.5 |

<!-- figures from: run, table -->
It is off by 0.3 mm, in 25 % of them by 1.5°.

<!-- no figures: defaults -->
| c | 0.1 | 0.2 | 0.3 | 0.4 |
"""
ENTRIES = {
    "run": {
        "command": "printf 'wrote a.csv\\nerror 0.25 mm\\n'",
        "lines": ["error 0.25 mm"],
        "again": [0.01, 0, ""],
    },
    "table": {"command": "python x.py", "part": "half", "lines": ["| a | b |", "|---|---|", "| 1.5 | 2.5 |"]},
}


@pytest.fixture
def manual(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("A page.\n")
    (tmp_path / figures.FILE).write_text(json.dumps(ENTRIES))
    (tmp_path / "docs" / "results.md").write_text(PAGE)
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    return tmp_path


def test_the_pages_agree_with_the_file():
    assert figures.check() == []


@pytest.mark.parametrize(
    ("before", "after", "wrong"),
    [
        ("0.25 mm\n", "0.26 mm\n", "results.md:5: other figures than run in docs/figures.json"),
        ("| 1.5 |", "| 1.6 |", "results.md:9: other figures than table in docs/figures.json"),
        ("0.3 mm", "0.4 mm", "results.md:14: 0.4 mm: not in run, table"),
        ("25 %", "26 %", "results.md:14: 26 %: not in run, table"),
        ("run, table", "table", "results.md:14: 0.3 mm, 25 %: not in table"),
        ("<!-- no figures: defaults -->\n", "", "results.md:16: figures without an origin"),
        (
            "<!-- figures: table -->\n",
            "<!-- figures: none -->\n",
            "results.md:9: docs/figures.json has no none",
        ),
    ],
)
def test_a_figure_that_is_not_its_entrys_is_named(manual, before, after, wrong):
    assert figures.check() == []
    page = manual / "docs" / "results.md"
    page.write_text(PAGE.replace(before, after, 1))
    assert f"docs/{wrong}" in figures.check()


def test_what_a_first_page_measures_has_an_origin(manual):
    (manual / "README.md").write_text(
        "Off by 3 mm, in `7 mm` code.\n\n<!-- figures from: run -->\nOff by 0.25 mm.\n"
    )
    assert figures.check() == ["README.md:1: figures without an origin"]


def test_pages_are_written_from_the_file(manual):
    page = manual / "docs" / "results.md"
    page.write_text(PAGE.replace("error 0.25 mm", "error 9.99 mm\nand more").replace("| 1.5 |", "| 1.6 |"))
    figures.main(["--pages"])
    assert page.read_text() == PAGE


def test_a_measurement_is_its_commands_output_in_file_and_page(manual, capsys):
    assert figures.main(["--check", "--run"]) == 0
    figures.main(["--measure", "run", "--command", "echo error 0.75 mm; echo in all"])
    assert "0.3 mm, 25 %: not in run, table" in capsys.readouterr().out
    assert "```\nerror 0.75 mm\nin all\n```" in (manual / "docs" / "results.md").read_text()
    entry = json.loads((manual / figures.FILE).read_text())["run"]
    assert entry["lines"] == ["error 0.75 mm", "in all"]
    assert {"date", "machine", "code"} < set(entry)
    with pytest.raises(SystemExit, match="table: half, of python x.py"):
        figures.main(["--measure", "table"])


def test_a_run_that_prints_other_figures_is_named(manual, capsys):
    for printed, wrong in (
        ("error 0.255 mm", False),
        ("error 0.27 mm", True),
        ("fault 0.25 mm", True),
        ("error 0.25 mm\\nmore", True),
    ):
        entry = ENTRIES["run"] | {"command": f"printf '{printed}'"}
        (manual / figures.FILE).write_text(json.dumps(ENTRIES | {"run": entry}))
        assert figures.main(["--run"]) == wrong
        assert ("run: has" in capsys.readouterr().out) == wrong


def test_a_page_s_block_is_entered_as_it_stands(manual):
    page = manual / "docs" / "results.md"
    page.write_text(PAGE.replace("| 1.5 |", "| 1.6 |"))
    figures.main(["--enter", "table"])
    entry = json.loads((manual / figures.FILE).read_text())["table"]
    assert (entry["lines"][2], entry["transcribed"], entry["command"]) == (
        "| 1.6 | 2.5 |",
        True,
        "python x.py",
    )
