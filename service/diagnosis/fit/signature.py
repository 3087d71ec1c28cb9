"""Whether what a hypothesis gives to an effect is the effect's own, where far more than noise is left.

What is left there is coloured and comes again in every run: no error of the noise says how much of it an effect may
take by chance. That shows in what it gives to the same torque where the effect is not at work: at another time, or
stronger in one run, on one side of the workspace or in one part of a joint's way. Something that the effect only stands
in for gives about as much to those. All rows of a joint weigh alike, whatever an effect leaves of them, so that none
chooses the rows by which it is judged; and the joints by what is left of them, so that a stranger on one hides nothing
of the others. Delta robots only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from service.diagnosis.fit.candidates import columns_of
from service.identification.fit import TOLD, Problem, evaluate, solve
from service.model.effects.base import Effect, on_joint
from service.model.hypothesis import Hypothesis
from service.model.parameters import Parameters
from service.model.torque import predict

SHIFTS = (0.02, 0.06, 0.15, 0.4)  # s, either way: a reversal, a jerk, a stroke, a pick
OWN = 5.0  # times what is given to the same torque elsewhere, that an effect takes: the best of a catalogue is asked
# Of what a ripple takes, that what is left gives to the ones next to it: true ones leave 5e-4, and up to 0.6 beside a
# contact on their own joint; of what stands in for such a contact 0.69 to 1.4 is left.
ALONE = 0.7
NEXT = (-4.0, -3.0, -2.0, -1.5, 1.5, 2.0, 3.0, 4.0)  # widths of a line over a joint's way
PARTS = 4  # of a joint's way: a contact or a stop is in one of them, and a ripple stands in for it there
ORDER = 2  # of the torque that goes by the platform's place: a force that changes evenly, and its lever
GOES_BY_PLACE = 0.5  # of what is left above the noise, that such a torque explains: then something pulls there
LEAST = 0.03  # of the noise's squares, that is left above it before it goes by anything
# The same of torque whose scale is another in each log and changes evenly as it goes on: of what motors that become
# warm leave it is 0.39 to 0.85 in eleven simulated robots, of what else is left up to 0.18 in twenty-five.
GOES_BY_SCALE = 0.3
OWN_ELSEWHERE = 0.9  # of an effect's own torque, that goes by place or scale as well: then it cannot be told beside it


def pulled(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether what is left goes by the platform's place."""
    return Signature(problem, hypothesis).goes_by_place() > GOES_BY_PLACE


def of_place(place: np.ndarray) -> np.ndarray:
    """(N, K) products up to `ORDER` of the platform's place (N, 3), in parts of its reach."""
    factors = np.concatenate([np.ones((len(place), 1)), place], axis=1)
    return np.stack([factors[:, one].prod(axis=1) for one in combinations_with_replacement(range(4), ORDER)], axis=1)


def _taken(columns: np.ndarray, values: np.ndarray) -> float:
    """Squares that columns (R, K) take of values (R,)."""
    moment = columns.T @ values
    return float(solve(columns.T @ columns, moment) @ moment)


