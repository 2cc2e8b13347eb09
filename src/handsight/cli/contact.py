"""`handsight contact`: wrenches to contacts."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from handsight.cli.terminal import announce_compiling, say

if TYPE_CHECKING:
    pass


class WithColumns(TyperCommand):
    """A `WithColumns` is a command whose help ends with what it reads and writes, laid out as it stands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Prints the help."""
        from handsight.contact import COLUMNS_HELP, FINGERTIP_HELP

        super().format_help(ctx, formatter)
        print(f"Fingertip: {FINGERTIP_HELP}\n{COLUMNS_HELP}")


def contact(
    wrenches: Annotated[str, typer.Argument(help="A .csv or .jsonl file of wrenches, or - for stdin.")],
    fingertip: Annotated[str, typer.Option(help="Shape of the tip, as below.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="CSV, or JSON lines by its name; default: CSV on stdout."),
    ] = None,
    sigma_force: Annotated[float, typer.Option(help="Noise of the force, per axis [N].")] = 0.01,
    sigma_torque: Annotated[float, typer.Option(help="Noise of the torque, per axis [N m].")] = 5e-5,
) -> None:
    """Where the object touches a fingertip, from the wrench its six-axis sensor reads (eq. 7 of the paper).

    Readings are what the object exerts on the tip, without bias and weight: `handsight.calibrate_wrench` and
    `handsight.contact.compensate` remove those.
    """
    from handsight.contact import convert, parse_fingertip

    announce_compiling()
    shape = parse_fingertip(fingertip)
    # Whatever the locale, tables are in UTF-8.
    source: Any = wrenches
    if wrenches == "-":
        source = open(sys.stdin.fileno(), encoding="utf-8", newline="", closefd=False)  # noqa: SIM115
    sink: Any = output
    if output is None or str(output) == "-":
        sink = sys.stdout
        sink.reconfigure(encoding="utf-8")
    counts = convert(source, sink, shape, sigma_force=sigma_force, sigma_torque=sigma_torque)
    counted = ", ".join(f"{count} {reason}" for reason, count in counts.items() if count) or "no rows"
    say(f"{'' if output is None else f'wrote {output}: '}{counted}")
