"""The noise floor's parts, each against the long way or just inside and just outside of its rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.signal import periodogram

from tests.service.subject import Band, noise
from tests.service.world import stub

BAND = Band.of(1e-3)


def floor_of(
    monkeypatch: pytest.MonkeyPatch,
    white: Any,
    white_left: Any,
    levels: Any,
    levels_left: Any,
    inside: Any,
    known: Any,
    torque: Any,
    step: Any,
) -> noise.Floor:
    """The floor of one recording, each argument an entry a joint: noise of torque and residual, first and last level of
    both, noise in the band as its colour says it and whether it does, rms of the torque, steps. A quarter of white
    noise passes the band."""
    recordings: Any = [stub(segment=stub(torque=np.array([[1.0], [-1.0]]) * np.array(torque)))]
    left = [np.zeros((2, len(torque)))]

    def profile(recordings: object, values: list[np.ndarray], band: object) -> np.ndarray:
        return np.array(levels_left if values is left else levels, float)

    def extrapolated(levels: np.ndarray, band: object) -> tuple[np.ndarray, np.ndarray]:
        expected = np.minimum(profile(None, [], None), profile(None, left, None))
        rows = [int(np.flatnonzero((expected == level).all(axis=1))[0]) for level in levels]
        return np.array(inside, float)[rows], np.array(known)[rows]

    monkeypatch.setattr(noise, "white_noise", lambda _, values=None: np.array(white if values is None else white_left))
    monkeypatch.setattr(noise, "_profile", profile)
    monkeypatch.setattr(noise, "_extrapolated", extrapolated)
    monkeypatch.setattr(noise, "_steps", lambda recordings: np.array(step))

    def band(values: np.ndarray) -> np.ndarray:
        return values

    band.white_share = 0.25  # pyright: ignore[reportFunctionMemberAccess]
    asked: Any = band
    return noise.floor(recordings, left, asked)


def test_the_quieter_of_torque_and_residual_is_noise_and_no_less_than_its_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flat = [[1.0, 1.0]] * 4
    found = floor_of(
        monkeypatch, [4.0, 9.0, 1.0, 0.0], [9.0, 4.0, 1.0, 0.0], flat, flat, [9.0] * 4, [True] * 4,
        [100.0, 100.0, 100.0, 0.0], [0.0, 0.0, 12.0, 0.0],
    )  # fmt: skip
    np.testing.assert_allclose(found.sample, [4.0, 4.0, 12**0.5, 1e-9])
    np.testing.assert_allclose(found.band, [2.0, 2.0, 0.5 * 12**0.5, 1e-9])
    assert not found.coloured.any()
    assert found.unknown.tolist() == [False] * 4


def test_noise_is_coloured_where_its_levels_rise_by_a_quarter_towards_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of torque or residual, whichever is less, and of what its steps alone make; then its colour tells what is in the
    band, if it does, and it is no less than white noise."""
    levels = [[1.26, 1.0], [1.24, 1.0], [1.26, 1.0], [9.0, 1.0], [1.26, 1.0], [1.26, 0.5]]
    left = [[9.0, 9.0], [9.0, 9.0], [1.26, 1.0], [1.24, 1.0], [9.0, 9.0], [9.0, 9.0]]
    levels = [[*row[:1], 0.0, *row[1:]] for row in levels]  # what is between does not count
    left = [[*row[:1], 0.0, *row[1:]] for row in left]
    for number, row in enumerate([*levels, *left]):
        row[1] = 1e-3 * number  # told apart
    found = floor_of(
        monkeypatch, [2.0] * 6, [2.0] * 6, levels, left, [1.5, 9.0, 0.5, 9.0, 9.0, 9.0],
        [True, True, True, True, False, True], [100.0] * 6, [0.0] * 5 + [1.02 * 12**0.5],
    )  # fmt: skip
    assert found.coloured.tolist() == [True, False, True, False, False, False]
    assert found.unknown.tolist() == [False] * 4 + [True, False]
    np.testing.assert_allclose(found.band, [1.5, 1.0, 1.0, 1.0, 1.0, 1.0])


def test_a_floor_is_a_thousandth_of_the_torque_or_a_hundredth_where_it_is_not_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flat, rising = [1.0, 0.0, 1.0], [9.0, 0.0, 1.0]
    levels = [flat, flat, rising, rising]
    for number, row in enumerate(levels):
        levels[number] = [row[0], 1e-3 * number, row[2]]
    found = floor_of(
        monkeypatch, [2.0] * 4, [2.0] * 4, levels, levels, [1.0] * 4, [True, True, True, False],
        [999.0, 1001.0, 1001.0, 500.0], [0.0] * 4,
    )  # fmt: skip
    assert found.unknown.tolist() == [False, True, True, True]
    assert found.coloured.tolist() == [False] * 4
    np.testing.assert_allclose(found.band, [1.0, 10.01, 10.01, 5.0])


