"""Torque that is a command: told by what the controller makes of its position error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from schemas.axes_description import Axes
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.joint_machines import identify_axes
from service.identification.loops import loops_of, told
from service.identification.regression import summarise
from service.model.nominal import pack
from tests.service.subject import Hypothesis, evaluate
from tests.service.world import BASE, ROBOT, course, problem


@pytest.mark.parametrize(
    ("noise", "gain", "closed"),
    [(0.0, 40.0, True), (0.1, 40.0, True), (0.2, 40.0, False), (0.05, 0.0, False)],
)
def test_a_torque_that_is_the_controllers_answer_is_told_by_its_gain(noise, gain, closed):
    """Joint 2's is a PD controller's of its position error, but for noise of so much of it (2 % of its square may be),
    or follows its speed alone; the others' are the robot's, of which one has no error at all."""
    run, random = course(1, 2.0), np.random.default_rng(3)
    error = np.asarray(lfilter([0.02], [1.0, -0.98], random.standard_normal((2000, 3)), axis=0))
    error[:, 0] = 0.0
    controlled = gain * (error[:, 1] + 0.0075 * np.gradient(error[:, 1], 1e-3)) + 0.5 * run.motion[1][:, 1]
    torque = run.torque.copy()
    made = problem([run], [run.torque])
    smooth = made.band(np.column_stack([controlled, controlled, controlled]))
    loud = made.band(random.standard_normal((2000, 3)))
    torque[:, 1] = controlled + noise * smooth.std() / loud.std() * random.standard_normal(2000)
    logs = problem([run], [torque])
    left = evaluate(logs, Hypothesis(BASE)).residuals
    found = loops_of(logs, [error], left)
    assert list(found) == ([1] if closed else [])
    assert loops_of(logs, [error], [0.0 * values for values in left]) == {}, "told better by the robot's own model"
    if closed:
        assert found[1] == (pytest.approx(gain, rel=0.05),) * 2
    assert loops_of(logs, [], left) == {}


@pytest.mark.parametrize(
    ("share", "base", "closed"), [(0.22, 9.0, True), (0.28, 9.0, False), (0.22, 0.4, True), (0.22, 0.15, False)]
)
def test_beside_speed_the_error_has_to_tell_three_quarters_of_the_rest(share, base, closed):
    """Nearly all of it is a damper's torque, beside 40 N m/rad and noise that leaves so much of what those make;
    base: mean square that the robot's own model leaves, of the noise's. A quarter of it tells more than the error."""
    run, random = course(1, 2.0), np.random.default_rng(3)
    error = np.asarray(lfilter([0.02], [1.0, -0.98], random.standard_normal((2000, 3)), axis=0))
    made, noise = problem([run], [run.torque]), random.standard_normal((2000, 3))
    size = 40.0 * made.band(error).std(axis=0) / made.band(noise).std(axis=0) * np.sqrt(share / (1 - share))
    torque = run.torque.copy()
    torque[:, 1] = (40.0 * error + size * noise + 300.0 * run.motion[1])[:, 1]
    logs = problem([run], [torque])
    level = np.sqrt(base) * (size * made.band(noise).std(axis=0) / logs.sigma)[1]
    left = [np.full(len(rows), level) for rows in logs.joints_of_rows]
    assert (1 in loops_of(logs, [error], left)) is closed


def test_a_gain_is_that_of_a_log():
    """Joint 2's is its position error times 40 N m/rad in one log and 160 in the other."""
    runs, gains = [course(seed, 2.0) for seed in (1, 2)], (40.0, 160.0)
    errors = [np.asarray(lfilter([0.02], [1.0, -0.98], np.random.default_rng(s).standard_normal((2000, 3)), axis=0))
              for s in (1, 2)]  # fmt: skip
    torques = [run.torque.copy() for run in runs]
    for torque, error, gain in zip(torques, errors, gains, strict=True):
        torque[:, 1] = gain * error[:, 1]
    logs = problem(runs, torques)
    found = loops_of(logs, errors, evaluate(logs, Hypothesis(BASE)).residuals)
    assert found == {1: pytest.approx(gains, rel=0.01)}
    assert "(40 to 160 N m per rad" in told(found, ROBOT)[0]
    assert "(40 N m per rad" in told({1: (40.0, 40.001)}, ROBOT)[0]


def commanded(seed: int, gain: float) -> Trace:
    """A course with a controller whose error is what a torque of `gain` N m/rad makes; 0: the torque is the robot's."""
    run, random = course(seed, 4.0), np.random.default_rng(seed)
    error = np.asarray(lfilter([0.02], [1.0, -0.98], random.standard_normal(run.torque.shape), axis=0))
    torque = run.torque + 0.3 * random.standard_normal(run.torque.shape)
    if gain:
        error = torque / gain
    return Trace(Path(f"run_{seed}"), run.time, run.motion[0], torque, position_command=run.motion[0] + error)


def test_identify_says_that_a_torque_is_a_command():
    for gain, said in ((2000.0, [1, 2, 3]), (0.0, [])):
        traces = [commanded(seed, gain) for seed in (1, 2, 3)]
        found = identify(ROBOT, [summarise(pack(ROBOT), trace) for trace in traces])
        lines = [line for line in found.warnings if "controller's response" in line]
        assert [line.split(" was not")[0] for line in lines] == [f"the torque of joint {joint}" for joint in said]
        mixed = [traces[0], replace(traces[1], position_command=None), traces[2]]
        found = identify(ROBOT, [summarise(pack(ROBOT), trace) for trace in mixed])
        assert not any("controller's response" in line for line in found.warnings), "not all logs have commands"


@pytest.mark.parametrize(
    ("unit", "gain", "said"), [("rad", 50.0, "(50 N m per rad, without"), ("m", 1.48e6, "(1480000 N per m, without")]
)
def test_of_an_axis_too_in_its_unit(unit, gain, said):
    time, random = np.arange(0.0, 8.0, 1e-3), np.random.default_rng(2)
    angle = np.sin(2 * np.pi * 0.7 * time) + 0.4 * np.sin(2 * np.pi * 1.9 * time)
    torque = 0.2 * np.gradient(np.gradient(angle, 1e-3), 1e-3) + 0.05 * random.standard_normal(len(time))
    axes = Axes.model_validate({"name": "one", "kind": "axes", "axis": [{"unit": unit, "gravity": False}]})
    for error, count in ((torque / gain, 1), (0.01 * random.standard_normal(len(time)), 0)):
        log = Trace(Path("log"), time, angle[:, None], torque[:, None], position_command=(angle + error)[:, None])
        lines = [line for line in identify_axes(axes, [log]).warnings if "controller's response" in line]
        assert len(lines) == count
        assert all(said in line for line in lines)
