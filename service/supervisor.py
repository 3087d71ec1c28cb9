"""Processes side by side: start them, wait until they are ready, end them, and say what a failed one said last."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from schemas.errors import BusError

READY_TIME = 600.0  # s for a process to say that it is ready: the first start of all compiles, on any host
STOP_TIME = 20.0  # s to end after Ctrl-C, files whole
STOP_TIME_STARTING = 0.3  # s for one that was not ready yet and has nothing to make whole; it may be compiling
PROGRAM = (sys.executable, "-m", "deltatwin")

Ready = str | Path | Callable[[], bool]  # what it says, the file it makes, or what becomes true when it is ready


class Process:
    """One process, what it says going to a file. name: what messages call it."""

    def __init__(self, name: str, command: Sequence[str], log: Path, environment: dict[str, str], ready: Ready) -> None:
        self.name, self.log, self._ready = name, log, ready
        self._give_up: float | None = None
        with log.open("w") as file:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=file, stderr=subprocess.STDOUT, env=environment, text=True
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def wait_ready(self) -> None:
        """Wait until it is ready.

        Raises:
            BusError: it ended first, or is not ready after `READY_TIME`.
        """
        give_up = time.monotonic() + READY_TIME
        while not self._is_ready():
            if not self.running:
                raise BusError(f"{self.name} did not start: {self.last_words()}")
            if time.monotonic() > give_up:
                raise BusError(f"{self.name} is not ready after {READY_TIME:.0f} s: {self.last_words()}")
            time.sleep(0.05)

    def _is_ready(self) -> bool:
        if isinstance(self._ready, str):
            return self._ready in self.log.read_text()
        return self._ready.exists() if isinstance(self._ready, Path) else self._ready()

    def tell(self, line: str) -> None:
        """Write to its standard input."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait(self, timeout: float) -> None:
        """Wait for it to end by itself, s.

        Raises:
            BusError: it failed or does not end.
        """
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise BusError(f"{self.name} does not end: {self.last_words()}") from None
        self.check()

    def check(self) -> None:
        """
        Raises:
            BusError: it ended, and not well.
        """
        if self._process.poll():
            raise BusError(f"{self.name} failed: {self.last_words()}")

    def interrupt(self) -> None:
        """Ask it to end, as Ctrl-C does, and do not wait."""
        if self.running and self._give_up is None:
            self._give_up = time.monotonic() + (STOP_TIME if self._is_ready() else STOP_TIME_STARTING)
            self._process.send_signal(signal.SIGINT)

    def stop(self) -> None:
        """End it as Ctrl-C does, and by force if that does not help."""
        self.interrupt()
        if self.running:
            assert self._give_up is not None
            try:
                self._process.wait(max(self._give_up - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                self.kill()
        if self._process.stdin is not None:
            self._process.stdin.close()

    def kill(self) -> None:
        """End it by force."""
        self._process.kill()
        self._process.wait()

    def last_words(self) -> str:
        """The last line it said, but for what it says comes next."""
        lines = [line for line in self.log.read_text().strip().splitlines() if not line.startswith("next: ")]
        return lines[-1].removeprefix("deltatwin: ") if lines else "it printed nothing"


class Supervisor:
    """Starts processes that log to `folder`, and ends what is left of them when it is left itself: the last one first,
    or all at once where an exception leaves it.

    runtime_folder: where they meet on the bus; this process's own if None.
    """

    def __init__(self, folder: Path, runtime_folder: str | None = None) -> None:
        self._folder = folder
        self._environment = dict(os.environ) | ({"XDG_RUNTIME_DIR": runtime_folder} if runtime_folder else {})
        self._started: list[Process] = []

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None:
            for process in self._started:
                process.interrupt()
        for process in reversed(self._started):
            process.stop()

    def start(self, ready: Ready, *arguments: object, name: str = "") -> Process:
        """One command of this program, in the background."""
        return self.launch(name or str(arguments[0]), (*PROGRAM, *map(str, arguments)), ready)

    def run(self, *arguments: object, name: str = "", timeout: float = 600.0) -> None:
        """One command of this program, to its end.

        Raises:
            BusError: it failed or does not end.
        """
        self.start("", *arguments, name=name).wait(timeout)

    def launch(self, name: str, command: Sequence[str], ready: Ready = "") -> Process:
        """Any program, in the background, logging to `<name>.log`."""
        process = Process(name, command, self._folder / f"{name}.log", self._environment, ready)
        self._started.append(process)
        return process

    def check(self) -> None:
        """
        Raises:
            BusError: one of them ended, and not well.
        """
        for process in self._started:
            process.check()
