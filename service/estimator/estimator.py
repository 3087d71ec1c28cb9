"""The estimator as an object: a robot description, a sample period and the state, around one compiled step."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np

from schemas.errors import DataError
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, HealthFlag, stamp_ns
from schemas.robot import Robot
from service.estimator import state
from service.estimator.feedforward import plan_kernel
from service.estimator.friction_health import findings_kernel
from service.estimator.payload.payload_step import payload_kernel
from service.estimator.step import answer_kernel, compile_beside_payload, look_back_kernel, run_kernel
from service.stopping import end_with

# Samples from which the period is read. Stamps of a bus jitter; the median of this many does not.
PERIOD_SAMPLES = 16
SHORTEST_PERIOD = 2e-5  # s, below it there is no drive's cycle
LONGEST_PERIOD = 0.1  # s, above it there is no motion to follow
# This share of the steps in sequence must be a multiple of a stride; of random losses far less are.
STRIDE_SHARE = 0.8


class Result(NamedTuple):
    """Records of `schemas.messages`, oldest first: one `feedforward` a sample,
    `payload` and `error` a fixed lag later."""

    feedforward: np.ndarray
    payload: np.ndarray
    error: np.ndarray


class Rate(NamedTuple):
    """period: s between samples. stride: sequence numbers between them, more than 1 where every n-th was kept."""

    period: float
    stride: int


class Estimator:
    """Consumes samples in the order they come; the same samples give the same bits, one by one or in any batches.

    feedforward, payload, error, friction: (1,) records, what the last `step`, `look_back` and `findings` said,
    overwritten by the next.
    """

    def __init__(self, robot: Robot, period: float, stride: int = 1) -> None:
        """robot: with its identified parameters. period, stride: of its samples, as `rate_of` reads them."""
        self.period, self.stride = period, stride
        self._steps = state.fresh(state.settings(robot, period, stride))
        self._sample = self._steps["sample"].view(np.uint8).data
        self.feedforward, self.payload, self.error, self.friction = (
            self._steps[name] for name in ("feedforward", "payload", "error", "friction")
        )
        self._lagged = False

    def step(self, message: bytes) -> int:
        """Fill `feedforward` for one SAMPLE as it came off the wire. Returns its flags."""
        if self._lagged:
            self.look_back()
        self._sample[:] = message
        flags, self._lagged = answer_kernel(self._steps)
        return flags

    def look_back(self) -> int:
        """Fill `payload` and `error`, which nobody waits for, after a `step`.

        Returns the payload event, or -1 where there is nothing: samples do not reach back to the fixed lag yet, or that
        one closed no cycle. (Left out, the next step does it first.)
        """
        if not self._lagged:
            return -1
        self._lagged = False
        return look_back_kernel(self._steps)

    def run(self, samples: np.ndarray) -> Result:
        """Take (N,) records of SAMPLE."""
        self.look_back()
        count = len(samples)
        samples = samples.view()
        samples.flags.writeable = False  # as what came off a wire is: compiled once for both
        feedforward, payload, error = (message.empty(count) for message in (FEEDFORWARD, PAYLOAD, MODEL_ERROR))
        lagged = run_kernel(self._steps, samples, feedforward, payload, error)
        return Result(feedforward, payload[:lagged], error[:lagged])

    def plan(self, reference: np.void) -> None:
        """Take one REFERENCE record: while it lies ahead, the feed-forward torque is for its motion.

        One that no joint could follow is not taken, and the next feed-forward says so in its flags.
        """
        self._steps["reference"] = reference
        plan_kernel(self._steps)

    @property
    def state(self) -> np.void:
        """The STATE record: everything that is remembered from sample to sample."""
        return self._steps["state"][0]

    def findings(self) -> HealthFlag:
        """Fill `friction` with what is known of it now. Returns what there is to say of it in health."""
        return HealthFlag(findings_kernel(self._steps))

    def warm_up(self) -> None:
        """Compile `plan` and `step`, without touching the state, so that the first live sample is not seconds late."""
        with _payload_beside() as wait:
            self._compile(wait)

    def _compile(self, wait: Callable[[], object]) -> None:
        """wait: for what another process compiles meanwhile."""
        fresh = state.fresh(self._steps["settings"])
        plan_kernel(fresh)
        answer_kernel(fresh)
        findings_kernel(fresh)
        compile_beside_payload(fresh[0])
        wait()
        look_back_kernel(fresh)


def compile_all(robot: Robot) -> None:
    """What `warm_up` does, for a process that has no estimator yet: one is built while the other process starts."""
    with _payload_beside() as wait:
        Estimator(robot, 1e-3)._compile(wait)


@contextlib.contextmanager
def _payload_beside() -> Iterator[Callable[[], object]]:
    """Where nothing is compiled yet, a second process takes the payload, a third of it that shares next to nothing with
    the rest: Numba compiles one function at a time, and this process finds what the other one left in the cache. Gives
    what waits for it; if it failed, this process compiles all."""
    if _is_compiled():
        yield lambda: None
        return
    ends = f"from {end_with.__module__} import end_with; end_with({os.getpid()})"
    with subprocess.Popen(
        [sys.executable, "-c", f"{ends}; from {__name__} import compile_payload; compile_payload()"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as beside:  # fmt: skip
        try:
            yield beside.wait
        finally:
            beside.kill()
            beside.wait()  # `Popen` itself leaves after a quarter of a second of an interrupt


def compile_payload() -> None:
    """Compile the payload's part of `look_back` and leave it in the cache."""
    step = np.zeros(1, state.STEP)[0]
    payload_kernel.inside.compile(tuple(numba.typeof(step[part]["payload"]) for part in ("settings", "state")))


def _is_compiled() -> bool:
    folder = look_back_kernel.stats.cache_path
    return folder is None or any(Path(folder).glob("step.look_back_kernel-*.nbi"))


def rate_of(samples: np.ndarray) -> Rate:
    """Sample period, to the microsecond, and stride from the stamps and sequence numbers of the first samples.

    Raises:
        DataError: the stamps do not rise, or faster than any drive, or slower than any controller.
    """
    first = samples[:PERIOD_SAMPLES]
    steps = np.diff(first["sequence"]).astype(np.int64)  # modulo 2^64
    rising = steps > 0
    if not rising.any():
        raise DataError(f"no sample period: the sequence numbers of the first {len(first)} samples do not rise")
    steps = steps[rising]
    stride = max([1, *(int(step) for step in set(steps) if np.mean(steps % step == 0) >= STRIDE_SHARE)])
    period = round(float(np.median(np.diff(stamp_ns(first))[rising] / steps) * stride) * 1e-3) * 1e-6
    if period <= 0:
        raise DataError(f"no sample period: the stamps of the first {len(first)} samples do not rise")
    if period < SHORTEST_PERIOD:
        raise DataError(
            f"sample period {period * 1e6:g} us: too short, no drive is faster than {SHORTEST_PERIOD * 1e6:g} us"
        )
    if period > LONGEST_PERIOD:
        raise DataError(f"sample period {period:g} s: too long, no controller is slower than {LONGEST_PERIOD:g} s")
    return Rate(period, stride)
