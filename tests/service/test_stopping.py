"""Signals at moments at which they are easily lost, or end a process in a way that nobody asked for."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

import drivers.bus
from drivers.bus import open_bus
from replay.demo import LOG, ROBOT
from schemas.errors import BusError
from schemas.messages import Role
from service.cli.segment import _listening

DELTATWIN = str(Path(sys.executable).with_name("deltatwin"))
AS_MAIN = """
import os, signal, sys, time
from service.cli import main
def app():
    {}
main.app = app
main.main()
"""


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(
    ("how", "before"),
    [
        *((how, "typer") for how in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
        *((signal.SIGINT, module) for module in ("atexit", "service.stopping")),
    ],
)
def test_while_the_program_is_loaded_it_ends_without_a_word(how: signal.Signals, before: str) -> None:
    done = run(f"""
import os, sys
class Sends:
    def find_spec(self, name, path=None, target=None):
        if name == {before!r}:
            os.kill(os.getpid(), {how:d})
sys.meta_path.insert(0, Sends())
sys.argv = ["deltatwin", "--version"]
from deltatwin.__main__ import main
main()
""")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_before_a_command_is_chosen_it_ends_without_a_word(how: signal.Signals) -> None:
    done = run(f"""
import gc, os, sys
gc.set_threshold = lambda young: os.kill(os.getpid(), {how:d})
sys.argv = ["deltatwin", "--version"]
from deltatwin.__main__ import main
main()
""")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_while_the_interpreter_ends_it_changes_nothing(how: signal.Signals) -> None:
    """What was done was done: it ends as it would have."""
    done = run(f"""
import builtins, os, sys
class Sends:
    def __del__(self, kill=os.kill, me=os.getpid()):
        kill(me, {how:d})
builtins.kept = Sends()  # until modules are taken apart
sys.argv = ["deltatwin", "--version"]
from deltatwin.__main__ import main
main()
""")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("deltatwin ")


def test_an_interrupt_that_code_which_catches_everything_has_swallowed_stops_a_role() -> None:
    swallowing = """
    from service.stopping import stop_requested
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    except BaseException:  # as a library does while it is imported
        pass
    print(stop_requested()())
"""
    done = run(AS_MAIN.format(swallowing))
    assert done.stdout.strip() == "True", done.stderr


def test_an_interrupt_that_is_swallowed_by_what_a_library_calls_back_is_raised_again() -> None:
    swallowing = """
    import ctypes
    back = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM) or time.sleep(5))
    back()
    print("swallowed", flush=True)
    time.sleep(50)"""
    done = run(AS_MAIN.format(swallowing))
    assert (done.returncode, done.stdout, done.stderr) == (130, "swallowed\n", "")


def test_an_interrupt_that_a_library_prints_is_no_traceback_and_raised_again(tmp_path: Path) -> None:
    """C code that cannot hand an exception on prints it (PyErr_Print), which calls `sys.excepthook`."""
    done = run("""
import os, signal, sys, time
class Prints:
    def find_spec(self, name, path=None, target=None):
        if name == "numba":
            try:
                os.kill(os.getpid(), signal.SIGHUP) or time.sleep(5)
            except KeyboardInterrupt:
                sys.excepthook(*sys.exc_info())
            time.sleep(50)
sys.meta_path.insert(0, Prints())
sys.argv = ["deltatwin", "simulate", "--robot", "d3-1200", "--out", sys.argv[1]]
from deltatwin.__main__ import main
main()
""", str(tmp_path / "log.mcap"))  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


HALF_BUILT = """
    class Target:
        def __init__(self):
            {}
            self.open = True
        def __del__(self):
            del self.open
    Target()"""


def test_an_object_that_an_interrupt_left_half_built_says_nothing() -> None:
    done = run(AS_MAIN.format(HALF_BUILT.format("os.kill(os.getpid(), signal.SIGHUP) or time.sleep(5)")))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    done = run(AS_MAIN.format(HALF_BUILT.format("del self.open")))
    assert "Exception ignored in" in done.stderr, "without an interrupt it is told"


def test_what_a_library_makes_of_an_interrupt_is_no_traceback() -> None:
    compiler = """
    import ctypes
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT) or time.sleep(5))()
    raise RuntimeError("no compiled object yet")"""
    loading = """
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt"""
    building = """
    raise ValueError("Error building `literal` serializer: KeyboardInterrupt: ")"""
    naming = """
    class Field:
        def __set_name__(self, owner, name):
            os.kill(os.getpid(), signal.SIGINT) or time.sleep(5)
    class Owner:
        field = Field()"""
    replacing = """
    try:
        os.kill(os.getpid(), signal.SIGHUP) or time.sleep(5)
    except KeyboardInterrupt:
        pass
    raise ImportError("numba._devicearray failed to import")"""
    library = """
