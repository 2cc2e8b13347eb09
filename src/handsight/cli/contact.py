"""`handsight contact`: a table of wrenches converted to contacts."""

import sys
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option
from typer.core import TyperCommand

from handsight.cli.terminal import announce_compiling, say


class WithColumns(TyperCommand):
    """A command whose help ends with the columns of its tables, in their own layout."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Prints the help."""
        from handsight.contact import COLUMNS_HELP, FINGERTIP_HELP

        super().format_help(ctx, formatter)
        print(f"Fingertip: {FINGERTIP_HELP}\n{COLUMNS_HELP}")


def contact(
    wrenches: Annotated[str, Argument(help="A .csv or .jsonl file of wrenches, or - for stdin.")],
    fingertip: Annotated[str, Option(metavar="SHAPE", help="Shape of the fingertip, as described below.")],
    output: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            help="File for the contacts: CSV, or JSON lines for a name in .jsonl. Default: stdout, as CSV.",
        ),
    ] = None,
    sigma_force: Annotated[float, Option(help="Standard deviation of the force, per axis [N].")] = 0.01,
    sigma_torque: Annotated[float, Option(help="Standard deviation of the torque, per axis [N m].")] = 5e-5,
) -> None:
    """Compute where an object touches a fingertip, from what its force/torque sensor reads (eq. 7 of the paper).

    A wrench is the force and torque of the object on the fingertip. The sensor's bias and the weight that it carries
    must be removed before; in Python, `handsight.calibrate_wrench` and `handsight.contact.compensate` do that.

    ```
    handsight contact wrenches.csv --fingertip ellipsoid:8,8,12mm,cap=-2mm --output contacts.csv
    ```
    """
    from handsight.contact import convert, parse_fingertip

    announce_compiling()
    shape = parse_fingertip(fingertip)
    # Tables are in UTF-8, whatever the locale.
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
