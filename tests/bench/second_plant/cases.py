"""Cases of the second plant: a folder with a robot's description, its logs and, beside them, the truth.

    fit_*.csv   given to the diagnosis            robot.toml  as the robot is described
    test_*.csv  kept from it                      truth.json  what is wrong with it

A family and a seed say all; the same seed gives the same files.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from scipy.signal import butter, sosfiltfilt

from tests.bench.second_plant.closed_chain import (
    ANGLE,
    CYCLE_S,
    MOTOR,
    PLACE,
    STATES,
    Plant,
    run,
)
from tests.bench.second_plant.faults import DISTURBANCES, EFFECTS, afflicted, disturbed, may_join, misdescribed
from tests.bench.second_plant.inverse import Moving, along, angles, parts, required
from tests.bench.second_plant.platform_paths import gentle, picks, stations, waves
from tests.bench.second_plant.recorder import Log, Recorder, clean, controller_log, recorded, scope, write
from tests.bench.second_plant.robots import World, as_described, drawn

FAMILIES = (
    "none", "single", "pair", "three", "disturbed", "description", "production", "scope", "gap_free", "outside",
)  # fmt: skip
BAND_HZ = 40.0  # in which gaps are compared
FINE_HZ = 2000.0  # at which it is computed how far a gap stands out
SMOOTH_HZ = 120.0  # below which the motion is taken for that
MOST_RADPS2 = 220.0  # of the joints, in the paths
SLOWEST_RADPS = 0.02  # below, a joint counts as resting
SEVERAL = {"pair": 2, "three": 3, "disturbed": 2, "none": 0, "gap_free": 0, "outside": 0}  # effects; else one


@dataclass(frozen=True)
class Case:
    """A drawn case. work: whether the robot did its work alone, with nothing that was made to excite it."""

    family: str
    seed: int
    world: World
    recorder: Recorder
    work: bool


def draw(family: str, seed: int) -> Case:
    """What a family and a seed say.

    Effects of the family `single` go through the catalogue, that of seed 0 first, so that some seeds in a row are as
    many effects; `outside` goes through the disturbances.
    """
    rng = np.random.default_rng([FAMILIES.index(family), seed])
    world = drawn(rng)
    count = SEVERAL.get(family, 1)
    if family == "description" and seed % 2:
        count = 0
    names = _names(family, seed, count, rng)
    if family == "description":
        world = misdescribed(world, rng)
    for name in names:
        world = afflicted(world, name, rng)
    if family in ("disturbed", "outside"):
        every = tuple(DISTURBANCES)
        world = disturbed(world, every[seed % len(every)], rng)
    by_scope = family == "scope" or (family == "gap_free" and seed % 2 == 0)
    recorder = (scope if by_scope else controller_log)(rng, world.size, world.gear)
    return Case(family, seed, world, recorder, family == "production" or (family == "gap_free" and seed % 2 == 1))


def _names(family: str, seed: int, count: int, rng: np.random.Generator) -> list[str]:
    if family == "single":
        order = np.random.default_rng(0).permutation(len(EFFECTS))
        return [EFFECTS[order[seed % len(EFFECTS)]]]
    names: list[str] = []
    while len(names) < count:
        more = [*names, str(rng.choice(EFFECTS))]
        names = more if may_join(more) else names
    return names


@dataclass(frozen=True)
class Run:
    """One log: what was asked of the robot and what it did, a row a cycle."""

    name: str
    begin: float
    reference: np.ndarray
    forward: np.ndarray
    angle: np.ndarray
    asked: np.ndarray
    checks: np.ndarray


def motions(case: Case, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Paths of the platform, (n, 3) m, by the name of the log."""
    room = case.world.room
    if case.work:
        at = stations(rng, room)
        return {f"{name}_work": picks(rng, room, 8.0, at) for name in ("fit_a", "fit_b", "fit_c", "test_a", "test_b")}
    return {
        "fit_a_pick": picks(rng, room, 5.5),
        "fit_b_waves": waves(rng, room, 7.5, 0.25, 3.5, 1.1),
        "fit_c_slow": waves(rng, room, 8.5, 0.08, 0.35, 0.3),
        "fit_d_pick": picks(rng, room, 5.5),
        "test_a_pick": picks(rng, room, 5.5),
        "test_b_waves": waves(rng, room, 6.5, 0.25, 3.5, 1.1),
    }


