"""How far the model scatters, block by block of a move, against weighted least squares and by hand."""

import numpy as np
import pytest

from service.estimator import departure
from service.estimator.departure import COUNT, PARTS
from service.estimator.payload import scatter
from service.estimator.payload.payload_state import BLOCKS, COLOUR, LOADS, STATE, settings, start
from tests.service.estimator.test_departure import PRIOR, slopes_of

PERIOD = 1e-3
SETTINGS = settings(PERIOD, PRIOR, 6.0, np.ones(3), np.ones(3))[()]
SIZE = int(SETTINGS["block_size"])


def fresh(active=1):
    states = np.zeros(1, STATE)
    start(states, PRIOR)
    (state,) = states
    state["active"] = active
    return state


def fill(state, random, resting):
    """A block of samples, and what least squares leave of its mean residuals: over the noise, a degree of freedom, and
    what it says of the mass."""
    state["departure"]["delta"] = delta = 0.3 * random.standard_normal(COUNT)
    state["offset"] = offset = random.standard_normal(2) if state["active"] > 1 else np.zeros(2)
    weight = random.uniform(0.2, 3.0, (SIZE, 3)) * ~np.isin(np.arange(3), resting)
    column, residual = random.standard_normal((SIZE, 3, LOADS)), random.normal(0.0, 2.0, (SIZE, 3))
    way = random.standard_normal((SIZE, 3, PARTS))
    for n in range(SIZE):
        state["column"], state["residual"], state["weight"], state["shape"] = column[n], residual[n], weight[n], way[n]
        scatter.scatter_kernel(SETTINGS, state)
    known = np.array([slopes_of(shape) @ delta for shape in way]) + column[:, :, 1:] @ offset
    moving = [joint for joint in range(3) if joint not in resting]
    mean = {name: np.sum(weight * values, axis=0)[moving] / weight.sum(axis=0)[moving]
            for name, values in (("left", residual - known), ("phi", column[:, :, 0]))}  # fmt: skip
    root = np.sqrt(weight.sum(axis=0)[moving])
    _, rest, *_ = np.linalg.lstsq((root * mean["phi"])[:, None], root * mean["left"], rcond=None)
    return rest[0] / (len(moving) - 1), np.sum((root * mean["phi"]) ** 2)


def misfit(residual, phi, weight):
    """What least squares leave of the mean of samples (N, 3) of joints that move, over the noise, a degree."""
    total = weight.sum(axis=0)
    left, load = (np.sum(weight * values, axis=0) / np.sqrt(total) for values in (residual, phi))
    _, rest, *_ = np.linalg.lstsq(load[:, None], left, rcond=None)
    return rest[0] / 2


def test_what_sticks_shows_in_the_samples_in_which_a_joint_creeps():
    """A quarter of a block, then none: those are judged apart, and averaged over half a second of them."""
    random, state = np.random.default_rng(6), fresh()
    phi, weight = random.standard_normal((SIZE, 3, LOADS)), random.uniform(0.2, 3.0, (SIZE, 3))
    creeps = np.zeros((SIZE, 3), int)
    creeps[[3, 4, 5, 12, 13], [0, 0, 1, 2, 2]] = 1
    apart = creeps.max(axis=1) > 0
    residual = random.standard_normal((SIZE, 3)) + 20.0 * apart[:, None] * [1, -1, 1]
    for flags in (creeps, 0 * creeps):
        for n in range(SIZE):
            state["column"], state["residual"], state["weight"] = phi[n], residual[n], weight[n]
            state["shape"], state["creeps"] = 0.0, flags[n]
            scatter.scatter_kernel(SETTINGS, state)
        own = misfit(residual[apart], phi[apart, :, 0], weight[apart])
        expected = 1.0 + 5 * PERIOD / 0.5 * (own - 1.0)
        assert state["sticking"] == pytest.approx(expected), "as it was, where nothing creeps"
        assert state["breakaway"] == pytest.approx(inflation(expected))
        assert expected > 3
        assert state["creeping_time"] == 0.0
        assert not state["creeping"].any()


def inflation(scattered):
    return scattered if scattered < 1 else COLOUR * scattered - (COLOUR - 1)


