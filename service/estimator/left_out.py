"""Effects of a description that the online model does without: which, why, and how large a torque that leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.robot import Robot
from service.estimator import kalman, readout
from service.estimator.bounds import ARM_ANGLES
from service.estimator.named_effects import carried, corrected, readout_of
from service.model.description import base_of, terms_of
from service.model.effects.base import Effect
from service.model.hypothesis import Term
from service.model.mechanism import Delta
from service.model.scene import Recording, Scene
from service.model.signals import Segment
from service.model.torque import added

# The motion that a torque is told along: joints swing within the angles of `bounds`, each at a pace of its own.
SECONDS, SWINGS_HZ = 2.0, np.array([1.1, 1.6, 2.1])
NO_FORM = "it has no form that works sample by sample"


def left_out(robot: Robot, period: float) -> dict[str, str]:
    """Name -> why, of each effect that is not carried at a sample every `period` s.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    return {term.effect.name: why for term, why in _left_out(terms_of(robot), robot, period)}


def _left_out(terms: Sequence[Term], robot: Robot, period: float) -> list[tuple[Term, str]]:
    found = [(term, NO_FORM) for term in terms if not carried(term.effect)]
    reading = readout.settings(readout_of(robot, terms), period)
    if not reading["active"]:
        return found
    lag = kalman.design(period, robot.drive.position_resolution_rad, readout.newest(reading)).lag
    if not readout.fits(reading, lag):
        why = f"it needs more than the {kalman.MAX_LAG} samples of {period * 1e6:g} us that the online model stores"
        found += [(term, why) for term in terms if type(term.effect).read_out is not Effect.read_out]
    return found


def torque_left_out(robot: Robot, period: float) -> np.ndarray:
    """(3,) N m rms of the reported torque that is left out, along a motion amid the workspace."""
    terms = [term for term, _ in _left_out(terms_of(robot), robot, period)]
    if not terms:
        return np.zeros(3)
    changed, _, _ = corrected(robot)
    scene = Scene(Recording(swing(), Delta.of(changed), 0, robot.name), base_of(robot))
    square = np.zeros(3)
    for term in terms:
        if term.effect.measured:
            torque = scene.total
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                torque = term.effect.report(scene, place, torque, amplitude, term.nonlinear)
            extra = torque - scene.total
        else:
            extra = added(scene, term)
        square += np.mean(np.square(extra), axis=0)
    return np.sqrt(square)


def swing() -> Segment:
    """A motion amid the workspace, along which a torque is told."""
    period = 1e-3
    time = np.arange(round(SECONDS / period)) * period
    rate = 2 * np.pi * SWINGS_HZ
    wave, size = rate * time[:, None], 0.5 * (ARM_ANGLES[-1] - ARM_ANGLES[0])
    motion = ARM_ANGLES[1] + size * np.sin(wave), size * rate * np.cos(wave), -size * rate**2 * np.sin(wave)
    still, moves = np.zeros_like(wave), np.ones(wave.shape, bool)
    return Segment(np.arange(len(time)), time, period, *motion, still, moves)
