"""What `import deltatwin` does: the functions that the commands call, on objects in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import schemas.trace as recorded
from deltatwin.results import (
    DiagnosisResult,
    EvaluationResult,
    IdentificationResult,
    PayloadResult,
    RolloutResult,
)
from deltatwin.trace import Mapping as ColumnMapping
from deltatwin.trace import Trace, as_list
from drivers import trace as files
from schemas.axes import Description, load_description, save_description
from schemas.columns import Columns
from schemas.errors import DataError
from schemas.questions import Question, as_delta
from schemas.robot import Robot

Traces = recorded.Trace | Sequence[recorded.Trace]

__all__ = [
    "Description", "diagnose", "evaluate", "identify", "load_demo", "load_robot", "payload", "read_trace", "rollout",
    "save_robot",
]  # fmt: skip


def read_trace(path: str | Path, robot: Description | None = None, columns: ColumnMapping | None = None) -> Trace:
    """Read a recorded log: CSV, MCAP, or any format of `deltatwin import`.

    Args:
        path: the file.
        robot: gives joint range, gear ratio, and the layout of an EtherCAT capture.
        columns: the mapping of a foreign table: a TOML file (`deltatwin import` writes one), `emps` or
            `twincat_scope`, or a `Columns`.

    Returns:
        N samples at the joint side, s, rad, N m; `findings` lists what was noticed.

    Raises:
        TraceError: the file is unusable, naming file, line, column and value.

    Example:
        >>> import deltatwin as dt
        >>> log = dt.read_trace("fit_a.csv")  # doctest: +SKIP
        >>> log.torque.shape  # doctest: +SKIP
        (8001, 3)
    """
    mapping = columns if columns is None or isinstance(columns, Columns) else files.find_columns(columns)
    return Trace.of(files.read_trace(path, robot, mapping))


def load_robot(path: str | Path, effects: str | Path | None = None) -> Description:
    """Read the description of a Delta robot, of servo axes or of an arm.

    Args:
        path: a TOML file, or the name of a robot that comes along: `d3-1200`.
        effects: Python file with effects of your own that the description carries.

    Returns:
        The checked description; its attributes are the keys of the file. It is not changed in place.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.

    Example:
        >>> import deltatwin as dt
        >>> dt.load_robot("d3-1200").geometry.active_link_length  # m
        0.4
    """
    return load_description(path, None if effects is None else Path(effects))


def load_demo() -> tuple[Robot, Trace]:
    """The identified robot and the log of `deltatwin demo`: a Delta that picks and places products of known mass.

    Returns:
        The robot, and its log of three joints at 1 kHz.

    Example:
        >>> import deltatwin as dt
        >>> robot, log = dt.load_demo()
        >>> log.torque.shape[1]
        3
    """
    from replay.demo import LOG, ROBOT
    from schemas.robot import load_robot as load_delta

    robot = load_delta(ROBOT)
    return robot, read_trace(LOG, robot)


def save_robot(robot: Description, path: str | Path, template: str | Path | None = None) -> None:
    """Write a description as TOML.

    Args:
        robot: what `identify` or `diagnose` found, or any other.
        path: the file to write.
        template: the description it came from, whose comments are kept.

    Raises:
        StorageError: the file cannot be written.
    """
    save_description(robot, Path(path), None if template is None else Path(template))


def identify(
    robot: Description,
    traces: Traces,
    *,
    method: Literal["pooled", "paper"] = "pooled",
    carried: Sequence[tuple[float, recorded.Trace]] = (),
) -> IdentificationResult:
    """Identify inertia, gravity, forearm and friction, with standard errors: weighted least squares over all logs.

    Args:
        robot: as described; what it carries as identified is replaced, effects are left out.
        traces: logs of the robot without payload, three or more of 5 s.
        method: of a Delta; `paper` is the published grid search, for comparison.
        carried: mass in kg and log of known loads that hang throughout: they fix torque constants and platform mass.

    Returns:
        `robot` with its `[identified]` section, the parameters with their verdicts, the residuals.

    Raises:
        DataError: the data cannot give an answer, naming log and joint. TraceError: a log is unusable.

    Example:
        >>> import deltatwin as dt
        >>> robot, log = dt.load_demo()  # it carries products: a real identification takes logs without
        >>> known = dt.identify(robot, log)
        >>> known.to_frame()["name"].to_list()[:2]
        ['rho_1', 'rho_2']
    """
    from service.identification.of_logs import identify_logs

    logs = as_list(traces)
    result, figures = identify_logs(robot, logs, method, carried)
    names = tuple(log.name for log in logs)
    return IdentificationResult(result.robot, result.warnings, names, result.fit, tuple(figures))


def diagnose(
    robot: Description,
    traces: Traces,
    *,
    tests: Traces = (),
    baseline: Description | None = None,
    effects: str | Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> DiagnosisResult:
    """Find which unmodelled effect causes the gap between model and machine, and how far it shrinks on held-out data.

    Args:
        robot: as described; effects that it carries are part of the model.
        traces: logs, three or more of 5 s in which all joints move and reverse.
        tests: logs that are used for nothing but trying the correction.
        baseline: the description whose gap counts as the one before; default: `robot` identified anew.
        effects: Python file with effects of your own.
        progress: told what is at hand; takes seconds to a minute in all.

    Returns:
        The document (as `diagnosis.json`), its sentences, and the corrected robot.

    Raises:
        DataError: no joint moves, a torque that was not recorded, logs of several rates. TraceError: a log is unusable.
    """
    from service.diagnosis.diagnose import diagnose as find
    from service.diagnosis.documents.document import corrected, document, frequency_response
    from service.diagnosis.documents.online import online_trial
    from service.model.effects import catalogue

    logs, kept = as_list(traces), as_list(tests)
    findings = find(robot, logs, catalogue(None if effects is None else Path(effects)), progress, baseline, kept)
    tried = online_trial(findings, logs, kept, [])
    return DiagnosisResult(
        corrected(findings), document(findings, kept, None, tried, frequency_response(findings)), findings
    )


def evaluate(robot: Description, traces: Traces) -> EvaluationResult:
    """Measured minus predicted torque for each model that `robot` carries parameters for.

    Args:
        robot: plain, identified or corrected.
        traces: logs, best such as no fit has seen.

    Returns:
        Per log, model and joint: mean, standard deviation and rms of the error in N m, below 40 Hz while moving.

    Raises:
        TraceError: a log is unusable. DataError: axes without identified parameters.

    Example:
        >>> import deltatwin as dt
        >>> found = dt.evaluate(*dt.load_demo())
        >>> list(found.models)
        ['M_KH', 'M_Id', 'M_Id+F', 'full', 'full, m_p estimated']
    """
    from service.identification.evaluation import evaluate as compare

    return EvaluationResult(robot, tuple(compare(robot, trace) for trace in as_list(traces)))


def payload(robot: Description, trace: recorded.Trace) -> PayloadResult:
    """Picks and releases in a log, and the mass that was picked, as the online estimator finds them.

    Args:
        robot: an identified Delta robot.
        trace: the log.

    Returns:
        The mass in kg after every sample with its standard deviation, and each level with its event.

    Raises:
        DataError: the robot was never identified, or the stamps do not rise. RobotError: no Delta.
        TraceError: the log is unusable.

    Example:
        >>> import deltatwin as dt
        >>> picked = dt.payload(*dt.load_demo())
        >>> len(picked.mass) == len(picked.time)
        True
    """
    from service.identification.payload import common_error, levels, payload_history

    delta = as_delta(robot, Question.PICKS)
    found = payload_history(delta, trace)
    return PayloadResult(delta, trace.name, found, tuple(levels(found)), common_error(delta))


def rollout(
    robots: Description | Mapping[str, Description],
    traces: Traces,
    *,
    horizon: float = 0.2,
    commands: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> RolloutResult:
    """Simulate the robot under the recorded torque and compare its motion with the measured one.

    Args:
        robots: an identified or corrected Delta, or several by name to compare, the best last.
        traces: the logs, cut into windows.
        horizon: length of a window, s.
        commands: put the recorded position commands in instead, through the drives.
        progress: told what is at hand.

    Returns:
        Rms error after the horizon in mrad and mm, of each robot, of the plain one, and of noise alone.

    Raises:
        DataError: no window of that length, other robots, or the sign of a torque is wrong. RobotError: no Delta.
    """
    from service.rollout.document import document
    from service.rollout.gap import PLAIN, compare, plain, refuse_another_robot

    named = dict(robots) if isinstance(robots, Mapping) else {robots.name: robots}
    given: dict[str, Robot] = {}
    for name, robot in named.items():
        given[name] = as_delta(robot, Question.PLATFORM)
    if not given:
        raise DataError("rollout: no robot given")
    refuse_another_robot(given)
    compared = {PLAIN: plain(next(iter(given.values()))), **given}
    logs = as_list(traces)
    found = compare(compared, logs, horizon, commands, progress)
    return RolloutResult(document(found, compared, [log.name for log in logs]))
