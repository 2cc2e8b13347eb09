"""The command `handsight`: its subcommands, and how it reports errors."""

import gc
import io
import os
import shutil
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

# Help and version must appear at once, so each command imports what computes when it runs.
from handsight.cache_folder import why_unusable
from handsight.cli import terminal
from handsight.cli.contact import WithColumns, contact
from handsight.cli.correct import correct
from handsight.cli.demo import demo
from handsight.cli.locate import locate
from handsight.cli.objects import objects_app
from handsight.cli.reconstruct import reconstruct
from handsight.cli.rig import calibrate_app, rig_app
from handsight.cli.ros2_bridge import ros2_bridge
from handsight.cli.simulate import simulate
from handsight.cli.track import track
from handsight.cli.view import view
from handsight.errors import HandsightError, NotWritten
from handsight.files import write_errors

NEEDED_SPACE = 30_000_000
"""So much space [bytes] is left before kernels are compiled, which take some twenty megabytes."""

app = typer.Typer(
    help="Know where the object is in the robot's hand, by touch and sight.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Runs the command; a user's error gives one sentence on stderr and an exit code, not a traceback.

    Exit codes: 2 for wrong input, or for more input than fits into memory; 74 if something cannot be written, as on a
    full disk; 141 if the reader of stdout has closed it.
    """
    gc.set_threshold(50_000)  # modules that load leave no garbage; searching for it took a tenth of the time
    signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )  # as Ctrl-C: what is not complete is cleared away
    terminal.reopen_closed_streams()
    for stream in (sys.stdout, sys.stderr):  # a terminal of ASCII has no µ
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    warnings.showwarning = lambda message, *_: terminal.warn(str(message))
    try:
        try:
            app()
        finally:
            # Flushed now, as a failure could not be reported when Python exits.
            try:
                with write_errors("stdout"):
                    sys.stdout.flush()
            except (BrokenPipeError, NotWritten):
                terminal.discard(sys.stdout)
                raise
    except BrokenPipeError:
        sys.exit(terminal.NOBODY_READS)
    except HandsightError as error:
        message = str(error)
        code = terminal.exit_code(error)
    except OSError as error:
        message = f"{error.filename or 'output'}: {error.strerror or error}"
        code = terminal.CANNOT_WRITE
    except Warning as error:  # as PYTHONWARNINGS=error asks
        message = f"{error} (an error by PYTHONWARNINGS)"
        code = terminal.WRONG_INPUT
    except MemoryError:
        message = "expected input that fits into memory, got more"
        code = terminal.WRONG_INPUT
    terminal.say(f"handsight: {message}")
    sys.exit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"handsight {version('handsight')}")
        raise typer.Exit


@app.callback()
def _handsight(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def warmup(
    into: Annotated[
        Path | None,
        Option(metavar="FOLDER", help="Keep them there, for an image or for machines of the same kind."),
    ] = None,
) -> None:
    """Compile all kernels now, on all cores; needed once for each version and kind of machine.

    Without it, the first command that needs a kernel compiles it. They are kept in the user's cache folder, or in the
    one that HANDSIGHT_CACHE names, which may be copied to where processor, Python, numba and handsight are the same
    and handsight is installed in the same place.

    ```
    handsight warmup --into /opt/handsight
    ```
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    import numba

    if into is not None:  # else each kernel would be compiled, and not kept
        if reason := why_unusable(into):
            raise NotWritten(reason)
        into.mkdir(parents=True, exist_ok=True)
        os.environ["HANDSIGHT_CACHE"] = str(into.absolute())
        os.environ.pop("NUMBA_CACHE_DIR", None)
    from handsight._compiled.jit import FOLDER  # by these variables
    from handsight.tracking.warm import GROUPS, LATER

    if FOLDER is None:
        raise NotWritten("no folder for compiled kernels can be written; --into names another")
    free = shutil.disk_usage(FOLDER).free
    if free < NEEDED_SPACE:
        raise NotWritten(
            f"{FOLDER}: expected {NEEDED_SPACE / 1e6:.0f} MB for kernels, got {free / 1e6:.0f} MB"
        )
    started = time.monotonic()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(numba.config.NUMBA_NUM_THREADS, context) as workers:
        for names in ([name for name in GROUPS if name not in LATER], LATER):
            running = {workers.submit(_compile, name): name for name in names}
            for ended in as_completed(running):
                terminal.say(f"{ended.result():6.1f} s  {running[ended]}")
    place = FOLDER if into is None else f"{into}; to use them, HANDSIGHT_CACHE={into.absolute()}"
    print(f"compiled in {time.monotonic() - started:.1f} s; kept in {place}")


def _compile(name: str) -> float:
    """Returns the seconds that a group of kernels took to compile; raises NotWritten where they cannot be kept."""
    from handsight._compiled.jit import KernelWarning
    from handsight.tracking.warm import GROUPS

    warnings.simplefilter("error", KernelWarning)
    started = time.monotonic()
    try:
        GROUPS[name]()
    except KernelWarning as error:
        raise NotWritten(str(error)) from None
    return time.monotonic() - started


for command in (demo, track, view, locate, simulate, correct, reconstruct):
    app.command()(command)
app.command(cls=WithColumns)(contact)
app.command()(warmup)
app.command()(ros2_bridge)
app.add_typer(objects_app, name="objects")
app.add_typer(rig_app, name="rig")
app.add_typer(calibrate_app, name="calibrate")
