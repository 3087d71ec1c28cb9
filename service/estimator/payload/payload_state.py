"""What the payload estimate remembers, and what it is told of robot and rate."""

from __future__ import annotations

import numpy as np

from service.estimator import departure, slow
from service.estimator.payload import rest

BIN_TIME = 0.002  # s, resolution of an onset
WINDOW = 150  # bins in which the mass was told, how far back an onset is looked for
MEMORY_TIME = 3.0  # s, forgetting: longer than a carry, shorter than the drift of friction with temperature
# An unloaded gripper is the prior, within this; also the bound of the covariance when nothing excites.
PRIOR_STD = 2.0  # kg
# Smallest change that counts as a pick or release: friction and inertia errors imitate less than this.
SMALLEST_CHANGE = 0.12  # kg
# The least that ever hung after a release may be a tool left on since the model was identified; it is remembered for
# this long, for tools are changed and friction drifts.
GROUND_TIME = 600.0  # s
# Torque noise and small errors are alike for about this long, so a sample is worth period / this time; what a model
# with unmodelled effects leaves over lasts as long as a stretch of a move.
CORRELATION_TIME, MODEL_ERROR_TIME = 0.003, 0.015  # s
# Residuals are averaged over blocks of this length; what then stands out of the noise lasts longer by this factor.
BLOCK_TIME, COLOUR = 0.02, 3.0  # s, -
# Friction is learnt from means over so much of the fastest joint's way: phi turns by less than its noise does.
MEAN_PATH = 0.003  # rad
BLOCKS = 16  # with motion, over which their scatter is averaged
# A mass below nothing, or of nothing, shows a bias that other masses have too; it is remembered for this long.
SHORTFALL_TIME = 30.0  # s
# A mass that is not trusted any longer leaves the feed-forward torque: so fast where it has become lighter, and so
# slowly for good, that trust lost for a moment does not show.
LIGHTER_TIME, LEAVING_TIME = 0.05, 1.0  # s
# A gripper that nobody hears of works while the robot stands still: after so long without motion that tells the mass it
# is not known any more, until so much motion has told it.
STILL_TIME, TELLING_TIME = 0.12, 0.15  # s
# A mass that only so much motion has told may be one odd stretch of torque.
LEAST_TIME = 0.02  # s
# Torque constants that nobody calibrated hold to some 5 %, and to 7 with what else of the model moves with them: two of
# these standard deviations. Without a known load nothing shows by how much all masses are off.
UNCALIBRATED = 0.035
LOADS = 3  # m and, where the fourth axis turns, the m d_1 and m d_2 of `turning`
PAIRS = LOADS * (LOADS + 1) // 2 - 1  # of loads that share information, the mass with itself apart
FINEST = 32767.0  # steps to either side of nothing that two bytes have
# One standard deviation of m d: 4 kg at 50 mm.
OFFSET_STD = 0.2  # kg m
WEIGHT, RESIDUAL, COLUMN = range(3)  # of a joint's sums over a block

