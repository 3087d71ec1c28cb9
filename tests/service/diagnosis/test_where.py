"""Where the gap lies: budgets that add up, regimes and frequencies that hold what was put there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch

from schemas.diagnosis import Regime
from service.diagnosis.documents import report
from service.identification.frequency import cross_density
from tests.service.subject import Hypothesis, evaluate, where
from tests.service.world import BASE, course, problem, stub


def test_the_budget_adds_up_to_the_gap_of_the_base_model(findings):
    for joint in range(3):
        parts = where.budget(findings, joint)
        mine = [j == joint for j in findings.problem.joints_of_rows]
        before = np.concatenate([r[m] for r, m in zip(findings.before, mine, strict=True)])
        sigma = findings.problem.sigma[joint]
        assert sum(parts.values()) == pytest.approx(sigma**2 * np.mean(before**2), rel=1e-9)
        assert min(parts.values()) >= 0.0
        assert parts["noise"] == pytest.approx(sigma**2, rel=0.1)
        assert parts["unexplained"] < 0.2 * parts["noise"]
    # Stribeck friction of 1.6 to 2.4 N m on all joints, cogging on the second alone
    assert where.budget(findings, 1)["cogging"] > 20 * where.budget(findings, 0)["cogging"]
    for joint in (0, 2):
        parts = where.budget(findings, joint)
        assert parts["stribeck_friction"] > 0.8 * (sum(parts.values()) - parts["noise"])


def test_what_is_left_above_noise_and_reversals_is_unexplained(findings):
    more = replace(findings, after=[2.0 * r for r in findings.after])
    parts, was = where.budget(more, 0), where.budget(findings, 0)
    left = sum(was[name] for name in ("noise", "reversals", "unexplained"))
    reversal = findings.reversal[0] ** 2
    assert parts["noise"] == pytest.approx(findings.problem.sigma[0] ** 2)
    assert parts["reversals"] == pytest.approx(reversal)
    assert parts["unexplained"] == pytest.approx(4 * left - parts["noise"] - reversal)


@pytest.fixture(scope="module")
def rows(findings):
    return where.RowStates.of(findings.problem, findings.best.hypothesis)


def test_every_row_has_its_state(findings, rows):
    problem = findings.problem
    first = problem.recordings[0].segment
    keep = problem.rows[0][:, 1]
    at = int(problem.rows[0][:, 0].sum())
    mine = slice(at, at + int(keep.sum()))
    assert (rows.joint[mine] == 1).all()
    for state, signal in (
        (rows.theta, first.theta),
        (rows.speed, first.theta_dot),
        (rows.acceleration, first.theta_ddot),
    ):
        np.testing.assert_array_equal(state[mine], signal[:: problem.band.step][keep, 1])
    np.testing.assert_allclose(rows.clock[mine], (first.time[:: problem.band.step] - first.time[0])[keep])
    assert rows.platform.shape == (len(rows.joint), 3)
    assert len(rows.joint) == problem.count


def test_the_clock_counts_from_each_runs_own_start():
    runs = [course(1, 1.0), course(2, 1.0)]
    logs = problem(runs, [run.torque for run in runs], starts=[40.0, 70.0])
    clock = where.RowStates.of(logs, Hypothesis(BASE)).clock
    assert 0.0 < clock.min() < 0.2
    assert 0.8 < clock.max() < 1.0


def told(findings, rows, mask: np.ndarray) -> dict[str, Regime]:
    """Regimes of joint 1 where its residual is 3 times the noise in `mask` and the noise elsewhere."""
    residual = np.where(mask & (rows.joint == 0), 3.0, 1.0)
    counts = [int(r.sum()) for r in findings.problem.rows]
    parts = np.split(residual, np.cumsum(counts)[:-1])
    return {entry.regime: entry for entry in where.regimes(findings, rows, parts, 0)}


def third(values: np.ndarray, rows, upper: bool) -> np.ndarray:
    """The rows of the joint's least or largest third of `values`."""
    size = np.abs(values)
    low, high = np.quantile(size[rows.joint == 0], [1 / 3, 2 / 3])
    return size > high if upper else size < low


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (lambda r: np.abs(r.speed) < 0.1, "within 0.1 rad/s of reversal"),
        (lambda r: r.speed > 0, "forward motion"),
        (lambda r: third(r.speed, r, True), "speed above"),
        (lambda r: third(r.acceleration, r, False), "acceleration below"),
        (lambda r: third(r.load, r, True), "load above"),
        (lambda r: r.clock < 0.5 * r.clock.max(), "first half of the runs"),
        (lambda r: r.platform[:, 2] > np.median(r.platform[r.joint == 0, 2]), "platform z above"),
    ],
)
def test_a_gap_put_somewhere_is_found_there(findings, rows, place, words):
    mask = place(rows)
    found = told(findings, rows, mask)
    name, entry = next((name, entry) for name, entry in found.items() if name.startswith(words))
    assert entry.share == 1.0
    assert entry.of_time == pytest.approx(mask[rows.joint == 0].mean(), abs=0.02)
    if entry.of_time < 0.5:
        assert name in list(found)[:3]


