"""What is said of the mass: its standard deviation, whether to trust it, what happened to it. Nothing is trusted before
it is excited, nor while it contradicts what a gripper can do.
"""

from __future__ import annotations

import math

from schemas.kernels import kernel, part
from schemas.messages import Gripper, PayloadEvent
from service.estimator import departure
from service.estimator.payload.loads import begin_whole, locate, prior_of, weigh_whole
from service.estimator.payload.payload_state import COLOUR, LEAST_TIME, SMALLEST_CHANGE, WINDOW
from service.estimator.payload.scatter import LEAST_INFLATION

# So soon after an event a smaller part of the load than this is the estimate settling, not the next event.
REFINING_TIME, REFINING_SHARE = 0.15, 0.5  # s, -
# A mass that was sure for so long since its event is refined: another step the same way is another part.
REFINED_TIME = 0.1  # s
GRIPPER_TIME = 0.03  # s, no gripper lets go again sooner
EVENT_SIGMAS = 3.0  # standard deviations of now and then that a change of load stands out of
# A pick or release is reported once its step stands out of one standard deviation this many times, which for a heavy
# load is well before its mass is trusted.
CLEAR_STEP = 10.0
# The same where most of that is what the model lacked when it was identified, which unlike noise is not drawn anew with
# every sample.
BIASED_STEP = 4.0
# A change whose onset is further back than this, while the mass is not sure or the model lacks as much as a load, or
# after which the robot sets out from a rest so long as slowly as nothing tells the mass in, is believed, and no event:
# of a late one nobody knows what it is about.
FRESH_TIME = 0.29  # s of motion
# Where what it lacks is so many times that of then, squared, gears are soft and settle: no step at rest is an event.
SOFT = 10.0
# What the model lacks is this many times the noise: what it says of the mass is not to be used.
FOREIGN = 12.0
# What it lacks is so many times the noise over some seconds of motion and, what is learnt taken off, now: such a thing
# may do more along the mass than at right angles to it, where that shows.
LASTING, STILL_LASTING = 1.5, 3.0
# What the model lacks over some seconds of motion comes again with every move: this share of it, brought to the
# platform, does not average out of the mass.
BIAS_SHARE = 0.55
# Where it is as much as a load, it is all of it at one place and in one direction, and as much along the mass as at
# right angles to it.
PLACE_SHARE = 1.0
# A move's directions average out; what the newest samples say beyond so many standard deviations of it is no average.
AVERAGE_SIGMAS = 3.0
# Of a block it is all, which this much motion halves: what a gear rubs more or less keeps its sign for a stroke.
BIAS_AVERAGING = 0.2  # s
# What is left beside a command is no sensor's noise: it lasts from block to block of a move, and a mean of blocks has
# so many times the variance of one of white noise: their correlation says 1.6 on robots drawn at random, and 1.0 where
# the torque is as reported.
LEFT_BESIDE = 1.5
# What hangs there after every release is a tool, a load that nobody let go of, or the platform's own weight by a wrong
# torque constant: the mass of what was picked is off by it or by nothing, and this share of it covers either way within
# two standard deviations, and what a mass still settles by.
TOOL_SHARE = 0.75
# It may turn round with the motion, as what a shaft rubs with does: where both loads are more than twice what always
# hangs there, a step between them of less than this share of it is no event.
OFF_SHARE = 2.5
# Trusted when one standard deviation is below share * mass + floor.
TRUST_SHARE, TRUST_FLOOR = 0.1, 0.03  # -, kg
# A shortfall counts where a mass is this sure, and shows for this long, by more than this: a release is not seen at
# once.
SHORTFALL_STD, SETTLING_TIME, SHORTFALL_FLOOR = 0.1, 0.3, 0.02  # kg, s, kg
# Beyond this many standard deviations and this much below nothing, or above the greatest payload, a mass is none.
CONTRADICTION, CONTRADICTION_FLOOR = 2.0, 0.05  # -, kg
# A gripper makes this many events a second at most; a burst of so many more is no gripper.
EVENT_RATE, EVENT_BURST = 5.0, 3.0  # 1/s, -
EMPTY_SIGMAS = 5.0  # by which a mass contradicts an open gripper

UNKNOWN, OPEN = Gripper.UNKNOWN.value, Gripper.OPEN.value