STATE = np.dtype(
    [
        ("information", "f8", (LOADS, LOADS)),
        ("moment", "f8", LOADS),
        ("drag", "f8", (LOADS, departure.COUNT)),  # sum of weight column x: what delta adds to the moment
        ("whole_information", "f8"),  # kg^-2, the same three of the mass since the last change, none of it forgotten
        ("whole_moment", "f8"),  # for what the model lacks
        ("whole_drag", "f8", departure.COUNT),
        ("bin_information", "f8", WINDOW),  # of the mass
        ("bin_moment", "f8", WINDOW),
        ("bin_drag", "f8", (WINDOW, departure.COUNT)),  # of a robot without a fourth axis
        ("bin_told", "f8", WINDOW),
        # narrower, since a controller has little memory: of the offsets too, while the fourth axis turns
        ("swing_information", "f4", (WINDOW, PAIRS)),  # by `pair`
        ("swing_moment", "f4", (WINDOW, LOADS - 1)),
        # of the mass: of a robot with a fourth axis; in steps of 1 / FINEST of a load's largest in the bin
        ("swing_drag", "i2", (WINDOW, LOADS, departure.COUNT)),
        ("swing_step", "f4", (WINDOW, LOADS)),
        ("filling_drag", "f8", (LOADS, departure.COUNT)),  # the same of the bin that is being filled
        ("turns", "i8"),  # whether the robot has one
        ("told", "f8"),  # samples that the information is from
        ("active", "i8"),  # loads to be found: the mass alone, or all where the fourth axis turns
        ("turning", "i8"),  # samples for which they still are
        ("offset", "f8", 2),  # kg m, of the load from the fourth axis
        ("head", "i8"),  # bin that is being filled
        ("in_bin", "i8"),  # samples in it
        ("filled", "i8"),  # bins since the last change, at most WINDOW
        ("changed", "i8"),  # samples since the load changed, where this sample shows that it has
        ("load", "f8"),  # kg, mass at the last event, then whenever it is trusted
        ("load_variance", "f8"),  # kg^2, of it then, without what friction does
        ("load_drag", "f8", departure.COUNT),  # which is this, a departure
        ("load_before", "f8"),  # kg, the same before the last event
        ("last_event", "i8"),
        ("quiet", "i8"),  # samples since then
        ("sure_for", "f8"),  # s of them in which the mass was sure
        ("burst", "f8"),  # events of late, leaking
        ("blocks", "f8", BLOCKS),  # squared residuals at right angles to phi over what the noise explains, a ring
        ("block", "i8"),  # the next to be written
        ("inflation", "f8"),  # of the variance of the noise, of now
        ("measured", "f8"),  # the same without its least value
        ("raw_information", "f8"),  # information without inflation
        ("excess", "f8"),  # of the blocks' scatter over the noise, over BIAS_TIME
        ("scatter", "f8"),  # of the blocks, over the same
        ("leverage", "f8"),  # kg^-2, what a block says of the mass, over the same
        ("judged", "f8"),  # share of BIAS_TIME that the three have been averaged over so far
        ("bias", "f8"),  # kg^2, variance of what the model's error does to a mass for good
        ("hidden", "f8"),  # kg^2, of a change that the newest samples suggest and that may be the model's error
        ("wrong_for", "f8"),  # s
        ("shortfall", "f8"),  # kg, how far below nothing masses have been of late, or off it where nothing hung
        ("grounded", "i8"),  # whether a mass was ever known after a release
        ("ground", "f8"),  # kg, the least of those, whichever way it was off nothing
        ("in_block", "i8"),
        ("path", "f8"),  # rad, of the fastest joint since friction was learnt from
        ("clock", "i8"),  # samples taken
        ("ended", "i8", BLOCKS),  # when each block did
        ("fresh", "i8"),  # blocks since the last change, as far as they are kept
        ("creeping", "f8", (3, COLUMN + LOADS)),  # the same sums of samples in which a joint creeps
        ("creeping_time", "f8"),  # s of them
        ("sticking", "f8"),  # what they scatter by over their noise, over CREEPING_TIME
        ("breakaway", "f8"),  # inflation of the variance of the noise for that
        ("creeps", "i8", 3),  # of this sample, whether a joint does
        ("sums", "f8", (BLOCKS, 3, COLUMN + LOADS)),  # of each block, a joint: weight, residual and loads times weight
        ("departure", departure.STATE),
        ("slow", slow.STATE),
        ("rest", rest.STATE),
        # scratch: sums since an onset and before it, of all loads and of the mass alone
        ("since_information", "f8", (LOADS, LOADS)),
        ("since_moment", "f8", LOADS),
        ("since_drag", "f8", (LOADS, departure.COUNT)),
        ("before_information", "f8", (LOADS, LOADS)),
        ("before_moment", "f8", LOADS),
        ("pull", "f8", LOADS),
        ("found", "f8", LOADS),
        ("step", "f8", LOADS),
        ("inverse", "f8", (LOADS, LOADS)),
        ("inverse_before", "f8", (LOADS, LOADS)),
        ("inverse_spread", "f8", (LOADS, LOADS)),
        ("spread", "f8", (LOADS, LOADS)),
        ("contrast", "f8", (LOADS, departure.COUNT)),
        ("delta_before", "f8", departure.COUNT),  # of the departure, before a block was learnt from
        ("known", "f8", 3),  # of this sample, N m: of the load's offset
        ("shape", "f8", (3, departure.PARTS)),  # of this sample: direction, speed, 1, torque, that of ball joints
        ("column", "f8", (3, LOADS)),  # of this sample: what each load does, phi N m/kg and swing N m/(kg m)
        ("residual", "f8", 3),  # of this sample, N m, measured minus predicted without payload
        ("weight", "f8", 3),  # of this sample, (N m)^-2, 0 where a joint has nothing to say
        ("resting", "i8"),  # whether nothing moves in this sample
        ("behind", "i8"),  # whether it is told behind a low-pass of the report
        ("commanded", "i8"),  # whether it is told by a command, without the noise of a report
        ("still", "f8"),  # s, without motion that tells the mass
        ("unheard", "i8"),  # whether a gripper that nobody hears of may have worked in a rest since
        ("untold", "f8"),  # s of motion that it takes until the mass is known again
        ("crept", "f8"),  # s of slow motion since such a rest, until the mass is known again
        ("gripper", "i8"),  # of this sample, schemas.messages.Gripper
        ("gripper_before", "i8"),
        ("mass", "f8"),  # kg
        ("std_dev", "f8"),  # kg, what trust goes by
        ("random_std_dev", "f8"),  # kg, of the error that differs from one mass to the next
        ("common_std_dev", "f8"),  # kg, of the error that all masses of the robot have in common
        ("trusted", "i8"),
        ("usable", "f8"),  # kg, that the feed-forward torque reckons with
    ],
    align=True,
)