def test_levels_are_spectra_of_tapered_windows_without_their_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against SciPy's, of windows of 128 samples of two parts; what is over a window's end is left out."""
    random = np.random.default_rng(0)
    parts = [random.standard_normal((300, 2)) + 5.0, random.standard_normal((130, 2)), np.zeros((100, 2))]
    asked = []

    def quiet(levels: np.ndarray, freedom: float) -> float:
        asked.append((levels, freedom))
        return 4.0 * len(asked)

    monkeypatch.setattr(noise, "_quiet", quiet)
    recordings: Any = [stub(segment=stub(period=1e-3))] * 3
    found = noise._levels(recordings, parts, [(100.0, 250.0), (250.0, np.inf)])
    np.testing.assert_allclose(found, np.sqrt([[4.0, 12.0], [8.0, 16.0]]))
    windows = [parts[0][:128], parts[0][128:256], parts[1][:128]]
    taper: Any = np.hanning(128)
    frequency, density = periodogram(np.array(windows), 1e3, taper, detrend="constant", axis=1)
    level = 500.0 * density  # of a sample, were all frequencies so
    level[:, -1] *= 2.0  # the last has no mirror image
    for band, (low, high) in enumerate(((100.0, 250.0), (250.0, 501.0))):
        inside = (frequency >= low) & (frequency < high)
        for joint in range(2):
            levels, freedom = asked[2 * band + joint]
            np.testing.assert_allclose(levels, level[:, inside, joint].mean(axis=1), rtol=1e-9)
            assert freedom == pytest.approx(inside.sum() * 2 / 1.5)


def test_the_quietest_windows_are_those_within_three_deviations_of_each_other() -> None:
    """Of 200 degrees of freedom: a tenth each."""
    levels = np.array([1.25] * 5 + [1.0] * 20 + [1.6] * 5)
    assert noise._quiet(levels, 200.0) == pytest.approx((20 + 5 * 1.25) / 25)
    assert noise._quiet(np.full(3, 2.0), 200.0) == pytest.approx(2.0)
    assert noise._quiet(np.zeros(3), 200.0) == 0.0
    assert noise._quiet(np.r_[np.full(40, 1.6), np.ones(10)], 200.0) == pytest.approx(1.0), "however many are louder"


@pytest.mark.parametrize(("rise", "known"), [(3.9, True), (4.1, False)])
def test_noise_of_first_order_goes_on_below_as_it_does_above(rise: float, known: bool) -> None:
    """White beside it, joints of one corner and of other shares; where it would rise fourfold it is not known."""
    edges = np.geomspace(1.2 * BAND.cutoff_hz, 500.0, 6)
    middle = np.sqrt(edges[1:] * edges[:-1])
    corner = float(np.geomspace(0.2 * BAND.cutoff_hz, 500.0, 60)[15])

    def density(white: float, more: float, frequency: np.ndarray) -> np.ndarray:
        return white + more / (1.0 + (frequency / corner) ** 2)

    # white + more is `rise` times what there is in the lowest of the levels
    first = 1.0 / (1.0 + (middle[0] / corner) ** 2)
    more = (rise - 1.0) / (1.0 - rise * first)
    shares = [(1.0, more), (2.0, 0.5)]
    levels = np.sqrt([density(white, rest, middle) for white, rest in shares])
    found, told = noise._extrapolated(levels, BAND)
    frequency, passed = BAND.passes
    truth = [np.sqrt(np.mean(density(white, rest, frequency) * passed)) for white, rest in shares]
    np.testing.assert_allclose(found, truth, rtol=1e-6)
    assert told.tolist() == [known, True]


def test_a_torques_steps_are_the_least_between_values_that_come_again() -> None:
    random = np.random.default_rng(0)
    stepped = 0.25 * random.integers(0, 20, 100)
    table = np.column_stack([
        stepped, stepped + 1e-13 * random.standard_normal(100), np.ones(100), random.standard_normal(100),
        np.r_[np.arange(20.0), np.zeros(80)], np.r_[np.arange(21.0), np.zeros(79)],
        1e6 * stepped + 1e-4 * random.standard_normal(100),
    ])  # fmt: skip
    recordings: Any = [stub(segment=stub(torque=table[:40])), stub(segment=stub(torque=table[40:]))]
    np.testing.assert_allclose(noise._steps(recordings), [0.25, 0.25, 0.0, 0.0, 1.0, 0.0, 2.5e5])


def test_white_noise_is_read_above_the_robots_own_motion_or_the_upper_half(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 250 Hz on; at 500 Hz from half of what there is."""
    asked: list[Any] = []
    monkeypatch.setattr(
        noise, "_levels", lambda recordings, values, bands: asked.append((values, bands)) or np.ones((2, 1))
    )
    for period in (1e-3, 2e-3, 1e-4):
        recordings: Any = [stub(segment=stub(period=period, torque="torque"))]
        noise.white_noise(recordings)
        left: Any = ["left"]
        noise.white_noise(recordings, left)
    assert [values for values, _ in asked] == [["torque"], ["left"]] * 3
    highest = [bands for _, bands in asked[::2]]
    assert highest == [[(min(noise.NOISE_HZ, hz), np.inf)] for hz in (250.0, 125.0, 2500.0)]


def test_a_torque_that_stood_at_its_limit_has_no_colour_to_be_read() -> None:
    """Of a saturated drive the quietest windows hold nothing at all; beside it another joint is read as it is alone."""
    read = np.array([[4.0, 3.0, 2.0, 1.5, 1.2]])
    inside, known = noise._extrapolated(np.concatenate([read, [[4.0, 3.0, 2.0, 1.5, 0.0]], np.zeros((1, 5))]), BAND)
    alone, its = noise._extrapolated(read, BAND)
    assert (inside[0], known[0]) == (alone[0], its[0])
    assert known.tolist()[1:] == [False, False]
    assert inside.tolist()[1:] == [0.0, 0.0]


def test_weights_of_two_columns_are_those_of_scipy() -> None:
    random = np.random.default_rng(4)
    columns = random.uniform(0.1, 3.0, (50, 4, 5, 2))
    columns[..., 1] /= np.linspace(0.1, 9.0, 5)  # of some one column is best alone
    weights, left = noise._weights(columns)
    expected = [nnls(one, np.ones(5)) for one in columns.reshape(-1, 5, 2)]
    np.testing.assert_allclose(weights.reshape(-1, 2), [one for one, _ in expected], atol=1e-9)
    np.testing.assert_allclose(left.ravel(), [rest**2 for _, rest in expected], atol=1e-9)
    assert 0 < np.count_nonzero(weights == 0.0) < weights.size // 2
