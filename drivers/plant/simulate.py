"""A plant taken through a motion, as a trace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from drivers.motion import Trajectory
from drivers.plant.plant import Plant, Target
from schemas.trace import Trace


class Carrier:
    """Says what is on the platform in every cycle of a motion."""

    def __init__(self, motion: Trajectory):
        self.mass = np.zeros(len(motion))
        for payload in motion.payloads:
            self.mass[round(payload.pick / motion.period) : round(payload.release / motion.period)] = payload.mass

    def apply(self, plant: Plant, cycle: int) -> None:
        if self.mass[cycle] != plant.payload:
            plant.set_payload(float(self.mass[cycle]))


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
    carrier = Carrier(motion)
    plant.set_payload(0.0)
    plant.reset(motion.position[0])
    started = plant.time
    position, torque, command = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    nothing = np.zeros(3)
    for k in range(count):
        if k in changes:
            changes[k].adopt(plant)
            plant = changes[k]
        carrier.apply(plant, k)
        measured = plant.latch(
            Target(motion.position[k], motion.velocity[k]),
            Target(motion.position[k + 1], motion.velocity[k + 1]),
            nothing if feedforward is None else feedforward[k],
        )
        position[k], torque[k], command[k] = measured
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