try:
    os.kill(os.getpid(), signal.SIGHUP) or time.sleep(5)
except KeyboardInterrupt:
    pass
raise TypeError('expected a message argument')
"""
    imported = f"""
    exec(compile({library!r}, "library.py", "exec"))"""
    for left_behind in (compiler, loading, building, naming, replacing, imported):
        done = run(AS_MAIN.format(left_behind))
        assert (done.returncode, done.stderr) == (130, "")
    done = run(AS_MAIN.format("raise RuntimeError('of its own')"))
    assert done.returncode == 1
    assert done.stderr.endswith("RuntimeError: of its own\n")


def test_an_error_after_an_interrupt_that_was_answered_is_told() -> None:
    cleaning = """
    try:
        os.kill(os.getpid(), signal.SIGINT) or time.sleep(5)
    except KeyboardInterrupt:
        raise RuntimeError("of its own") from None"""
    done = run(AS_MAIN.format(cleaning))
    assert done.returncode == 1
    assert done.stderr.endswith("RuntimeError: of its own\n")
    later = """
    try:
        os.kill(os.getpid(), signal.SIGINT) or time.sleep(5)
    except KeyboardInterrupt:
        time.sleep(1.1)
    raise ImportError("of its own")"""
    done = run(AS_MAIN.format(later))
    assert done.returncode == 1
    assert done.stderr.endswith("ImportError: of its own\n")


def test_what_makes_files_whole_is_not_torn_by_the_same_ctrl_c_from_another_side() -> None:
    twice = """
    try:
        os.kill(os.getpid(), signal.SIGINT) or time.sleep(5)
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.2)
        print("whole", flush=True)"""
    done = run(AS_MAIN.format(twice))
    assert (done.returncode, done.stdout, done.stderr) == (130, "whole\n", "")


def test_at_the_end_a_signal_changes_nothing() -> None:
    late = AS_MAIN.format("pass") + "\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(5)\n"
    done = run(late)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_bus_that_is_closed_has_left_no_thread(bus_folder: Path) -> None:
    before = set(threading.enumerate())
    with open_bus("bench", Role.MONITOR) as bus, open_bus("bench", Role.PLAYER):
        inboxes = [bus.subscribe(topic) for topic in ("sample", "health")]
        assert not any(inbox.wait(0.05) for inbox in inboxes)
        assert len(set(threading.enumerate()) - before) == 2
    assert set(threading.enumerate()) <= before


def test_a_clock_before_1970_is_an_error(bus_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers.bus.time, "time", lambda: -86_400.0)
    with pytest.raises(BusError, match=r"says 1969-12-31 00:00:00 UTC; set it"):
        open_bus("bench", Role.MONITOR)


def test_the_listener_of_a_segment_ends_with_it(
    monkeypatch: pytest.MonkeyPatch, until: Callable[[Callable[[], bool]], None]
) -> None:
    from drivers.simulated.segment.wire import Switches

    heard, told = os.pipe()
    switches, before = Switches(), set(threading.enumerate())
    with os.fdopen(heard) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with _listening(switches):
            os.write(told, b"product 2.5\nsil")
            until(lambda: switches.product == 2.5)
            os.write(told, b"ence 3\n")
            until(lambda: bool(switches.silent))
    assert set(threading.enumerate()) <= before
    os.close(told)


STARTS_ONE = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1].format(os.getpid())], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux, whose kernel ends it")
def test_what_was_started_ends_with_a_process_that_is_killed() -> None:
    starts = (
        "import time; from service.stopping import end_with; end_with({}); print('runs', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", STARTS_ONE, starts], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        assert child.is_running()
        parent.kill()
    assert psutil.wait_procs([child], 10.0)[0]


def test_what_was_started_by_a_process_that_is_gone_ends() -> None:
    ended = run("from service.stopping import end_with; end_with(1); print('runs')")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


def test_while_estimate_compiles_a_signal_ends_it_at_once(bus_folder: Path, tmp_path: Path) -> None:
    """Not by an exception, which what is compiled could swallow, or leave memory with two owners behind."""
    ended = run(f"""
