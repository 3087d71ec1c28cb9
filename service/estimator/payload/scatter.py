"""How far may the noise be believed? Read off the residuals at right angles to phi, which no payload can cause: in the
mean over stretches of a move they show what the model lacks, and the mass is as much less certain.
"""

from __future__ import annotations

from schemas.kernels import kernel, part
from service.estimator import departure
from service.estimator.payload.payload_state import BLOCKS, COLOUR, COLUMN, LOADS, MEAN_PATH, RESIDUAL, WEIGHT

# The newest few blocks, which may already speak for more scatter than the average does.
NEWEST, NEWEST_SHARE = 4, 0.6
# Noise that is white from sample to sample averages better than CORRELATION_TIME says, down to this.
LEAST_INFLATION = 0.4
LEAST_LEARNING = 0.1  # the same of friction and scale, which many moves have a say in
BIAS_TIME = 3.0  # s of motion over which what the model lacks is averaged
OUTLYING = 0.3  # of the scatter of a single block, which noise alone makes three times its mean now and then
ONSET_DOUBT = 3  # bins by which an onset is found too late
PENDING = 5  # newest blocks that a change not yet found may lie in
# A gear that sticks more than it did shows while a joint sets out and stops, some 50 ms of a move: what samples with a
# creeping joint scatter by is averaged apart, over so much of them.
CREEPING_TIME = 0.5  # s


@part
def scatter_kernel(settings, state):
    """Average of what the residuals of a block show at right angles to phi, friction and offset taken off, over their
    noise."""
    if state.creeps[0] + state.creeps[1] + state.creeps[2] > 0:
        _add(state, state.creeping)
        state.creeping_time += settings.period
    _add(state, state.sums[state.block])
    for i in range(3):
        state.known[i] = state.column[i, 1] * state.offset[0] + state.column[i, 2] * state.offset[1]
    departure.gather_kernel(state.departure, state.column, state.residual, state.known, state.weight, state.shape)
    state.in_block += 1
    state.clock += 1
    state.path += settings.period * max(abs(state.shape[0, 1]), abs(state.shape[1, 1]), abs(state.shape[2, 1]))
    if state.path >= MEAN_PATH or state.in_block >= settings.block_size:
        state.path = 0.0
        departure.eliminate_kernel(state.departure)
    if state.in_block < settings.block_size:
        return
    state.in_block = 0
    _judge_creeping(state)
    own, leverage = _misfit(state.sums[state.block], state.offset)
    if own >= 0.0:
        oldest = (state.block + 1) % BLOCKS
        share = settings.block_size * settings.period / BIAS_TIME
        state.excess += share * (max(0.0, state.blocks[oldest] - 1.0) - state.excess)
        state.scatter += share * (state.blocks[oldest] - state.scatter)
        state.leverage += share * (leverage - state.leverage)
        state.judged += share * (1.0 - state.judged)
        state.blocks[state.block], state.ended[state.block] = own, state.clock
        if state.active > 1:
            _look_again(state)
            state.fresh = min(BLOCKS - 2, state.fresh + 1)
        found = state.measured = _inflate(state)
        # friction is not to learn from what it cannot be: the block itself has a say
        doubtful = max(LEAST_LEARNING, found, _inflation(OUTLYING * own))
        _note_delta(state)
        departure.learn_kernel(state.departure, settings.prior, settings.departure_forgetting, doubtful)
        _weigh_load_again(state)
        state.block = oldest
    state.sums[state.block] = 0.0


@kernel
def _add(state, sums):
    """Take the sample into the sums of a block."""
    for i in range(3):
        left, weight = state.residual[i], state.weight[i]
        for a in range(departure.PARTS):
            left -= state.shape[i, a] * state.departure.delta[departure.place(i, a)]
        sums[i, WEIGHT] += weight
        sums[i, RESIDUAL] += weight * left
        for p in range(LOADS):
            sums[i, COLUMN + p] += weight * state.column[i, p]


@kernel
def _judge_creeping(state):
    """state.breakaway, from what the samples of a block in which a joint creeps show."""
    own = _misfit(state.creeping, state.offset)[0]
    if own >= 0.0:
        share = state.creeping_time / CREEPING_TIME
        state.sticking += share * (own - state.sticking)
        state.breakaway = _inflation(state.sticking)
    _empty_creeping(state)


@kernel
def _empty_creeping(state):
    state.creeping[:] = 0.0
    state.creeping_time = 0.0


@kernel
def _misfit(sums, offset):
    """What a block's mean residuals show at right angles to phi, a degree of freedom, over their noise; -1: nothing is
    known. And what the block says of the mass, kg^-2."""
    along = leverage = total = 0.0
    moving = 0
    for i in range(3):
        weight = sums[i, WEIGHT]
        if weight > 0.0:
            moving += 1
            left = sums[i, RESIDUAL] - sums[i, COLUMN + 1] * offset[0] - sums[i, COLUMN + 2] * offset[1]
            along += sums[i, COLUMN] * left / weight
            leverage += sums[i, COLUMN] * sums[i, COLUMN] / weight
            total += left * left / weight
    if moving < 2 or leverage <= 0.0:
        return -1.0, 0.0
    return max(0.0, total - along * along / leverage) / (moving - 1), leverage


@kernel
def _inflate(state):
    """state.inflation from the blocks of late, which it returns as it would be without its least value."""
    average = newest = 0.0
    # where a load swings, a change shows here before it is found; it is not to hide itself
    fresh = PENDING if state.active > 1 else 0
    for n in range(fresh, BLOCKS):
        average += state.blocks[(state.block - n + BLOCKS) % BLOCKS] / (BLOCKS - fresh)
    for n in range(fresh, fresh + NEWEST):
        newest += state.blocks[(state.block - n + BLOCKS) % BLOCKS] / NEWEST
    found = _inflation(max(average, NEWEST_SHARE * newest))
    state.inflation = max(LEAST_INFLATION, found)
    return found


@kernel
def _look_again(state):
    """Judge the blocks since the last change anew, by the offset of now."""
    index = state.block
    for _ in range(state.fresh):
        index = index - 1 if index > 0 else BLOCKS - 1
        state.blocks[index] = max(0.0, _misfit(state.sums[index], state.offset)[0])


@kernel
def part_blocks(settings, state, samples):
    """A load changed `samples` ago: the block in which it did says nothing of the model."""
    begun = state.clock - samples
    if begun > state.clock - state.in_block:
        state.in_block = 0
        state.sums[state.block] = 0.0
        _empty_creeping(state)
    state.fresh = 0
    if state.active > 1:
        _note_delta(state)
        departure.unlearn_kernel(state.departure, settings.prior)  # which a swinging load looks like until it is found
        _weigh_load_again(state)
    index = state.block
    for _ in range(BLOCKS - 1):
        index = index - 1 if index > 0 else BLOCKS - 1
        if state.ended[index] - settings.block_size >= begun:
            state.fresh += 1
        elif state.ended[index] > begun - ONSET_DOUBT * settings.bin_size:
            state.blocks[index] = 1.0
        else:
            break


@kernel
def _note_delta(state):
    for a in range(departure.COUNT):
        state.delta_before[a] = state.departure.delta[a]


@kernel
def _weigh_load_again(state):
    """The load believed so far by what is known of friction and scale now: what these do to a mass is no step of it."""
    for a in range(departure.COUNT):
        state.load -= state.load_drag[a] * (state.departure.delta[a] - state.delta_before[a])


@kernel
def _inflation(scatter):
    """How much less a sample says than its noise allows, for blocks that scatter so."""
    return scatter + (COLOUR - 1.0) * max(0.0, scatter - 1.0)
