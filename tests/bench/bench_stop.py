"""Commands that are started and stopped at a random moment, by a random one of the signals that end them.

    uv run python -m tests.bench.bench_stop --starts 300 [--cold 60] [--jobs 3] [--seed 1] [--roles estimate monitor]

Each job plays the bundled log without end to whom it starts, so that both processors are taken. A moment falls anywhere
between the first instruction and as long again as a start takes, 20 s at most. Cold: with no kernel compiled. It has to
end whole: by itself, with 0 or 130, and without a traceback. Before the interpreter reads our first line the signal is
Python's; that is counted apart. The bench ends with 3 where one did not end well, and prints what that
one said.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from docs.making.figures import store
from drivers.trace import read_trace, write_trace
from replay.demo import LOG, ROBOT
from schemas.robot import load_robot, save_robot
from service.stopping import ENDING

COMMAND = str(Path(sys.executable).with_name("deltatwin"))
START_S = 900.0  # to be ready, on a host that compiles beside other work
END_S = 60.0  # a command that still runs then has not heard the signal
MOST_S = 20.0  # from a start to its signal
COLD_S = 25.0  # of a cold start, in which it is stopped
ROLES = {
    "estimate": ("estimate", "--robot", "{robot}", "--keep", "{folder}/kept.json"),
    "monitor": ("monitor", "--robot", "{robot}", "--out", "{folder}/run.mcap"),
    "watch": ("watch", "--robot", "{robot}", "--out", "{folder}/findings"),
    "view": ("view", "--robot", "{robot}", "--port", "0"),
    "replay": ("replay", "{log}", "--robot", "{other}", "--loop", "0", "--wait", "0"),
    "simulate": ("simulate", "--live", "--robot", "{other}", "--truth", "ideal"),
    "identify": ("identify", "{log}", "--robot", "{robot}", "--out", "{folder}/identified.toml"),
}
READY = {  # the socket that it opens last; other roles end by themselves
    "estimate": "stopped.estimator.sock",
    "monitor": "stopped.monitor.sock",
    "watch": "stopped.watch.sock",
    "view": "stopped.observer.sock",
    "replay": "other.player.sock",
    "simulate": "other.robot.sock",
}
COLD = ("estimate", "identify")  # roles whose start compiles
OWN = re.compile(r"/(service|schemas|drivers|replay)/|/deltatwin/\w+\.py")  # a file of ours in a traceback
BAD = ("Traceback", "Exception ignored", "FATAL", "Fatal", "panicked", "Aborted")


@dataclass
class Ends:
    """What became of the starts of one role: how many ended how, what those said that did not end well, and s."""

    counts: Counter[str] = field(default_factory=Counter)
    said: list[str] = field(default_factory=list)
    took: list[float] = field(default_factory=list)


def how_it_ended(code: int | None, said: str, stop: signal.Signals) -> str:
    """The column of the table that a start belongs to."""
    if code is None:
        return "not ended"
    if code in (-signal.SIGABRT, -signal.SIGSEGV):
        return "aborted"
    if any(word in said for word in BAD):
        own = bool(OWN.search(said))
        starting = code == -signal.SIGINT or "Fatal Python error: init_" in said  # other packages in it, too
        return "in Python's start" if starting and not own else "traceback"
    if (code == -stop and not said) or said == "KeyboardInterrupt\n":  # without a frame: no line has been run yet
        return "in Python's start"
    return str(code) if code in (0, 130) else f"code {code}"


def _goes_on(process: psutil.Process) -> bool:
    """Not where it has ended and who takes orphans, the first process of the machine, has not looked yet."""
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


class Job:
    """A bus of its own with a player on it, and one command after the other."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._random = folder, random.Random(seed)
        self._names = {"folder": str(folder), "log": str(folder / "log.mcap")}
        for key, name in (("robot", "stopped"), ("other", "other")):
            self._names[key] = str(folder / f"{name}.toml")
            save_robot(load_robot(ROBOT).model_copy(update={"name": name}), Path(self._names[key]))
        write_trace(read_trace(LOG, load_robot(ROBOT)), folder / "log.mcap", "stopped")
        self._environment = os.environ | {"XDG_RUNTIME_DIR": str(folder)}
        self._environment.pop("PYTHONDONTWRITEBYTECODE", None)
        feed = ("replay", LOG, "--robot", self._names["robot"], "--loop", "0", "--wait", "0")
        self._feed = self._start(feed, self._environment, folder / "feed.log")

    def _start(self, arguments: tuple[object, ...], environment: dict[str, str], log: Path) -> subprocess.Popen[bytes]:
        with log.open("w") as file:
            return subprocess.Popen(
                (COMMAND, *map(str, arguments)), env=environment, stdin=subprocess.DEVNULL, stdout=file, stderr=file
            )

    def one(self, role: str, longest: float, cold: bool) -> tuple[str, str, float]:
        """Start it, stop it within `longest` s. How it ended, all that is to be told of it, s from signal to end."""
        moment, stop = self._random.uniform(0.0, longest), signal.Signals(self._random.choice(ENDING))
        arguments = tuple(part.format(**self._names) for part in ROLES[role])
        for left in ("run.mcap", "kept.json"):
            (self._folder / left).unlink(missing_ok=True)
        log = self._folder / f"{role}.log"
        with tempfile.TemporaryDirectory(dir=self._folder, ignore_cleanup_errors=True) as kernels:
            process = self._start(arguments, self._environment | ({"NUMBA_CACHE_DIR": kernels} if cold else {}), log)
            time.sleep(moment)
            running = process.poll() is None
            children = psutil.Process(process.pid).children(recursive=True) if running else []
            process.send_signal(stop)
            since = time.monotonic()
            try:
                code = process.wait(END_S)
            except subprocess.TimeoutExpired:
                code = None
                process.kill()
                process.wait()
            took = time.monotonic() - since
            left = [child for child in psutil.wait_procs(children, 1.0)[1] if _goes_on(child)]
            for child in left:
                child.kill()
        said = log.read_text(errors="replace")
        ended = how_it_ended(code, said, stop) if running else "had ended"
        if left:
            ended = "left a process behind"
        how = f"{role}{' cold' if cold else ''}, {stop.name} after {moment:.3f} s: {ended} (code {code})"
        return ended, f"--- {how}\n{said[-3000:]}", took

    def ready(self, role: str) -> float:
        """How long a start takes, s: until it says that it runs, or ends."""
        begin, log = time.monotonic(), self._folder / f"{role}.log"
        process = self._start(tuple(part.format(**self._names) for part in ROLES[role]), self._environment, log)
        held = self._folder / "deltatwin" / READY.get(role, "none")
        try:
            while process.poll() is None and not held.exists():
                assert time.monotonic() < begin + START_S, f"{role} does not start: {log.read_text()}"
                time.sleep(0.02)
        finally:
            took = time.monotonic() - begin
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.wait(END_S)
            for left in ("run.mcap", "kept.json"):
                (self._folder / left).unlink(missing_ok=True)
        return took

    def close(self) -> None:
        """End the player."""
        self._feed.send_signal(signal.SIGINT)
        self._feed.wait(END_S)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--starts", type=int, default=300, help="with warm caches, over all roles")
    arguments.add_argument("--cold", type=int, default=0, help="starts with nothing compiled, over roles that compile")
    arguments.add_argument("--jobs", type=int, default=3, help="at once")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--roles", nargs="+", choices=ROLES, default=list(ROLES))
    arguments.add_argument("--store", action="store_true", help="put the figures into results/stop.json")
    given = arguments.parse_args()
    for number in ENDING:  # in the background of a shell or under `nohup` all that is started here would ignore them
        signal.signal(number, signal.default_int_handler)
    cold = [role for role in COLD if role in given.roles]
    work = [(given.roles[n % len(given.roles)], False) for n in range(given.starts)]
    work += [(cold[n % len(cold)], True) for n in range(given.cold if cold else 0)]
    found: dict[str, Ends] = {}
    over: list[bool] = []  # by Ctrl-C: those that run are waited for, and all so far is told
    with ExitStack() as stack:
        jobs = []
        for number in range(given.jobs):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dt-", ignore_cleanup_errors=True)))
            jobs.append(Job(folder, 1000 * given.seed + number))
            stack.callback(jobs[-1].close)
        for role in given.roles:
            jobs[0].ready(role)  # leaves everything compiled
        longest = {role: min(2 * jobs[0].ready(role), MOST_S) for role in given.roles}
        print("stopped within, s: " + ", ".join(f"{role} {s:.1f}" for role, s in longest.items()), flush=True)

        def run(number: int) -> None:
            for role, is_cold in work[number :: given.jobs]:
                if over:
                    return
                ended, told, took = jobs[number].one(role, COLD_S if is_cold else longest[role], is_cold)
                ends = found.setdefault(f"{role}{', cold' if is_cold else ''}", Ends())
                ends.counts[ended] += 1
                ends.took.append(took)
                if ended not in ("0", "130", "had ended", "in Python's start"):
                    ends.said.append(told)
                    print(told, flush=True)

        with ThreadPoolExecutor(given.jobs) as pool:
            try:
                list(pool.map(run, range(given.jobs)))
            except KeyboardInterrupt:
                over.append(True)
    for role, ends in found.items():
        counts = ", ".join(f"{how}: {count}" for how, count in sorted(ends.counts.items()))
        print(f"{role:<16} {sum(ends.counts.values()):>5} starts, longest end {max(ends.took):6.2f} s; {counts}")
    bad = sum(len(ends.said) for ends in found.values())
    print(f"{sum(sum(ends.counts.values()) for ends in found.values())} starts, {bad} did not end well")
    if given.store:
        print(f"kept in {store('stop', _figures(found))}")
    sys.exit(3 if bad else 0)


def _figures(found: dict[str, Ends]) -> dict[str, tuple[float | int, int, str | None]]:
    """By the keys of results/stop.json."""
    starts = sum(sum(ends.counts.values()) for ends in found.values())
    took = [one for ends in found.values() for one in ends.took]
    each = ", ".join(f"{role} {sum(ends.counts.values())}" for role, ends in found.items())
    slowest = max(found, key=lambda role: max(found[role].took))
    return {
        "not_well": (sum(len(ends.said) for ends in found.values()), starts, each),
        "longest": (round(max(took), 1), starts, slowest),
    }


if __name__ == "__main__":
    main()