SETTINGS = np.dtype(
    [
        ("forgetting", "f8"),
        ("departure_forgetting", "f8"),
        ("prior", "f8", departure.COUNT),
        ("bin_size", "i8"),  # samples
        ("block_size", "i8"),
        ("remember", "f8"),  # per sample, of the shortfall
        ("rise", "f8"),  # per sample, of the least mass after a release towards that of now
        ("lighten", "f8"),  # per sample, of what a mass not trusted is lighter by
        ("leave", "f8"),  # per sample, of a mass not trusted
        ("model_error", "f8"),  # squared, over the noise of a block
        ("information_weight", "f8"),  # share of a sample that is new information
        ("period", "f8"),  # s
        ("max_payload", "f8"),  # kg
        ("common_share", "f8"),  # of a mass, standard deviation of what the torque constants put all masses off by
        ("unsure", "f8"),  # kg^2, variance of a mass for what is not known of the effects
        ("turns", "i8"),  # whether the robot has a fourth axis
        ("settling", "f8"),  # bins, time constant of the low-pass that the torque is reported behind; 0: none
    ],
    align=True,
)


def sample_variance(noise: np.ndarray, model_error: np.ndarray) -> np.ndarray:
    """Variance (3,) (N m)^2 to weigh a torque sample with, from rms (3,) N m of white noise and of what the model left.

    A model error well below the noise is told from the noise's own colour by nothing, so it counts for less.
    """
    square = np.square(model_error)
    shown = square / np.maximum(square + np.square(noise), 1e-12)
    return np.square(noise) + shown * square * MODEL_ERROR_TIME / CORRELATION_TIME


def settings(
    period: float,
    prior: np.ndarray,
    max_payload: float,
    model_error: np.ndarray,
    variance: np.ndarray,
    torque_constant_error: float | None = None,
    unsure: float = 0.0,
    turns: bool = False,
    lag: float = 0.0,
) -> np.ndarray:
    """One SETTINGS record. period: s. prior: (COUNT,) of departure. max_payload: kg. model_error: (3,) N m rms that the
    model left where it was identified. variance: (3,) (N m)^2, as `sample_variance`. torque_constant_error: standard
    error of the torque constants as a share, None where nobody calibrated them. unsure: kg, standard deviation of a
    mass for what is not known of the effects. turns: whether the robot has a fourth axis. lag: s, time constant of the
    low-pass that the torque is reported behind."""
    record = np.zeros((), SETTINGS)
    for name, time in (("bin_size", BIN_TIME), ("block_size", BLOCK_TIME)):
        record[name] = max(1, round(time / period))
    record["forgetting"] = np.exp(-period / MEMORY_TIME)
    for name, time in (("remember", SHORTFALL_TIME), ("lighten", LIGHTER_TIME), ("leave", LEAVING_TIME)):
        record[name] = np.exp(-period / time)
    record["rise"] = period / GROUND_TIME
    record["departure_forgetting"] = np.exp(-record["block_size"] * period / departure.MEMORY_TIME)
    record["information_weight"] = min(1.0, period / CORRELATION_TIME)
    record["model_error"] = (
        record["block_size"] * record["information_weight"] * np.mean(np.square(model_error) / variance)
    )
    record["prior"], record["period"], record["max_payload"] = prior, period, max_payload
    record["common_share"] = UNCALIBRATED if torque_constant_error is None else torque_constant_error
    record["unsure"], record["turns"] = unsure**2, turns
    record["settling"] = lag / (record["bin_size"] * period)
    return record


def start(state: np.ndarray, prior: np.ndarray, turns: bool = False) -> None:
    """An empty gripper, nothing known; prior: (COUNT,) of departure. turns: whether the robot has a fourth axis."""
    state[:] = np.zeros((), STATE)
    state["turns"] = turns
    state["information"][..., range(LOADS), range(LOADS)] = [PRIOR_STD**-2, OFFSET_STD**-2, OFFSET_STD**-2]
    state["active"] = state["filled"] = 1
    state["untold"] = LEAST_TIME
    state["blocks"] = state["inflation"] = state["measured"] = state["sticking"] = state["breakaway"] = 1.0
    state["raw_information"] = state["whole_information"] = PRIOR_STD**-2
    state["std_dev"] = state["random_std_dev"] = PRIOR_STD
    state["ground"] = SMALLEST_CHANGE  # before the first release nothing tells a tool from what was picked
    departure.start(state["departure"], prior)
