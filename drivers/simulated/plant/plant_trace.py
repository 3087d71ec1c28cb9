"""A plant taken through a motion, as a trace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from drivers.motion import Trajectory
from drivers.simulated.plant.plant import Measured, Plant, Target
from schemas.trace import Trace


class Course:
    """A motion as a plant is taken through it, with what is on the platform in every cycle."""

    def __init__(self, motion: Trajectory):
        self.motion = motion
        self.mass = np.zeros(len(motion))
        for payload in motion.payloads:
            self.mass[round(payload.pick / motion.period) : round(payload.release / motion.period)] = payload.mass

    def latch(
        self,
        plant: Plant,
        cycle: int,
        feedforward: np.ndarray | None,
        ahead: np.ndarray | float = 0.0,
        further: np.ndarray | float = 0.0,
    ) -> Measured:
        """As `Plant.latch`. ahead: (3,) rad, of the motors before the motion; further: (3,) rad, of that in a cycle."""
        if self.mass[cycle] != plant.payload:
            plant.set_payload(float(self.mass[cycle]))
        position, velocity = self.motion.position, self.motion.velocity
        pace = further / plant.period
        now = Target(position[cycle] + ahead, velocity[cycle] + pace)
        then = Target(position[cycle + 1] + ahead + further, velocity[cycle + 1] + pace)
        return plant.latch(now, then, feedforward)


def simulate(
    plant: Plant,
    motion: Trajectory,
    name: str = "simulated",
    feedforward: np.ndarray | None = None,
    progress: Callable[[int], None] = lambda cycle: None,
    changes: Mapping[int, Plant] = MappingProxyType({}),
) -> Trace:
    """Take `plant` from rest at the start of `motion` to its end; the trace begins at the plant's time.

    feedforward: (N, 3) N m that the drives add. progress: called with the number of every cycle. changes: cycle -> the
    plant that goes on from there.

    Raises:
        DataError: the motion tears the mechanism apart.
    """
    count = len(motion)
    course = Course(motion)
    plant.set_payload(0.0)
    plant.reset(motion.position[0])
    started = plant.time
    position, torque, command = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    for k in range(count):
        if k in changes:
            changes[k].adopt(plant)
            plant = changes[k]
        fed = None if feedforward is None else feedforward[k]
        position[k], torque[k], command[k] = course.latch(plant, k, fed)
        plant.run()
        progress(k)
    plant.set_payload(0.0)
    return Trace(
        path=Path(name),
        time=started + np.arange(count) * plant.period,
        position=position,
        torque=torque,
        position_command=motion.position[:count],
        torque_command=command,
        flags=np.zeros(count, np.uint32),
    )