@part
def conclude(settings, state):
    """Mass, standard deviation and trust of now. Returns the event that they amount to."""
    mass = locate(state)
    doubt, unlearnt = _doubt(settings, state)
    # what was learnt while the model fitted says less once it no longer does
    worse = max(1.0, state.inflation * state.information[0, 0] / state.raw_information)
    lacking, gentle = _lacking(settings, state)
    known_empty = state.gripper == OPEN
    std_dev = math.sqrt(worse * state.inverse[0, 0] + doubt + state.bias + settings.unsure)
    contradicted = known_empty and mass > EMPTY_SIGMAS * std_dev + SMALLEST_CHANGE
    std_dev = _with_shortfall(settings, state, mass, std_dev)
    trusted = is_sure(std_dev, mass) and state.inflation < FOREIGN
    state.quiet += 1
    state.burst = max(0.0, state.burst - EVENT_RATE * settings.period)
    held = min(max(mass, 0.0), settings.max_payload)
    margin = CONTRADICTION * std_dev + CONTRADICTION_FLOOR
    if mass < -margin or mass > settings.max_payload + margin or state.burst > EVENT_BURST:
        trusted = False
        std_dev = max(std_dev, abs(mass - held))
    if contradicted:  # the gripper says one thing, the torque another
        trusted, std_dev = False, max(std_dev, held)
    elif known_empty:
        trusted, held, std_dev = True, 0.0, 0.0
    event = _happened(settings, state, held, std_dev, doubt, lacking, trusted)
    if event != PayloadEvent.NONE.value:
        state.untold = min(state.untold, LEAST_TIME)  # weighed anew
        begin_whole(state)
    state.mass = _averaged(settings, state, mass, held)
    borne_out = trusted and (known_empty or state.untold == 0.0)
    std_dev = _scattering(settings, state, std_dev, doubt - unlearnt, worse, gentle)
    fits = state.scatter <= LASTING * state.judged or state.inflation < STILL_LASTING
    sure = borne_out and (known_empty or (fits and is_sure(std_dev, mass)))
    _say(settings, state, mass, held, std_dev, sure)
    if sure:
        state.sure_for += settings.period
    _reckon(settings, state, borne_out, sure)
    return event


@kernel
def _doubt(settings, state):
    """Variance of the mass, kg^2, for what is not known of friction and scale, and the part for what is not learnt yet;
    state.contrast[0]: what each of them does to it."""
    drag = state.contrast[0]
    for a in range(departure.COUNT):
        drag[a] = 0.0
        for p in range(state.active):
            drag[a] += state.inverse[0, p] * state.drag[p, a]
    whole, unlearnt = departure.doubt_kernel(state.departure, settings.prior, drag)
    return whole, unlearnt


@kernel
def _lacking(settings, state):
    """state.bias: variance of the mass, kg^2, for what the model lacks. Returns how much that is over the noise, -1
    before anything tells, and the variance that it has since the last change, kg^2."""
    state.bias = gentle = 0.0
    if not state.leverage > 0.0:
        return -1.0, gentle
    # averages that are not full yet are judged by what is in them
    lacking = settings.model_error + max(state.excess / state.judged, (state.inflation - 1.0) / COLOUR)
    state.bias = BIAS_SHARE * BIAS_SHARE * lacking * state.judged / state.leverage
    gained = state.raw_information - prior_of(0)
    if gained > 0.0:  # a block since the last change may tell less of the mass, in a gentle move
        now = max(lacking, state.scatter / state.judged - LEAST_INFLATION)
        share = max(BIAS_SHARE * BIAS_SHARE, 1.0 / (1.0 + state.told * settings.period / BIAS_AVERAGING))
        gentle = share * now * state.told / (settings.block_size * gained)
    return lacking, gentle


@kernel
def _with_shortfall(settings, state, mass, std_dev):
    """The standard deviation, kg, with what a mass below nothing, or of nothing, has shown to be wrong with others."""
    state.shortfall *= settings.remember
    known_empty = state.gripper == OPEN
    # what hangs on nothing is an error too, whichever way
    empty = known_empty or (state.gripper == UNKNOWN and state.load < SMALLEST_CHANGE and mass < SMALLEST_CHANGE)
    wrong = (abs(mass) if empty else -mass) - CONTRADICTION * std_dev - SHORTFALL_FLOOR
    lasting = std_dev < SHORTFALL_STD and wrong > state.shortfall
    state.wrong_for = state.wrong_for + settings.period if lasting else 0.0
    if state.wrong_for > (0.0 if known_empty else SETTLING_TIME):
        state.shortfall += settings.period / SETTLING_TIME * (wrong - state.shortfall)
    std_dev = math.hypot(std_dev, state.shortfall)
    if empty:
        std_dev = max(std_dev, (abs(mass) - SHORTFALL_FLOOR) / CONTRADICTION)
    return std_dev


