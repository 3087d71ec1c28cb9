"""`latency` is ended by Ctrl-C in a terminal, which all of its processes get."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest

CODE = """
import sys, time
from replay import round_trip
from schemas.messages import SAMPLE
from service.cli import latency, main

def command(show):
    answer = latency._estimator if sys.argv[1] == "starting" else latency._echo
    round_trip.take_turns({"answer": answer}, SAMPLE.empty(100), 1000.0, 40_000, show)

if __name__ == "__main__":
    if sys.argv[1] == "starting":
        begun = round_trip.multiprocessing.process.BaseProcess.start
        def start(process):
            begun(process)
            time.sleep(1.5)  # it imports
            print("now", flush=True)
            time.sleep(0.2)
        round_trip.multiprocessing.process.BaseProcess.start = start
    main.app = lambda: command(lambda sent: print("now", flush=True) if sys.argv[1] == "measuring" else None)
    main.main()
"""


@pytest.mark.parametrize("moment", ["starting", "measuring"])
def test_ctrl_c_ends_all_processes_without_a_traceback(tmp_path: os.PathLike[str], moment: str) -> None:
    script = os.path.join(tmp_path, "measured.py")
    with open(script, "w", encoding="utf-8") as file:
        file.write(CODE)
    command = [sys.executable, script, moment]
    environment = os.environ | {"PYTHONPATH": os.getcwd()}
    with (
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment
        ) as process,
        ExitStack() as last,
    ):
        last.callback(process.kill)  # which is waited for without an end, also where this fails
        assert process.stdout is not None
        assert process.stdout.readline() == "now\n"
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said, said
