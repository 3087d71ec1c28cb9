"""The `deltatwin` command: a file of this folder whose first line reads "`deltatwin NAME`: ..." is that subcommand.

Only the file of the command that runs is imported; help and completion read first lines.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import sys
from collections.abc import Callable
from enum import Enum
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperGroup

from schemas.errors import DeltatwinError, printable
from schemas.files import remove_unused_folders
from service.cli.terminal import wrap_terminals
from service.stopping import INTERRUPTED, broke, end_at_once, terminate_as_interrupt

GROUPS = {
    "Start": ("demo", "init", "import", "inspect", "convert", "doctor"),
    "From logs to answers": ("identify", "evaluate", "payload", "diagnose", "fleet", "plan-motion", "rollout"),
    "On the bus": ("replay", "estimate", "monitor", "watch", "top", "view", "recover", "keys", "latency"),
    "On EtherCAT": ("tap", "master", "segment", "ethercat-demo"),
    "In the controller": ("export", "verify"),
    "Simulated robots": ("simulate", "closed-loop", "experiment", "blindtest"),
}
OTHERS = "More"
MISSED = 3  # exit code: everything ran, a stated bound does not hold
EXTRAS = {"mujoco": "simulate", "foxglove": "view"}  # module: what it is installed by
LINUX_ONLY = ("fcntl", "pysoem")  # what live commands import; the others run anywhere
YOUNG = 50_000  # objects between two looks for rubbish; at Python's 700 the imports alone cause a hundred
HELP_WIDTH = 120  # characters, where the terminal has as many
METAVARS = {Path: "PATH", int: "N", float: "NUMBER", str: "TEXT"}  # of options that have none of their own
_HEAD = '"""`deltatwin '


@cache
def summaries() -> dict[str, str]:
    """What each command does, by its name: the first line of its file."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        with path.open(encoding="utf-8") as file:
            head = file.readline().rstrip().removesuffix('"""')
        if head.startswith(_HEAD):
            name, _, does = head.removeprefix(_HEAD).partition("`: ")
            found[name] = does
    return found


class _Commands(TyperGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = dict.fromkeys(self.list_commands(None))  # names, for what Typer suggests after a typing error

    def list_commands(self, ctx: Any) -> list[str]:
        grouped = [name for names in GROUPS.values() for name in names if name in summaries()]
        return grouped + [name for name in summaries() if name not in grouped]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in summaries():
            return None
        module = cmd_name.replace("-", "_") + ("_" if cmd_name == "import" else "")
        one = typer.Typer(add_completion=False, rich_markup_mode=None)
        function = importlib.import_module(f"{__package__}.{module}").command
        one.command(cmd_name)(function)
        found: Any = typer.main.get_command(one)
        hints = get_type_hints(function, include_extras=True)
        for parameter in found.params:
            parameter.metavar = parameter.metavar or _metavar(hints.get(parameter.name))
            if parameter.param_type_name == "argument":
                parameter.get_help_record = partial(_record, parameter.get_help_record)
        return found

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        grouped = {name for names in GROUPS.values() for name in names}
        rest = tuple(name for name in summaries() if name not in grouped)
        for title, names in (*GROUPS.items(), (OTHERS, rest)):
            rows = [(name, summaries()[name]) for name in names if name in summaries()]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _record(made: Callable[[Any], tuple[str, str] | None], ctx: Any) -> tuple[str, str] | None:
    """How help lists an argument: by its name alone, without Python's word for its type behind it."""
    record = made(ctx)
    return record and (record[0].partition(" <")[0], record[1])


def _metavar(hint: Any) -> str | None:
    """What stands in help for a value of this type; None for a flag."""
    if isinstance(hint, type) and issubclass(hint, Enum):
        return "|".join(one.value for one in hint)
    if get_origin(hint) is Literal:
        return "|".join(get_args(hint))
    return METAVARS.get(hint) or next(filter(None, map(_metavar, get_args(hint))), None)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"deltatwin {version('deltatwin')}")
        raise typer.Exit


app = typer.Typer(
    name="deltatwin",
    cls=_Commands,
    help="Controller-side twin for Delta robots: feed-forward torque, payload mass, and the sim-to-real gap explained.",
    epilog="deltatwin COMMAND --help says more, with an example.",
    no_args_is_help=True,
    rich_markup_mode=None,  # brackets are meant; and the help of a pipe is that of a terminal
    pretty_exceptions_enable=False,
    context_settings={
        "max_content_width": HELP_WIDTH,
        "terminal_width": None if sys.stdout.isatty() or os.environ.get("COLUMNS") else HELP_WIDTH,
    },
)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run a subcommand.

    A known error is one line on stderr and exit code 1, wrong usage 2, a bound that is missed 3, Ctrl-C 130.
    """
    wrap_terminals()
    try:
        terminate_as_interrupt()
        # Matrices here are small, and what is large has threads of its own: more would only wait for each other.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is imported
        gc.set_threshold(YOUNG)
        code = _outcome()
        end_at_once(code or 0)
    except KeyboardInterrupt:
        code = INTERRUPTED
        end_at_once(code)
    if code == INTERRUPTED:
        # Files are whole by now; a thread that still computes, or compiles for seconds, has nobody to do it for.
        atexit._run_exitfuncs()
        os._exit(code)
    if code is not None:
        sys.exit(code)


def _outcome() -> int | None:
    """The exit code; None where nothing set one.

    Raises:
        KeyboardInterrupt: it was interrupted.
    """
    try:
        _run()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except Exception as error:
        if broke(error):
            raise KeyboardInterrupt from None
        raise
    return None


def _run() -> None:
    try:
        try:
            app()
        finally:
            remove_unused_folders()
            sys.stdout.flush()  # here, where a full disk or a closed pipe behind it can still be told
    except DeltatwinError as error:
        _end(str(error))
    except OSError as error:
        if sys.stdout.fileno() == 1:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left in the buffer goes nowhere
        _end(printable(f"{error.filename or 'output'}: {error.strerror or error}"))
    except ModuleNotFoundError as error:
        missing, what = (error.name or "").partition(".")[0], sys.argv[1] if len(sys.argv) > 1 else "this"
        if missing in EXTRAS:
            _end(f"{what} needs {missing}: install deltatwin[{EXTRAS[missing]}]")
        if missing not in LINUX_ONLY:
            raise
        _end(f"{what} needs Linux: this system has no {missing}")
    except MemoryError:
        _end("out of memory; give a shorter log, or use a machine with more memory")


def _end(said: str) -> NoReturn:
    print(f"deltatwin: {said}", file=sys.stderr)
    sys.exit(1)