@pytest.mark.parametrize("active", [1, LOADS])
@pytest.mark.parametrize("resting", [(), (1,)], ids=["all move", "one rests"])
def test_a_block_is_judged_by_what_no_mass_explains_of_it(active, resting):
    random, state = np.random.default_rng(2), fresh(active)
    share = SIZE * PERIOD / scatter.BIAS_TIME
    excess = scattered = leverage = judged = 0.0
    for block in range(3):
        state["blocks"][block + 1] = 4.0  # the oldest, which is written next
        expected, said = fill(state, random, resting)
        assert state["blocks"][block] == pytest.approx(expected, rel=1e-9)
        excess += share * (3.0 - excess)
        scattered += share * (4.0 - scattered)
        leverage += share * (said - leverage)
        judged += share * (1.0 - judged)
        averages = [state[name] for name in ("excess", "scatter", "leverage", "judged")]
        assert averages == pytest.approx([excess, scattered, leverage, judged])
        assert (state["block"], state["in_block"], state["clock"]) == (block + 1, 0, (block + 1) * SIZE)
        assert state["ended"][block] == state["clock"]
        assert state["fresh"] == (block + 1) * (active > 1)
        assert not state["sums"][block + 1].any()
    state["fresh"] = BLOCKS - 2
    fill(state, random, resting)
    assert state["fresh"] == BLOCKS - 2, "the next to be written is none"


def test_a_block_in_which_one_joint_moves_tells_nothing_of_the_model():
    state = fresh()
    state["column"], state["residual"], state["weight"] = 1.0, 5.0, [1.0, 0.0, 0.0]
    for _ in range(SIZE):
        scatter.scatter_kernel(SETTINGS, state)
    assert (state["block"], state["judged"], state["inflation"]) == (0, 0.0, 1.0)
    assert not state["sums"][0].any()
    assert (state["blocks"] == 1.0).all()


@pytest.mark.parametrize("active", [1, LOADS])
@pytest.mark.parametrize("late", [0.2, 9.0], ids=["calm", "of late"])
def test_noise_counts_for_more_by_the_blocks_of_late(active, late):
    """Where a load swings, those in which a change may lie unfound are left out."""
    random, state = np.random.default_rng(3), fresh(active)
    newest = scatter.PENDING if active > 1 else 0
    ages = random.uniform(0.1, 1.5, BLOCKS)  # age 0 is the newest
    ages[newest : newest + scatter.NEWEST] = late
    state["block"] = 5
    state["blocks"] = ages[(5 - np.arange(BLOCKS)) % BLOCKS]
    found = scatter._inflate(state)
    scattered = max(ages[newest:].mean(), scatter.NEWEST_SHARE * late)
    assert found == pytest.approx(inflation(scattered))
    assert state["inflation"] == pytest.approx(max(scatter.LEAST_INFLATION, found))
    assert scatter._inflation(0.1) == 0.1
    assert scatter._inflation(2.0) == pytest.approx(1 + COLOUR)


def test_friction_learns_little_from_a_block_that_it_cannot_be():
    """The block itself counts, however calm those before it were."""
    learnt = []
    for scale in (1.0, 60.0):
        random, state = np.random.default_rng(4), fresh(LOADS)
        state["column"], state["weight"], state["shape"] = random.standard_normal((3, LOADS)), 1.0, 1.0
        state["residual"], state["offset"] = scale * np.array([1.0, -2.0, 0.5]), [0.3, -0.8]
        known = state["column"][:, 1:] @ [0.3, -0.8]
        for _ in range(SIZE):
            scatter.scatter_kernel(SETTINGS, state)
        by_block = inflation(scatter.OUTLYING * state["blocks"][0])
        learnt.append((state["departure"]["covariance"].copy(), max(state["inflation"], by_block)))
        expected = fresh()
        for name in ("column", "weight", "shape", "residual"):
            expected[name] = state[name]
        for _ in range(SIZE):
            departure.gather_kernel(
                expected["departure"], state["column"], state["residual"], known, state["weight"], state["shape"]
            )
        departure.eliminate_kernel(expected["departure"])
        departure.learn_kernel(expected["departure"], PRIOR, SETTINGS["departure_forgetting"], learnt[-1][1])
        np.testing.assert_allclose(state["departure"]["delta"], expected["departure"]["delta"], rtol=1e-9, atol=1e-15)
    assert learnt[1][1] > 10 * learnt[0][1]
    assert np.trace(learnt[1][0]) > np.trace(learnt[0][0]), "and knows less for it"


