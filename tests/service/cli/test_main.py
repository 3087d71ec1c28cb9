"""The command line as a whole: what it is made of, how soon it answers, what is never imported."""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import service.cli
from service.cli.main import GROUPS, app, summaries

SLOW = ("scipy.signal", "scipy.stats", "scipy.ndimage", "scipy.optimize", "filterpy")
HEAVY = ("numpy", "rich", "numba", "polars", "zenoh", "mujoco")  # seconds to import; help needs none of them


def test_every_command_is_found_and_grouped() -> None:
    commands = {
        found.name.removesuffix("_").replace("_", "-")
        for found in pkgutil.iter_modules(service.cli.__path__)
        if found.name != "main" and hasattr(importlib.import_module(f"service.cli.{found.name}"), "command")
    }
    assert set(summaries()) == commands
    shown = CliRunner().invoke(app, ["--help"]).output
    for group in GROUPS:
        assert f"\n{group}:\n" in shown
    for name, does in summaries().items():
        assert does in " ".join(shown.split())
        assert f"\n  {name} " in shown


def test_help_and_version_import_nothing_heavy() -> None:
    code = f"""
import sys
sys.argv = ["deltatwin", "--help"]
from service.cli.main import main
try:
    main()
finally:
    print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_a_diagnosis_waits_for_no_import_that_it_can_do_without() -> None:
    """SciPy's signals import its statistics, as filterpy does: together they took an eighth of a diagnosis. So is it
    with the estimator's filter, which tries a correction."""
    code = f"""
import sys
import drivers.trace.csv_file
from service.diagnosis.pipeline import diagnose
from service.diagnosis.documents import document, report, worth
from service.estimator.kalman import design
design(1e-3, 1e-6)
print([name for name in {SLOW} if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_identification_does_not_wait_for_the_estimator() -> None:
    """Four fifths of an identification of half a minute of log are imports."""
    code = """
import sys
import drivers.trace.csv_file
from service.identification import conclusion, of_logs, rigs
print([name for name in ("scipy.signal", "service.estimator.estimator") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_start_hardly_looks_for_rubbish() -> None:
    """At Python's own threshold some hundred times, a twentieth of a diagnosis in all."""
    code = """
import gc
from service.cli import main
main.app = lambda: __import__("service.diagnosis.pipeline")
before = gc.get_stats()[0]["collections"]
main.main()
print(gc.get_stats()[0]["collections"] - before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 20


@pytest.mark.skipif(not Path("/proc/self/task").is_dir() or os.cpu_count() == 1, reason="threads are not told here")
def test_linear_algebra_has_no_threads_of_its_own() -> None:
    """Those that OpenBLAS starts on import took a fifth of the processor time of a diagnosis and more."""
    code = """
import os
from service.cli import main
main.app = lambda: __import__("numpy")
main.main()
print(len(os.listdir("/proc/self/task")))
"""
    said = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=said)
    assert done.stdout.strip() == "1"


def test_version_is_the_packages() -> None:
    from importlib.metadata import version

    assert CliRunner().invoke(app, ["--version"]).output.strip() == f"deltatwin {version('deltatwin')}"


@pytest.mark.parametrize("name", summaries())
def test_help_of_each_command_has_an_example_and_keeps_brackets(name: str) -> None:
    shown = CliRunner().invoke(app, [name, "--help"])
    assert shown.exit_code == 0
    assert f"deltatwin {name}" in shown.output.split("Example:", 1)[1]


def test_an_option_takes_the_same_everywhere() -> None:
    """One metavar a name over all commands, and none that is Python's word for a type."""
    commands: Any = get_command(app)
    taken: dict[str, dict[str | None, list[str]]] = {}
    for name in summaries():
        command = commands.get_command(None, name)
        shown = CliRunner().invoke(app, [name, "--help"]).output
        assert not re.search(r"^  \S+ <", shown, re.MULTILINE), name
        for option in command.params:
            taken.setdefault(max(option.opts, key=len), {}).setdefault(option.metavar, []).append(name)
    assert len(taken) > 60
    several = {option: found for option, found in taken.items() if len(found) > 1}
    assert set(several) == {"--motion"}, several  # `simulate` also plans by a name
    asked = {name for names in taken["--json"].values() for name in names}
    assert {"demo", "experiment", "closed-loop", "diagnose", "fleet", "inspect", "recover", "rollout"} <= asked


def test_any_command_ends_by_sigterm_as_by_ctrl_c() -> None:
    code = """
import os, signal
from service.cli import main
main.app = lambda: os.kill(os.getpid(), signal.SIGTERM) or signal.pause()
main.main()
"""
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 130


def test_an_interrupted_command_waits_for_no_thread_and_tidies_up() -> None:
    code = """
import atexit, signal, time
from concurrent.futures import ThreadPoolExecutor
from service.cli import main
pool = ThreadPoolExecutor(1)
pool.submit(time.sleep, 300)
atexit.register(print, "tidied", flush=True)
def stopped():
    print("some output", end=" ")
    raise OUTCOME
main.app = stopped
main.main()
"""
    for outcome in ("KeyboardInterrupt", "SystemExit(130)"):  # Typer makes the second of the first
        program = [sys.executable, "-c", code.replace("OUTCOME", outcome)]
        done = subprocess.run(program, check=False, timeout=60, capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (130, "some output tidied\n")


def test_a_command_that_waits_for_a_thread_hears_ctrl_c_after_polars_is_there() -> None:
    code = """
import os, signal, threading, time
from service.cli import main
def waits():
    from drivers.trace.csv_file import pl
    from concurrent.futures import ThreadPoolExecutor
    pool = ThreadPoolExecutor(1)
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    pool.submit(time.sleep, 300).result()
main.app = waits
main.main()
"""
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 130


def test_brackets_in_help_are_kept() -> None:
    assert "[identified] section" in " ".join(CliRunner().invoke(app, ["identify", "--help"]).output.split())


def test_a_typing_error_is_answered_with_the_nearest_command() -> None:
    done = CliRunner().invoke(app, ["identfy"])
    assert done.exit_code == 2
    assert "Did you mean 'identify'" in done.output


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("simulate --robot {axes} --motion multisine --out {out}/a.csv --picks {out}/p.csv", "--picks: only for Delta"),
        ("simulate --robot {axes} --motion slow --out {out}/a.csv --later warmup@1s", "--later: only for Delta robots"),
        ("simulate --robot d3-1200 --out {out}/a.csv --loop 2", "--loop: only for --live"),
        ("simulate --robot d3-1200 --out {out}/a.csv --ros-domain 2", "--ros-domain: only for --live"),
        ("simulate --robot d3-1200 --live --loop 1 --picks {out}/p.csv", "--picks: only for a log that is"),
        ("fleet {out} --out {out}/f --scheduler tcp://127.0.0.1:1", "--scheduler: only for --backend dask"),
        ("blindtest --out {out}/b --scheduler tcp://127.0.0.1:1", "--scheduler: only for --backend dask"),
    ],
)
def test_an_option_that_would_do_nothing_is_wrong_usage(tmp_path: Path, command: str, said: str) -> None:
    axes = tmp_path / "axes.toml"
    axes.write_text('name = "one"\nkind = "axes"\n[[axis]]\n')
    told = CliRunner().invoke(app, command.format(out=tmp_path, axes=axes).split())
    assert (told.exit_code, said in " ".join(told.output.split())) == (2, True), told.output
    assert list(tmp_path.iterdir()) == [axes]
