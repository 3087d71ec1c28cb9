"""Any table of numbers gives a result or one line, whatever reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from schemas.errors import DeltatwinError
from service.cli.main import app

EXAMPLES = 25  # a command
AXIS = 'name = "axis"\nkind = "axes"\n[[axis]]\nunit = "{}"\n'
DELTA = [f"{what}_{j}_{unit}" for what, unit in (("position", "rad"), ("torque", "nm")) for j in (1, 2, 3)]
HEADS = {
    "delta": ["time_s", *DELTA],
    "rad": ["time_s", "position_1_rad", "torque_1_nm"],
    "m": ["time_s", "position_1_m", "torque_1_n"],
}  # fmt: skip
COMMANDS = {
    "inspect": "inspect {log}",
    "convert": "convert {log} {out}.csv --overwrite",
    "import": "import {log} --robot {robot} --yes --overwrite --out {out}.csv",
    "identify": "identify {log} --robot {robot} --out {out}.toml",
    "evaluate": "evaluate {log} --robot {robot}",
    "diagnose": "diagnose {log} --robot {robot} --out {out}",
    "payload": "payload {log} --robot {robot}",
}

_size = st.sampled_from([1e-320, 1e-300, 1e-12, 1e-3, 1.0, 57.3, 1e3, 65536.0, 1e9, 1e15, 1e300, 1e308])
_shape = st.sampled_from(["zero", "constant", "ramp", "sine", "steps", "noise", "saw", "missing", "spike"])


@st.composite
def tables(draw: st.DrawFn) -> tuple[str, np.ndarray]:
    """A machine's kind, and the table: stamps first."""
    kind = draw(st.sampled_from(list(HEADS)))
    rows = draw(st.sampled_from([0, 1, 2, 3, 20, 150, 400, 1500]))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    step = draw(st.sampled_from([1e-9, 1e-4, 1e-3, 0.004, 0.05, 1.0, 1e3, 1e9]))
    clock = np.arange(rows) * step + draw(st.sampled_from([0.0, -5.0, 1.7e9]))
    way = draw(st.sampled_from(["even", "jitter", "back", "repeated", "down", "missing", "noise"]))
    if rows:
        clock = {
            "even": clock, "jitter": clock + step * random.uniform(-0.4, 0.4, rows), "repeated": clock // (3 * step),
            "back": np.where(np.arange(rows) > rows // 2, clock - 10 * step, clock), "down": clock[::-1],
            "missing": np.where(random.random(rows) < 0.3, np.nan, clock), "noise": random.standard_normal(rows),
        }[way]  # fmt: skip
    columns = [clock, *(_column(draw(_shape), draw(_size), rows, random) for _ in HEADS[kind][1:])]
    return kind, np.column_stack(columns)


def _column(shape: str, size: float, rows: int, random: np.random.Generator) -> np.ndarray:
    k = np.arange(rows)
    with np.errstate(over="ignore"):
        return size * {
            "zero": np.zeros(rows), "constant": np.ones(rows), "ramp": k / max(rows, 1), "sine": np.sin(k / 9.0),
            "steps": np.round(3 * np.sin(k / 30.0)), "noise": random.standard_normal(rows), "saw": (k % 17) - 8.0,
            "missing": np.where(random.random(rows) < 0.5, np.nan, np.sin(k / 9.0)),
            "spike": np.where(k == rows // 2, 1e6, np.sin(k / 9.0)),
        }[shape]  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_a_result_or_one_line(command: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("any")
    robots = {"delta": "d3-1200"}
    for unit in ("rad", "m"):
        robots[unit] = str(folder / f"{unit}.toml")
        Path(robots[unit]).write_text(AXIS.format(unit))

    @settings(
        max_examples=EXAMPLES, deadline=None, database=None, derandomize=True,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )  # fmt: skip
    @given(tables())
    def read(made: tuple[str, np.ndarray]) -> None:
        kind, block = made
        log, out = folder / "log.csv", folder / "out"
        np.savetxt(log, block, delimiter=",", header=",".join(HEADS[kind]), comments="", fmt="%.17g")
        for old in folder.glob("out*"):
            if old.is_file():
                old.unlink()
        words = COMMANDS[command].format(log=log, out=out, robot=robots[kind]).split()
        done = CliRunner().invoke(app, words, standalone_mode=False)
        error = done.exception
        if error is not None and not isinstance(error, SystemExit):
            assert isinstance(error, DeltatwinError), f"{type(error).__name__}: {error}"
            assert "\n" not in str(error)

    read()
