"""The load on a frame of an arm from blocks of motion: the fit that a log and the running arm have in common.

What the description knows of the arm is known within its standard errors: that is the prior of a least-squares fit of
base parameters and load together. A base parameter and the load may ask for the same torque, as on the last link; then
the prior is what tells them apart, and its error is in the load's. Friction grows with what a gear carries, so that of
the joints may move by `FRICTION` of its value. Standard errors come from leaving out blocks.

Source: Khalil, Gautier, Lemoine, Identification of the payload inertial parameters of industrial manipulators, ICRA
2007 (doi 10.1109/ROBOT.2007.364241).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from schemas.axes_description import Description
from service.model.arm import about_centre, pseudo_inertia
from service.model.description import base_errors
from service.model.scene import Base

FRICTION = 0.3  # of its value, one standard deviation: what a load makes of a joint's friction
WIDEST = np.array([100.0] + 3 * [30.0] + 6 * [10.0])  # kg, kg m, kg m^2, one standard deviation before any data
SCARCE = 4  # blocks of motion: fewer give no error
BLOCK = 0.5  # s, longer than the residual remembers
SEEN = 3.0  # standard errors of its mass, from which there is a load
WITHIN = 0.5  # of the largest moment of inertia, within which inertia is determined
REACHES = 2.0  # times its reach, within which the centre is
STEP = 1e-6  # of a parameter's unit, of finite differences


@dataclass(frozen=True)
class Body:
    """A load on a frame. mass: kg. centre: (3,) m, in the frame. inertia: (6,) kg m^2, xx xy yy xz yz zz about the
    centre, in the frame's axes. Each with its standard error. common: (10,) of the errors of mass, centre, inertia,
    the part that all loads of this arm share: that of its identified parameters."""

    mass: float
    mass_error: float
    centre: np.ndarray
    centre_error: np.ndarray
    inertia: np.ndarray
    inertia_error: np.ndarray
    common: np.ndarray

    @property
    def seen(self) -> bool:
        """Whether there is a load at all."""
        return self.mass > SEEN * self.mass_error

    @property
    def centre_told(self) -> bool:
        """Whether the motion tells the centre."""
        return self.seen and bool(self.centre_error.max() < REACHES * self.reach)

    @property
    def reach(self) -> float:
        """m, what the centre's error is held against: the lever of a body of this mass and 1000 kg/m^3."""
        return float(np.cbrt(max(self.mass, 1e-3) / 1000.0))

    @property
    def inertia_told(self) -> bool:
        """Whether the motion tells the inertia: within half of its largest moment, and it is that of a body."""
        moments = self.inertia[[0, 2, 5]]
        possible = bool(np.linalg.eigvalsh(pseudo_inertia(np.r_[1.0, 0, 0, 0, self.inertia])[:3, :3])[0] > 0)
        return self.centre_told and possible and bool(self.inertia_error.max() < WITHIN * moments.max())


@dataclass(frozen=True)
class Blocks:
    """Normal equations of load (first 10) and base parameters, P together, with residuals in units of each joint's own.

    grams, moments: (B, P, P) and (B, P) of blocks in which something moves. prior: (P,) 1 over standard deviation
    squared. memory: how many times fewer samples there are for their likeness to their neighbours.
    """

    grams: np.ndarray
    moments: np.ndarray
    prior: np.ndarray
    memory: float = 1.0

    @property
    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) and (P,) of all blocks."""
        return self.grams.sum(axis=0), self.moments.sum(axis=0)

    def solved(self, gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """(P,) load, and changes of the base parameters; what no prior lets move stands."""
        free = np.isfinite(self.prior)
        result = np.zeros(len(self.prior))
        information = gram[np.ix_(free, free)] / self.memory + np.diag(self.prior[free])
        scale = 1.0 / np.sqrt(np.diag(information))
        result[free] = scale * np.linalg.solve(information * np.outer(scale, scale), scale * moment[free] / self.memory)
        return result

    def remembers(self) -> float:
        """Variance of the blocks' moments over that of samples without memory, over the parameters' mean."""
        scores = self.moments - self.grams @ self.solved(*self.whole)
        alone = np.einsum("bpp->p", self.grams)
        return max(1.0, float(np.mean((np.sum(scores**2, axis=0) / np.maximum(alone, 1e-300))[alone > 0])))

    def without_each(self) -> Iterator[np.ndarray]:
        """(P,) solved without one block after the other."""
        gram, moment = self.whole
        for own_gram, own_moment in zip(self.grams, self.moments, strict=True):
            yield self.solved(gram - own_gram, moment - own_moment)

    def covariances(self, without: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) twice, of what differs from load to load and of what the prior's own errors leave. without: (B, P) as
        `without_each`."""
        count, off = len(self.grams), without - np.mean(without, axis=0)
        free = np.isfinite(self.prior)
        common = np.zeros((len(free), len(free)))
        inverse = np.linalg.inv(self.whole[0][np.ix_(free, free)] / self.memory + np.diag(self.prior[free]))
        common[np.ix_(free, free)] = inverse @ (self.prior[free, None] * inverse)
        return (count - 1) / count * off.T @ off, common


def body_from(values: np.ndarray, random: np.ndarray, common: np.ndarray) -> Body:
    """The body of (10,) `A_LINK` about the frame with (10, 10) covariances of either error."""
    shown, slopes = about_centre(values), np.empty((10, 10))
    for place, unit in enumerate(np.eye(10)):
        slopes[:, place] = (about_centre(values + STEP * unit) - shown) / STEP
    shared = np.einsum("ip,pq,iq->i", slopes, common, slopes)
    errors = np.sqrt(np.einsum("ip,pq,iq->i", slopes, random, slopes) + shared)
    return Body(
        float(shown[0]), float(errors[0]), shown[1:4], errors[1:4], shown[4:], errors[4:],
        np.sqrt(np.maximum(shared, 0.0)),
    )  # fmt: skip


def information_of(robot: Description, base: Base) -> np.ndarray:
    """(P,) information on the base parameters of a description; without end on what stands as it is."""
    known = base_errors(robot)
    rubs = np.r_[np.zeros(len(base.rigid)), np.abs(base.viscous), np.abs(base.coulomb)]
    errors = np.hypot(known, FRICTION * rubs)
    return np.divide(1.0, errors**2, out=np.full(len(errors), np.inf), where=errors > 0)