def at_rest(plant: Plant, place: np.ndarray) -> np.ndarray:
    """State of the plant at rest with its motors where they have to be for a platform at `place` (3,); compliant gears
    are bent by the weight behind them, as they are where a vibration has died out, so the platform hangs lower."""
    state = np.zeros(STATES)
    motor = angles(plant, place[None])
    standing = along(plant, np.repeat(place[None], 5, axis=0), CYCLE_S)
    load = required(plant, standing)[2]
    soft = plant.stiffness > 0.0
    bent = np.where(soft, load / np.where(soft, plant.stiffness, 1.0) + np.sign(load) * plant.lash / 2, 0.0)
    state[MOTOR : MOTOR + 3] = motor[0]
    state[ANGLE : ANGLE + 3] = motor[0] - bent
    state[PLACE : PLACE + 3] = placed(plant, motor - bent)[0] if soft.any() else place
    return state


def moved(case: Case) -> list[Run]:
    """All logs of a case, one after the other on one clock.

    Raises:
        ArithmeticError: the control lost the robot, or a forearm came apart.
    """
    rng = np.random.default_rng([FAMILIES.index(case.family), case.seed, 1])
    plant, found, clock = case.world.plant, [], 0.0
    model = as_controller(case)
    ahead = rng.uniform(0.7, 1.0)
    for name, drawn_path in motions(case, rng).items():
        path = gentle(model, drawn_path, MOST_RADPS2)
        moving = along(model, path, CYCLE_S)
        forward = ahead * required(model, moving)
        angle, asked, _, checks = run(plant, at_rest(plant, path[0]), moving.angle, moving.rate, forward, clock)
        if not np.all(np.isfinite(angle)) or checks[:, 0].max() > 1e-4 or np.abs(angle - moving.angle).max() > 0.3:
            raise ArithmeticError(f"{case.family} {case.seed}, {name}: the robot was lost")
        found.append(Run(name, clock, moving.angle, forward, angle, asked, checks))
        clock += len(path) * CYCLE_S + rng.uniform(0.5, 2.0)
    return found


def as_controller(case: Case) -> Plant:
    """The plant that the controller takes the robot for: its description, and about the right rotors and friction."""
    plant = case.world.plant
    return as_described(case.world.description)._replace(
        rotor=np.full(3, np.median(plant.rotor)), viscous=0.8 * plant.viscous, coulomb=0.8 * plant.coulomb
    )


