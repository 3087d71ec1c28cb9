"""Does the declared scaling fit what the drives say? Nothing is corrected here; a contradiction is put into words.

Three things a Delta robot's data can contradict:
* The speed of the position against 0x606C: wrong counts per turn, velocity unit or mapping.
* The torque against the acceleration: the mass matrix is positive definite, so in a regression of a joint's torque on
  all accelerations, friction and gravity its own acceleration has a positive coefficient. Else a torque sign is wrong.
* The torque against gravity: what hangs on a joint pulls it down, which is positive, so the drive holds it with a
  negative torque. Else the joint's sign is wrong, or something else carries the arm. Not asked of a robot on a wall.
"""

from __future__ import annotations

import os
import threading

import numpy as np

from drivers.ethercat.cia402 import VELOCITY_ACTUAL, Scale, scales
from drivers.ethercat.process_data.object_layout import INPUTS
from schemas.messages import SAMPLE, SampleFlag, stamp_ns
from schemas.robot import Robot

ENOUGH = 500  # consecutive sound samples before anything is judged
AT_MOST = 200_000  # samples kept
WINDOW = 5_000  # samples by which a live stream is judged
TRAVEL = 0.2  # rad of every joint in it
SMOOTHED_S = 0.03  # width of the local cubic that derives speed and acceleration
MOVING_RADPS = 0.02  # below, quantisation decides
SPEED_TOLERANCE = 0.05  # of the speed's scale
CLEAR_SHARE = 0.05  # of the torque's variance that the own acceleration must explain before its sign is judged
CLEAR_SIGMAS = 10.0
GRAVITY_SHARE = 0.2  # of the torque's rms that a load in the wrong direction must reach
HANGS = 0.8  # share of gravity along -z from which every arm is pulled down


class Declaration:
    """Collects sound samples of a stream and judges the robot description by them."""

    def __init__(self, robot: Robot) -> None:
        self._scales = scales(robot)
        self._hangs = -robot.gravity_mps2[2] > HANGS * float(np.linalg.norm(robot.gravity_mps2))
        self._kept = 0
        self._samples: list[np.ndarray] = []
        self._velocity: list[np.ndarray] = []

    def add(self, samples: np.ndarray, raw: np.ndarray) -> None:
        """(N,) records of SAMPLE and their (N, 3, 6) inputs in drive units."""
        room = AT_MOST - self._kept
        if room > 0 and len(samples):
            self._samples.append(samples[:room].copy())
            self._velocity.append(raw[:room, :, INPUTS.index(VELOCITY_ACTUAL)].copy())
            self._kept += len(self._samples[-1])

    def findings(self) -> list[str]:
        """What contradicts the declaration, one line each."""
        if self._kept < ENOUGH:
            return []
        samples = np.concatenate(self._samples)
        run = _longest_run(samples["flags"] & ~np.uint32(SampleFlag.NO_COMMAND) == 0)
        samples, velocity = samples[run], np.concatenate(self._velocity)[run]
        if len(samples) < ENOUGH:
            return []
        from scipy.signal import savgol_filter

        period = float(np.median(np.diff(stamp_ns(samples)))) * 1e-9
        window = max(5, int(SMOOTHED_S / period) | 1)
        position = samples["position"]
        speed, acceleration = (
            np.asarray(savgol_filter(position, window, 3, deriv=order, delta=period, axis=0)) for order in (1, 2)
        )
        found = []
        for joint, scale in enumerate(self._scales):
            name = f"joint {joint + 1}"
            found += _judge_speed(name, scale, speed[:, joint], velocity[:, joint])
            torque = samples["torque"][:, joint]
            found += _judge_torque(name, joint, position, speed, acceleration, torque, self._hangs)
        return found


