"""Whether drives do what they are told is read off logs."""

from dataclasses import replace

import numpy as np
import pytest

from service.identification.torque_source import command_ahead, is_commanded
from service.model.effects.base import Readout
from service.model.signals import lagging
from tests.known import PERIOD, make, robot, trace_of

__all__ = ["make", "robot"]

NOISE = 0.5


def shifted(torque: np.ndarray, samples: float) -> np.ndarray:
    """The torque this much later, in samples."""
    at = np.arange(len(torque), dtype=float)
    return np.stack([np.interp(at - samples, at, joint) for joint in torque.T], axis=1)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda torque, noise: (torque + noise, torque), True),
        (lambda torque, noise: (torque + noise, torque + 0.02 * NOISE), True),
        (lambda torque, noise: (torque + noise, None), False),
        (lambda torque, noise: (torque, torque), False),
        (lambda torque, noise: (torque + noise, shifted(torque, 0.5)), False),
        (lambda torque, noise: (torque + noise, torque * [1.0, 1.0, 1.05]), False),
        (lambda torque, noise: (torque + noise, 0.0 * torque), False),
        (lambda torque, noise: (torque + np.cumsum(noise, axis=0) / 20, torque), False),
        (lambda torque, noise: ((torque + noise)[:500], torque[:500]), False),
        (lambda torque, noise: (torque + noise, np.where(np.arange(4000)[:, None] == 7, np.nan, torque)), False),
    ],
    ids=[
        "white noise", "a little off", "no command", "to the last digit", "half a sample late", "one joint's scale",
        "nothing commanded", "noise with a memory", "half a second", "a hole",
    ],
)  # fmt: skip
def test_a_torque_is_the_commanded_one_where_nothing_but_white_noise_is_between(make, change, expected):
    known = make(4.0)
    torque, command = change(known.torque, NOISE * np.random.default_rng(3).standard_normal(known.torque.shape))
    whole = trace_of(known)
    count = len(torque)
    trace = replace(
        whole, time=whole.time[:count], position=whole.position[:count], torque=torque, torque_command=command,
        flags=whole.flags[:count],
    )  # fmt: skip
    assert is_commanded(trace) is expected


TELLS = [
    (lambda torque: shifted(torque, 2.6), Readout(late=0.0022), 0.0026),
    (lambda torque: shifted(torque, -0.3), Readout(), -0.0003),
    (lambda torque: lagging(torque, 40.0, PERIOD), Readout(late=0.0003, lag=1 / (80 * np.pi)), 0.0),
    (lambda torque: lagging(torque, 40.0, PERIOD), Readout(lag=1 / (100 * np.pi)), None),
    (lambda torque: shifted(torque, 2.6), Readout(), None),
    (lambda torque: shifted(torque, 2.6), Readout(late=0.0026, follows=0.008), None),
    (lambda torque: shifted(torque * [1.0, 1.0, 1.05], 2.6), Readout(late=0.0026), None),
]


@pytest.mark.parametrize(("reported", "readout", "expected"), TELLS, ids=[
    "late", "early", "filtered", "another filter", "far later", "a drive that follows", "one joint's scale",
])  # fmt: skip
def test_how_far_a_command_is_ahead_of_what_is_reported_of_it(make, reported, readout, expected):
    known = make(4.0)
    noise = NOISE / 2 * np.random.default_rng(3).standard_normal((2, *known.torque.shape))
    logs = [replace(trace_of(known), torque=reported(known.torque) + one, torque_command=known.torque) for one in noise]
    found = command_ahead(logs, readout)
    assert found == (None if expected is None else pytest.approx(expected, abs=3e-5))
    assert command_ahead([logs[0], trace_of(known)], readout) is None


@pytest.mark.parametrize(("rows", "expected"), [(1000, True), (999, False)])
def test_it_takes_fifty_blocks_of_twenty_to_tell(make, rows, expected):
    known = make(4.0)
    torque = known.torque + NOISE * np.random.default_rng(3).standard_normal(known.torque.shape)
    trace = replace(trace_of(known), torque=torque, torque_command=known.torque)
    part = {name: getattr(trace, name)[:rows] for name in ("time", "position", "torque", "torque_command", "flags")}
    assert is_commanded(replace(trace, **part)) is expected


@pytest.mark.parametrize(("slow", "expected"), [(0.08, True), (0.2, False)])
def test_a_slow_part_shows_from_five_deviations_of_what_blocks_scatter_by(make, slow, expected):
    """Two hundred blocks of twenty scatter by a tenth: 1.5 times the noise; a part of so much of it makes 1.13, 1.8."""
    known = make(4.0)
    whole = trace_of(known)
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal((4000, 3))
        noise += slow * np.where(np.arange(4000) // 200 % 2, 1.0, -1.0)[:, None]
        found = is_commanded(replace(whole, torque=known.torque + NOISE * noise, torque_command=known.torque))
        assert found is expected


def test_white_noise_is_white_whatever_the_draw(make):
    """Sixty blocks, whose squares scatter by a fifth; with a slow part of half as much, it is not."""
    known, rows = make(4.0), slice(1400, 2600)
    whole = trace_of(known)
    whole = replace(whole, time=whole.time[rows], position=whole.position[rows], flags=whole.flags[rows])
    torque = known.torque[rows]
    for seed in range(12):
        noise = NOISE * np.random.default_rng(seed).standard_normal((1200, 3))
        slow = 0.5 * NOISE * np.random.default_rng([seed, 1]).standard_normal((24, 3)).repeat(50, axis=0)
        assert is_commanded(replace(whole, torque=torque + noise, torque_command=torque))
        assert not is_commanded(replace(whole, torque=torque + noise + slow, torque_command=torque))
