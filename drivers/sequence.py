"""What sequence numbers say of a source: what was lost, came twice, came late, and when it began anew."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

_HISTORY = 4096  # sequence numbers below the newest of which it is known whether they came
_RESTART_JUMP = 1 << 28  # numbers skipped at once; nine hours at 8 kHz are another count, not a loss
_RESTART_RUN = 16  # consecutive rising numbers below the newest that can only be a source that started over


class SequenceCounter:
    """Tells from the sequence numbers of one source what was lost, came twice or came late; any uint64 may come.

    lost: numbers skipped and not come since. repeated: numbers seen before. out_of_order: numbers below the newest that
    had been skipped. restarts: times the source began again from another number, a lower or a far higher one. What a
    message costs does not depend on how many numbers are missing: holes are kept as ranges.
    """

    def __init__(self) -> None:
        self.newest = -1
        self.lost = 0
        self.repeated = 0
        self.out_of_order = 0
        self.restarts = 0
        self._begins: list[int] = []  # of the holes among the newest numbers, rising
        self._ends: list[int] = []  # the first number behind each hole
        self._run_last = -2
        self._run: list[bool] = []  # of the run below the newest: was each one a skipped number

    def update(self, sequence: int) -> None:
        """Count one message."""
        step = sequence - self.newest
        if step == 1 or self.newest < 0:
            self.newest = sequence
        elif step > _RESTART_JUMP:
            self.restarts += 1
            self._begin_anew(sequence)
        elif step > 1:
            self.lost += step - 1
            self._begins.append(self.newest + 1)
            self._ends.append(sequence)
            self.newest = sequence
            if self._ends[0] <= sequence - _HISTORY:
                old = bisect_right(self._ends, sequence - _HISTORY)
                del self._begins[:old], self._ends[:old]
        else:
            self._behind(sequence)

    def update_many(self, sequences: np.ndarray) -> None:
        """Count messages in the order they came, (N,) integers."""
        for sequence in sequences.tolist():
            self.update(sequence)

    def _behind(self, sequence: int) -> None:
        late = self._fill(sequence)
        if late:
            self.lost -= 1
            self.out_of_order += 1
        else:
            self.repeated += 1
        if sequence != self._run_last + 1:
            self._run.clear()
        self._run.append(late)
        self._run_last = sequence
        if len(self._run) == _RESTART_RUN:
            self._restart(sequence)

    def _fill(self, sequence: int) -> bool:
        """Take `sequence` out of the holes; whether it was in one."""
        hole = bisect_right(self._begins, sequence) - 1
        if hole < 0 or sequence >= self._ends[hole]:
            return False
        begin, end = self._begins[hole], self._ends[hole]
        sides = [(low, high) for low, high in ((begin, sequence), (sequence + 1, end)) if low < high]
        self._begins[hole : hole + 1] = [low for low, _ in sides]
        self._ends[hole : hole + 1] = [high for _, high in sides]
        return True

    def _restart(self, sequence: int) -> None:
        late = sum(self._run)
        self.lost += late
        self.out_of_order -= late
        self.repeated -= len(self._run) - late
        self.restarts += 1
        self._begin_anew(sequence)

    def _begin_anew(self, sequence: int) -> None:
        self.newest = sequence
        self._begins.clear()
        self._ends.clear()
        self._run.clear()
        self._run_last = -2
