"""Torque left of real machines on data held out, axis by axis: `identify` beside plain least squares.

uv run python -m tests.bench.bench_real --store

Both see the same rows: the last third of a single log is predicted from what comes before and the first from what
follows, each log of several from the others. Both are scored alike: measured less predicted torque while an axis moves,
below 40 Hz or as far as the encoders tell the acceleration. Least squares is what one writes by hand: Pinocchio's
regressor of the same URDF (or inertia, sine and cosine), rotor, viscous and Coulomb friction and a constant for each
axis and for each motor that turns with several, positions through a Butterworth filter there and back and
differentiated, rows near standstill left out, every axis weighted by what a first fit leaves.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from docs.making import figures
from drivers.trace import read_trace
from schemas.axes_description import Axes, load_axes
from schemas.chain_description import Chain
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.model.arm import pinocchio
from service.model.prediction import FULL, error_in_band, motion, predict_along
from tests.service.diagnosis.test_real_machines import PWM, tx40_columns

DATA = Path(__file__).resolve().parents[3] / "shared" / "real"
LEFT_OUT = ("10h28m17", "10h29m21", "10h29m54")  # XL330: logs whose torque is off for most of the time


@dataclass(frozen=True)
class Set:
    """A machine and its logs. cutoff_hz, rate_hz: of the least squares, as published fits of such logs have them.
    still: rad/s or m/s below which an axis rests. least: rad/s from which the score counts. most: stretches held out,
    where the log is too short for all."""

    name: str
    columns: str
    description: str
    logs: Callable[[], list[Path]]
    cutoff_hz: float
    rate_hz: float
    still: float
    unit: str = "N m"
    least: float = 0.0
    most: int | None = None


def _chain(urdf: str, joints: Sequence[str], more: str = "") -> str:
    return f'kind = "chain"\nurdf = "{DATA / urdf}"\njoints = {list(joints)}\n{more}'


def _ur10_columns(joints: Sequence[str]) -> str:
    position, torque = (", ".join(f'"{name}.{what}"' for name in joints) for what in ("position", "effort"))
    return f'joints = 6\ntime = "time"\nposition = [{position}]\ntorque = [{torque}]\n'


UR10 = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
TX40_COLUMNS, TX40_COUPLING = tx40_columns()
SETS = (
    Set(
        "tx40", TX40_COLUMNS,
        _chain("tx40/tx40_mdh_modified.urdf", [f"joint_{j}" for j in range(1, 7)], TX40_COUPLING),
        lambda: [DATA / "tx40" / "pos_read_data.csv"], 100.0, 500.0, 0.05, most=1,
    ),
    Set(
        "ur10", _ur10_columns(UR10), _chain("ur10_unisa/ur10_robot.urdf", UR10),
        lambda: [DATA / "ur10_unisa" / "ur10_exciting_trajectory.db3"], 20.0, 125.0, 0.02,
    ),
    Set(
        "emps", (Path(__file__).resolve().parents[2] / "drivers/trace/mappings/emps.toml").read_text(encoding="utf-8"),
        'kind = "axes"\n[[axis]]\nunit = "m"\n',
        lambda: [DATA / "emps" / "emps.csv"], 40.0, 200.0, 0.002, "N",
    ),
    Set(
        "xl330", PWM, 'kind = "axes"\n[[axis]]\n',
        lambda: [p for p in sorted((DATA / "bam_xl330" / "raw").glob("*.json")) if p.stem[-8:] not in LEFT_OUT],
        8.0, 200.0, 0.2, least=0.2,
    ),
)  # fmt: skip


def stretch(trace: Trace, start: int, end: int) -> Trace:
    """Rows of a trace as one of its own."""
    part = slice(start, end)
    command = None if trace.position_command is None else trace.position_command[part]
    return replace(
        trace, path=Path(f"{trace.name}_{start}.csv"), time=trace.time[part], position=trace.position[part],
        torque=trace.torque[part], position_command=command, torque_command=None, flags=trace.flags[part], findings=(),
        sequence=None, own_time={},
    )  # fmt: skip


def folds(traces: Sequence[Trace]) -> list[tuple[list[Trace], Trace]]:
    """Those to learn from and the one that is predicted."""
    if len(traces) > 1:
        return [([*traces[:k], *traces[k + 1 :]], test) for k, test in enumerate(traces)]
    (trace,) = traces
    first, last = len(trace) // 3, 2 * len(trace) // 3
    return [
        ([stretch(trace, 0, last)], stretch(trace, last, len(trace))),
        ([stretch(trace, first, len(trace))], stretch(trace, 0, first)),
    ]


class LeastSquares:
    """By hand, of one machine."""

    def __init__(self, robot: Axes | Chain, one: Set) -> None:
        self.robot, self.set = robot, one
        self.model = None
        if isinstance(robot, Chain):
            self.model = pinocchio("bench").buildModelFromXML(robot.arm.text)
            self.order = [self.model.joints[self.model.getJointId(name)].idx_v for name in robot.joints]

    def _motion(self, trace: Trace) -> tuple[np.ndarray, ...]:
        """On an even clock: time, positions, speeds, accelerations, torque through the same filter."""
        period = float(np.median(np.diff(trace.time)))
        clock = np.arange(trace.time[0], trace.time[-1] + period / 2, period)
        sections = butter(4, min(self.set.cutoff_hz, 0.4 / period), fs=1 / period, output="sos")

        def filtered(values: np.ndarray) -> np.ndarray:
            even = np.stack([np.interp(clock, trace.time, column) for column in values.T], axis=1)
            return sosfiltfilt(sections, even, axis=0)

        q = filtered(trace.position)
        v = np.gradient(q, period, axis=0)
        return clock, q, v, np.gradient(v, period, axis=0), filtered(trace.torque)

    def _columns(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(N, n, p)."""
        count, n = q.shape
        rows = [np.eye(n)[j] for j in range(n)] + [self.robot.motors[m] for m in self.robot.shared_motors]
        turns = [(a @ row)[:, None] * row for row in rows]
        rubs = [f((v @ row)[:, None]) * row for row in rows for f in (np.asarray, np.sign)]
        ones = [np.broadcast_to(np.eye(n)[j], (count, n)) for j in range(n)]
        parts = [np.stack([*turns, *rubs, *ones], axis=-1)]
        if self.model is not None:
            compute, data = pinocchio("bench").computeJointTorqueRegressor, self.model.createData()
            links = np.empty((count, n, 10 * n))
            turned = np.empty((3, count, n))
            turned[:, :, self.order] = q, v, a
            for k in range(count):
                links[k] = compute(self.model, data, *turned[:, k])[self.order]
            parts.append(links)
        elif not self.robot.linear:
            parts += [f(q)[..., None] * np.eye(n) for f in (np.sin, np.cos)]
        return np.concatenate(parts, axis=-1)

    def fit(self, traces: Sequence[Trace]) -> np.ndarray:
        """(p,), the shortest of those that are as good."""
        columns, torque, counted = [], [], []
        for trace in traces:
            clock, q, v, a, measured = self._motion(trace)
            edge = max(1, round(0.1 / (clock[1] - clock[0])))
            rows = np.arange(edge, len(clock) - edge, max(1, round(1 / (self.set.rate_hz * (clock[1] - clock[0])))))
            columns.append(self._columns(q[rows], v[rows], a[rows]))
            torque.append(measured[rows])
            counted.append(np.abs(v[rows]) > self.set.still)
        x, y, use = (np.concatenate(parts) for parts in (columns, torque, counted))
        weight, found = np.ones(y.shape[1]), np.zeros(x.shape[-1])
        for _ in range(2):
            flat, wanted = (x / weight[:, None])[use], (y / weight)[use]
            size = np.linalg.norm(flat, axis=0)
            size[size == 0] = 1.0
            found = np.linalg.lstsq(flat / size, wanted, rcond=1e-6)[0] / size
            left = np.where(use, y - x @ found, 0.0)
            weight = np.sqrt(np.sum(left**2, axis=0) / use.sum(axis=0))
        return found

    def predict(self, found: np.ndarray, trace: Trace) -> np.ndarray:
        """(N, n) at the samples of a trace."""
        clock, q, v, a, _ = self._motion(trace)
        torque = self._columns(q, v, a) @ found
        return np.stack([np.interp(trace.time, clock, column) for column in torque.T], axis=1)