@pytest.mark.parametrize(("speed", "gathered"), [(-3.5, 1), (1.1, 3), (0.1, SIZE)], ids=["fast", "gentle", "slow"])
def test_friction_is_learnt_from_means_over_a_way(speed, gathered):
    state = fresh()
    state["column"], state["weight"], state["shape"][1, 1] = 1.0, 1.0, speed
    left = []
    for _ in range(SIZE):
        scatter.scatter_kernel(SETTINGS, state)
        left.append(state["departure"]["sum_weight"][0])
    assert left[:gathered] == [*range(1, gathered), 0]
    assert left[-1] == 0, "none is left for the next block"


def test_blocks_since_a_change_are_judged_anew_by_the_place_of_the_load():
    random, state = np.random.default_rng(5), fresh(LOADS)
    sums = random.uniform(0.5, 2.0, state["sums"].shape)
    state["sums"], state["offset"], state["block"], state["fresh"] = sums, [0.3, -0.4], 2, 4
    scatter._look_again(state)
    for block in range(BLOCKS):
        if block not in (1, 0, BLOCKS - 1, BLOCKS - 2):
            assert state["blocks"][block] == 1.0
            continue
        weight, pulled, *columns = sums[block].T
        left = pulled - np.array(columns[1:]).T @ [0.3, -0.4]
        root = np.sqrt(weight)
        _, rest, *_ = np.linalg.lstsq((columns[0] / root)[:, None], left / root, rcond=None)
        assert state["blocks"][block] == pytest.approx(rest[0] / 2, rel=1e-9)


@pytest.mark.parametrize("samples", [3, 8, 30, 95, 10_000])
def test_the_block_in_which_a_load_changed_says_nothing_of_the_model(samples):
    """Blocks lie end to end, but for a stretch of rest; 8 samples of the next are in."""
    state = fresh(LOADS)
    state["block"], state["in_block"], state["clock"] = 3, 8, 5000
    ends = 5000 - 8 - SIZE * np.arange(BLOCKS - 1) - 400 * (np.arange(BLOCKS - 1) >= 9)  # newest first
    ring = (2 - np.arange(BLOCKS - 1)) % BLOCKS
    state["ended"][ring], state["blocks"], state["sums"] = ends, 7.0, 1.0
    scatter.part_blocks(SETTINGS, state, samples)
    begun = 5000 - samples
    behind = ends - SIZE >= begun
    doubtful = ~behind & (ends > begun - scatter.ONSET_DOUBT * SETTINGS["bin_size"])
    assert state["fresh"] == behind.sum()
    np.testing.assert_array_equal(state["blocks"][ring], np.where(doubtful, 1.0, 7.0))
    parted = samples < 8
    assert state["in_block"] == (0 if parted else 8)
    assert state["sums"][3].any() != parted


def test_what_is_learnt_of_friction_moves_the_load_that_is_believed_too():
    """The same samples say another mass by another friction; the load before is said by as much another, no step."""
    random, state = np.random.default_rng(8), fresh()
    state["load"], state["load_drag"] = 2.0, random.standard_normal(COUNT)
    for _ in range(4 * SIZE):
        state["column"][:, 0], state["weight"], state["shape"] = 1.0, 1.0, random.standard_normal((3, PARTS))
        state["residual"] = slopes_of(state["shape"]) @ np.full(COUNT, 0.2) + random.standard_normal(3)
        scatter.scatter_kernel(SETTINGS, state)
    learnt = state["departure"]["delta"].copy()
    assert np.abs(learnt).max() > 0.05
    assert state["load"] == pytest.approx(2.0 - state["load_drag"] @ learnt)
    state["active"] = LOADS  # a load that swings looks like friction until it is found
    scatter.part_blocks(SETTINGS, state, SIZE)
    assert (state["departure"]["delta"] != learnt).any(), "taken back"
    assert state["load"] == pytest.approx(2.0 - state["load_drag"] @ state["departure"]["delta"])
