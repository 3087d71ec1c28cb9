"""`Trace` as `import deltatwin` gives it: from arrays and data frames, to a data frame and a plot."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import schemas.trace as recorded
from deltatwin.given import as_path, described
from drivers.trace import find_columns
from drivers.trace.csv_file import own_columns, table_of
from drivers.trace.from_columns import assemble, plan, stamped
from drivers.trace.quality import RowNames, check
from schemas.axes_description import Description
from schemas.columns import Columns
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS
from schemas.words import counted, significant

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from drivers.data_frames import pl

Mapping = str | Path | Columns  # a mapping of foreign columns: its file, its name where it comes along, or itself


@dataclass(frozen=True, repr=False)
class Trace(recorded.Trace):
    """N samples of n joints as they were recorded; nothing is repaired, faults are flagged and listed.

    Attributes:
        time: (N,) s.
        position, torque: (N, n) rad and N m at the joint; m and N where `angular` is False.
        position_command, torque_command: (N, n), or None where the source has none.
        fourth_position: (N,) rad, the axis of the gripper, or None.
        gripper: (N,) of 0 unknown, 1 open, 2 closed, or None.
        flags: (N,) uint32, bits for the faults of a row; 0: none.
        findings: the faults found; each has a `message` and `rows`.
        path: the file, or the name given.

    Example:
        >>> import numpy as np
        >>> import deltatwin as dt
        >>> time = np.arange(1000) * 1e-3
        >>> log = dt.Trace.from_arrays(time, 0.3 * np.sin(6 * time), np.cos(6 * time), name="bench")
        >>> log
        <Trace bench: 1000 samples of 1 joint, 1000 Hz, 0.999 s>
    """

    @classmethod
    def of(cls, trace: recorded.Trace) -> Trace:
        """The same trace with what this class adds."""
        return cls(**{field.name: getattr(trace, field.name) for field in fields(recorded.Trace)})

    @classmethod
    def from_arrays(
        cls,
        time: Any,
        position: Any,
        torque: Any,
        *,
        position_command: Any = None,
        torque_command: Any = None,
        fourth_position: Any = None,
        gripper: Any = None,
        name: str = "arrays",
        angular: bool = True,
        robot: Description | None = None,
    ) -> Trace:
        """A trace from your own arrays, checked like a file.

        Args:
            time: (N,) s, rising; or datetime64.
            position, torque: (N, n) rad and N m at the joint side of the gears, or (N,) of a single joint.
            position_command, torque_command: the same of the commands, where there are any.
            fourth_position: (N,) rad of a Delta's fourth axis.
            gripper: (N,) 0 unknown, 1 open, 2 closed.
            name: what messages and documents call it.
            angular: False for linear axes, in m and N.
            robot: the positions are checked against its joint range.

        Raises:
            TraceError: arrays that do not match, do not contain numbers, or are not a recording: time that mostly
                does not rise, positions out of any range.
        """
        robot = None if robot is None else described(robot)
        clock, epoch_ns = _clock(time, name)
        channels = {"position": position, "torque": torque}
        channels |= {"position_command": position_command, "torque_command": torque_command}
        arrays = {key: _array(key, values, len(clock), name) for key, values in channels.items() if values is not None}
        joints = {key: values.shape[1] for key, values in arrays.items()}
        if len(set(joints.values())) > 1:
            raise TraceError(f"{name}: arrays of different numbers of joints: {joints}")
        single = {
            key: _array(key, values, len(clock), name)[:, 0]
            for key, values in (("fourth_position", fourth_position), ("gripper", gripper))
            if values is not None
        }
        if gripper is not None:
            single["gripper"] = single["gripper"].astype(np.uint32)
        rows, left_out = stamped(clock, RowNames("row", np.arange(len(clock))))
        if len(rows) == 0:
            raise TraceError(f"{name}: no sample has a time")
        clock = clock[rows]
        arrays, single = ({key: one[rows] for key, one in given.items()} for given in (arrays, single))
        trace = recorded.Trace(
            Path(name), clock, arrays["position"], arrays["torque"], arrays.get("position_command"),
            arrays.get("torque_command"), single.get("fourth_position"), single.get("gripper"), epoch_ns=epoch_ns,
            angular=angular, findings=tuple(left_out),
        )  # fmt: skip
        return cls.of(check(trace, RowNames("row", rows), robot))

    @classmethod
    def from_dataframe(
        cls, frame: Any, *, columns: Mapping | None = None, name: str = "frame", robot: Description | None = None
    ) -> Trace:
        """A trace from a Polars or pandas table, checked like a file.

        Args:
            frame: table with the column names of our CSV (`time_s`, `position_1_rad`, `torque_1_nm`, ...), or others.
            columns: the mapping of a table with other column names: a TOML file (`deltatwin import` writes one), `emps`
                or `twincat_scope`, or a `Columns`.
            name: what messages and documents call it.
            robot: gives joint range and the gear ratio of motor-side columns.

        Raises:
            TraceError: a column is missing or does not contain numbers, or the table is not a recording.
        """
        if not hasattr(frame, "columns"):
            raise TraceError(f"{name}: a {type(frame).__name__} is not a data frame of Polars or pandas")
        names = [str(column) for column in frame.columns]
        robot = None if robot is None else described(robot)
        mapping = columns if columns is None or isinstance(columns, Columns) else find_columns(as_path(columns))
        mapping = mapping or own_columns(names, robot)
        if mapping is None:
            raise TraceError(f"{name}: no column position_1_rad; assign the columns with `columns`: {', '.join(names)}")
        wanted = plan(names, mapping, Path(name))
        used = sorted({*wanted.times, *wanted.values})
        cells = {str(index): _numbers(names[index], frame[frame.columns[index]], name) for index in used}
        from drivers.data_frames import pl

        table = pl.DataFrame(cells)
        return cls.of(assemble(table, wanted, mapping, robot, Path(name), [], 0, "row"))

    def to_frame(self) -> pl.DataFrame:
        """A Polars data frame with the columns of our own CSV; `.to_pandas()` converts it to pandas."""
        return table_of(self)

    def plot(self) -> go.Figure:
        """Position and torque of every joint over time, a Plotly figure."""
        from deltatwin.plots import of_trace

        return of_trace(self)

    def __repr__(self) -> str:
        joints = self.position.shape[1]
        rate = f"{significant(1 / self.period, 4)} Hz, " if len(self) > 1 else ""
        wrong = f", {counted(int(np.count_nonzero(self.flags)), 'row')} flagged" if self.flags.any() else ""
        return (
            f"<Trace {self.name}: {counted(len(self), 'sample')} of {counted(joints, 'joint')}, "
            f"{rate}{np.ptp(self.time):.4g} s{wrong}>"
        )

    def _repr_html_(self) -> str:
        from deltatwin.results import html

        return html(repr(self)[1:-1], [finding.message for finding in self.findings], (), ())


def _clock(time: Any, name: str) -> tuple[np.ndarray, int]:
    """(N,) s, and the bus time in ns that they count from."""
    stamps = np.asarray(time)
    if stamps.ndim != 1:
        raise TraceError(f"{name}: time has {stamps.ndim} dimensions; the shape must be (N,)")
    if np.issubdtype(stamps.dtype, np.datetime64) and len(stamps):
        since = stamps.astype("datetime64[ns]").astype(np.int64)
        return (since - since[0]) / NANOSECONDS, int(since[0])
    return _numbers("time", stamps, name), 0


def _array(key: str, values: Any, rows: int, name: str) -> np.ndarray:
    """(N, n) float64 of `values`."""
    found = _numbers(key, values, name)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or len(found) != rows:
        raise TraceError(f"{name}: {key} has shape {found.shape}, but time has {rows} samples")
    return found


def _numbers(key: str, values: Any, name: str) -> np.ndarray:
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise TraceError(f"{name}: {key} does not contain numbers: {error}") from None