def measured(one: Set, folder: Path) -> tuple[np.ndarray, int]:
    """(3, n) rms left by `identify`, by least squares, and of the torque itself, over all data held out; and of how
    many stretches."""
    (folder / "columns.toml").write_text(one.columns)
    (folder / "robot.toml").write_text(f'name = "{one.name}"\ncolumns = "columns.toml"\n{one.description}')
    robot = load_axes(folder / "robot.toml")
    by_hand = LeastSquares(robot, one)
    squares, count = np.zeros((3, robot.count)), np.zeros(robot.count)
    stretches = folds([read_trace(path, robot) for path in one.logs()])[: one.most]
    for learn, test in stretches:
        along = motion(test)
        ours = predict_along(identify_axes(robot, learn).robot, test, along)[FULL]
        theirs = by_hand.predict(by_hand.fit(learn), test)
        errors = np.stack([error_in_band(test, along, torque) for torque in (ours, theirs, np.zeros_like(ours))])
        counted = np.isfinite(errors).all(axis=0) & (np.abs(along.theta_dot) >= one.least)
        squares += np.sum(np.where(counted, errors, 0.0) ** 2, axis=1)
        count += counted.sum(axis=0)
    return np.sqrt(squares / count), len(stretches)


def main() -> None:
    """Print each set, and store its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", help=f"of {', '.join(one.name for one in SETS)}; default: all")
    parser.add_argument("--store", action="store_true", help="put the figures into results/real_held_out.json")
    given = parser.parse_args()
    stored = {}
    for one in SETS:
        if given.sets and one.name not in given.sets:
            continue
        with tempfile.TemporaryDirectory() as folder:
            (ours, theirs, torque), count = measured(one, Path(folder))
        for axis, (mine, other, whole) in enumerate(zip(ours, theirs, torque, strict=True), start=1):
            mark = "" if mine <= other else "  WORSE"
            print(
                f"{one.name} axis {axis}: {mine:.4g} {one.unit}, least squares {other:.4g}, torque {whole:.4g}{mark}",
                flush=True,
            )
            beside = f"least squares {other:.3g}, torque {whole:.3g}"
            stored[f"{one.name}_{axis}"] = (float(f"{mine:.3g}"), count, beside)
    if given.store:
        print(f"stored in {figures.store('real_held_out', stored)}")


if __name__ == "__main__":
    main()
