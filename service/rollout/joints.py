"""The gap as motion of axes and arms: how far simulated joints are from a log after a while under its torque.

As `gap` for a Delta: windows start in the smoothed measured state, and the recorded torque alone goes in. Friction of
the base model follows the simulated motion; effects act as they would along the measured one, which in a window is the
same but for the error that is told. What delay, filter or scale did to the reported torque is undone first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from schemas.axes_description import Description
from schemas.errors import DataError, NoWindowError, UnansweredError
from schemas.trace import Trace
from schemas.words import significant
from service.identification.noise import white_noise
from service.machines import machine_of
from service.machines.forward_runs import run
from service.machines.machine import MachineModel
from service.model.description import hypothesis_of
from service.model.hypothesis import Hypothesis
from service.model.mechanism import mechanism_of
from service.model.scene import Recording
from service.model.signals import EDGE, Segment, one_period, segments_of, thin
from service.model.torque import predict, unreported
from service.rollout.gap import DRAWS, LONGEST, PLAIN, SEED, SHORTEST, rms
from service.rollout.packed import true_torque

FLOOR = "floor"
STILL = "stands still"


@dataclass(frozen=True)
class Deviation:
    """One machine over W windows: simulated less measured at the horizon, (W, n) rad or m, NaN where a run was lost;
    growth: (S, n) rms on the way there; tool: (W,) m of the tool, None where the machine has none."""

    name: str
    joint: np.ndarray
    growth: np.ndarray
    tool: np.ndarray | None = None

    @property
    def good(self) -> np.ndarray:
        """(W,) windows that came to their end."""
        return np.isfinite(self.joint.sum(axis=1))

    @property
    def joint_rms(self) -> np.ndarray:
        """(n,) rad or m."""
        return rms(self.joint[self.good])

    @property
    def tool_rms(self) -> float | None:
        """m."""
        return None if self.tool is None else float(rms(self.tool[self.good]))


@dataclass(frozen=True)
class JointRollout:
    """Machines against logs, in the order given, then what standing still and noise alone make of it. left_out: windows
    without motion or between faults are none. horizon, period: s."""

    deviations: tuple[Deviation, ...]
    windows: int
    horizon: float
    period: float
    angular: bool


@dataclass(frozen=True)
class _Cut:
    trace: Trace
    segment: Segment
    starts: np.ndarray


def plain(machine: Description) -> Description:
    """The description as it was drawn up."""
    return machine.model_copy(update={"identified": None, "effect": []})


def compare(
    machines: dict[str, Description],
    traces: Sequence[Trace],
    horizon: float,
    progress: Callable[[str], None] = lambda _: None,
) -> JointRollout:
    """Simulate the machines, by name, over windows of `traces`; noise is laid over the last one's runs.

    Raises:
        DataError: the horizon makes no sense, logs of several rates, or axes that were never identified.
        NoWindowError: no window. TraceError: a trace without a usable part, naming the file.
        RobotError: an effect that is not known.
    """
    if not SHORTEST <= horizon <= LONGEST:
        raise DataError(f"horizon of {horizon:g} s: must be {SHORTEST:g} to {LONGEST:g} s")
    for name, machine in machines.items():
        if not machine.predicts:
            raise DataError(f"{name}: no [identified] parameters to simulate: run `deltatwin identify`")
    parts = [(trace, thin(part)) for trace, whole in zip(traces, segments_of(traces), strict=True) for part in whole]
    period = one_period([(str(trace.path), part) for trace, part in parts])
    samples = max(2, round(horizon / period)) + 1
    cuts = [_Cut(trace, part, _windows(part, samples)) for trace, part in parts]
    cuts = [cut for cut in cuts if len(cut.starts)]
    if not cuts:
        raise NoWindowError(f"{traces[0].path}: no window of {horizon:g} s between faults in which a joint moves")
    deviations = []
    models = {name: machine_of(described) for name, described in machines.items()}
    for name, model in models.items():
        progress(name)
        deviations.append(_joined(name, [_deviation(model, cut, samples) for cut in cuts]))
    progress(FLOOR)
    last = list(models.values())[-1]
    draws = [_deviation(last, cut, samples, np.random.default_rng([SEED, k])) for k in range(DRAWS) for cut in cuts]
    deviations += [_joined(FLOOR, draws), _joined(STILL, [_still(cut, samples) for cut in cuts])]
    windows = sum(len(cut.starts) for cut in cuts)
    return JointRollout(tuple(deviations), windows, (samples - 1) * period, period, parts[0][1].angular)


def _windows(segment: Segment, samples: int) -> np.ndarray:
    """(W,) first samples of windows one after the other in which some joint moves."""
    edge = round(EDGE / segment.period)
    every = range(edge, len(segment.time) - edge - samples, samples - 1)
    return np.array([at for at in every if segment.moving[at : at + samples].any()], np.int64)


def _deviation(machine: MachineModel, cut: _Cut, samples: int, noise: np.random.Generator | None = None) -> Deviation:
    """Runs of a machine less what was measured; with `noise` over torque and start, less its runs without."""
    segment, hypothesis = cut.segment, hypothesis_of(machine.description)
    recording = Recording(segment, machine.mechanism, 0, cut.trace.name)
    torque = _at_joints(recording, hypothesis, segment.torque)
    place = cut.starts[:, None] + np.arange(samples)
    angles = _run(machine, hypothesis, torque[place], segment.theta[cut.starts], segment.theta_dot[cut.starts], segment)
    measured = segment.theta[place]
    if noise is not None:
        left = segment.torque - predict(hypothesis.seen(recording), hypothesis)
        level = np.minimum(white_noise([recording]), white_noise([recording], [left]))
        louder = _at_joints(recording, hypothesis, segment.torque + level * noise.standard_normal(torque.shape))
        measured, start = angles, segment.theta[cut.starts]
        off = noise.standard_normal(start.shape) * (0.0 if segment.noise is None else segment.noise)
        angles = _run(machine, hypothesis, louder[place], start + off, segment.theta_dot[cut.starts], segment)
    error = angles - measured
    growth = np.sqrt(np.nanmean(error**2, axis=0))
    return Deviation("", error[:, -1], growth, _tool(machine, angles[:, -1], measured[:, -1]))


def _at_joints(recording: Recording, hypothesis: Hypothesis, torque: np.ndarray) -> np.ndarray:
    """What of a reported torque (N, n) moves the base model: the measurement undone, effects taken off."""
    scene = hypothesis.seen(recording)
    true = true_torque(hypothesis.terms, hypothesis.base.timing, torque, recording.segment.period)
    return true - (unreported(scene, hypothesis) - scene.total)


def _run(
    machine: MachineModel,
    hypothesis: Hypothesis,
    torque: np.ndarray,
    theta: np.ndarray,
    theta_dot: np.ndarray,
    segment: Segment,
) -> np.ndarray:
    """(W, S, n) under (W, S, n) torque, straight between samples."""

    def drive(k: int, share: float, live: np.ndarray, _: np.ndarray, __: np.ndarray) -> np.ndarray:
        return (1.0 - share) * torque[live, k] + share * torque[live, k + 1]

    return run(machine, hypothesis.base, (theta, theta_dot), drive, torque.shape[1], segment.period)[0]


def _tool(machine: MachineModel, angles: np.ndarray, measured: np.ndarray) -> np.ndarray | None:
    """(W,) m between the tools at two (W, n) angles; NaN of a lost run."""
    good = np.isfinite(angles).all(axis=1) & np.isfinite(measured).all(axis=1)
    try:
        places = [machine.place(values[good]) for values in (angles, measured)]
    except UnansweredError:
        return None
    result = np.full(len(angles), np.nan)
    result[good] = np.linalg.norm(places[0] - places[1], axis=1)
    return result


def _still(cut: _Cut, samples: int) -> Deviation:
    measured = cut.segment.theta[cut.starts[:, None] + np.arange(samples)]
    error = measured[:, :1] - measured
    return Deviation("", error[:, -1], rms(error))


def _joined(name: str, deviations: Sequence[Deviation]) -> Deviation:
    weight = np.array([len(one.joint) for one in deviations], float)
    growth = np.sqrt(np.average([one.growth**2 for one in deviations], axis=0, weights=weight))
    tools = [one.tool for one in deviations if one.tool is not None]
    tool = np.concatenate(tools) if len(tools) == len(deviations) else None
    return Deviation(name, np.concatenate([one.joint for one in deviations]), growth, tool)


def named(machines: Sequence[tuple[str, Description]]) -> dict[str, Description]:
    """By name, an arm first as its URDF has it.

    Raises:
        DataError: one is another machine than the first.
    """
    (first, given), result = machines[0], {}
    if mechanism_of(given).unidentified:
        result[PLAIN] = plain(given)
    for name, machine in machines:
        if not machine.has_joints_of(given):
            raise DataError(f"{name}: describes other joints than {first}: compare descriptions of one machine")
        result[name] = machine
    return result


def sentences(found: JointRollout) -> list[str]:
    """What a reader should know first."""
    *robots, floor, still = found.deviations
    last = robots[-1]
    share = last.joint_rms / still.joint_rms
    worst = max(range(len(share)), key=lambda joint: share[joint])
    least = f"{significant(100 * min(share), 2)} to " if len(share) > 1 else ""
    lines = [
        f"{last.name}: after {1e3 * found.horizon:.0f} ms its joints are off by {least}"
        f"{significant(100 * share[worst], 2)} % of their travel, joint {worst + 1} most."
    ]
    if not last.good.any():
        lines = []
    elif share[worst] > 1.0:
        lines.append(f"Joint {worst + 1} is off by more than its travel: wrong sign or unit of its torque, or a load?")
    if last.good.any() and (one := last.tool_rms) is not None and (noise := floor.tool_rms) is not None:
        lines.append(
            f"Its tool is off by {significant(1e3 * one)} mm; noise alone gives {significant(1e3 * noise)} mm."
        )
    lines += [
        f"{one.name}: runs away in {int((~one.good).sum())} of {len(one.good)} windows: no value here includes these."
        for one in robots
        if not one.good.all()
    ]
    return lines
