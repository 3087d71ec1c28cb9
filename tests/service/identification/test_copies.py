"""A log that is given twice is refused, whatever its name; two logs of one motion are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import write_trace
from schemas.errors import DataError
from schemas.trace import Trace
from service.cli.main import app
from service.identification.copies import refuse_copies


def log(name: str, noise: int, steps: float = 0.0, joints: int = 3) -> Trace:
    """Swings with a rest before and after, positions in `steps`. noise: seed of that of the torque."""
    time = np.arange(4000) * 1e-3
    swing = np.sin(2 * np.pi * np.outer(time, np.linspace(0.5, 1.1, joints))) * ((time > 0.5) & (time < 3.5))[:, None]
    torque = 10 * swing + np.random.default_rng(noise).normal(0.0, 0.2, swing.shape)
    if steps:
        swing, torque = np.round(swing / steps) * steps, np.round(torque / (20 * steps)) * 20 * steps
    return Trace(Path(name), time, swing, torque)


def cut(trace: Trace, rows: slice) -> Trace:
    return replace(trace, path=Path("cut.csv"), time=trace.time[rows], position=trace.position[rows],
                   torque=trace.torque[rows])  # fmt: skip


@pytest.mark.parametrize("joints", [1, 3])
@pytest.mark.parametrize("steps", [0.0, 0.01])
def test_logs_of_one_motion_are_two_measurements(joints: int, steps: float) -> None:
    refuse_copies([log("a.csv", 1, steps, joints), log("b.csv", 2, steps, joints), log("c.csv", 3, steps, joints)])


def test_a_copy_is_refused_and_both_are_named() -> None:
    with pytest.raises(DataError, match=r"^b\.csv: the same motion and torque as a\.csv; give it only once$"):
        refuse_copies([log("a.csv", 1), log("other.csv", 2), log("b.csv", 1)])


def test_a_part_of_a_log_is_a_copy() -> None:
    whole = log("a.csv", 1)
    with pytest.raises(DataError, match="cut"):
        refuse_copies([whole, cut(whole, slice(700, 2500))])
    with pytest.raises(DataError, match="cut"):
        refuse_copies([cut(whole, slice(700, 2500)), whole])


def test_a_copy_with_a_row_that_differs_is_one() -> None:
    torque = log("a.csv", 1).torque.copy()
    torque[1000] = np.nan
    with pytest.raises(DataError, match="nan"):
        refuse_copies([log("a.csv", 1), replace(log("nan.csv", 1), torque=torque)])


def test_logs_at_rest_are_not_compared() -> None:
    rest = Trace(Path("rest.csv"), np.arange(500) * 1e-3, np.zeros((500, 3)), np.zeros((500, 3)))
    refuse_copies([rest, replace(rest, path=Path("also.csv"))])


@pytest.mark.parametrize("given", [("{a}", "{a}"), ("{a}", "--test", "{a}")])
def test_the_command_refuses_a_log_given_twice(tmp_path: Path, given: tuple[str, ...]) -> None:
    write_trace(log("a.csv", 1), tmp_path / "a.csv", "d3-1200")
    logs = [part.format(a=tmp_path / "a.csv") for part in given]
    done = CliRunner().invoke(app, ["diagnose", *logs, "--robot", "d3-1200", "--out", str(tmp_path / "out")])
    assert isinstance(done.exception, DataError), done.output
    assert "give it only once" in str(done.exception)
