"""Families of blind cases: each is a way to draw one. And what is wrong with a description or a recorder besides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from drivers.simulated.plant.effects import CATALOGUE, OUT_OF_CATALOGUE
from schemas.robot import Robot
from schemas.trace import Trace

KNOWN = list(CATALOGUE)
STRANGE = list(OUT_OF_CATALOGUE)
SEVERITY = (0.5, 2.0)
# Of the cases of the first family; the rest has one catalogue effect.
SHARES = {"null": 0.12, "pair": 0.12, "unknown": 0.18}

# What a scope makes of a signal.
EVERY = 2  # samples of the bus of which it keeps one
RATED_NM = (40.0, 80.0)  # joint side; torque comes in thousandths of it
ENCODER_COUNTS = 2.0**17  # a motor turn
JITTER_S = (20e-6, 100e-6)  # rms of its stamps
NOISE_MEMORY_S = 3e-3
CURRENT_HZ = (150.0, 300.0)  # the low-pass that its torque, a current, went through


@dataclass(frozen=True)
class Draw:
    """What a case is made of. wrong: the quantity of the description that is off, one of `WRONG`. picks: production
    pick-and-place motion alone. scope: recorded by a scope."""

    kind: str
    effects: tuple[str, ...] = ()
    severity: float = 1.0
    wrong: str = ""
    picks: bool = False
    scope: bool = False


@dataclass(frozen=True)
class WrongQuantity:
    """A quantity of a description that is off. change: the description from the true one; names: effects that say so,
    beside none at all."""

    change: Callable[[Robot, np.random.Generator], Robot]
    names: frozenset[str]


def _all_arms(key: str, low: float, high: float) -> Callable[[Robot, np.random.Generator], Robot]:
    def change(robot: Robot, rng: np.random.Generator) -> Robot:
        length = getattr(robot.geometry, key) + rng.choice((-1.0, 1.0)) * rng.uniform(low, high)
        return robot.model_copy(update={"geometry": robot.geometry.model_copy(update={key: float(length)})})

    return change


def _one_arm(key: str, low: float, high: float) -> Callable[[Robot, np.random.Generator], Robot]:
    def change(robot: Robot, rng: np.random.Generator) -> Robot:
        values = list(getattr(robot.geometry, key))
        values[rng.integers(3)] += float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))
        return robot.model_copy(update={"geometry": robot.geometry.model_copy(update={key: values})})

    return change


def _mass(key: str) -> Callable[[Robot, np.random.Generator], Robot]:
    def change(robot: Robot, rng: np.random.Generator) -> Robot:
        mass = getattr(robot.mass, key) * (1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(0.1, 0.25))
        return robot.model_copy(update={"mass": robot.mass.model_copy(update={key: float(mass)})})

    return change


# Lengths off by 3 to 6 mm, azimuths by half a degree to one, masses by 10 to 25 %.
WRONG: dict[str, WrongQuantity] = {
    "active_link_length": WrongQuantity(_all_arms("active_link_length", 3e-3, 6e-3), frozenset({"link_length_error"})),
    "passive_link_length": WrongQuantity(
        _all_arms("passive_link_length", 3e-3, 6e-3), frozenset({"forearm_length_error"})
    ),
    "base_radius": WrongQuantity(_all_arms("base_radius", 3e-3, 6e-3), frozenset({"base_radius_error"})),
    "platform_radius": WrongQuantity(_all_arms("platform_radius", 3e-3, 6e-3), frozenset({"base_radius_error"})),
    "active_link_length of an arm": WrongQuantity(
        _one_arm("active_link_length_error", 3e-3, 6e-3), frozenset({"link_length_error"})
    ),
    "passive_link_length of an arm": WrongQuantity(
        _one_arm("passive_link_length_error", 3e-3, 6e-3), frozenset({"forearm_length_error"})
    ),
    "base_radius of an arm": WrongQuantity(_one_arm("base_radius_error", 3e-3, 6e-3), frozenset({"base_radius_error"})),
    "azimuth of an arm": WrongQuantity(_one_arm("arm_angles_deg", 0.5, 1.0), frozenset({"azimuth_error"})),
    "active_link mass": WrongQuantity(_mass("active_link"), frozenset({"arm_mass"})),
    "passive_link mass": WrongQuantity(_mass("passive_link"), frozenset({"tool_mass"})),
    "platform mass": WrongQuantity(_mass("platform"), frozenset({"tool_mass"})),
}


def known(rng: np.random.Generator, cases: int) -> list[Draw]:
    """Single effects, each as often as any other, gap-free logs, pairs, and what is not in the catalogue."""
    counts = {kind: round(share * cases) for kind, share in SHARES.items()}
    drawn = [Draw("null")] * counts["null"]
    drawn += [Draw("pair", _some(rng, 2)) for _ in range(counts["pair"])]
    drawn += [Draw("unknown", (STRANGE[i % len(STRANGE)],), _severity(rng)) for i in range(counts["unknown"])]
    first = rng.permutation(len(KNOWN))
    drawn += [Draw("catalogue", (KNOWN[first[i % len(KNOWN)]],), _severity(rng)) for i in range(cases - len(drawn))]
    return [drawn[i] for i in rng.permutation(len(drawn))]


def three(rng: np.random.Generator, cases: int) -> list[Draw]:
    """Three effects of the catalogue at once."""
    return [Draw("three", _some(rng, 3)) for _ in range(cases)]


def outside(rng: np.random.Generator, cases: int) -> list[Draw]:
    """Two effects of the catalogue beside one that is not in it."""
    return [Draw("outside", (*_some(rng, 2), str(rng.choice(STRANGE)))) for _ in range(cases)]


def description(rng: np.random.Generator, cases: int) -> list[Draw]:
    """No effect; the description is wrong in one quantity, each as often as any other."""
    order = rng.permutation(len(WRONG))
    return [Draw("description", wrong=list(WRONG)[order[i % len(WRONG)]]) for i in range(cases)]


def production(rng: np.random.Generator, cases: int) -> list[Draw]:
    """One effect, pick-and-place logs alone."""
    return [replace(draw, kind="production", picks=True) for draw in _single(rng, cases)]


def scope(rng: np.random.Generator, cases: int) -> list[Draw]:
    """One effect, recorded by a scope."""
    return [replace(draw, kind="scope", scope=True) for draw in _single(rng, cases)]


FAMILIES: dict[str, Callable[[np.random.Generator, int], list[Draw]]] = {
    "known": known,
    "three": three,
    "outside": outside,
    "description": description,
    "production": production,
    "scope": scope,
}


def plan(cases: int, seed: int, families: Sequence[str]) -> list[Draw]:
    """What each case is made of: the families have as many each, the first of them what is over."""
    each, over = divmod(cases, len(families))
    return [
        draw
        for place, name in enumerate(families)
        for draw in FAMILIES[name](
            np.random.default_rng([seed, 17, list(FAMILIES).index(name)]), each + over * (not place)
        )
    ]


def _some(rng: np.random.Generator, count: int) -> tuple[str, ...]:
    return tuple(str(name) for name in rng.choice(KNOWN, count, replace=False))


def _single(rng: np.random.Generator, cases: int) -> list[Draw]:
    order = rng.permutation(len(KNOWN))
    return [Draw("", (KNOWN[order[i % len(KNOWN)]],), _severity(rng)) for i in range(cases)]


def _severity(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(SEVERITY))))


def as_recorded(traces: Sequence[Trace], noise_nm: float, rng: np.random.Generator) -> list[Trace]:
    """Traces without torque noise as a scope leaves them: a filtered current in thousandths of a rated torque, noise
    that remembers, every other sample, stamps that jitter."""
    period = traces[0].period
    step, jitter, hertz = rng.uniform(*RATED_NM) / 1000, rng.uniform(*JITTER_S), rng.uniform(*CURRENT_HZ)
    samples, remember = 1.0 / (np.pi * hertz * period), np.exp(-period / NOISE_MEMORY_S)
    recorded = []
    for trace in traces:
        first = trace.torque[0]
        current = first + lfilter([1.0, 1.0], [1.0 + samples, 1.0 - samples], trace.torque - first, axis=0)
        white = rng.standard_normal(trace.torque.shape) * noise_nm * (1.0 - remember**2) ** 0.5
        white[0] /= (1.0 - remember**2) ** 0.5
        torque = np.round((current + lfilter([1.0], [1.0, -remember], white, axis=0)) / step) * step
        time = trace.time + jitter * rng.standard_normal(len(trace.time)).clip(-3, 3)
        assert trace.position_command is not None
        recorded.append(
            replace(
                trace,
                time=time[::EVERY],
                position=trace.position[::EVERY],
                torque=torque[::EVERY],
                position_command=trace.position_command[::EVERY],
                torque_command=None,
                flags=trace.flags[::EVERY],
            )
        )
    return recorded


def coloured_share(band_hz: float) -> float:
    """Of the power of the scope's noise, what lies below `band_hz`."""
    return float(np.arctan(2 * np.pi * band_hz * NOISE_MEMORY_S) / (np.pi / 2))