def test_angles_are_told_in_ten_bins(findings, rows):
    theta = rows.theta[rows.joint == 0]
    low, high = np.linspace(theta.min(), theta.max(), 11)[[4, 5]]
    found = told(findings, rows, (rows.theta >= low) & (rows.theta < high))
    assert next(iter(found)) == f"angle {low:.3g} to {high:.3g} rad"
    assert sum(name.startswith("angle") for name in found) == 10


def test_noise_alone_lies_nowhere(findings, rows):
    assert told(findings, rows, np.zeros(len(rows.joint), bool)) == {}


def test_a_regimes_share_is_of_the_energy_above_the_noise(findings, rows):
    """3 times the noise in forward motion, 2 elsewhere: 8 and 3 above it."""
    forward = rows.speed > 0
    parts = np.split(np.where(forward, 3.0, 2.0), np.cumsum([int(r.sum()) for r in findings.problem.rows])[:-1])
    (found,) = [one for one in where.regimes(findings, rows, parts, 0) if one.regime == "forward motion"]
    time = forward[rows.joint == 0].mean()
    assert found.of_time == pytest.approx(time, abs=1e-4)
    assert found.share == pytest.approx(8 * time / (8 * time + 3 * (1 - time)), abs=1e-4)


@pytest.mark.parametrize(("above", "told"), [(0.01, False), (0.03, True)])
def test_next_to_nothing_above_the_noise_lies_nowhere(findings, rows, above, told):
    parts = [np.full(int(r.sum()), (1 + above) ** 0.5) for r in findings.problem.rows]
    assert bool(where.regimes(findings, rows, parts, 0)) == told


def test_each_run_counts_for_its_length():
    """1 Hz in the long one, half as strong at 15 Hz in the short one."""
    runs = [course(1, 3.0), course(2, 1.2)]
    logs = problem(runs, [run.torque for run in runs])
    step = logs.band.period * logs.band.step
    counts = [int(rows[:, 0].sum()) for rows in logs.rows]
    parts = []
    for joints, count, hz, size in zip(logs.joints_of_rows, counts, (1.0, 15.0), (40.0, 20.0), strict=True):
        parts.append(np.zeros(len(joints)))
        parts[-1][joints == 0] = size * np.sin(2 * np.pi * hz * np.arange(count) * step)
    low, _, high, _ = where.spectrum(stub(problem=logs), parts, 0)
    assert high.share / low.share == pytest.approx(counts[1] / counts[0] / 4, rel=0.1)


@pytest.mark.parametrize(("hz", "band"), [(1.0, 0), (6.0, 1), (15.0, 2), (30.0, 3)])
def test_a_wave_lies_at_its_frequency(findings, hz, band):
    problem = findings.problem
    step = problem.band.period * problem.band.step
    parts = [5.0 * np.sin(2 * np.pi * hz * np.arange(int(r.sum())) * step) for r in problem.rows]
    found = where.spectrum(findings, parts, 0)
    assert [(entry.from_hz, entry.to_hz) for entry in found] == [
        (0.0, 3.0),
        (3.0, 10.0),
        (10.0, 20.0),
        (20.0, 40.0),
    ]
    assert found[band].share > 0.9
    assert sum(entry.share for entry in found) == pytest.approx(1.0, abs=1e-3)


