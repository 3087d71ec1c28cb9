"""The load of a running arm: blocks of motion gathered sample by sample, fitted as a log's (`machines.load`).

Torque and columns are averaged alike over `BIN` s, which takes noise of the acceleration off both. Each `BLOCK` s of
motion the newest `MOST_BLOCKS` blocks are fitted anew, a part of that work a sample. A block that asks for another
load makes the known one doubtful, until two in a row ask for the same other one, or one for the old one again: then it
was a collision.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from schemas.messages import Gripper, PayloadEvent
from service.estimator.payload.verdict import is_sure
from service.machines.load_fit import BLOCK, SCARCE, WIDEST, Blocks, Body, body_from, information_of
from service.machines.machine import MachineModel
from service.model.description import base_of
from service.model.mechanism import SerialArm

BIN = 0.01  # s
MOST_BLOCKS = 40  # 20 s of motion: a load that nobody saw change is forgotten by then
# Of its full speed: a joint that is slower may stick, and its friction is anything.
MOVES = 0.01
# Standard errors of a change of mass from which the load is another, after a look each half second for weeks.
CHANGED = 6.0
SMALLEST_CHANGE = 0.05  # kg
# One standard deviation of a body's lever over that of water of its mass, as far as the feed-forward believes in it
# without data; of its inertia over mass times that squared.
LEVER, INERTIA = 3.0, 1.0
_GATHERED = 10  # parameters of a load


@dataclass(frozen=True)
class Found:
    """What is known of the load. random: standard errors (10,) of its mass, centre and inertia, of what differs from
    load to load. feed: (10,) of a body about the frame, for the feed-forward. motion: s that it is from."""

    body: Body
    random: np.ndarray
    trusted: bool
    feed: np.ndarray
    motion: float


@dataclass
class _Doubted:
    """What was known, and by how many kg the newest block since then asks for more, with the standard error."""

    found: Found
    grams: list[np.ndarray]
    moments: list[np.ndarray]
    change: float
    error: float


class LoadMemory:
    """Call `add` for every look back; `found` is the newest result, None: not yet."""

    def __init__(self, machine: MachineModel, tree: SerialArm, period: float, unit: np.ndarray) -> None:
        """tree: the mechanism of `machine`. unit: (n,) rad/s, speeds by which `MOVES` is meant."""
        self.frame, self._onto = machine.load(None)
        self._regressor, self._rows = tree.regressor(), tree.rows
        base = base_of(machine.description)
        self._rigid, self._known = base.rigid, tree.known
        self._prior = np.r_[1.0 / WIDEST**2, information_of(machine.description, base)]
        self._slowest = MOVES * unit
        self._per_bin = max(1, round(BIN / period))
        self._per_block = max(2, round(BLOCK / (self._per_bin * period)))
        size, joints = len(self._prior) + 1, tree.joints
        self._bin, self._moving = np.zeros((joints, size)), np.ones(joints, bool)
        self._filled = 0
        self._rows_of_block = np.empty((self._per_block, joints, size))
        self._moves = np.zeros((self._per_block, joints), bool)
        self._bins = 0
        self._sigma: np.ndarray | None = None
        self._work: Iterator[None] | None = None
        self._covariance: np.ndarray | None = None  # of the last fit
        self._values, self._memory = np.zeros(len(self._prior)), 1.0
        self._gripper = int(Gripper.UNKNOWN)
        self._event = PayloadEvent.NONE
        self._doubted: _Doubted | None = None
        self.forget()

    def forget(self) -> None:
        """Nothing is known of what hangs there."""
        self.found: Found | None = None
        self._first: list[tuple[np.ndarray, np.ndarray]] = []  # blocks before it is known how joints weigh
        self._grams: list[np.ndarray] = []
        self._moments: list[np.ndarray] = []
        self._filled = self._bins = 0
        self._work = self._doubted = None

    def event(self) -> PayloadEvent:
        """What happened since the last call."""
        event, self._event = self._event, PayloadEvent.NONE
        return event

    def grip(self, gripper: int) -> None:
        """The gripper's state of now: where it changes, the load does."""
        if gripper != self._gripper:
            if Gripper.UNKNOWN not in (gripper, self._gripper):
                self._event = PayloadEvent.PICK if gripper == Gripper.CLOSED else PayloadEvent.RELEASE
                self.forget()
            self._gripper = gripper

    def residual(self, motion: np.ndarray, reported: np.ndarray, rubbed: np.ndarray, dry: np.ndarray) -> np.ndarray:
        """(n, P + 1): columns of load and base parameters at a motion (3, n), and what is left of the torque."""
        columns, every = self._regressor(motion)
        left = reported - columns @ self._rigid - every @ self._known - rubbed
        sliding = self._rows @ motion[1]
        rows = self._rows.T
        return np.hstack([every @ self._onto, columns, rows * sliding, rows * dry, left[:, None]])

    def add(self, row: np.ndarray, speed: np.ndarray, votes: bool) -> None:
        """A sample: `residual` (n, P + 1), speed (n,) of the joints. Does a part of the work that is due."""
        if self._work is not None and next(self._work, True):
            self._work = None
        if not votes:
            self._filled = 0
            return
        if self._filled == 0:
            self._bin[:], self._moving[:] = 0.0, True
        self._bin += row
        self._moving &= np.abs(speed) > self._slowest
        self._filled += 1
        if self._filled < self._per_bin:
            return
        self._filled = 0
        if not self._moving.any():
            return
        self._rows_of_block[self._bins] = self._bin / self._per_bin
        self._moves[self._bins] = self._moving
        self._bins += 1
        if self._bins == self._per_block:
            self._bins = 0
            self._finish()
            self._work = self._take(self._rows_of_block.copy(), self._moves.copy())

    def _finish(self) -> None:
        """Do all the work that is due."""
        if self._work is not None:
            for _ in self._work:
                pass
            self._work = None

    def _equations(self, rows: np.ndarray, moves: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) and (P,): normal equations of a block, joints weighing by 1 over `sigma` (n,)."""
        weighed = (rows / sigma[:, None])[moves]
        columns, left = weighed[:, :-1], weighed[:, -1]
        return columns.T @ columns, columns.T @ left

    def _take(self, rows: np.ndarray, moves: np.ndarray) -> Iterator[None]:
        """Take a block: a part at a time."""
        if self._sigma is None:
            self._first.append((rows, moves))
            if len(self._first) < SCARCE:
                return
            yield
            self._sigma = self._noise()
            for one in self._first:
                yield
                self._keep(*self._equations(*one, self._sigma))
            self._first = []
        else:
            gram, moment = self._equations(rows, moves, self._sigma)
            yield
            if not self._stands(gram, moment):
                return
            self._keep(gram, moment)
        if len(self._grams) < SCARCE:
            return
        yield
        yield from self._fit()

    def _keep(self, gram: np.ndarray, moment: np.ndarray) -> None:
        self._grams.append(gram)
        self._moments.append(moment)
        del self._grams[:-MOST_BLOCKS], self._moments[:-MOST_BLOCKS]

    def _noise(self) -> np.ndarray:
        """(n,) N m rms of what the first blocks leave, joints weighing alike by their torque."""
        rows, moves = (np.concatenate(parts) for parts in zip(*self._first, strict=True))
        size = np.array([np.sqrt(np.mean(rows[m, j, -1] ** 2)) if (m := moves[:, j]).any() else 1.0
                         for j in range(rows.shape[1])])  # fmt: skip
        sigma = np.maximum(size, 1e-9)
        for _ in range(2):
            gram, moment = self._equations(rows, moves, sigma)
            blocks = Blocks(gram[None], moment[None], self._prior)
            left = rows[..., -1] - rows[..., :-1] @ blocks.solved(*blocks.whole)
            sigma = np.array([np.sqrt(np.mean(left[m, j] ** 2)) if (m := moves[:, j]).any() else s
                              for j, s in enumerate(sigma)])  # fmt: skip
            sigma = np.maximum(sigma, 1e-9)
        return sigma

    def _stands(self, gram: np.ndarray, moment: np.ndarray) -> bool:
        """Whether a block counts. The first that asks for another load does not, as it may be that of the change."""
        doubted = self._doubted
        if self.found is None and doubted is None:
            return True
        change, error = self._change(gram, moment)
        changed = abs(change) > max(CHANGED * error, SMALLEST_CHANGE)
        if doubted is None:
            assert self.found is not None
            if changed:
                self._doubted = _Doubted(self.found, self._grams, self._moments, change, error)
                self.found, self._grams, self._moments = None, [], []
            return not changed
        if not changed:
            self.found, self._grams, self._moments = doubted.found, doubted.grams, doubted.moments
            self._doubted = None
            return True
        again = abs(change - doubted.change) < max(CHANGED * float(np.hypot(error, doubted.error)), SMALLEST_CHANGE)
        if not again:
            doubted.change, doubted.error = change, error
            return False
        self._event, self._doubted = (PayloadEvent.PICK if change > 0 else PayloadEvent.RELEASE), None
        return True

    def _change(self, gram: np.ndarray, moment: np.ndarray) -> tuple[float, float]:
        """kg by which a block asks for another load than the one known last, and its standard error."""
        assert self._covariance is not None
        load = slice(_GATHERED)
        score = moment - gram @ self._values
        noise = self._memory * gram + gram @ self._covariance @ gram
        # what the block alone says, with the parameters of the arm as they are known
        own = gram[load, load] / self._memory + np.diag(self._prior[load])
        change = float(np.linalg.solve(own, score[load] / self._memory)[0])
        weigh = np.linalg.solve(own, np.eye(_GATHERED)[0]) / self._memory
        return change, float(np.sqrt(weigh @ noise[load, load] @ weigh))

    def _fit(self) -> Iterator[None]:
        blocks = Blocks(np.array(self._grams), np.array(self._moments), self._prior)
        yield
        self._memory = blocks.remembers()
        blocks = Blocks(blocks.grams, blocks.moments, self._prior, self._memory)
        yield
        values, without = blocks.solved(*blocks.whole), []
        for one in blocks.without_each():
            without.append(one)
            yield
        random, common = blocks.covariances(np.array(without))
        yield
        load = slice(_GATHERED)
        self._values, self._covariance = values, random + common
        body = body_from(values[load], random[load, load], common[load, load])
        errors = np.r_[body.mass_error, body.centre_error, body.inertia_error]
        spread = np.sqrt(np.maximum(errors**2 - body.common**2, 0.0))
        yield
        trusted = bool(is_sure(body.mass_error, body.mass)) and body.mass > -3.0 * body.mass_error - SMALLEST_CHANGE
        feed = _believed(values[load], (random + common)[load, load], body.reach, max(body.mass, 0.0))
        self.found = Found(body, spread, trusted, feed, len(self._grams) * BLOCK)


def _believed(values: np.ndarray, covariance: np.ndarray, reach: float, mass: float) -> np.ndarray:
    """(10,) of a load, drawn to a body of its mass at the frame as far as the data do not tell: what they leave open is
    not to become a torque."""
    lever = LEVER * reach
    inertia = INERTIA * mass * lever**2
    spread = np.array([max(mass, 1e-3)] + 3 * [max(mass, 1e-3) * lever] + 6 * [max(inertia, 1e-6)])
    centre = np.zeros(_GATHERED)
    centre[0] = mass
    weigh = np.linalg.solve(covariance + np.diag(spread**2), np.diag(spread**2))
    return centre + weigh.T @ (values - centre)
