"""What the functions of `deltatwin` give: each short in a notebook, as a data frame, as a plot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from schemas.axes_description import Description
from schemas.robot import Robot
from schemas.words import counted, percent

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from drivers.data_frames import pl
    from schemas.diagnosis import Diagnosis
    from schemas.rollout_document import RolloutDocument
    from service.diagnosis.findings import Findings
    from service.identification.calibration import CalibratedFigure
    from service.identification.evaluation import Evaluation
    from service.identification.log_load import Load
    from service.identification.pooled import Plain
    from service.identification.weighed_picks import CommonError, MassLevel, PayloadHistory
    from service.rollout.joints import JointRollout

MOST_ROWS = 12  # of a table in a notebook


def html(title: str, sentences: Iterable[str], head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A heading, sentences and a table, as notebooks show them."""
    told = "".join(f"<p style='margin:.3em 0'>{escape(sentence)}</p>" for sentence in sentences)
    body = list(rows)
    table = ""
    if body:
        cells = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in body[:MOST_ROWS]
        )
        more = f"<p>... {len(body) - MOST_ROWS} more: .to_frame()</p>" if len(body) > MOST_ROWS else ""
        table = f"<table><tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>{cells}</table>{more}"
    return f"<div><b>{escape(title)}</b>{told}{table}</div>"


@dataclass(frozen=True, repr=False)
class Result(ABC):
    """What all results have in common."""

    @property
    @abstractmethod
    def conclusion(self) -> str:
        """The conclusion, in one or more sentences."""

    @abstractmethod
    def to_frame(self) -> pl.DataFrame:
        """The values as a Polars data frame; `.to_pandas()` converts it to pandas."""

    @abstractmethod
    def plot(self) -> go.Figure:
        """A Plotly figure; a notebook shows it, `.write_html(path)` keeps it."""

    @abstractmethod
    def _title(self) -> str: ...

    @abstractmethod
    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]: ...

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._title()}>\n{self.conclusion}"

    def _repr_html_(self) -> str:
        return html(self._title(), [self.conclusion], *self._rows())


def _frame(rows: list[dict[str, Any]], keys: Sequence[str] = ()) -> pl.DataFrame:
    """keys: the columns, which stand where there are no rows, too."""
    from drivers.data_frames import pl

    return pl.DataFrame(rows, infer_schema_length=None) if rows else pl.DataFrame({key: [] for key in keys})


@dataclass(frozen=True, repr=False)
class IdentificationResult(Result):
    """What `identify` found.

    Attributes:
        robot: the description with its `[identified]` section; `deltatwin.save_robot` writes it.
        warnings: read these before you use the result.
        traces: names of the logs.
    """

    robot: Description
    warnings: tuple[str, ...]
    traces: tuple[str, ...]
    fit: Plain = field(repr=False)
    calibration: tuple[CalibratedFigure, ...] = ()

    @property
    def conclusion(self) -> str:
        from service.identification.conclusion import of_fit

        return " ".join([of_fit(self.fit)[0], *(f"Warning: {warning}." for warning in self.warnings)])

    def to_frame(self) -> pl.DataFrame:
        """One row per parameter: name, value, std_error, unit, verdict, reason."""
        from service.model.description import in_units_of

        keys = ("name", "value", "std_error", "unit", "verdict", "reason")
        rows = [{key: getattr(one, key) for key in keys} for one in self.fit.estimates]
        return _frame([row | {"unit": in_units_of(self.robot, row["unit"])} for row in rows])

    def plot(self) -> go.Figure:
        """Torque, residual and noise, rms of each joint; logarithmic."""
        from deltatwin.plots import of_identification

        return of_identification(self)

    def _title(self) -> str:
        return f"{self.robot.name} identified on {counted(len(self.traces), 'log')}"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        head = ("parameter", "value", "std. error", "unit", "verdict")
        frame = self.to_frame().iter_rows(named=True)
        return head, [
            (one["name"], f"{one['value']:.4g}", f"{one['std_error']:.2g}", one["unit"], one["verdict"])
            for one in frame
        ]


@dataclass(frozen=True, repr=False)
class EvaluationResult(Result):
    """The error of each model.

    Attributes:
        robot: whose models they are.
        evaluations: one per log; `.torque[model]` is (N, n) N m of every row, `.events` stretches far above the rest.
    """

    robot: Description
    evaluations: tuple[Evaluation, ...]

    @property
    def models(self) -> dict[str, np.ndarray]:
        """Rms error (n,) N m of each model over all logs, joints moving, below 40 Hz."""
        from service.identification.evaluation import pooled_by_model

        return {name: moments.rms for name, moments in pooled_by_model(self.evaluations).items()}

    @property
    def conclusion(self) -> str:
        from service.identification.conclusion import of_evaluation

        return of_evaluation(self.robot, self.evaluations)[0]

    def to_frame(self) -> pl.DataFrame:
        """One row per log, model and joint: mean, std and rms of the error in N m (N for linear axes)."""
        return _frame(
            [
                {"trace": one.trace.name, "model": model, "joint": joint + 1, "mean": float(moments.mean[joint]),
                 "std": float(moments.std[joint]), "rms": float(moments.rms[joint])}
                for one in self.evaluations
                for model, moments in one.errors.items()
                for joint in range(len(moments.count))
            ]
        )  # fmt: skip

    def plot(self, trace: int = 0) -> go.Figure:
        """Measured and predicted torque of each joint over time. trace: which log, from 0."""
        from deltatwin.plots import of_evaluation

        return of_evaluation(self, trace)

    def _title(self) -> str:
        return f"{self.robot.name} on {counted(len(self.evaluations), 'log')}"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        found = self.models
        joints = len(next(iter(found.values())))
        head = ("model", *(f"joint {joint + 1}, rms" for joint in range(joints)))
        return head, [(name, *(f"{value:.3g}" for value in rms)) for name, rms in found.items()]