def test_white_noise_lies_at_no_frequency(findings):
    random = np.random.default_rng(0)
    # what the band leaves of white noise, in its own unit
    parts = [findings.problem.band(random.standard_normal((5 * int(r.sum()), 1)))[:, 0] for r in findings.problem.rows]
    share = findings.problem.band.white_share**0.5
    energy = np.concatenate(parts) / share
    assert np.mean(energy**2) == pytest.approx(1.0, rel=0.1)
    bare = where.spectrum(findings, [3.0 * np.sign(np.sin(np.arange(len(p)))) * 0 for p in parts], 0)
    assert all(entry.share == 0.0 for entry in bare)


def test_the_noise_is_taken_off_each_band_of_frequencies():
    """Half as much of a wave as there is noise, which is white up to the band's end: the wave is all that is left."""
    run = course(1, 20.0)
    logs = problem([run], [run.torque])
    (rows,), random = logs.rows, np.random.default_rng(0)
    noise = logs.band(random.standard_normal((len(run.time), 1)))[:, 0] / logs.band.white_share**0.5
    wave = np.sin(2 * np.pi * 15.0 * np.arange(len(noise)) * logs.band.period * logs.band.step)
    values = (noise + wave)[rows[:, 0]]
    values = np.concatenate([values, np.zeros(int(rows[:, 1:].sum()))])
    assert where.spectrum(stub(problem=logs), [values], 0)[2].share > 0.8


def test_the_section_names_joints_and_runs(findings):
    section = where.where(findings).model_dump()
    assert [entry["joint"] for entry in section["joints"]] == [1, 2, 3]
    assert sum(entry["rows"] for entry in section["joints"]) == findings.problem.count
    moving = np.concatenate([r.segment.moving for r in findings.problem.recordings])
    assert section["left_out_at_rest_and_ends"] == pytest.approx(1 - moving.mean(), abs=1e-4)
    worst = section["worst_runs"]
    rms = {r.name: np.sqrt(np.mean(x**2)) for r, x in zip(findings.problem.recordings, findings.after, strict=True)}
    assert {entry["run"]: entry["after_over_noise"] for entry in worst} == pytest.approx(rms, abs=1e-3)
    assert [entry["after_over_noise"] for entry in worst] == sorted(rms[e["run"]].round(3) for e in worst)[::-1]
    assert section["bursts"] == []
    assert evaluate(findings.problem, findings.reference).cost > 2 * findings.problem.count


def test_the_strongest_burst_is_told_first(findings):
    """Two stretches of one run, the second twice as strong."""
    after = [values.copy() for values in findings.after]
    after[0][100:110] += 30.0
    after[0][400:410] += 60.0
    told = where.where(replace(findings, after=after)).bursts
    weak, strong = sorted(told, key=lambda burst: burst.from_s)
    assert [burst.from_s for burst in told] == [strong.from_s, weak.from_s]
    assert strong.over_noise > 1.5 * weak.over_noise


def test_a_spectrum_of_runs_shorter_than_its_window():
    """400 samples each, where 512 are wanted: as long as the longest run, at the level of the noise."""
    random = np.random.default_rng(3)
    runs = [course(seed, 0.4) for seed in (1, 2, 3)]
    logs = problem(runs, [run.torque + 0.3 * random.standard_normal(run.torque.shape) for run in runs])
    frequency, density = report._density(stub(problem=logs), Hypothesis(BASE))
    assert len(frequency) == len(density) == 200
    assert np.median(density) == pytest.approx(0.3 * (2e-3) ** 0.5, rel=0.2)  # one-sided, N m a root of a hertz


@pytest.mark.parametrize("window", [512, 301])
def test_the_spectrum_is_welchs(window):
    values = np.random.default_rng(4).standard_normal((1300, 3)).cumsum(axis=0)
    frequency, density = cross_density(values, values, 2e-3, window)
    expected = welch(values, 1 / 2e-3, nperseg=window, axis=0)
    np.testing.assert_allclose(frequency, expected[0])
    np.testing.assert_allclose(density, expected[1], rtol=1e-9, atol=1e-12 * np.abs(density).max())
