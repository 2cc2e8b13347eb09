"""Options under their former names work for one release, and say what they are now."""

import pytest
import typer

from handsight.cli.options import renamed


@pytest.mark.parametrize(("new", "old"), [(False, False), (True, False), (False, True), (True, True)])
def test_a_former_name_works_and_names_the_new_one(new, old, capsys):
    assert renamed(new, old, ("--in-hand", "--held")) is (new or old)
    message = "handsight: --held is now --in-hand; the old name goes with the next release\n"
    assert capsys.readouterr().err == (message if old else "")


def test_a_value_under_a_former_name_is_used_unless_the_new_one_is_given(capsys):
    assert renamed(None, "out", ("--output-folder", "--output")) == "out"
    assert renamed("new", "out", ("--output-folder", "--output")) == "new"
    assert renamed(None, None, ("--output-folder", "--output")) is None
    assert capsys.readouterr().err.count("--output is now --output-folder") == 2


def test_former_names_are_not_in_the_help():
    from typer.testing import CliRunner

    from handsight.cli.reconstruct import reconstruct

    app = typer.Typer()
    app.command()(reconstruct)
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    assert "--in-hand" in text
    assert "--robot-poses" in text
    assert "--held" not in text
    assert "--given" not in text
