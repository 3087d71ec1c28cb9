"""The bus's time as a master takes it: the distributed clock where that can be right, else counted on."""

from __future__ import annotations

from schemas.messages import NANOSECONDS

SLIP = 0.1  # s that a reading may be off what is counted on; more has not passed unnoticed between two frames
ANEW = 16  # cycles that a clock which jumped must go on evenly before it is believed
_LAST = (1 << 31) * NANOSECONDS  # ns, what a stamp can hold


class BusClock:
    """Stamps of cycles, ns.

    Attributes: stamp: of the last cycle, 0 before the first. odd: readings in a row that cannot be right; odd_ever: all
    of them.
    """

    def __init__(self, period_ns: int) -> None:
        self.stamp = 0
        self.odd = self.odd_ever = 0
        self._period = period_ns
        self._strange = 0  # the last reading that could not be right

    def step(self, cycles: int, told: int | None) -> int:
        """Go on by `cycles` and take what the frame says, None where it says nothing; cycles by the bus's own time.

        A clock that jumped is passed over until it has gone on evenly for `ANEW` cycles from where it is now.
        """
        expected = self.stamp + cycles * self._period
        stamp = expected if told is None else self._believed(cycles, expected, told)
        jumped = abs(stamp - expected) > SLIP * NANOSECONDS + cycles * self._period
        steps = cycles if jumped else max(1, round((stamp - self.stamp) / self._period))
        self.stamp = stamp
        return steps

    def _believed(self, cycles: int, expected: int, told: int) -> int:
        if self.stamp and not told >> 32:  # a clock of 32 bits goes on over its wraps
            told = expected + ((told - expected + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
        near = abs(told - expected) <= SLIP * NANOSECONDS + cycles * self._period
        if near or (not self.stamp and told < _LAST):
            self.odd = 0
            return told
        even = abs(told - self._strange - cycles * self._period) < self._period // 2
        self.odd, self._strange = self.odd + 1 if even else 1, told
        self.odd_ever += 1
        return told if self.odd >= ANEW and 0 < told < _LAST else expected
