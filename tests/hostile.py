"""Streams that no bus should send: random bytes, and good samples with hostile values strewn in."""

from __future__ import annotations

import numpy as np

from schemas.messages import REFERENCE, Message

REAL = np.array(
    [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, 1e5, -200.0, 90.0, 2.1, -1.5, 0.4],
)
_SEQUENCES = np.array([0, 1, 39, 2**31, 2**62, 2**63 - 1, 2**63, 2**64 - 1], np.uint64)
_SECONDS = np.array([-(2**31), -1, 0, 3600, 2**31 - 1], np.int32)
_NANOSECONDS = np.array([0, 10**9, 2**32 - 1], np.uint32)


def hostile(random: np.random.Generator, good: np.ndarray, count: int) -> np.ndarray:
    """`count` records like `good`: noise, or `good` from some row on with values, order and stamps put out of joint."""
    if random.random() < 0.15:
        return np.frombuffer(random.bytes(good.dtype.itemsize * count), good.dtype).copy()
    samples = np.resize(good[random.integers(len(good)) :], count).copy()
    for field in ("position", "torque", "position_command"):
        share = random.choice([0.0, 0.01, 0.1, 0.5])
        struck = random.random(samples[field].shape) < share
        samples[field] = np.where(struck, random.choice(REAL, samples[field].shape), samples[field])
    for field, values in (("sequence", _SEQUENCES), ("stamp_sec", _SECONDS), ("stamp_nanosec", _NANOSECONDS)):
        struck = random.random(count) < random.choice([0.0, 0.01, 0.2])
        samples[field][struck] = random.choice(values, struck.sum())
    if random.random() < 0.3:
        samples = samples[random.permutation(count)]
    if random.random() < 0.3:
        samples = np.repeat(samples, random.integers(1, 4, count))[:count]
    if random.random() < 0.2:
        samples["position_command"] += random.uniform(-0.5, 0.5)
    samples["flags"][random.random(count) < 0.02] = random.integers(2**32, dtype=np.uint32)
    return samples


def reference(random: np.random.Generator, sequence: int, message: Message = REFERENCE) -> np.void:
    """A plan for about `sequence`, hostile in one way or another."""
    record = np.frombuffer(random.bytes(message.dtype.itemsize), message.dtype).copy()[0]
    if random.random() < 0.7:
        record["sequence"] = (sequence + int(random.integers(0, 10))) % 2**64
        for field, scale in (("position", 1.0), ("velocity", 30.0), ("acceleration", 4000.0)):
            record[field] = random.uniform(-scale, scale, record[field].shape)
            if random.random() < 0.3:
                record[field][random.integers(len(record[field]))] = random.choice(REAL)
    return record


def not_finite(record: np.void, name: str = "") -> list[str]:
    """Names of the fields of a structured record, nested ones too, that hold a number that is none."""
    found = []
    for field in record.dtype.names or ():
        value, dtype = record[field], record.dtype[field].base
        if dtype.names:
            for part in np.atleast_1d(value):
                found += not_finite(part, f"{name}{field}.")
        elif dtype.kind == "f" and not np.isfinite(value).all():
            found.append(name + field)
    return found