class Signature:
    """What `hypothesis` leaves of all rows of `problem`, beside its fields: residual (R,) and tangents (R, F), in units
    of the noise or of what is left of the joint, if that is more."""

    def __init__(self, problem: Problem, hypothesis: Hypothesis):
        self.problem, self.hypothesis = replace(problem, weights=()), hypothesis
        every = evaluate(self.problem, hypothesis)
        self.joints, residual = np.concatenate(self.problem.joints_of_rows), np.concatenate(every.residuals)
        count = np.bincount(self.joints, minlength=len(problem.sigma))
        square = np.bincount(self.joints, residual**2, len(problem.sigma)) / np.maximum(count, 1)
        self.unit = np.sqrt(np.maximum(square, 1.0))[self.joints]
        self.residual = residual / self.unit
        self.tangents = np.concatenate(every.tangents) / self.unit[:, None]

    def elsewhere(self, effect: Effect) -> float:
        """Rms of what is left gives to the torque of `effect` elsewhere, over what the effect takes itself; 1 where it
        has no torque to hold that against."""
        mine, torque = self._of(effect)
        own = self._beside(self.tangents[:, ~mine], torque[:, None])
        others = self._beside(self.tangents, np.stack([*self._modulated(torque), *self._shifted(torque)], axis=1))
        square = np.sum(others**2, axis=0)
        told = square > TOLD * float(torque @ torque)
        if not told.any():
            return 1.0
        given = (self.residual @ others[:, told]) ** 2 / square[told]
        return float(np.sqrt(np.mean(given) / max(float(np.sum(own**2)), 1e-300)))

    def next_to(self, effect: Effect) -> float:
        """What is left gives to a ripple next to the strongest one of `effect`, over what the effect takes, both
        squared; 0 of an effect that is none. What happens in one place only is no line over the turns of a motor."""
        ripples = [
            (float(np.sum(np.square(amplitude))), joint, term.nonlinear[0])
            for term in self.hypothesis.terms
            if term.effect is effect and effect.of_motor_turns
            for joint, amplitude in zip(term.joints, term.amplitude, strict=True)
        ]
        if not ripples:
            return 0.0
        _, joint, order = max(ripples)
        recordings = self.problem.recordings
        travel = float(np.ptp(np.concatenate([recording.segment.theta[:, joint] for recording in recordings])))
        line = 2 * np.pi / (recordings[0].mechanism.gear_ratio[joint] * travel)
        orders = [order + lines * line for lines in NEXT if order + lines * line > 0]
        beside = (self._beside(self.tangents, columns) for columns in self._rippled(effect, joint, orders))
        given = [_taken(columns, self.residual) for columns in beside]
        return max(given, default=0.0) / max(float(np.sum(self._own(effect)[1] ** 2)), 1e-300)

    def _rippled(self, effect: Effect, joint: int, orders: list[float]) -> list[np.ndarray]:
        """(R, k) for each order, what `effect` does on `joint` there."""
        parts = []
        for number, scene in enumerate(self.problem.scenes(self.hypothesis)):
            columns = columns_of(scene, self.hypothesis, effect, joint, [(order,) for order in orders])
            if effect.own_joint:
                columns = on_joint(columns, joint, scene.joints)
            parts.append(self.problem.select(number, self.problem.band(columns)))
        return np.split(np.concatenate(parts) / self.unit[:, None], len(orders), axis=1)

    def goes_by_place(self) -> float:
        """Share of what is left above the noise that goes by the platform's place, on each joint in its own way; 0 of
        next to nothing."""
        return self._goes_by(lambda: self._beside(self.tangents, self._places()))

    def by_place(self, effect: Effect) -> float:
        """Share of the effect's own torque that goes by the platform's place."""
        return self._by(self._places(), effect)

    def goes_by_scale(self) -> float:
        """Share of what is left above the noise that goes by the torque itself, in each log and joint by another share
        of it that changes evenly; 0 of next to nothing. Not what goes by the same share of a joint's torque in all
        logs: a mass does too."""

        def changing() -> np.ndarray:
            scales = self._scales()
            each = np.unique(self.joints)
            steady = [np.where(self.joints == joint, scales[:, ::2].sum(axis=1), 0.0) for joint in each]
            return self._beside(np.concatenate([self.tangents, np.stack(steady, axis=1)], axis=1), scales)

        return self._goes_by(changing)

    def by_scale(self, effect: Effect) -> float:
        """Share of the effect's own torque that the scale of the rest makes, if it changes like that: all torque by the
        same share more would hold the effect itself."""
        return self._by(self._scales(effect), effect)

    def _goes_by(self, beside: Callable[[], np.ndarray]) -> float:
        """Share of what is left above the noise that columns (R, K) take, which are asked for where there is any."""
        noise = float(np.sum(self.unit**-2.0))
        above = float(self.residual @ self.residual) - noise
        if above < LEAST * noise:
            return 0.0
        columns = beside()
        return (_taken(columns, self.residual) - columns.shape[1]) / above

    def _by(self, field: np.ndarray, effect: Effect) -> float:
        mine, own = self._own(effect)
        return _taken(self._beside(self.tangents[:, ~mine], field), own) / max(float(own @ own), 1e-300)

    def left_open(self, effect: Effect, fields: Sequence[np.ndarray]) -> float:
        """Share of the effect's own torque that `fields`, as in `Problem`, could explain."""
        (_, own), beside = self._own(effect), replace(self.problem, fields=fields)
        ends, left = np.cumsum([0, *(len(joints) for joints in beside.joints_of_rows)]), 0.0
        for number, joints in enumerate(beside.joints_of_rows):
            part = own[ends[number] : ends[number + 1], None]
            for rows in (np.flatnonzero(joints == joint) for joint in np.unique(joints)):
                left += float(np.sum(beside.clear(number, rows, part[rows]) ** 2))
        return 1.0 - left / max(float(own @ own), 1e-300)

    def _own(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """(F,) tangents of `effect`, and its torque (R,) beside all others."""
        mine, torque = self._of(effect)
        return mine, self._beside(self.tangents[:, ~mine], torque[:, None])[:, 0]

    def _of(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """(F,) tangents of `effect`, and its torque (R,): of its amplitudes, or of a shift or lag, which has none, as
        far as its slope says."""
        parameters = Parameters(self.hypothesis)
        mine, at_work = np.zeros((2, len(parameters.values)), bool)
        for term, places in zip(self.hypothesis.terms, parameters.terms, strict=True):
            if term.effect is effect:
                mine[places] = True
                at_work[places] = np.arange(mine[places].sum()) < (term.amplitude.size or np.inf)
        mine, at_work = mine[parameters.free], at_work[parameters.free]
        return mine, self.tangents[:, at_work] @ parameters.values[parameters.free][at_work]

    @staticmethod
    def _beside(known: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Columns (R, K) without what columns `known` (R, F) explain of them."""
        return columns - known @ solve(known.T @ known, known.T @ columns)

    def _modulated(self, torque: np.ndarray) -> list[np.ndarray]:
        """Stronger on one side of the workspace, in one run, or in one part of a joint's way."""
        place = self._rows([recording.arms.position for recording in self.problem.recordings])
        place = (place - place.mean(axis=0)) / np.maximum(place.std(axis=0), 1e-300)
        log, part = self._logs(), self._parts()
        return [
            *(torque * side for side in place.T),
            *(np.where(log == one, torque, 0.0) for one in np.unique(log)[1:]),
            *(np.where(part == one, torque, 0.0) for one in range(PARTS)),
        ]

    def _parts(self) -> np.ndarray:
        """(R,) in which of `PARTS` equal parts of its way a row's joint is."""
        along = [self.problem.band(recording.segment.theta) for recording in self.problem.recordings]
        angle = np.concatenate([self.problem.pick(number, part) for number, part in enumerate(along)])
        part = np.zeros(len(angle), int)
        for rows in (self.joints == joint for joint in np.unique(self.joints)):
            low, high = angle[rows].min(), angle[rows].max()
            part[rows] = np.minimum(PARTS * (angle[rows] - low) / max(high - low, 1e-300), PARTS - 1)
        return part

    def _shifted(self, torque: np.ndarray) -> list[np.ndarray]:
        """Earlier and later."""
        period = self.problem.band.period * self.problem.band.step
        steps = [max(1, round(shift / period)) for shift in SHIFTS]
        shifted: list[list[np.ndarray]] = [[] for _ in (*steps, *steps)]
        start = 0
        for rows in self.problem.rows:
            for column in rows.T:
                end = start + int(column.sum())
                along = np.zeros(len(column))
                along[column] = torque[start:end]
                for number, step in enumerate(steps):
                    late = np.concatenate([np.zeros(step), along])[: len(along)]
                    early = np.concatenate([along, np.zeros(step)])[-len(along) :]
                    for place, values in ((2 * number, late), (2 * number + 1, early)):
                        shifted[place].append(values[column])
                start = end
        return [np.concatenate(parts) for parts in shifted]

    def _scales(self, gone: Effect | None = None) -> np.ndarray:
        """(R, 2 L n) torque that is expected, of each of L logs and n joints by itself, and the same times the time.
        gone: an effect without which."""
        problem, parts, begun = self.problem, [], {}
        terms = tuple(term for term in self.hypothesis.terms if term.effect is not gone)
        for number, scene in enumerate(problem.scenes(self.hypothesis)):
            torque = predict(scene, replace(self.hypothesis, terms=terms))
            time = scene.time - begun.setdefault(problem.logs[number], scene.time[0])
            parts.append(problem.select(number, problem.band(np.stack([torque, torque * time[:, None]], axis=2))))
        columns, log = np.concatenate(parts) / self.unit[:, None], self._logs()
        each = [(log == one) & (self.joints == joint) for one in np.unique(log) for joint in np.unique(self.joints)]
        return np.concatenate([np.where(rows[:, None], columns, 0.0) for rows in each], axis=1)

    def _logs(self) -> np.ndarray:
        """(R,) which log a row is of."""
        return np.repeat(self.problem.logs, [rows.sum() for rows in self.problem.rows])

    def _places(self) -> np.ndarray:
        """(R, K n) torque that goes by the platform's place up to `ORDER`."""
        place = [recording.arms.position for recording in self.problem.recordings]
        middle = np.concatenate(place).mean(axis=0)
        reach = np.abs(np.concatenate(place) - middle).max()
        products = [of_place((along - middle) / reach) for along in place]
        columns, each = self._rows(products), np.unique(self.joints)
        return np.concatenate([np.where(self.joints[:, None] == one, columns, 0.0) for one in each], axis=1)

    def _rows(self, values: list[np.ndarray]) -> np.ndarray:
        """(R, K) in the band, of (N, K) a recording that are the same for all joints."""
        joints = len(self.problem.sigma)
        parts = [np.repeat(self.problem.band(one)[:, None], joints, axis=1) for one in values]
        return np.concatenate([self.problem.pick(number, part) for number, part in enumerate(parts)])
