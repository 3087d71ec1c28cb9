"""Labelled cases for checking a diagnosis: a random robot with chosen effects, its logs, and the answer apart.

    key = simulate_case(folder, seed=7, draw=Draw("catalogue", ("backlash",)))

writes robot.toml (nominal figures), fit_*.csv and test_*.csv as a controller would have logged them one after the other
since power-on, and returns the answer for the key file. Everything follows from the arguments; the cases of one seed
share their robot and motions whatever the effects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from drivers.motion import MotionLimits, Planner, Trajectory
from drivers.simulated.plant.effects import EFFECTS, PlantEffect
from drivers.simulated.plant.families import ENCODER_COUNTS, WRONG, Draw, as_recorded, coloured_share
from drivers.simulated.plant.mujoco_delta import CompiledMechanism, Design, build, required_torque
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import simulate
from drivers.simulated.plant.truth import PlantTruth
from drivers.trace import write_trace
from schemas.errors import DataError, PoseError
from schemas.robot import Drive, Geometry, Mass, Robot, save_robot
from schemas.trace import Trace

PERIOD = 1e-3  # s
PAUSE = 5.0  # s between two logs of a case
BAND_HZ = 40.0  # in which gap and noise are compared
EDGE = 250  # samples left out at each end of a log, where the filters settle
ATTEMPTS = 5  # draws of an effect, should the drives not hold the robot with it


@dataclass(frozen=True)
class Case:
    """A robot, what it is believed to be, and the motions it makes: (file name, motion)."""

    robot: Robot
    truth: PlantTruth
    motions: tuple[tuple[str, Trajectory], ...]


def random_case(seed: int, picks: bool = False) -> Case:
    """The robot and motions of a seed: a small Delta of 0.9 m reach with friction and noise, without effects.

    picks: production pick-and-place motion alone.
    """
    rng = np.random.default_rng([seed, 0])
    robot = Robot(
        name=f"case-{seed}",
        geometry=Geometry(
            active_link_length=_round(rng.uniform(0.30, 0.39)),
            passive_link_length=_round(rng.uniform(0.81, 0.89)),
            base_radius=_round(rng.uniform(0.18, 0.22)),
            platform_radius=_round(rng.uniform(0.045, 0.055)),
        ),
        mass=Mass(
            active_link=_round(rng.uniform(2.2, 2.8)),
            passive_link=_round(rng.uniform(0.50, 0.75)),
            platform=_round(rng.uniform(1.0, 1.5)),
        ),
        drive=Drive(gear_ratio=25.0),
    )
    nominal = PlantTruth.nominal(robot)
    length, mass = robot.geometry.active_link_length, robot.mass.active_link * rng.uniform(0.92, 1.08)
    truth = nominal.model_copy(
        update={
            "active_link_kg": [mass] * 3,
            "active_link_centre_m": [rng.uniform(0.40, 0.55) * length] * 3,
            "active_link_inertia_kgm2": [mass * length**2 * rng.uniform(0.30, 0.36)] * 3,
            "rotor_inertia_kgm2": [rng.uniform(0.03, 0.08)] * 3,
            "coulomb_friction_nm": rng.uniform(2.0, 4.5, 3).tolist(),
            "viscous_friction_nms": rng.uniform(0.5, 1.4, 3).tolist(),
            "creep_radps": rng.uniform(0.005, 0.010),
            "encoder_counts_per_turn": float(2**20),
            "encoder_noise_rad": 1e-7,
            "torque_noise_nm": [rng.uniform(0.2, 0.5)] * 3,
            "peak_torque_nm": 250.0,
            "position_bandwidth_hz": rng.uniform(6.0, 10.0),
            "velocity_bandwidth_hz": rng.uniform(25.0, 40.0),
            "integral_time_s": rng.uniform(0.04, 0.10),
        }
    )
    planner = Planner(robot, PERIOD, MotionLimits(speed=10.0, acceleration=240.0, torque=85.0))

    def pick() -> Trajectory:
        return planner.pick_and_place(rng, rng.uniform(4.4, 5.4), speed=rng.uniform(0.7, 1.0))

    def multisine() -> Trajectory:
        return planner.multisine(rng, 8.0, rng.uniform(0.6, 1.0))

    if picks:
        names = ("fit_a_pick", "fit_b_pick", "fit_c_pick", "fit_d_pick", "test_a_pick")
        return Case(robot, truth, tuple((name, pick()) for name in names))
    motions = (
        ("fit_a_pick", pick()),
        ("fit_b_multisine", multisine()),
        ("fit_c_slow", planner.slow(rng, 8.0)),
        ("fit_d_pick", pick()),
        ("test_a_pick", pick()),
        ("test_b_multisine", multisine()),
    )
    return Case(robot, truth, motions)


def simulate_case(folder: Path, seed: int, draw: Draw) -> dict[str, Any]:
    """Write the case into `folder` and return its key entry.

    The entry: case, kind, effects, allowed (names that are true besides), joints (from 0, a list an effect), severity,
    wrong, noise (N m rms a sample, of white noise that leaves as much in the band), fx (parameters), lift (gap of the
    best plain model on test_* over the noise floor), refused (why earlier draws made no case).

    Raises:
        KeyError: an effect or quantity that is not there.
        DataError: the drives cannot hold the robot with these effects, drawn five times.
    """
    case = random_case(seed, draw.picks)
    noise = case.truth.torque_noise_nm[0]
    if draw.scope:
        sins = {"torque_noise_nm": [0.0] * 3, "encoder_counts_per_turn": ENCODER_COUNTS}
        case = dataclasses.replace(case, truth=case.truth.model_copy(update=sins))
    drawn: tuple[PlantEffect, ...] = ()
    traces: list[Trace] = []
    refused: list[str] = []
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1, attempt])
        drawn = tuple(EFFECTS[effect].draw(rng, case.truth, draw.severity) for effect in draw.effects)
        try:
            traces = run_case(case, drawn, seed)
            break
        except (DataError, PoseError) as error:
            refused.append(str(error))
            if attempt == ATTEMPTS - 1:
                what = f"case of seed {seed} with {', '.join(draw.effects) or 'no effect'} at severity {draw.severity}"
                raise DataError(f"{what}: {error}") from error
    allowed: frozenset[str] = frozenset()
    rng = np.random.default_rng([seed, 3])
    if draw.scope:
        traces, allowed = as_recorded(traces, noise, rng), frozenset({"torque_filter", "torque_delay"})
        noise *= (coloured_share(BAND_HZ) / (2 * BAND_HZ * PERIOD)) ** 0.5
    if draw.wrong:
        robot, allowed = WRONG[draw.wrong].change(case.robot, rng), WRONG[draw.wrong].names
        case = dataclasses.replace(case, robot=robot)
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(case.robot, folder / "robot.toml")
    for trace in traces:
        write_trace(trace, folder / f"{trace.name}.csv", case.robot.name)
    return {
        "case": folder.name,
        "kind": draw.kind,
        "effects": list(draw.effects),
        "allowed": sorted(allowed),
        "joints": [effect.joints for effect in drawn],
        "severity": draw.severity,
        "wrong": draw.wrong,
        "noise": noise,
        "fx": {effect: made.figures for effect, made in zip(draw.effects, drawn, strict=True)},
        "lift": round(plain_gap(case, traces) / (noise * (2 * BAND_HZ * PERIOD) ** 0.5), 3),
        "refused": refused,
    }


def run_case(case: Case, effects: tuple[PlantEffect, ...], seed: int) -> list[Trace]:
    """The logs of `case` with `effects` at work, on one plant from power-on.

    Raises:
        DataError: the drives lose the robot: the mechanism comes apart or a joint strays by more than 0.3 rad.
    """
    plant = Plant(case.robot, case.truth, effects, PERIOD, seed)
    traces = []
    for name, motion in case.motions:
        trace = simulate(plant, motion, name)
        assert trace.position_command is not None
        stray = float(np.abs(trace.position - trace.position_command).max())
        if stray > 0.3:
            raise DataError(f"{name}: a joint strays by {stray:.2f} rad from its command")
        traces.append(trace)
        plant.time += PAUSE
    return traces


def plain_gap(case: Case, traces: Sequence[Trace]) -> float:
    """rms gap, N m, on the test_* logs below `BAND_HZ` while the joints move, of the plain model fitted to the others.

    The plain model: MuJoCo's rigid body as described (forearms as rods), with link inertia, link weight and every
    joint's Coulomb and viscous friction fitted by least squares.
    """
    mechanism = build(Design(PlantTruth.nominal(case.robot)), PERIOD)
    creep = case.truth.creep_radps
    fit = [_regression(mechanism, creep, trace) for trace in traces if not trace.name.startswith("test")]
    basis, torque = np.concatenate([f[0] for f in fit]), np.concatenate([f[1] for f in fit])
    coefficients, *_ = np.linalg.lstsq(basis, torque, rcond=None)
    squares = count = 0.0
    for trace in traces:
        if trace.name.startswith("test"):
            basis, torque = _regression(mechanism, creep, trace)
            squares += float(((torque - basis @ coefficients) ** 2).sum())
            count += len(torque)
    return (squares / count) ** 0.5


def _regression(mechanism: CompiledMechanism, creep: float, trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Basis (M, 8) and target (M,) of the plain model over the moving samples of all joints."""
    rate = 1 / trace.period
    position = _low_pass(trace.position, 120.0, rate)
    spline = make_interp_spline(trace.time, position, k=5)
    velocity, acceleration = spline(trace.time, 1), spline(trace.time, 2)
    target = _low_pass(trace.torque - required_torque(mechanism, position, velocity, acceleration), BAND_HZ, rate)
    inertia, weight = (_low_pass(column, BAND_HZ, rate) for column in (acceleration, np.cos(position)))
    dry, viscous = (_low_pass(column, BAND_HZ, rate) for column in (np.tanh(velocity / creep), velocity))
    moving = _moving(trace.position, rate)
    moving[:EDGE] = moving[-EDGE:] = False
    rows, right = [], []
    for joint in range(3):
        chosen = moving[:, joint]
        block = np.zeros((int(chosen.sum()), 8))
        block[:, 0], block[:, 1] = inertia[chosen, joint], weight[chosen, joint]
        block[:, 2 + 2 * joint], block[:, 3 + 2 * joint] = dry[chosen, joint], viscous[chosen, joint]
        rows.append(block)
        right.append(target[chosen, joint])
    return np.concatenate(rows), np.concatenate(right)


def _low_pass(values: np.ndarray, hz: float, rate: float) -> np.ndarray:
    return sosfiltfilt(butter(4, hz / (rate / 2), output="sos"), values, axis=0)


def _moving(position: np.ndarray, rate: float) -> np.ndarray:
    """(N, 3) False where a joint stands still (below 0.01 rad/s) for 40 ms or more, and 15 ms round it."""
    speed = np.abs(np.gradient(_low_pass(position, 60.0, rate), 1 / rate, axis=0))
    moving = np.ones(position.shape, bool)
    margin, shortest = int(0.015 * rate), 0.040 * rate
    for joint in range(position.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (speed[:, joint] < 0.01).astype(int), [0]])))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if end - start >= shortest:
                moving[max(0, start - margin) : end + margin, joint] = False
    return moving


def _round(value: float) -> float:
    return round(float(value), 6)
