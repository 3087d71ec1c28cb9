"""What `import deltatwin` does: the functions that the commands call, on objects in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import get_args, overload

import schemas.trace as recorded
from deltatwin.given import Traces, as_list, as_path, described, logs_of
from deltatwin.public_trace import Mapping as ColumnMapping
from deltatwin.public_trace import Trace
from deltatwin.results import (
    DiagnosisResult,
    EvaluationResult,
    IdentificationResult,
    JointRolloutResult,
    LoadResult,
    PayloadResult,
    RolloutResult,
)
from drivers import trace as files
from schemas.axes_description import Axes, Description, load_description, save_description
from schemas.chain_description import Chain
from schemas.columns import Columns
from schemas.errors import DataError
from schemas.questions import Question, as_delta
from schemas.robot import Method, Robot

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
        N samples on the joint side, s, rad, N m; `findings` lists the faults found.

    Raises:
        TraceError: the file is unusable, naming file, line, column and value.

    Example:
        >>> import deltatwin as dt
        >>> log = dt.read_trace("fit_a.csv")  # doctest: +SKIP
        >>> log.torque.shape  # doctest: +SKIP
        (8001, 3)
    """
    mapping = columns if columns is None or isinstance(columns, Columns) else files.find_columns(as_path(columns))
    return Trace.of(files.read_trace(as_path(path), None if robot is None else described(robot), mapping))


def load_robot(path: str | Path, effects: str | Path | None = None) -> Description:
    """Read the description of a Delta robot, of servo axes or of an arm.

    Args:
        path: a TOML file, or the name of a bundled robot: `d3-1200`.
        effects: Python file with effects of your own that the description names.

    Returns:
        The checked description; its attributes are the keys of the file. It is not changed in place.

    Raises:
        RobotError: naming file, key and value of the first thing that is wrong.

    Example:
        >>> import deltatwin as dt
        >>> dt.load_robot("d3-1200").geometry.active_link_length  # m
        0.4
    """
    from service.model.effects import catalogue

    if effects is None:
        return load_description(as_path(path))
    own = as_path(effects)
    catalogue(own)  # also where the description names no effect: who gives the file means it to be used
    return load_description(as_path(path), own)


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
    save_description(described(robot), as_path(path), None if template is None else as_path(template))


def identify(
    robot: Description,
    traces: Traces,
    *,
    method: Method = "pooled",
    carried: Sequence[tuple[float, recorded.Trace]] = (),
) -> IdentificationResult:
    """Identify inertia, gravity, forearm and friction, with standard errors: weighted least squares over all logs.

    Args:
        robot: as described; identified parameters are replaced, effects are left out.
        traces: logs of the robot without payload, three or more of 5 s.
        method: for a Delta; `paper` is the published grid search, for comparison.
        carried: mass in kg and log of known loads carried throughout; they calibrate torque constants, platform mass.

    Returns:
        `robot` with its `[identified]` section, the parameters with their verdicts, the residuals.

    Raises:
        DataError: the data cannot give an answer, naming log and joint; no such method. TraceError: a log is unusable.

    Example:
        >>> import deltatwin as dt
        >>> robot, log = dt.load_demo()  # it has products: use logs without payload
        >>> known = dt.identify(robot, log)
        >>> known.to_frame()["name"].to_list()[:2]
        ['rho_1', 'rho_2']
    """
    from service.identification.of_logs import identify_logs

    if method not in get_args(Method):
        raise DataError(f"method: {method!r} is none of {', '.join(map(repr, get_args(Method)))}")
    logs = logs_of(described(robot), traces)
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
        robot: as described; its effects are part of the model.
        traces: logs, three or more of 5 s in which all joints move and reverse.
        tests: logs that are used only to test the correction.
        baseline: the description that gives the gap before the correction; default: `robot` identified from `traces`.
        effects: Python file with effects of your own.
        progress: called with the name of each stage; all stages take seconds to a minute.

    Returns:
        The document (as `diagnosis.json`), its sentences, and the corrected robot.

    Raises:
        DataError: no joint moves, a torque that was not recorded, logs of several rates, a log that is given twice.
        TraceError: a log is unusable.
    """
    from service.diagnosis.documents.document import corrected, document, frequency_response
    from service.diagnosis.documents.worth import online_trial
    from service.diagnosis.pipeline import diagnose as find
    from service.identification.copies import refuse_copies
    from service.model.effects import catalogue

    logs, kept = logs_of(described(robot), traces), logs_of(robot, tests, least=0)
    refuse_copies([*logs, *kept])
    findings = find(robot, logs, catalogue(None if effects is None else as_path(effects)), progress, baseline, kept)
    tried = online_trial(findings, logs, kept, [])
    return DiagnosisResult(
        corrected(findings), document(findings, kept, None, tried, frequency_response(findings)), findings
    )


def evaluate(robot: Description, traces: Traces) -> EvaluationResult:
    """Measured minus predicted torque for each model that `robot` has parameters for.

    Args:
        robot: plain, identified or corrected.
        traces: logs, preferably not used for any fit.

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

    return EvaluationResult(robot, tuple(compare(robot, trace) for trace in logs_of(described(robot), traces)))


