"""Shared fixtures. A test that needs something outside the repository skips and says what; CI forbids such skips."""

from __future__ import annotations

import lzma
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY / "tests" / "data"
# What watches the clock, on interfaces, sockets and roles: one after the other when tests run on several workers.
ON_THE_CLOCK = (
    *(f"tests/drivers/ethercat/test_{name}" for name in ("faults", "soem_master", "passed_over", "segment")),
    "tests/drivers/ethercat/test_live_tap",
    *(f"tests/drivers/test_{name}.py" for name in ("bus", "health", "motion", "ros", "security")),
    "tests/drivers/simulated/plant/test_plant_on_bus.py", "tests/replay", "tests/service/test_",
    "tests/service/monitor",
    "tests/service/cli/test_demo.py", "tests/service/cli/test_replay.py",
    "tests/service/experiment/test_live_loop.py",
    "tests/service/machines/test_every_command.py::test_a_log_on_the_bus",
    "tests/docs/test_tutorials.py::test_a_tutorial_does_what_it_says[first-demo",
)  # fmt: skip

# Files of few tests that take minutes each.
LONGEST = ("tests/test_wheel.py", "tests/docs/test_tutorials.py")

# What does another thing for root, or with wireshark and a browser. What skips without them is asked again anyway.
BY_RIGHTS = (
    *(f"tests/service/cli/test_{name}" for name in ("disk", "doctor", "first_day", "traces")),
    "tests/service/pages", "tests/test_wheel.py",
)  # fmt: skip


def _listed(name: str) -> tuple[str, ...]:
    lines = Path(__file__).with_name(name).read_text("utf-8").splitlines()
    return tuple(line for line in lines if line[0] != "#")


# What the quick set does without, and what of that CI runs once a week: see there.
SLOW, WEEKLY = _listed("slow.txt"), _listed("weekly.txt")


class _Held:
    """When the hypervisor held this machine up, as `tests/stolen.py` tells it, and when the present test began."""

    began = 0.0  # s of CLOCK_MONOTONIC
    process: subprocess.Popen[bytes] | None = None
    told = tempfile.TemporaryFile("a+b")  # noqa: SIM115  # as long as this process

    @classmethod
    def during_test(cls) -> bool:
        cls.told.seek(0)
        return any(float(line) >= cls.began for line in cls.told)


def pytest_configure(config: pytest.Config) -> None:
    """Under `nohup`, or in the background of a shell, all that is started here would ignore these signals. And where
    Python may leave nothing beside its sources (containers), each of hundreds of processes would compile 1250 modules:
    they leave it in a folder that goes with this run."""
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
        compiled = tempfile.TemporaryDirectory(prefix="deltatwin-tests-", ignore_cleanup_errors=True)
        config.add_cleanup(compiled.cleanup)
        os.environ["PYTHONPYCACHEPREFIX"] = compiled.name
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _passed_before() -> set[str]:
    """`module.test` of what passed by the report (JUnit's XML) that DELTATWIN_PASSED names: `.ci/run` asks once."""
    report = os.environ.get("DELTATWIN_PASSED")
    if report is None:
        return set()
    cases = ElementTree.parse(report).iter("testcase")
    return {f"{case.get('classname')}.{case.get('name')}" for case in cases if not len(case)}


def _scope(nodeid: str) -> str:
    """What goes to one worker: the tests of a file, which share what they make, and all that watch the clock."""
    return "clock" if nodeid.startswith(ON_THE_CLOCK) else nodeid.split("::", 1)[0]


