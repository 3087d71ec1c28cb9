"""Logs in which everything happens that a controller's day has."""

from __future__ import annotations

import numpy as np

from schemas.messages import Gripper, SampleFlag, set_stamp, stamp_ns


def disturbed(samples: np.ndarray, seed: int = 1) -> np.ndarray:
    """`samples` ((N,) records of SAMPLE, N >= 1000) with lost, repeated and late ones, what is no number, jumps, stray
    commands, a torque sensor that breaks, bus faults, a gripper that is heard, and a source that starts over."""
    random = np.random.default_rng(seed)
    made, count = samples.copy(), len(samples)
    made["torque_command"] = made["torque"] + random.normal(0.0, 0.2, made["torque"].shape)
    made["torque_command"][: count // 8] = np.nan

    def at(share: float, length: int = 1) -> slice:
        return slice(int(share * count), int(share * count) + length)

    made["position"][at(0.20, 3)] = np.nan
    made["torque"][at(0.25, 2), 1] = np.inf
    made["position"][at(0.30)] += 0.4
    made["position_command"][at(0.33)] += 0.5
    made["position_command"][at(0.36, 40)] = np.nan
    made["position_command"][at(0.40, 5), 2] = 9.0
    made["flags"][at(0.43, 4)] = SampleFlag.BUS_FAULT
    made["torque"][at(0.46), 0] = 1e7
    made["gripper"][at(0.50, 150)] = Gripper.OPEN
    made["gripper"][at(0.50, 150).stop : at(0.70).start] = Gripper.CLOSED
    made["sequence"][at(0.75).start :] -= np.uint64(at(0.75).start - 5)  # the source starts over
    stamps = stamp_ns(made)
    stamps[at(0.80).start :] += 3_000_000  # a hole that the sequence does not show
    set_stamp(made, stamps)
    keep = np.ones(count, bool)
    keep[random.choice(count, count // 60, replace=False)] = False
    keep[at(0.60, 12)] = keep[at(0.85, 45)] = keep[at(0.90, 120)] = False  # to coast over, to restart after
    order = np.flatnonzero(keep)
    order = np.insert(order, len(order) // 3, order[len(order) // 3])  # repeated
    order[[700, 701]] = order[[701, 700]]  # late
    return made[order]
