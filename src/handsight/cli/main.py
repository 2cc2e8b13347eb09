"""The command `handsight`: its commands put together, and what is said of wrong input."""

import sys
import time
import warnings
from typing import Annotated

import typer

# Help and version are to be there at once: what computes is imported by the command that needs it.
from handsight.cli.contact import WithColumns, contact
from handsight.cli.correct import correct
from handsight.cli.demo import demo
from handsight.cli.locate import locate
from handsight.cli.objects import objects_app
from handsight.cli.reconstruct import reconstruct
from handsight.cli.rig import calibrate_app, rig_app
from handsight.cli.ros2_bridge import ros2_bridge
from handsight.cli.simulate import simulate
from handsight.cli.terminal import CANNOT_WRITE, WRONG_INPUT, exit_code, flush_stdout, hold_streams, say, warn
from handsight.cli.track import track
from handsight.cli.view import view
from handsight.errors import HandsightError

app = typer.Typer(
    help="Know where the object is in the robot's hand, by touch and sight.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Runs the command; what goes wrong is one sentence on stderr and an exit code, never a traceback.

    2: wrong input, or more of it than memory holds. 74: what cannot be written, such as onto a full disk.
    """
    hold_streams()
    warnings.showwarning = lambda message, *_: warn(str(message))
    try:
        try:
            app()
        finally:
            flush_stdout()
    except HandsightError as error:
        message, code = str(error), exit_code(error)
    except OSError as error:
        message, code = f"{error.filename or 'output'}: {error.strerror or error}", CANNOT_WRITE
    except MemoryError:
        message, code = "expected what fits into memory, got more", WRONG_INPUT
    say(f"handsight: {message}")
    sys.exit(code)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"handsight {version('handsight')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def warmup() -> None:
    """Compile what computes, ahead of the first problem; done once for each version and machine.

    Without it the first command that computes does so. `HANDSIGHT_CACHE` names another folder.
    """
    from handsight._kernels.runtime.kernel_cache import folder
    from handsight.tracking.warm import warm

    began = time.monotonic()
    warm(lambda name, seconds: say(f"{seconds:6.1f} s  {name}"))
    print(f"compiled in {time.monotonic() - began:.1f} s; kept in {folder()}")


for command in (demo, track, view, locate, simulate, correct, reconstruct):
    app.command()(command)
app.command(cls=WithColumns)(contact)
app.command()(warmup)
app.command()(ros2_bridge)
app.add_typer(objects_app, name="objects")
app.add_typer(rig_app, name="rig")
app.add_typer(calibrate_app, name="calibrate")
