"""Bodies that can be, of base parameters that motion told: masses, centres and inertias of links, nearest to those of a
URDF as far as the parameters leave them open.

Each body is a positive definite pseudo-inertia P = L M M^T L^T with the Cholesky factor L of the URDF's and an upper
triangular M, whose diagonal is an exponential: no mass and no inertia can be less than nothing, and M = 1 is the URDF.

Source: Rucker, Wensing, Smooth parameterization of rigid-body inertia, IEEE RA-L 2022 (doi 10.1109/LRA.2022.3144517).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.arm import body_of, pseudo_inertia

PRIOR = 0.5  # standard deviation of the entries of log M: a link of the URDF weighs 0.6 to 1.6 times as much
LEAST = 1e-4  # of a pseudo-inertia's largest eigenvalue: a URDF may have a body without extent
SMALLEST_ERROR = 1e-3  # of a parameter: no fit tells a body better
SMALL_ROTOR = 1e-6  # kg m^2: less is none
LOOSE = 10.0  # standard deviation of the logarithm of a rotor's inertia: nothing is known of it
LINK = np.triu_indices(4)
ENTRIES = len(LINK[0])


@dataclass(frozen=True)
class Bodies:
    """bodies: (n, 10) as `arm.A_LINK` in each carrier's frame. rotors: (F,) kg m^2. off: (k,) how far the parameters of
    these bodies are from those that were found, in standard errors."""

    bodies: np.ndarray
    rotors: np.ndarray
    off: np.ndarray


def bodies_near(
    described: np.ndarray, columns: np.ndarray, rotors: np.ndarray, found: np.ndarray, errors: np.ndarray
) -> Bodies:
    """The bodies that explain parameters best.

    described: (n, 10) of the URDF. columns: (k, 10 n), what a unit of each adds to the k parameters. rotors: (k, F) the
    same of rotors. found, errors: (k,) parameters, less what no body here changes, and their standard errors; one
    without end was not told.
    """
    from scipy.optimize import least_squares, nnls

    factors = [np.linalg.cholesky(_possible(pseudo_inertia(body))) for body in described]
    told = np.isfinite(errors)
    weight = np.where(told, 1.0 / np.maximum(errors, SMALLEST_ERROR * np.abs(found) + 1e-9), 0.0)
    count, turning = len(described), rotors.shape[1]

    def bodies(values: np.ndarray) -> np.ndarray:
        return np.array([_body(f, v) for f, v in zip(factors, values.reshape(count, ENTRIES), strict=True)])

    def off(values: np.ndarray) -> np.ndarray:
        links, motors = values[turning:], np.exp(values[:turning])
        return (columns @ bodies(links).ravel() + rotors @ motors - found) * weight

    def cost(values: np.ndarray) -> np.ndarray:
        return np.r_[off(values), values[turning:] / PRIOR, (values[:turning] - start[:turning]) / LOOSE]

    # what the URDF's bodies leave, as far as rotors can explain it
    guess = np.maximum(nnls(rotors * weight[:, None], (found - columns @ described.ravel()) * weight)[0], SMALL_ROTOR)
    start = np.r_[np.log(guess), np.zeros(count * ENTRIES)]
    solved = least_squares(cost, start, method="lm", x_scale="jac").x
    return Bodies(bodies(solved[turning:]), np.exp(solved[:turning]), off(solved))


def _possible(pseudo: np.ndarray) -> np.ndarray:
    """The pseudo-inertia, or the nearest with some extent in every direction."""
    values, vectors = np.linalg.eigh(pseudo)
    least = LEAST * max(float(values[-1]), 1e-6)
    return (vectors * np.maximum(values, least)) @ vectors.T


def _body(factor: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(10,) of (10,) entries of log M."""
    moved = np.zeros((4, 4))
    moved[LINK] = values
    np.fill_diagonal(moved, np.exp(np.clip(np.diag(moved), -20.0, 20.0)))
    root = factor @ moved
    return body_of(root @ root.T)