class FirstMotion:
    """Judges a live stream once, by its first window in which every joint travels, beside the bus, not in its way."""

    def __init__(self, robot: Robot) -> None:
        import scipy.signal  # noqa: F401 - loaded before the bus is looked at, not while it runs

        self._robot = robot
        self._samples = SAMPLE.empty(WINDOW)
        self._raw = np.zeros((WINDOW, 3, len(INPUTS)), np.int64)
        self._count = 0
        self._judging: threading.Thread | None = None
        self._found: list[str] = []

    def add(self, sample: np.ndarray, raw: np.ndarray) -> None:
        """(1,) record of SAMPLE and its (1, 3, 6) inputs in drive units."""
        if self._count < WINDOW:
            self._samples[self._count], self._raw[self._count] = sample[0], raw[0]
            self._count += 1

    def news(self, ended: bool = False) -> list[str]:
        """What contradicts the declaration, told once; to be asked in a pause. ended: waits for the judgement."""
        if self._count == WINDOW and self._judging is None:
            if (np.ptp(self._samples["position"], axis=0) < TRAVEL).any():
                self._count = 0
            else:
                self._judging = threading.Thread(target=self._judge)
                self._judging.start()
        if ended and self._judging is not None:
            self._judging.join()
        found, self._found = self._found, []
        return found

    def _judge(self) -> None:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # of this thread, whatever the bus's has
        declaration = Declaration(self._robot)
        declaration.add(self._samples, self._raw)
        self._found = declaration.findings()


def _longest_run(sound: np.ndarray) -> slice:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], sound.astype(np.int8), [0]])))
    if len(edges) == 0:
        return slice(0, 0)
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return slice(int(starts[longest]), int(ends[longest]))


def _judge_speed(name: str, scale: Scale, speed: np.ndarray, units: np.ndarray) -> list[str]:
    moving = np.abs(speed) > MOVING_RADPS
    if scale.radians_per_s_per_unit is None or np.count_nonzero(moving) < ENOUGH:
        return []
    told = units[moving] * scale.radians_per_s_per_unit
    if not told.any():
        return [
            f"{name}: 0x606C stays 0 while the joint moves: the drive does not supply it, or it is mapped elsewhere"
        ]
    ratio = float(told @ speed[moving] / (told @ told))
    if abs(ratio - 1) <= SPEED_TOLERANCE:
        return []
    return [
        f"{name}: the position moves {ratio:.4g} times as fast as 0x606C says: counts_per_turn, the velocity unit or "
        "the mapping is declared wrong"
    ]


def _judge_torque(
    name: str,
    joint: int,
    position: np.ndarray,
    speed: np.ndarray,
    acceleration: np.ndarray,
    torque: np.ndarray,
    hangs: bool,
) -> list[str]:
    own = acceleration[:, joint]
    angle, rate = position[:, joint], speed[:, joint]
    others = np.delete(acceleration, joint, axis=1)
    rest = np.column_stack([np.cos(angle), np.sin(angle), rate, np.sign(rate), others, np.ones(len(angle))])
    scatter = np.linalg.lstsq(rest, np.column_stack([own, torque]), rcond=None)[0]
    own_alone, torque_alone = (np.column_stack([own, torque]) - rest @ scatter).T  # Frisch-Waugh: what the rest leaves
    energy = float(own_alone @ own_alone)
    spread = float(np.var(torque)) * len(torque)
    if energy <= 1e-12 * float(own @ own) or spread <= 0:
        return []
    inertia = float(own_alone @ torque_alone) / energy
    left = torque_alone - inertia * own_alone
    correlated = max(1.0, len(left) / max(1, np.count_nonzero(np.diff(np.sign(left)))))  # samples per independent one
    sigma = np.sqrt(float(left @ left) / len(left) * correlated / energy)
    found = []
    if inertia < -CLEAR_SIGMAS * sigma and inertia**2 * energy > CLEAR_SHARE * spread:
        found.append(
            f"{name}: the torque falls when the joint accelerates ({inertia:.3g} N m per rad/s^2, but an inertia is "
            "positive): torque_sign or sign is declared wrong"
        )
    load = float(np.mean(torque - inertia * own))
    if hangs and load > GRAVITY_SHARE * float(np.sqrt(np.mean(torque**2))) and np.mean(np.cos(angle)) > 0.2:
        found.append(
            f"{name}: on average the drive pushes the arm down with {load:.3g} N m, although it has to hold it against "
            "gravity: sign is declared wrong, unless a spring or a counterweight carries the arm"
        )
    return found