def _longest_first(items: list[pytest.Item]) -> None:
    """So that no worker is left alone with a long file at the end; a browser, which hangs where roles of real-time
    priority have the processors, comes when these have gone."""
    slow = Counter(_scope(item.nodeid) for item in items if item.get_closest_marker("slow"))
    every = Counter(_scope(item.nodeid) for item in items)

    def turn(item: pytest.Item) -> tuple[int, int, int]:
        scope = _scope(item.nodeid)
        early = 0 if scope == "clock" or scope in LONGEST else 2 if scope.startswith("tests/service/pages/") else 1
        return early, -slow[scope], -every[scope]

    items.sort(key=turn)


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What watches the clock and failed while this machine was not let run has shown nothing: it is run again, twice at
    most, and listed as such. What `SLOW` and `WEEKLY` name is marked so. Of what passed before, what rights or a clock
    make another test is asked again."""
    again = pytest.mark.flaky(reruns=2, condition=_Held.during_test)
    passed, kept, left_out = _passed_before(), [], []
    for item in items:
        path, _, name = item.nodeid.partition("::")
        known = f"{path.removesuffix('.py').replace('/', '.')}.{name.replace('::', '.')}" in passed
        again_here = item.nodeid.startswith((*ON_THE_CLOCK, *BY_RIGHTS))
        (left_out if known and not again_here else kept).append(item)
    items[:] = kept
    config.hook.pytest_deselected(items=left_out)
    for item in items:
        if item.nodeid.startswith(ON_THE_CLOCK):
            item.add_marker(again)
        if item.nodeid.startswith(SLOW):
            item.add_marker(pytest.mark.slow)
        if item.nodeid.startswith(WEEKLY):
            item.add_marker(pytest.mark.weekly)
    if config.option.markexpr != "not slow":
        _longest_first(items)


def pytest_runtest_logstart(nodeid: str) -> None:
    """Each test, and each of its repetitions, has its own account."""
    if _Held.process is None and nodeid.startswith(ON_THE_CLOCK):
        command = [sys.executable, str(REPOSITORY / "tests/stolen.py")]
        _Held.process = subprocess.Popen(command, stdout=_Held.told, stderr=subprocess.DEVNULL)
    _Held.began = time.monotonic()


@pytest.fixture(autouse=True)
def _as_it_was() -> Iterator[None]:
    """A test that leaves its process at another priority fails, not those after it."""
    if not hasattr(os, "sched_getscheduler"):  # macOS
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    after = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, *before)
    assert after[0] == before[0], "left its process at another priority"


@pytest.fixture(scope="session")
def data() -> Iterator[Path]:
    """The recorded data of `tests/data`, unpacked: as its README has them, without `.xz`."""
    with tempfile.TemporaryDirectory(prefix="deltatwin-data-") as made:
        for packed in (path for path in DATA.rglob("*") if path.is_file()):
            target = Path(made, packed.relative_to(DATA))
            target.parent.mkdir(parents=True, exist_ok=True)
            if packed.suffix == ".xz":
                target.with_suffix("").write_bytes(lzma.decompress(packed.read_bytes()))
            else:
                shutil.copy(packed, target)
        yield Path(made)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder beside the checkout with the scorer that judges this project from the outside."""
    folder = REPOSITORY.parent / "shared"
    if not folder.is_dir():
        pytest.skip("needs ../shared (the scorer), which is not beside this checkout")
    return folder


@pytest.fixture
def bus_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of its own for every Zenoh session of the test and of the processes it starts."""
    with tempfile.TemporaryDirectory(prefix="dt-") as folder:  # short: socket paths end at 107 bytes
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


@pytest.fixture
def bench_robot(tmp_path: Path) -> Path:
    """The description of a robot called `bench`."""
    path = tmp_path / "robot.toml"
    path.write_text(
        'name = "bench"\n'
        "[geometry]\nactive_link_length = 0.3\npassive_link_length = 0.8\nbase_radius = 0.2\nplatform_radius = 0.05\n"
        "[mass]\nactive_link = 1.0\npassive_link = 0.2\nplatform = 0.5\n"
    )
    return path


@pytest.fixture(scope="session")
def until() -> Callable[[Callable[[], bool]], None]:
    """Wait for a condition; half a minute in vain fails the test, how long it takes does not matter."""

    def wait(condition: Callable[[], bool]) -> None:
        give_up = time.monotonic() + 30.0
        while not condition():
            assert time.monotonic() < give_up, "waited in vain"
            time.sleep(0.01)

    return wait


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `-n 2`: by `_scope`, and where slow tests are among them in the order of `_longest_first`."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _scope(nodeid)

    config.option.loadscopereorder = config.option.markexpr == "not slow"
    return Scheduling(config, log)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """With DELTATWIN_NO_SKIPS=1 a skipped test fails the run: what may skip elsewhere must run in CI."""
    if _Held.process is not None:
        _Held.process.kill()
        _Held.process.wait()
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("DELTATWIN_NO_SKIPS") == "1" and reporter and reporter.stats.get("skipped") and exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line("DELTATWIN_NO_SKIPS=1: the skipped tests above count as failures", red=True)