@dataclass(frozen=True, repr=False)
class PayloadResult(Result):
    """What was picked.

    Attributes:
        robot: the identified robot.
        trace: name of the log.
        history: arrays (N,): `time` s, `mass` kg, `std_dev` kg, `trusted`, `event` (0 none, 1 pick, 2 release).
        levels: each payload, from event to event, with its standard deviations.
        common_error: the error that all masses of this robot share.
    """

    robot: Robot
    trace: str
    history: PayloadHistory = field(repr=False)
    levels: tuple[MassLevel, ...]
    common_error: CommonError

    @property
    def time(self) -> np.ndarray:
        """(N,) s, bus time."""
        return self.history.time

    @property
    def mass(self) -> np.ndarray:
        """(N,) kg, as known after each sample."""
        return self.history.mass

    @property
    def conclusion(self) -> str:
        from service.identification.conclusion import of_payload

        return of_payload(self.levels)

    def to_frame(self) -> pl.DataFrame:
        """One row per sample: time_s, mass_kg, std_dev_kg, trusted, event; mass and error are NaN until the first
        estimate. `.levels` has the picks."""
        from drivers.data_frames import pl

        found = self.history
        estimated = found.std_dev > 0.0
        mass, error = (np.where(estimated, values, np.nan) for values in (found.mass, found.std_dev))
        columns = {"time_s": found.time, "mass_kg": mass, "std_dev_kg": error}
        return pl.DataFrame(columns | {"trusted": found.trusted, "event": found.event})

    def plot(self) -> go.Figure:
        """The mass over time with two standard deviations to either side, and where picks and releases were seen."""
        from deltatwin.plots import of_payload

        return of_payload(self)

    def _title(self) -> str:
        return f"payload of {self.robot.name} in {self.trace}"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        head = ("from, s", "until, s", "event", "mass, kg", "std. dev., kg", "trusted")
        return head, [
            (f"{one.begin:.3f}", f"{one.end:.3f}", one.event.name.lower(), f"{one.mass:.3f}", f"{one.std_dev:.3f}",
             percent(one.trusted))
            for one in self.levels
        ]  # fmt: skip


@dataclass(frozen=True, repr=False)
class DiagnosisResult(Result):
    """Where the gap lies, which effect causes it, how far it shrinks.

    Attributes:
        robot: the corrected description; `deltatwin.save_robot` writes it.
        document: as `diagnosis.json` has it: `.verdict`, `.effects`, `.gap`, `.cannot_tell`, ...
    """

    robot: Description
    document: Diagnosis
    findings: Findings = field(repr=False)

    @property
    def conclusion(self) -> str:
        from service.diagnosis.documents.text import paragraphs

        return " ".join(paragraphs(self.document)[0])

    @property
    def text(self) -> str:
        """All that the command says of it."""
        from service.diagnosis.documents.text import paragraphs

        return "\n\n".join("\n".join(group) for group in paragraphs(self.document))

    def to_frame(self) -> pl.DataFrame:
        """One row per parameter of the effects: effect, joints, probability, parameter, value, low, high, unit."""
        keys = ("effect", "joints", "probability", "parameter", "value", "low", "high", "unit")
        rows = [
            (effect.name, effect.joints, effect.probability, name, one.value, *one.ci95, one.unit)
            for effect in self.document.effects
            for name, one in effect.parameters.items()
        ]
        return _frame([dict(zip(keys, row, strict=True)) for row in rows], keys)

    def plot(self) -> go.Figure:
        """The gap of each joint before and after, on held-out data."""
        from service.diagnosis.documents.report import levels

        return levels(self.document)

    def write_report(self, path: str | Path) -> None:
        """Write the whole report, one HTML file that needs no network.

        Raises:
            StorageError: it cannot be written.
        """
        from service.diagnosis.documents.report import write_report

        write_report(self.findings, self.document, Path(path))

    def _title(self) -> str:
        return f"{self.document.robot}, {counted(len(self.document.traces), 'log')}: {self.document.verdict}"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        head = ("effect", "joints", "probability", "of the gap")
        return head, [
            (one.title or one.name, ", ".join(map(str, one.joints)), percent(one.probability), percent(one.gap_share))
            for one in self.document.effects
        ]