@kernel
def _happened(settings, state, held, std_dev, doubt, lacking, trusted):
    """The event that a mass of `held` kg amounts to; the load believed becomes it where it is one, or sure."""
    as_identified = 0.0 <= lacking <= 2.0 * settings.model_error
    soft = lacking > SOFT * settings.model_error
    known_empty = state.gripper == OPEN
    if state.last_event == PayloadEvent.RELEASE.value and _refining(settings, state):
        state.load = min(state.load, held)  # the rest of a release is no second one
    own = max(0.0, std_dev * std_dev - doubt)
    if known_empty:
        own = std_dev * std_dev
        for a in range(departure.COUNT):
            state.contrast[0, a] = 0.0
    variance = _step_variance(state, held - state.load, own)
    foreign = not as_identified and state.bias > SMALLEST_CHANGE * SMALLEST_CHANGE
    least = _least_step(settings, state, own, variance, as_identified, foreign)
    refined = own < state.load_variance and (held - state.load) ** 2 < variance + state.load_variance
    event = PayloadEvent.NONE.value
    if state.rest.step != 0.0:
        if not (foreign and soft):
            event = (PayloadEvent.PICK if state.rest.step > 0.0 else PayloadEvent.RELEASE).value
            _note_event(state, event, state.load)
        _believe(state, held, own)
    elif trusted or refined or (held - state.load) ** 2 > least:
        late = state.filled * settings.bin_size * settings.period > FRESH_TIME
        late &= not known_empty and (foreign or not trusted)
        late |= state.gripper == UNKNOWN and state.crept > FRESH_TIME
        if late:
            _believe(state, held, own)
            state.crept = 0.0 if trusted and state.unheard == 0 else state.crept
        else:
            event = _event(settings, state, held, own, variance, trusted or refined)
    return event


@kernel
def _scattering(settings, state, std_dev, learnt, worse, gentle):
    """The standard deviation, kg, with what a change may hide in; state.random_std_dev: of the error that differs from
    one mass to the next: the noise as it is measured, and what friction does of which nothing is learnt yet.

    To trust a mass, the noise has a least value, and the errors of what was `learnt`, kg^2, and of the model count too.
    These come again with every move and every mass.
    """
    if state.gripper == OPEN:
        state.random_std_dev = std_dev
        return std_dev
    # a change may hide in what passes for the model's error; none to take a load away for
    here = (PLACE_SHARE / BIAS_SHARE) ** 2 * state.bias if lacks_a_load(settings, state) else 0.0
    more = max(0.0, max(gentle, here) - state.bias)
    std_dev = math.sqrt(std_dev * std_dev + state.hidden + more)
    noise = min(state.inflation, state.measured * (LEFT_BESIDE if state.commanded != 0 else 1.0))
    floor = worse * state.inverse[0, 0] * (1.0 - noise / state.inflation)
    cautious = floor + learnt + state.bias + more + settings.unsure
    state.random_std_dev = math.sqrt(max(0.0, std_dev * std_dev - cautious))
    return std_dev


@kernel
def _say(settings, state, mass, held, std_dev, sure):
    """Trust, and the standard deviations with the error that all masses have in common."""
    known_empty = state.gripper == OPEN
    tool = 0.0  # of a gripper that is heard the shortfall says what hangs there when it is open
    if state.gripper == UNKNOWN:
        tool = TOOL_SHARE * _ground(settings, state, sure, max(state.mass, -mass))
    load = tool if tool > TOOL_SHARE * SMALLEST_CHANGE else 0.0  # less is no tool, and no reason to say nothing
    state.trusted = 1 if sure and (known_empty or is_sure(math.hypot(std_dev, load), mass)) else 0
    # a wrong torque constant makes a load of the platform's own weight, and the others heavier by as much: one error
    common = tool + settings.common_share * held
    state.common_std_dev = math.sqrt(common * common + (0.0 if known_empty else settings.unsure))
    state.std_dev = math.hypot(std_dev, common)


@kernel
def lacks_a_load(settings, state):
    """Whether what the model lacked when it was identified does to a mass what the smallest load does."""
    lacked = BIAS_SHARE * BIAS_SHARE * settings.model_error * state.judged
    return state.leverage > 0.0 and lacked > SMALLEST_CHANGE * SMALLEST_CHANGE * state.leverage


@kernel
def _averaged(settings, state, mass, held):
    """The mass to be said, kg, of `mass` by the newest samples and `held` in its bounds: where older ones are forgotten
    for what the model lacks (`step`), the average since the last change is nearer, for a move goes both ways."""
    if state.active > 1 or state.gripper == OPEN or not lacks_a_load(settings, state):
        return held
    average = weigh_whole(state)
    if (mass - average) ** 2 > AVERAGE_SIGMAS * AVERAGE_SIGMAS * state.bias:
        begin_whole(state)
        return held
    return min(max(average, 0.0), settings.max_payload)


