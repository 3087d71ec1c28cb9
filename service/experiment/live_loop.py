"""The loop closed: a live simulated robot and an estimator, each a process of its own, on Zenoh.

One run a variant, the same motion and the same noise in each; what differs is what the drives are fed: the stages of
one model on a robot as described, or the model without and with the correction on a robot that has an effect.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.bus import Bus, open_bus
from drivers.motion import Trajectory
from drivers.simulated.plant.effects import PlantEffect
from drivers.simulated.plant.plant import Plant, make_plant
from drivers.simulated.plant.plant_on_bus import LiveRun, run_live
from replay.clock import Pacer
from schemas.fitted import JointParameter, Parameter
from schemas.messages import NANOSECONDS, HealthFlag, Role
from schemas.robot import Identified, Robot, save_robot
from service.model import kinematics
from service.model.nominal import pack
from service.supervisor import Process, Supervisor

SETTLING = 0.5  # s at the start of a run that do not count: the integrators hand the weight over to the feed-forward
FEEDBACK = "feedback alone"
RIGID, CORRECTED = "rigid tau_FF", "corrected tau_FF"
BLIND = JointParameter(value=[1e6, 1e6, 1e6])  # N m of noise, in which no payload can be seen
# Share of cycles that began late or without feed-forward from which a run measures the computer: whatever the drives
# were fed then was not the feed-forward of this variant, and its absence disturbs a hundred times what is left with it.
SPOILT = 0.01
BLOCK = 0.5  # s of motion that are drawn together for an interval: longer than any move
DRAWS = 2000


@dataclass(frozen=True)
class Subject:
    """The simulated robot at hand: its description, the truth file (as `make_plant` takes it), effects at work besides,
    and the period of the controller, s."""

    robot: Robot
    truth: str | None
    effects: tuple[PlantEffect, ...]
    period: float

    def plant(self, seed: int) -> Plant:
        """One of it, at rest, with noise of its own."""
        return make_plant(self.robot, self.truth, self.period, seed, self.effects)[0]


@dataclass(frozen=True)
class Tracking:
    """How well one variant followed its command.

    joint_rms (3,) rad; worst rad, any joint; helped: share of cycles with feed-forward, held: with one that was for an
    earlier cycle; late: how many cycles began after the next was due. error (N, 3) rad, measured minus commanded, from
    the end of settling, at `time` (N,) s. missed (N,) m: how far the platform is from its place, by the encoders;
    astray (N,) m: the same in truth, with what gears bend and play.
    """

    name: str
    time: np.ndarray
    error: np.ndarray
    joint_rms: np.ndarray
    missed: np.ndarray
    astray: np.ndarray
    worst: float
    helped: float
    held: float
    late: int

    @property
    def rms(self) -> float:
        """All joints, rad."""
        return float(np.sqrt(np.mean(self.joint_rms**2)))

    @property
    def platform_rms(self) -> float:
        """By the encoders, m."""
        return _rms(self.missed)

    @property
    def true_rms(self) -> float:
        """Of the platform in truth, m."""
        return _rms(self.astray)

    @property
    def spoilt(self) -> bool:
        """Whether the run says more of the computer than of the robot. With feedback alone nothing has to come in time:
        the simulated robot then does the same however late its cycles are."""
        return self.name != FEEDBACK and max(self.late / len(self.time), 1.0 - self.helped) > SPOILT


@dataclass(frozen=True)
class Ratio:
    """An rms over another, with the 95 % interval of other such motions."""

    value: float
    low: float
    high: float


def ratio(before: Tracking, after: Tracking) -> Ratio:
    """Platform error, in truth, of one run over that of another with the same motion; from resampled blocks."""
    count = max(1, round(BLOCK / float(before.time[1] - before.time[0])))
    starts = np.arange(0, len(before.time), count)
    squares = np.array([np.add.reduceat(run.astray**2, starts) for run in (before, after)])
    draws = np.random.default_rng(0).integers(0, len(starts), (DRAWS, len(starts)))
    was, now = squares[:, draws].sum(axis=2)
    low, high = np.quantile(np.sqrt(now / was), [0.025, 0.975])
    return Ratio(after.true_rms / before.true_rms, float(low), float(high))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def variants(robot: Robot) -> dict[str, Robot | None]:
    """What the drives are fed in turn, by name; `robot` carries what was identified. None: no estimator.

    The models are stages of one estimator, so a lesser one is a description with the later terms left out. To show what
    the payload is worth, all but the last are blinded to it by a torque noise in which no payload can be told.
    """
    full = robot.identified or Identified()
    none = JointParameter(value=[0.0, 0.0, 0.0])
    empty = Parameter(value=0.0)
    stages = {
        "M_KH": Identified(),
        "M_Id": full.model_copy(
            update={"viscous_friction_nms": none, "coulomb_friction_nm": none, "forearm_inertia_kg": empty}
        ),
        "M_Id+F": full.model_copy(update={"forearm_inertia_kg": empty}),
        "full": full,
    }
    blind = {
        f"{name}, m_p = 0": robot.model_copy(update={"identified": stage.model_copy(update={"torque_noise_nm": BLIND})})
        for name, stage in stages.items()
    }
    return {FEEDBACK: None} | blind | {"full, payload-aware": robot}


def follow(
    robot: Robot,
    make_plant: Callable[[], Plant],
    motion: Trajectory,
    feed: Robot | None,
    *,
    pace: Callable[[int], int] | None = None,
    standing: HealthFlag = HealthFlag(0),
    progress: Callable[[int], object] = lambda cycle: None,
    lose_estimator_at: int | None = None,
) -> LiveRun:
    """One live run of `motion`, an estimator for `feed` running beside it (none: feedback alone).

    pace: waits for a deadline and says how late it is, ns. lose_estimator_at: cycle at which the estimator's process
    is killed.

    Raises:
        BusError: the estimator does not come up, or a role of this robot is taken.
    """
    with open_bus(robot.name, Role.ROBOT) as bus, _estimator(robot, feed, bus) as process:

        def on_cycle(cycle: int) -> None:
            if cycle == lose_estimator_at and process is not None:
                process.kill()
            progress(cycle)

        run = run_live(make_plant(), motion, bus, pace or Pacer(), standing=standing, progress=on_cycle)
        if run.interrupted:  # half a run has no figures
            raise KeyboardInterrupt
        return run


def tracking(robot: Robot, name: str, run: LiveRun) -> Tracking:
    """What `run` comes to, without its first half second."""
    trace = run.trace
    assert trace.position_command is not None
    counted = slice(round(SETTLING / trace.period), None)
    error = (trace.position - trace.position_command)[counted]
    model = pack(robot)
    missed = kinematics.forward(model, trace.position[counted]) - kinematics.forward(
        model, trace.position_command[counted]
    )
    return Tracking(
        name=name,
        time=trace.time[counted],
        error=error,
        joint_rms=np.sqrt(np.mean(error**2, axis=0)),
        missed=np.linalg.norm(missed, axis=1),
        astray=np.linalg.norm(run.astray[counted], axis=1),
        worst=float(np.abs(error).max()),
        helped=float(np.isfinite(run.feedforward[counted]).all(axis=1).mean()),
        held=float(run.held[counted].mean()),
        late=int((run.lateness[counted] > trace.period * NANOSECONDS).sum()),
    )


@contextmanager
def _estimator(robot: Robot, feed: Robot | None, bus: Bus) -> Iterator[Process | None]:
    if feed is None:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="deltatwin-") as folder, Supervisor(Path(folder)) as crew:
        description = Path(folder) / "robot.toml"
        save_robot(feed.model_copy(update={"name": robot.name}), description)
        own = ("--effects", feed.effects_file) if feed.effects_file else ()
        process = crew.start(lambda: Role.ESTIMATOR in bus.alive, "estimate", "--robot", description, *own)
        process.wait_ready()
        yield process