def lift(case: Case, runs: list[Run]) -> float:
    """How far the gap that the best base model leaves stands above the noise, rms over rms below `BAND_HZ`.

    The base model (two factors on the rigid body, forearms as rods, friction a joint) is fitted by least squares to
    what the drives said, without noise and sampled finely.
    """
    fine = replace(case.recorder, rate_hz=FINE_HZ)
    logs = [clean(fine, case.world.report, one.begin, one.angle, one.asked) for one in runs]
    described = as_described(case.world.description)._replace(coulomb=np.ones(3), viscous=np.ones(3), rotor=np.zeros(3))
    rows, right = [], []
    for log in logs:
        block, torque, moving = _columns(described, log, FINE_HZ)
        keep = np.abs(moving.rate) > SLOWEST_RADPS
        keep[: len(keep) // 40] = keep[-(len(keep) // 40) :] = False
        rows.append(block[keep])
        right.append(torque[keep])
    matrix, target = np.concatenate(rows), np.concatenate(right)
    size = np.sqrt(np.mean(matrix**2, axis=0))
    found = np.linalg.lstsq(matrix / size, target, rcond=None)[0]
    gap = float(np.sqrt(np.mean((target - matrix / size @ found) ** 2)))
    return float(np.hypot(gap, noise_in_band(case.recorder)) / noise_in_band(case.recorder))


def noise_in_band(recorder: Recorder) -> float:
    """Rms of the recorder's torque noise and steps below `BAND_HZ`, N m, by their spectra."""
    nyquist = recorder.rate_hz / 2
    keeps = np.exp(-1 / (recorder.rate_hz * recorder.memory_s))
    turn = np.linspace(0, np.pi * min(BAND_HZ / nyquist, 1.0), 2000)
    slow = np.trapezoid((1 - keeps**2) / (1 - 2 * keeps * np.cos(turn) + keeps**2), turn) / np.pi
    white = recorder.noise_nm**2 * (1 - recorder.coloured) + recorder.torque_step_nm**2 / 12
    return float(np.sqrt(white * turn[-1] / np.pi + recorder.noise_nm**2 * recorder.coloured * slow))


def _columns(plant: Plant, log: Log, rate_hz: float) -> tuple[np.ndarray, np.ndarray, Moving]:
    """Base regressors (n, 3, 9) and torque (n, 3) of a log, both below `BAND_HZ`, and its motion."""
    smooth = butter(4, SMOOTH_HZ, fs=rate_hz, output="sos")
    band = butter(4, BAND_HZ, fs=rate_hz, output="sos")
    moving = along(plant, placed(plant, sosfiltfilt(smooth, log.angle, axis=0)), 1 / rate_hz)
    with_rods = parts(plant, moving)
    light = parts(plant._replace(forearm_mass=np.zeros(3)), moving)
    rods = with_rods["carried"] - light["carried"]
    bars = parts(plant._replace(link_mass=np.zeros(3), platform_mass=1e-9), moving)["carried"]
    whole = [with_rods["turning"], with_rods["weight"], light["carried"] + rods, bars]
    own = [with_rods[name] * np.eye(3)[j] for name in ("dry", "wet") for j in range(3)]
    fixed = whole[2]
    columns = np.stack([whole[0], whole[1], whole[3], *own], axis=-1)
    return (
        sosfiltfilt(band, columns, axis=0), sosfiltfilt(band, log.torque - fixed, axis=0), moving,
    )  # fmt: skip


def placed(plant: Plant, angle: np.ndarray) -> np.ndarray:
    """Platform (n, 3) in m at joint angles (n, 3), below the elbows: where three spheres meet."""
    out = plant.radius + plant.link * np.cos(angle)
    elbow = np.stack([out * np.cos(plant.azimuth), out * np.sin(plant.azimuth), -plant.link * np.sin(angle)], axis=-1)
    first, second, third = (elbow[:, j] for j in range(3))
    x, to_third = second - first, third - first
    across = np.linalg.norm(x, axis=1, keepdims=True)
    x = x / across
    part = np.sum(x * to_third, axis=1, keepdims=True)
    y = to_third - part * x
    height = np.linalg.norm(y, axis=1, keepdims=True)
    y = y / height
    square = plant.forearm**2
    u = (square[0] - square[1] + across**2) / (2 * across)
    v = (square[0] - square[2] + part**2 + height**2 - 2 * part * u) / (2 * height)
    w = np.sqrt(square[0] - u**2 - v**2)
    z = np.cross(x, y)
    return first + u * x + v * y - w * z * np.sign(z[:, 2:])


def make(family: str, seed: int, folder: Path) -> dict[str, Any]:
    """Write the case into `folder`; returns what `truth.json` says.

    Raises:
        ArithmeticError: the drawn robot cannot be held by its control.
    """
    case = draw(family, seed)
    rng = np.random.default_rng([FAMILIES.index(family), seed, 2])
    runs = moved(case)
    for each in runs:
        log = clean(case.recorder, case.world.report, each.begin, each.angle, each.asked)
        write(recorded(rng, case.recorder, log, each.reference, each.forward), folder / f"{each.name}.csv")
    (folder / "robot.toml").write_text(tomlkit.dumps({"name": "second", **case.world.description}))
    truth = {
        "family": family, "seed": seed, "effects": case.world.named, "disturbances": case.world.disturbed,
        "misdescribed": case.world.misdescribed, "work": case.work, "recorder": asdict(case.recorder),
        "noise_in_band_nm": noise_in_band(case.recorder), "lift": lift(case, runs),
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return truth
