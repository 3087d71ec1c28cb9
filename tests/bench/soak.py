"""Player, estimator and monitor side by side for as long as you like: what they hold, lose, cost and how late they are.

    python -m tests.bench.soak --minutes 60 --rate 1000
    python -m tests.bench.soak --minutes 10 --rate 8000 --pin     # player and estimator on one processor each
    python -m tests.bench.soak --minutes 3 --rate 1000 --view     # beside `view` and a client that takes all it shows
    python -m tests.bench.soak --minutes 3 --rate 1000 --watch    # beside `watch`, which finds a cogging
    python -m tests.bench.soak --minutes 3 --rate 1000 --top      # beside `top` on a terminal, twenty times a second

A row a minute, and at the end (or at Ctrl-C) the table as markdown, with what the recording holds of what was sent.
Lateness is the player's, latency the estimator's, from a sample's arrival to the sending of its answer; both are
medians over the minute of what `health` says every second, p99 and max the largest of it. The demo log is played round
and round, resampled to the rate; the recording takes about 0.2 GB a minute at 8 kHz. `watch` knows the log as it is and
hears it with a cogging on joint 2, so that its diagnosis runs beside the others.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import os
import pty
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, replace
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from scipy.interpolate import CubicSpline
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from docs.making.figures import store
from drivers.bus import Bus, open_bus
from drivers.trace import read_trace, write_trace
from replay.demo import LOG, PAYLOADS, ROBOT
from schemas.messages import Gripper, Role
from schemas.robot import load_robot, save_robot
from schemas.trace import Trace

COMMAND = Path(sys.executable).with_name("deltatwin")
ROW_S = 60.0
POLL_S = 0.1
START_S = 300.0  # a role that compiles its kernels on a busy host takes a minute
COGGING_NM, COGGING_PER_RAD = 2.0, 50.0  # of joint 2, twice a motor turn, which `watch` does not know of
ROLES = {"player": Role.PLAYER, "estimator": Role.ESTIMATOR, "monitor": Role.MONITOR}
HEADINGS = (
    "min", *(f"{role} {what}" for role in ROLES for what in ("RSS MiB", "fds", "CPU %")),
    "lost", "late", "lateness µs median / p99 / max", "latency µs median / p99 / max",
)  # fmt: skip


@dataclass(frozen=True)
class Usage:
    """Of one process: resident memory in MiB, open descriptors, processor time in s."""

    resident: float
    descriptors: int
    cpu: float


def usage(process: int) -> Usage:
    """What the kernel says of a process that runs."""
    place = Path(f"/proc/{process}")
    fields = (place / "stat").read_text().rsplit(")", 1)[1].split()
    return Usage(
        int((place / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20,
        len(list((place / "fd").iterdir())),
        (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"),
    )


def lay_out(folder: Path, rate: float, watch: bool) -> None:
    """The demo robot under a name of its own, and its log at `rate`; with cogging too where there is a `watch`."""
    robot = load_robot(ROBOT).model_copy(update={"name": "soak"})
    save_robot(robot, folder / "robot.toml")
    log = read_trace(LOG, robot)
    assert log.position_command is not None
    instants = np.arange(0.0, log.time[-1] - log.time[0], 1.0 / rate)
    position, torque, command = (
        CubicSpline(log.time - log.time[0], values)(instants)
        for values in (log.position, log.torque, log.position_command)
    )
    trace = Trace(Path("soak"), instants, position, torque, position_command=command)
    write_trace(trace, folder / "log.mcap", robot.name)
    if not watch:
        return
    picks = np.loadtxt(PAYLOADS, delimiter=",", skiprows=1)  # `watch` leaves out what is carried, and cogging weighs
    carries = ((picks[:, :1] <= instants) & (instants < picks[:, 1:2])).any(axis=0)
    cogging = COGGING_NM * np.sin(COGGING_PER_RAD * position) * [0, 1, 0]
    gripper = np.where(carries, Gripper.CLOSED, Gripper.OPEN).astype(np.uint8)
    write_trace(replace(trace, torque=torque + cogging, gripper=gripper), folder / "cogging.mcap", robot.name)


class Soak:
    """The three processes and what their `health` has said since the last row."""

    def __init__(self, folder: Path, bus: Bus, processors: dict[str, int]) -> None:
        """processors: role -> the one that it has to stay on."""
        self._folder, self._bus, self._processors = folder, bus, processors
        self._health = bus.subscribe("health")
        self._said: list[np.ndarray] = []
        self._last: dict[str, np.void] = {}
        self.processes: dict[str, subprocess.Popen] = {}
        self._before: dict[str, Usage] = {}
        self._at = time.monotonic()
        self._counted = {"lost": 0, "late": 0}
        self._shown = multiprocessing.get_context("spawn").Value("q", 0)
        self.answered: list[float] = []  # s, the estimator's median latency as it says it each second

    def start(self, rate: float, beside: str | None) -> None:
        """Monitor and estimator, and when they are there the player, with what is to run beside them: `view` and its
        client, `watch`, or `top`."""
        view, watch = beside == "view", beside == "watch"
        robot = ["--robot", self._folder / "robot.toml"]
        self._launch("monitor", "monitor", *robot, "--out", self._folder / "run.mcap")
        self._launch("estimator", "estimate", *robot)
        wanted = {Role.MONITOR, Role.ESTIMATOR}
        if watch:
            known = ["--reference", self._folder / "log.mcap"] * 15  # 2 s of free motion each
            self._launch("watch", "watch", *robot, *known, "--out", self._folder / "findings")
            wanted |= {Role.WATCH}
        give_up = time.monotonic() + START_S
        while not wanted <= self._bus.alive:
            if time.monotonic() > give_up:
                raise SystemExit(f"soak: {', '.join(r.name.lower() for r in wanted - self._bus.alive)} did not start")
            time.sleep(0.1)
        if view:
            self._launch("view", "view", *robot, "--port", "0")
            said = self._folder / "view.txt"
            while not (found := re.search(r"ws://\S+:\d+", said.read_text())) and time.monotonic() < give_up:
                time.sleep(0.1)
            assert found, said.read_text()
            client = multiprocessing.get_context("spawn").Process(
                target=look, args=(found[0], self._shown), daemon=True
            )
            client.start()
        if beside == "top":
            threading.Thread(target=self._show_top, args=(robot,), daemon=True).start()
        played = self._folder / ("cogging.mcap" if watch else "log.mcap")
        self._launch("player", "replay", played, *robot, "--loop", "0", "--rate", str(rate))
        self._at = time.monotonic()
        self._before = {name: usage(process.pid) for name, process in self.processes.items()}

    @property
    def lost(self) -> int:
        """Samples since the start, as of the last row."""
        return self._counted["lost"]

    def _launch(self, name: str, *arguments: object) -> None:
        place = ["taskset", "-c", str(self._processors[name])] if name in self._processors else []
        with (self._folder / f"{name}.txt").open("w") as out:
            self.processes[name] = subprocess.Popen([*place, COMMAND, *map(str, arguments)], stdout=out, stderr=out)

    def _show_top(self, robot: list[object]) -> None:
        """`top` on a terminal of its own, whose pictures (each has one second line) are counted."""
        here, there = pty.openpty()
        command = [COMMAND, "top", *map(str, robot)]
        self.processes["top"] = subprocess.Popen(
            command, stdin=there, stdout=there, stderr=there, env=os.environ | {"TERM": "xterm"}
        )
        os.close(there)
        with contextlib.suppress(OSError):  # `top` has ended
            while data := os.read(here, 65536):
                self._shown.value += data.count(b"\x1b[2;1H")
        os.close(here)

    def listen(self) -> None:
        """Take what was said; a role that has died ends the run."""
        self._said.append(self._health.take()[0])
        for name, process in self.processes.items():
            if process.poll() is not None:
                log = self._folder / f"{name}.txt"
                said = log.read_text() if log.exists() else ""
                raise SystemExit(f"soak: {name} ended with {process.returncode}: {said[-2000:]}")

    def row(self, minute: float) -> list[str]:
        """What happened since the last row."""
        now = time.monotonic()
        span, self._at = now - self._at, now
        cells = [f"{minute:g}"]
        for name in ROLES:
            used = usage(self.processes[name].pid)
            share = 100 * (used.cpu - self._before[name].cpu) / span
            cells += [f"{used.resident:.1f}", str(used.descriptors), f"{share:.0f}"]
            self._before[name] = used
        said = np.concatenate(self._said)
        self._said.clear()
        by_role = {name: said[said["role"] == role] for name, role in ROLES.items()}
        self._last |= {name: records[-1] for name, records in by_role.items() if len(records)}
        counts = {
            "lost": sum(int(self._last[name]["lost"]) for name in ("estimator", "monitor") if name in self._last),
            "late": int(self._last["player"]["late"]) if "player" in self._last else 0,
        }
        cells += [str(counts[what] - self._counted[what]) for what in counts]
        self._counted = counts
        for name in ("player", "estimator"):
            timed = by_role[name][by_role[name]["latency_max"] > 0]
            if len(timed):
                values = np.median(timed["latency_median"]), timed["latency_p99"].max(), timed["latency_max"].max()
                cells.append(" / ".join(f"{value * 1e6:.1f}" for value in values))
                if name == "estimator":
                    self.answered.extend(timed["latency_median"])
            else:
                cells.append("")
        return cells

    def stop(self) -> str:
        """End the roles one after the other; what was sent and what of it is in the file."""
        for name in ("player", "estimator", "monitor", "view", "watch", "top"):
            process = self.processes.get(name)
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(60)
                time.sleep(0.5)
        player = self._folder / "player.txt"
        said = re.search(r"sent (\d+)", player.read_text()) if player.exists() else None
        if said is None:
            return "nothing was sent"
        with (self._folder / "run.mcap").open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        held = {
            summary.channels[channel].topic.rsplit("/", 1)[1]: count
            for channel, count in summary.statistics.channel_message_counts.items()
        }
        size = (self._folder / "run.mcap").stat().st_size / 1e9
        return (
            f"sent {said[1]} samples; the recording ({size:.2f} GB) holds "
            + ", ".join(f"{count} {topic}" for topic, count in sorted(held.items(), key=lambda item: -item[1]))
            + (f"; the view's client took {self._shown.value} messages" if "view" in self.processes else "")
            + (f"; top drew {self._shown.value} pictures" if "top" in self.processes else "")
            + (f"\n\n{(self._folder / 'watch.txt').read_text()}" if "watch" in self.processes else "")
        )


def look(address: str, shown: Synchronized) -> None:
    """Take everything that a view shows, as Foxglove does; shown: how many messages that is."""

    async def take() -> None:
        client = await websocket_connect(HTTPRequest(address), subprotocols=["foxglove.sdk.v1"])
        while (message := await client.read_message()) is not None:
            if isinstance(message, bytes):
                shown.value += message[0] == 1
            elif (told := json.loads(message))["op"] == "advertise":
                wanted = [{"id": one["id"], "channelId": one["id"]} for one in told["channels"]]
                await client.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    asyncio.run(take())


def line(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--minutes", type=float, default=10.0)
    arguments.add_argument("--rate", type=float, default=1000.0, help="samples a second")
    arguments.add_argument("--pin", action="store_true", help="player and estimator on a processor each, monitor free")
    beside = arguments.add_mutually_exclusive_group()  # one of them, as this is the other one on the bus
    beside.add_argument("--view", action="store_true", help="beside a view and a client that takes all it shows")
    beside.add_argument("--watch", action="store_true", help="beside a watch")
    beside.add_argument("--top", action="store_true", help="beside a top")
    arguments.add_argument("--store", metavar="KEY", help="put samples lost into results/bus.json, under that key")
    given = arguments.parse_args()
    beside_them = next((name for name in ("view", "watch", "top") if getattr(given, name)), None)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rows: list[list[str]] = []
    first, last = min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))
    processors = {"player": first, "estimator": last} if given.pin else {}
    with tempfile.TemporaryDirectory(prefix="dt-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        folder = Path(name)
        lay_out(folder, given.rate, given.watch)
        with open_bus("soak", Role.OBSERVER if given.watch else Role.WATCH) as bus:  # a view is the observer
            soak = Soak(folder, bus, processors)
            try:
                soak.start(given.rate, beside_them)
                begin = time.monotonic()
                print(line(HEADINGS), line(["---"] * len(HEADINGS)), sep="\n", flush=True)
                while time.monotonic() - begin < 60 * given.minutes:
                    next_row = min(ROW_S * (len(rows) + 1), 60 * given.minutes)
                    while time.monotonic() - begin < next_row:
                        time.sleep(POLL_S)
                        soak.listen()
                    rows.append(soak.row(round(next_row / 60, 2)))
                    print(line(rows[-1]), flush=True)
            except KeyboardInterrupt:
                print(f"soak: interrupted after {len(rows)} rows", file=sys.stderr)
            finally:
                signal.signal(signal.SIGINT, signal.SIG_IGN)  # the roles end and the table is printed all the same
                found = soak.stop()
    print(f"\nsoak at {given.rate:g} Hz:\n", line(HEADINGS), line(["---"] * len(HEADINGS)), *map(line, rows), sep="\n")
    print(f"\n{found}")
    if given.store:
        sent = re.search(r"sent (\d+)", found)
        assert sent, found
        note = f"time to the answer, median of a second: {1e6 * np.median(soak.answered):.0f} µs"
        print(f"kept in {store('bus', {given.store: (soak.lost, int(sent[1]), note)})}")


if __name__ == "__main__":
    main()