@kernel
def is_sure(std_dev, mass):
    """Whether a mass is known well enough to be trusted, kg."""
    return std_dev < TRUST_SHARE * abs(mass) + TRUST_FLOOR


@kernel
def _ground(settings, state, sure, off):
    """The least, kg, that was known to hang there, or to be missing, after any release; before the first one a tool
    that nobody has seen yet, which is no more than ever hung there. off: the same of now."""
    if state.grounded != 0:
        state.ground += settings.rise * (off - state.ground)
    first = state.grounded == 0 and state.last_event == PayloadEvent.RELEASE.value
    if sure and (first or off < state.ground):
        state.grounded |= first
        state.ground = off
    return state.ground if state.grounded != 0 else min(state.ground, off)


@kernel
def _reckon(settings, state, borne_out, sure):
    """state.usable: only a mass that is sure gets in, load or tool. What motion does not bear out leaves smoothly, but
    for a release, which is a step by nature."""
    if sure:
        state.usable = state.mass
        return
    usable = min(state.usable, state.mass)
    if state.last_event != PayloadEvent.RELEASE.value or state.quiet * settings.period > REFINING_TIME:
        usable += (state.usable - usable) * settings.lighten
    state.usable = usable if borne_out else usable * settings.leave


@kernel
def _step_variance(state, step, own):
    """Of a step from the load believed so far, kg^2, where friction may do to the one what it does not to the other.
    own: kg^2, of the mass without friction. A step that is none for its size is not asked for."""
    if abs(step) <= SMALLEST_CHANGE:
        return own
    differs = state.contrast[1]
    for a in range(departure.COUNT):
        differs[a] = state.contrast[0, a] - state.load_drag[a]
    return own + departure.covariance_kernel(state.departure, differs, differs)


@kernel
def _least_step(settings, state, own, variance, as_identified, foreign):
    """Squared step from the load believed so far, kg^2, beyond which it is told before the mass is trusted. own: kg^2,
    of the mass without friction. variance: kg^2, of the step."""
    clear = CLEAR_STEP * CLEAR_STEP * variance
    biased = BIASED_STEP * BIASED_STEP * (variance + state.load_variance)
    if foreign:  # a wait for a clear step would make a late event of a change that was found in time
        unsettled = state.untold > 0.0 or state.quiet * settings.period <= REFINING_TIME
        return math.inf if unsettled else biased
    return min(clear, biased) if as_identified and own <= 2.0 * state.bias else clear


@kernel
def _event(settings, state, mass, own, variance, trusted):
    """What a mass says beside the one believed so far. Another step the same way only refines an event that is new."""
    step = mass - state.load
    soon = _refining(settings, state)
    since = state.quiet * settings.period
    small = abs(step) < REFINING_SHARE * state.load and since < REFINING_TIME
    sign = 1.0 if state.last_event == PayloadEvent.PICK.value else -1.0
    small |= since < GRIPPER_TIME and sign * (mass - state.load_before) > SMALLEST_CHANGE
    off = state.ground if state.grounded != 0 and state.gripper == UNKNOWN else 0.0
    small |= abs(step) < OFF_SHARE * off and min(mass, state.load) > 2.0 * off
    event = PayloadEvent.NONE.value
    least = max(SMALLEST_CHANGE, EVENT_SIGMAS * math.sqrt(variance + state.load_variance))
    if step > least:
        event = PayloadEvent.PICK.value
    elif step < -least:
        event = PayloadEvent.RELEASE.value
    before = state.load
    if trusted or event != PayloadEvent.NONE.value:
        _believe(state, mass, own)
    if event == PayloadEvent.NONE.value or small or (event == state.last_event and soon):
        return PayloadEvent.NONE.value
    _note_event(state, event, before)
    return event


@kernel
def _refining(settings, state):
    """Whether the mass may still be settling since the last event."""
    return state.quiet < WINDOW * settings.bin_size and state.sure_for < REFINED_TIME


@kernel
def _believe(state, mass, own):
    """A load of `mass`, its variance without what friction does, which is in state.contrast, `own`."""
    state.load, state.load_variance = mass, own
    for a in range(departure.COUNT):
        state.load_drag[a] = state.contrast[0, a]


@kernel
def _note_event(state, event, before):
    """before: kg, the load until then."""
    state.load_before = before
    state.last_event = event
    state.quiet, state.sure_for = 0, 0.0
    state.burst += 1.0
