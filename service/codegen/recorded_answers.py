"""What a controller answered, as it was recorded, against what its twin should have.

The service's own step runs along the recorded samples from the description beside the code, to the bits of the code
where the controller's compiler and mathematics library keep to IEEE 754.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from schemas.errors import DataError
from schemas.messages import MODEL_ERROR, PAYLOAD
from schemas.robot import Robot
from service.codegen.folder import Manifest
from service.estimator.estimator import Estimator
from service.monitor.readback import Recorded

# Another library's sine differs in the last bit, some 1e-16 of it; what a step makes of that is far below this.
SAME = 1e-9  # of a field's own unit
# What is compared of each topic, with the unit of it.
COMPARED = {
    "feedforward": {"torque": "N m", "source": "", "flags": "", "target_sequence": ""},
    "payload": {"mass": "kg", "std_dev": "kg", "trusted": "", "event": ""},
    "error": {"kh": "N m", "id": "N m", "id_friction": "N m", "full": "N m", "flags": ""},
}


class Difference(NamedTuple):
    """The first of a field's values that is another. joint: from 1, 0 where the field is of the whole robot."""

    sequence: int
    stamp_s: float
    field: str
    joint: int
    answered: float
    expected: float
    unit: str


class Compared(NamedTuple):
    """Of one topic. answers: recorded ones. missing: expected and not recorded. alike: answers that are the same bit
    for bit. largest: field -> difference in its unit. first: None where all are the same within `SAME`. last_row: of
    the last answer that differs, -1: none."""

    answers: int
    missing: int
    alike: int
    largest: dict[str, float]
    first: Difference | None
    last_row: int


def verify(robot: Robot, manifest: Manifest, recorded: Mapping[str, Recorded]) -> dict[str, Compared]:
    """recorded: topic -> records, as `read_recording`; that of `feedforward` at least.

    Raises:
        DataError: no samples or no answers are in it.
    """
    for topic in ("sample", "feedforward"):
        if not len(recorded[topic].records):
            raise DataError(
                f"no {topic} messages: record both the samples that the controller received and its answers"
            )
    expected = _expected(Estimator(robot, manifest.period_s), recorded["sample"], recorded["reference"])
    return {
        topic: _compare(recorded[topic].records, expected[topic], fields)
        for topic, fields in COMPARED.items()
        if len(recorded[topic].records)
    }


def _expected(estimator: Estimator, samples: Recorded, references: Recorded) -> dict[str, np.ndarray]:
    """What the twin answers, with each planned motion before the first sample that came after it."""
    places = np.searchsorted(samples.arrival, references.arrival, side="left")
    found: dict[str, list[np.ndarray]] = {topic: [] for topic in COMPARED}
    begin = 0
    for place, reference in [*zip(places, references.records, strict=True), (len(samples.records), None)]:
        result = estimator.run(samples.records[begin:place])
        for topic in COMPARED:
            found[topic].append(getattr(result, topic))
        if reference is not None:
            estimator.plan(reference)
        begin = max(begin, int(place))
    empty = {"payload": PAYLOAD.empty(0), "error": MODEL_ERROR.empty(0)}
    return {topic: np.concatenate([empty.get(topic, parts[0][:0]), *parts]) for topic, parts in found.items()}


def _compare(answered: np.ndarray, expected: np.ndarray, fields: Mapping[str, str]) -> Compared:
    """Answers to the same sample; of samples that came twice the first."""
    numbers, mine, other = np.intersect1d(answered["sequence"], expected["sequence"], return_indices=True)
    order = np.argsort(other)
    one, two = answered[mine[order]], expected[other[order]]
    alike, wrong, largest = np.ones(len(one), bool), np.zeros(len(one), bool), {}
    first: tuple[int, str] | None = None
    for name, unit in fields.items():
        same, off = _differences(one[name], two[name])
        alike &= same
        far = off > (SAME if unit else 0.0)
        wrong |= far
        if unit:
            largest[name] = float(off.max(initial=0.0))
        rows = np.flatnonzero(far)
        if len(rows) and (first is None or rows[0] < first[0]):
            first = int(rows[0]), name
    told = None if first is None else _told(one[first[0]], two[first[0]], first[1], fields[first[1]])
    last = int(np.flatnonzero(wrong)[-1]) if wrong.any() else -1
    missing = len(np.unique(expected["sequence"])) - len(numbers)
    return Compared(len(one), missing, int(alike.sum()), largest, told, last)


def _differences(one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether rows are the same, and by how much they are not, (N,) each; no number is like any other."""
    a, b = (np.asarray(values).reshape(len(values), -1) for values in (one, two))
    same = (a == b) | ((a != a) & (b != b))
    off = np.where(same, 0.0, np.abs(a.astype(float) - b.astype(float)))
    off = np.where(np.isnan(off), np.inf, np.where(~same & (off == 0.0), 1.0, off))
    return same.all(axis=1), off.max(axis=1)


def _told(one: Any, two: Any, name: str, unit: str) -> Difference:
    a, b = np.atleast_1d(one[name]), np.atleast_1d(two[name])
    joint = int(np.argmax(_differences(a, b)[1]))
    stamp = int(one["stamp_sec"]) + int(one["stamp_nanosec"]) * 1e-9
    values = (float(a[joint]), float(b[joint]))
    return Difference(int(one["sequence"]), stamp, name, joint + 1 if len(a) > 1 else 0, *values, unit)
