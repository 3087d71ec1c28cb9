"""The second plant's recorder: from what the drives said each cycle to a log as a scope or a controller writes it.

Torque noise is coloured (white noise and a first-order one beside it), torque and encoder are quantised, stamps are off
by some microseconds, and the rate is not that of the control.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from tests.bench.second_plant.closed_chain import CYCLE_S
from tests.bench.second_plant.robots import Report


@dataclass(frozen=True)
class Recorder:
    """rate_hz: a whole part of the control's. noise_nm: rms of the torque's noise a sample; memory_s: of its coloured
    share `coloured`. torque_step_nm, angle_step_rad: of the readings. stamps_s: rms by which stamps are off. smooth_s:
    over which a scope averages the torque before it takes a sample; 0: it does not. commands: whether the log has what
    was asked for."""

    rate_hz: float
    noise_nm: float
    memory_s: float
    coloured: float
    torque_step_nm: float
    angle_step_rad: float
    stamps_s: float
    smooth_s: float
    commands: bool

    @property
    def every(self) -> int:
        """Cycles a row."""
        return round(1 / (CYCLE_S * self.rate_hz))


def controller_log(rng: np.random.Generator, size: float, gear: float) -> Recorder:
    """What the controller itself logs: about each millisecond, in fine steps. size: N m of the robot's torque."""
    noise, bits = size * rng.uniform(0.012, 0.04), int(rng.integers(18, 21))
    return Recorder(
        float(rng.choice([500, 800, 1000])), noise, rng.uniform(0.3e-3, 1e-3), rng.uniform(0.1, 0.5),
        noise * rng.uniform(0.05, 0.3), 2 * np.pi / 2**bits / gear, rng.uniform(0.0, 5e-6), 0.0,
        bool(rng.random() < 0.7),
    )  # fmt: skip


def scope(rng: np.random.Generator, size: float, gear: float) -> Recorder:
    """What a scope beside the controller records: slow, averaged, coarse steps, noise with milliseconds of memory."""
    noise = size * rng.uniform(0.012, 0.04)
    return Recorder(
        float(rng.choice([400, 500])), noise, rng.uniform(2e-3, 5e-3), rng.uniform(0.6, 0.9),
        noise * rng.uniform(0.3, 0.8), 2 * np.pi / 2 ** int(rng.integers(16, 18)) / min(gear, 10.0),
        rng.uniform(15e-6, 40e-6), float(rng.choice([0.0, 1e-3])), False,
    )  # fmt: skip


def coloured(rng: np.random.Generator, recorder: Recorder, rows: int) -> np.ndarray:
    """Torque noise (rows, 3) in N m: white, and one that forgets within `memory_s`; their energies share the whole."""
    keeps = np.exp(-1 / (recorder.rate_hz * recorder.memory_s))
    settled = rows + 64 + round(20 * recorder.memory_s * recorder.rate_hz)
    slow = lfilter([np.sqrt(1 - keeps**2)], [1, -keeps], rng.standard_normal((settled, 3)), axis=0)[-rows:]
    white = rng.standard_normal((rows, 3))
    return recorder.noise_nm * (np.sqrt(recorder.coloured) * slow + np.sqrt(1 - recorder.coloured) * white)


def reported(asked: np.ndarray, report: Report) -> np.ndarray:
    """What the drives report of the torque (n, 3) asked of them each cycle, which they hold until the next: at the
    instant of a cycle that of before and that from now on, half each."""
    acting = (np.concatenate([asked[:1], asked[:-1]]) + asked) / 2
    torque = acting + report.crossed * np.roll(acting, -1, axis=1)
    if report.filter_hz:
        keeps = np.exp(-2 * np.pi * report.filter_hz * CYCLE_S)
        start = keeps * torque[:1]
        torque = lfilter([1 - keeps], [1, -keeps], torque, axis=0, zi=start)[0]
    if report.delay:
        cycles = np.arange(len(torque))
        late = np.clip(cycles - report.delay / CYCLE_S, 0, len(torque) - 1)
        torque = np.stack([np.interp(late, cycles, torque[:, j]) for j in range(3)], axis=1)
    return (1 + report.scale) * torque + report.offset


@dataclass(frozen=True)
class Log:
    """What stands in a file; rows of time s, angle rad, torque N m, and what of both was asked for, or None."""

    time: np.ndarray
    angle: np.ndarray
    torque: np.ndarray
    angle_asked: np.ndarray | None = None
    torque_asked: np.ndarray | None = None


def clean(recorder: Recorder, report: Report, begin: float, angle: np.ndarray, asked: np.ndarray) -> Log:
    """The log without noise, steps or jitter: what the drives said, (n, 3) a cycle, from `begin` s of the clock."""
    torque = reported(asked, report)
    span = round(recorder.smooth_s / CYCLE_S)
    if span > 1:
        torque = lfilter(np.full(span, 1 / span), [1.0], torque - torque[:1], axis=0) + torque[:1]
    rows = np.arange(0, len(angle), recorder.every)
    return Log(begin + rows * CYCLE_S, angle[rows], torque[rows])


def recorded(
    rng: np.random.Generator, recorder: Recorder, pure: Log, reference: np.ndarray, forward: np.ndarray
) -> Log:
    """The log as written. reference, forward (n, 3): angle and torque asked for, a cycle."""
    torque = pure.torque + coloured(rng, recorder, len(pure.time))
    every = slice(None, None, recorder.every)
    return Log(
        pure.time + rng.normal(0, recorder.stamps_s, len(pure.time)).clip(-1e-4, 1e-4),
        np.round(pure.angle / recorder.angle_step_rad) * recorder.angle_step_rad,
        np.round(torque / recorder.torque_step_nm) * recorder.torque_step_nm,
        reference[every] if recorder.commands else None,
        forward[every] if recorder.commands else None,
    )


def write(log: Log, path: Path) -> None:
    """The log as CSV with the columns that `deltatwin` reads without a mapping."""
    columns = {"time_s": log.time[:, None]}
    for name, values, unit in (
        ("position_command", log.angle_asked, "rad"), ("position", log.angle, "rad"),
        ("torque_command", log.torque_asked, "nm"), ("torque", log.torque, "nm"),
    ):  # fmt: skip
        for j in range(3):
            if values is not None:
                columns[f"{name}_{j + 1}_{unit}"] = values[:, j : j + 1]
    formats = ["%.9f" if name.endswith(("_rad", "_s")) else "%.5f" for name in columns]
    table = np.concatenate(list(columns.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt=formats)