import os, signal, sys, time
from service.estimator import online
def swallows(description):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5.0)
    except BaseException:
        print("swallowed", flush=True)
online.compile_estimator = swallows
sys.argv = ["deltatwin", "estimate", "--robot", {str(ROBOT)!r}]
from service.cli.main import main
main()
""")
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr.endswith("about half a minute\n")


@pytest.mark.slow
def test_who_compiles_for_a_process_that_was_killed_does_not_go_on(tmp_path: Path) -> None:
    code = """
from replay.demo import ROBOT
from schemas.robot import load_robot
from service.estimator.estimator import compile_all
compile_all(load_robot(ROBOT))
"""
    asking = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)})
    try:
        give_up = time.monotonic() + 120
        while not any(
            "compile_payload" in " ".join(child.cmdline()) for child in psutil.Process(asking.pid).children()
        ):
            assert asking.poll() is None
            assert time.monotonic() < give_up
            time.sleep(0.05)
        (beside,) = psutil.Process(asking.pid).children()
        while not any("llvmlite" in library.path for library in beside.memory_maps()):  # it compiles, or is about to
            time.sleep(0.05)
        time.sleep(3.0)
    finally:
        asking.kill()
        asking.wait()
    assert psutil.wait_procs([beside], 10)[0]


@pytest.mark.parametrize(
    ("given", "module", "method"),
    [
        (("replay", LOG, "--robot", ROBOT, "--loop", "0", "--wait", "0"), "drivers.health", "Health.time_one"),
        (("simulate", "--live", "--robot", ROBOT, "--truth", "ideal"), "drivers.health", "Health.time_one"),
        (("estimate", "--robot", ROBOT), "service.estimator.estimator_node", "EstimatorNode.step"),
        (("view", "--robot", ROBOT, "--port", "0"), "drivers.view.server", "LiveView.step"),
    ],
    ids=lambda one: one[0] if isinstance(one, tuple) else "",
)
@pytest.mark.parametrize("rounds", [0, 20], ids=["before", "inside"])
def test_an_interrupt_that_code_swallows_ends_a_loop_without_an_end(
    bus_folder: Path, given: tuple[object, ...], module: str, method: str, rounds: int
) -> None:
    """Code that catches everything does so while it is imported, or inside the loop itself."""
    code = """
import importlib, os, signal, sys, time
from service.stopping import terminate_as_interrupt
rounds, module, (owner, name) = int(sys.argv[1]), sys.argv[2], sys.argv[3].split(".")
def swallow():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5.0)
    except BaseException:
        pass
if rounds == 0:
    terminate_as_interrupt()
    swallow()
else:
    owner = getattr(importlib.import_module(module), owner)
    does, called = getattr(owner, name), []
    def swallowing(*given):
        called.append(1)
        if len(called) == rounds:
            swallow()
        return does(*given)
    setattr(owner, name, swallowing)
sys.argv = ["deltatwin", *sys.argv[4:]]
from service.cli.main import main
main()
"""
    ended = subprocess.run(
        [sys.executable, "-c", code, str(rounds), module, method, *map(str, given)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr  # as after any Ctrl-C in the loop
    assert "Traceback" not in ended.stderr


def test_a_role_ends_well_whenever_it_is_told_to(bus_folder: Path, bench_robot: Path, tmp_path: Path) -> None:
    """`tests/bench/bench_stop.py` does this hundreds of times, with all roles."""
    moments = random.Random(1)
    for number in range(6):
        how = signal.Signals(moments.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
        process = subprocess.Popen(
            [DELTATWIN, "monitor", "--robot", bench_robot, "--out", tmp_path / f"{number}.mcap"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        time.sleep(moments.uniform(0.2, 2.0))
        process.send_signal(how)
        _, said = process.communicate(timeout=60)
        assert process.returncode in (0, 130, -how), said  # the last: before Python has read a line of ours
        assert not any(word in said for word in ("Traceback", "ignored", "FATAL", "panicked")), said