@overload
def payload(robot: Robot, trace: recorded.Trace) -> PayloadResult: ...
@overload
def payload(robot: Axes | Chain, trace: recorded.Trace, frame: str | None = None) -> LoadResult: ...
@overload
def payload(robot: Description, trace: recorded.Trace, frame: str | None = None) -> PayloadResult | LoadResult: ...
def payload(robot: Description, trace: recorded.Trace, frame: str | None = None) -> PayloadResult | LoadResult:
    """What the robot carries: for a Delta picks and releases, as the online estimator finds them; for an arm the load
    that it carries throughout the log.

    Args:
        robot: an identified Delta robot or arm.
        trace: the log.
        frame: for an arm, the link of its URDF that carries the load; the last one by default.

    Returns:
        For a Delta the mass in kg after every sample with its standard deviation, and each level with its event. For an
        arm mass in kg, centre of mass in m and inertia in kg m^2, with standard errors.

    Raises:
        DataError: the robot was never identified, the stamps do not rise, or too little motion.
        RobotError: a machine without a load (servo axes), or no such link. TraceError: the log is unusable.

    Example:
        >>> import deltatwin as dt
        >>> picked = dt.payload(*dt.load_demo())
        >>> len(picked.mass) == len(picked.time)
        True
    """
    (trace,) = logs_of(described(robot), [trace])
    picking = robot.answering(Question.PICKS)
    if picking is None:
        from service.identification.log_load import load_on

        return LoadResult(robot, load_on(robot, trace, frame))
    from service.identification.weighed_picks import common_error, levels, payload_history

    if frame is not None:
        raise DataError(f"frame {frame!r}: a Delta robot has its load on the platform")
    found = payload_history(picking, trace)
    return PayloadResult(picking, trace.name, found, tuple(levels(found)), common_error(picking))


@overload
def rollout(
    robots: Robot | Mapping[str, Robot],
    traces: Traces,
    *,
    horizon: float = 0.2,
    commands: bool = False,
    progress: Callable[[str], None] = ...,
) -> RolloutResult: ...
@overload
def rollout(
    robots: Axes | Chain | Mapping[str, Axes] | Mapping[str, Chain],
    traces: Traces,
    *,
    horizon: float = 0.2,
    progress: Callable[[str], None] = ...,
) -> JointRolloutResult: ...
@overload
def rollout(
    robots: Description | Mapping[str, Description],
    traces: Traces,
    *,
    horizon: float = 0.2,
    commands: bool = False,
    progress: Callable[[str], None] = ...,
) -> RolloutResult | JointRolloutResult: ...
def rollout(
    robots: Description | Mapping[str, Description] | Mapping[str, Robot] | Mapping[str, Axes] | Mapping[str, Chain],
    traces: Traces,
    *,
    horizon: float = 0.2,
    commands: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> RolloutResult | JointRolloutResult:
    """Simulate the machine under the recorded torque and compare its motion with the measured one.

    Args:
        robots: an identified or corrected machine, or several by name to compare, the best last.
        traces: the logs, cut into windows.
        horizon: length of a window, s.
        commands: drive the simulation by the recorded position commands, through the drives; for a Delta.
        progress: called with the name of each stage.

    Returns:
        Rms error after the horizon, of each machine, of the plain one, and from noise alone: mrad and mm for a Delta,
        rad (m for linear axes) for axes and arms.

    Raises:
        DataError: no window of that length, different robots, or the sign of a torque is wrong.
        RobotError: `commands` for a machine that is not a Delta.
    """
    named: dict[str, Description] = {}
    if isinstance(robots, Mapping):
        named |= {name: described(one, name) for name, one in robots.items()}
    else:
        named[described(robots, "one robot, or several in a dict").name] = robots
    if not named:
        raise DataError("rollout: no robot is given")
    if not isinstance(horizon, int | float):
        raise DataError(f"horizon: {horizon!r} is not a number of seconds")
    logs = as_list(traces)
    for one in named.values():
        logs_of(one, logs)
    others = [(name, one) for name, one in named.items() if one.answering(Question.COMMANDS) is None]
    if others and not commands:
        from service.rollout import joints

        if len(others) < len(named):
            raise DataError(f"{', '.join(named)}: compare descriptions of one machine")
        return JointRolloutResult(joints.compare(joints.named(others), logs, horizon, progress))
    from service.rollout.gap import PLAIN, compare, plain, refuse_another_robot
    from service.rollout.rollout_page import document

    given = {name: as_delta(one, Question.COMMANDS) for name, one in named.items()}
    refuse_another_robot(given)
    compared = {PLAIN: plain(next(iter(given.values()))), **given}
    found = compare(compared, logs, horizon, commands, progress)
    return RolloutResult(document(found, compared, [log.name for log in logs]))