@dataclass(frozen=True, repr=False)
class RolloutResult(Result):
    """The gap as motion.

    Attributes:
        document: as `rollout.json` has it.
    """

    document: RolloutDocument

    @property
    def conclusion(self) -> str:
        from service.rollout.rollout_page import sentences

        return " ".join(sentences(self.document))

    def to_frame(self) -> pl.DataFrame:
        """One row per robot, and one for noise: rms after the horizon, mrad of each joint and mm of the platform."""
        return _frame(
            [
                {"robot": one.robot, "platform_mm": one.platform_mm, "ran_away": one.ran_away}
                | {f"joint_{joint + 1}_mrad": value for joint, value in enumerate(one.joint_mrad)}
                for one in (*self.document.robots, self.document.floor)
            ]
        )

    def plot(self) -> go.Figure:
        """How the platform's error grows over the horizon."""
        from service.rollout.rollout_page import growth

        return growth(self.document)

    def _title(self) -> str:
        return f"{counted(self.document.windows, 'window')} of {1e3 * self.document.horizon_s:.0f} ms"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        from service.rollout.rollout_page import in_figures

        head = ("robot", "platform, mm", "joints, mrad")
        return head, [
            (one.robot, in_figures(one.platform_mm), ", ".join(map(in_figures, one.joint_mrad)))
            for one in (*self.document.robots, self.document.floor)
        ]


@dataclass(frozen=True, repr=False)
class LoadResult(Result):
    """The load that an arm carried throughout a log.

    Attributes:
        robot: the identified arm.
        load: `.mass` kg, `.centre` (3,) m in the axes of the link `.frame`, `.inertia` (6,) kg m^2 about the centre,
            each with its standard error `.mass_error`, ...; `.common` (10,): the part of these errors that all loads
            of this arm share; `.seen`, `.centre_told`, `.inertia_told`: whether the motion determines mass, centre and
            inertia.
    """

    robot: Description
    load: Load

    @property
    def conclusion(self) -> str:
        from service.identification.conclusion import of_load

        return of_load(self.load)

    def to_frame(self) -> pl.DataFrame:
        """One row per parameter: name, value, std_error, unit, separable (whether the motion determines it)."""
        from service.identification.log_load import AXES

        one = self.load
        rows = [("mass", one.mass, one.mass_error, "kg", one.seen)]
        rows += [
            (f"centre {axis}", value, error, "m", one.centre_told)
            for axis, value, error in zip("xyz", one.centre, one.centre_error, strict=True)
        ]
        rows += [
            (f"inertia {axis}", value, error, "kg m^2", one.inertia_told)
            for axis, value, error in zip(AXES, one.inertia, one.inertia_error, strict=True)
        ]
        return _frame([
            {"name": name, "value": float(value), "std_error": float(error), "unit": unit, "separable": separable}
            for name, value, error, unit, separable in rows
        ])  # fmt: skip

    def plot(self) -> go.Figure:
        """Residual torque of each joint without the load and with it."""
        from deltatwin.plots import of_load

        return of_load(self)

    def _title(self) -> str:
        return f"load of {self.robot.name} in {self.load.trace}"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        head = ("figure", "value", "std. error", "unit", "separable")
        return head, [
            (one["name"], f"{one['value']:.4g}", f"{one['std_error']:.2g}", one["unit"],
             "yes" if one["separable"] else "no")
            for one in self.to_frame().iter_rows(named=True)
        ]  # fmt: skip


@dataclass(frozen=True, repr=False)
class JointRolloutResult(Result):
    """The gap of axes or an arm as motion.

    Attributes:
        found: `.deviations`, of each machine, of noise alone (`floor`) and of a machine at rest; `.horizon` s;
            `.windows`.
    """

    found: JointRollout

    @property
    def conclusion(self) -> str:
        from service.rollout.joints import sentences

        return " ".join(sentences(self.found))

    def to_frame(self) -> pl.DataFrame:
        """One row per machine, one for noise alone and one for a machine at rest: rms after the horizon, rad (m for
        linear axes) of each joint and m of an arm's tool."""
        return _frame(
            [
                {"robot": one.name, "tool_m": one.tool_rms, "ran_away": int((~one.good).sum())}
                | {f"joint_{joint + 1}": float(value) for joint, value in enumerate(one.joint_rms)}
                for one in self.found.deviations
            ]
        )

    def plot(self) -> go.Figure:
        """How the error of the joint that is worst at the end grows over the horizon."""
        from deltatwin.plots import of_joint_rollout

        return of_joint_rollout(self)

    def _title(self) -> str:
        return f"{counted(self.found.windows, 'window')} of {1e3 * self.found.horizon:.0f} ms"

    def _rows(self) -> tuple[Sequence[str], list[Sequence[str]]]:
        unit = "mrad" if self.found.angular else "mm"
        return ("robot", f"joints, {unit}"), [
            (one.name, ", ".join(f"{1e3 * value:.3g}" for value in one.joint_rms)) for one in self.found.deviations
        ]
