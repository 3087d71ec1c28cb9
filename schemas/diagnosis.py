"""The document that `diagnose` writes, `diagnosis.json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.robot import EffectEntry
from schemas.words import words

Verdict = Literal["within_noise", "explained", "partly_explained", "unexplained"]


class DocumentPart(BaseModel):
    """A table of a document that we write; a value that does not exist may be NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Online(DocumentPart):
    """Whether and how the online model contains an effect: computed from the present sample, as a state from sample to
    sample, in its settings, or between the true and the reported torque; or not at all."""

    carried: bool
    reason: Literal["present_sample", "state", "settings", "report", "no_online_form"]


CautionCode = Literal[
    "too_little_motion", "joints_at_rest", "one_way", "one_run", "beyond_any_robot", "several_arms", "runs_differ",
    "much_is_left", "other_joints", "sine_of_angle", "gravity", "closed_loop", "torque_held", "noise_coloured",
    "noise_unknown",
    "at_limit", "drives", "by_weight", "does_not_fall", "left_open", "no_shrink", "no_shrink_on", "varies", "by_place",
    "by_scale", "comes_again", "rivalled", "not_its_own", "misplaced", "degrees", "any_shape", "much_beside",
]  # fmt: skip
Advice = Literal[
    "record_runs", "record_all_joints", "record_reversals", "record_more", "check_description", "check_runs",
    "check_base", "measure_torque", "measure_noise", "log_quicker", "log_warm", "look_there", "say_degrees",
]  # fmt: skip


class Caution(DocumentPart):
    """A question that these data cannot answer. joints: those concerned, from 1. advice: what to record or to check.

    effect: the effect concerned. quantity: its parameter that is at its limit or undetermined. share, by `code`: the
    residual's share of the torque's rms, the share of the residual that depends on a quantity, the shrink that is too
    small, what the effect's torque shifted in time explains relative to the effect, or the share of bootstrap draws
    that prefer an alternative. run: the held-out log whose gap does not shrink. gain: of the control loop, torque per
    position error in gain_unit, the lowest of all logs; gain_most: the highest. pitch_m: path of the platform after
    which a force on it repeats. held_s: time after which the torque is updated.
    """

    code: CautionCode
    joints: list[int] = []
    advice: Advice
    effect: str | None = None
    quantity: str | None = None
    share: float | None = None
    run: str | None = None
    gain: float | None = None
    gain_most: float | None = None
    gain_unit: str | None = None
    pitch_m: float | None = None
    held_s: float | None = None


class Estimate(DocumentPart):
    """One parameter with its 95 % interval, which is a point where the value is fixed. meaning: in words."""

    value: float
    unit: str
    ci95: tuple[float, float]
    meaning: str = ""

    @property
    def fixed(self) -> bool:
        """Whether nothing was estimated."""
        return self.ci95[0] == self.ci95[1]


class NamedEffect(DocumentPart):
    """An effect that the data support. joints count from 1; empty if the effect acts on the robot as a whole.

    probability: that the effect is present, against alternative effects or none, given all other named effects; mean
    over block-bootstrap draws of the data.
    gap_share: share of the gap's energy above the noise that it removes on held-out data. title: the effect in plain
    words. means: what it means and what to do.
    """

    name: str
    title: str = ""
    means: str = ""
    joints: list[int]
    probability: float
    parameters: dict[str, Estimate]
    gap_share: float
    confusable_with: list[str]
    settles: str
    online: Online


class Ranked(DocumentPart):
    """A candidate, named or not. shrink: of the rms on held-out data, relative to the model before it was added."""

    name: str
    joints: list[int]
    probability: float
    after_nm: float
    shrink: float


class Rival(DocumentPart):
    """An alternative model at the point where the data decide least: all its effects, as in a description.

    probability, shrink: as in `Ranked`, of the last effect.
    """

    effects: list[EffectEntry]
    probability: float
    shrink: float


class Follows(DocumentPart):
    """A quantity on which the residual of a joint (from 1) depends, and which the model of the joint does not contain.

    other: the joint whose motion it is. share: of the residual's energy above the noise, on held-out data.
    """

    joint: int
    what: Literal["motion", "sine_of_angle", "position_error"]
    other: int | None
    share: float


class Extreme(DocumentPart):
    """Smallest or largest value of a torque or force, and where it occurs. One number each, or x, y and z."""

    value: list[float]
    at: list[float]


class Located(DocumentPart):
    """A quantity on which the unexplained residual depends. Either a torque of one joint (from 1) that depends on its
    angle, on its angle and the direction of motion (friction there) or on its speed; or, if joint is None, a force on
    the platform that depends on its position.

    alternative: the data do not separate it from the last entry above for which this is false. share: of the energy of
    all residuals above the noise, on held-out data, with its 95 % interval over blocks. rms: of torque or force about
    its mean over the motion, in `unit`. extremes: the smallest and the largest torque, or the largest force; known only
    up to a constant if the base model contains a constant.
    """

    joint: int | None
    over: Literal["angle", "friction_at_angle", "speed", "platform"]
    alternative: bool
    share: float
    share_ci95: tuple[float, float]
    rms: float
    unit: str
    extremes: list[Extreme]
    at_unit: str


class Moved(DocumentPart):
    """A parameter of the base model, with its standard error, before and after; an error of 0 means unknown."""

    before: float
    before_error: float
    after: float
    after_error: float
    unit: str


class Gap(DocumentPart):
    """Rms per joint on held-out runs, in the analysis band. unit: N m, N for linear axes.

    A run is predicted with parameters fitted to the others. Effects are found and accepted on all runs; the models that
    the search tried are then compared again without the run, and another one is used there if it is clearly better.

    torque_nm: rms of the recorded torque on the same samples. shrink: over the runs with motion as in production, all
    joints pooled. slow_runs: the runs without such motion; if there are any, the gap on the other runs is in
    work_before_nm and work_after_nm. shrink_ci95: interval for as many other runs of these kinds.
    """

    unit: str
    before_nm: list[float]
    after_nm: list[float]
    noise_floor_nm: list[float]
    reversal_nm: list[float]
    torque_nm: list[float] = []
    shrink: float
    shrink_ci95: tuple[float, float]
    shrink_of_explainable: float | None
    band_hz: float
    slow_runs: list[str] = []
    work_before_nm: list[float] = []
    work_after_nm: list[float] = []


class Regime(DocumentPart):
    """A kind of motion, by name: its share of a joint's gap above the noise, and of the time."""

    regime: str
    share: float
    of_time: float


class FrequencyShare(DocumentPart):
    """Share of a joint's gap above the noise between two frequencies."""

    from_hz: float
    to_hz: float
    share: float


class JointWhere(DocumentPart):
    """How the gap of one joint (from 1) is distributed. rows: number of compared samples. budget_nm2: mean square by
    cause; their sum is that of the base model's gap. Regimes are sorted, strongest concentration first."""

    joint: int
    rows: int
    budget_nm2: dict[str, float]
    before: list[Regime]
    after: list[Regime]
    spectrum_before: list[FrequencyShare]
    spectrum_after: list[FrequencyShare]


class RunLevel(DocumentPart):
    """Residual of one run, over the noise."""

    run: str
    after_over_noise: float


class Burst(DocumentPart):
    """A stretch in which the gap of a joint (from 1) is far above the rest: an event, not a property.

    over_noise: its rms, without slow parts, over the noise floor.
    """

    run: str
    joint: int
    from_s: float
    to_s: float
    over_noise: float


class Where(DocumentPart):
    """How the gap is distributed. Runs are sorted worst first, bursts strongest first. bursts_rhythm_s: the period of
    most bursts."""

    joints: list[JointWhere]
    left_out_at_rest_and_ends: float
    worst_runs: list[RunLevel]
    bursts: list[Burst]
    bursts_rhythm_s: float | None


class Shrunk(DocumentPart):
    """Rms per joint with the model before and after, in the analysis band."""

    before_nm: list[float]
    after_nm: list[float]
    shrink: float
    shrink_ci95: tuple[float, float]


class Simulated(DocumentPart):
    """The models before and after, simulated under the recorded torque: rms error after the horizon.

    path_mm: rms distance that the measured platform moves in that time. floor: torque noise and start state alone.
    None: the simulated robot left the workspace in every window. left_out: effects that cannot be simulated.
    """

    horizon_s: float
    windows: int
    path_mm: float
    platform_before_mm: float | None
    platform_after_mm: float | None
    platform_floor_mm: float | None
    joint_before_mrad: list[float | None]
    joint_after_mrad: list[float | None]
    left_out: list[str]


class Unseen(DocumentPart):
    """A test log, used for nothing else. bursts: of the corrected model's gap in it. rhythm_s: period of most bursts.

    simulated: if the robot is a Delta that moves. outside: without the bursts, if there are any. outside_share: share
    of the moving time outside the bursts.
    """

    trace: str
    whole: Shrunk
    bursts: list[Burst]
    rhythm_s: float | None
    outside: Shrunk | None
    outside_share: float
    simulated: Simulated | None = None


class OnlineFigures(DocumentPart):
    """Performance of the estimator on the loads with one description.

    right: number of load changes after which the mass is within the larger of 5 % and 50 g, from 150 ms after the
    change until the next. trusted: share of the time from 150 ms after each change. false_events: events without a load
    change. feedforward_nm: rms of measured torque minus feed-forward without a load, while joints move, below 40 Hz.
    feedforward_over_noise: the same over the noise floor; 1 for a correct model.
    """

    right: int
    trusted: float
    false_events: int
    feedforward_nm: float
    feedforward_over_noise: float


OnlineReason = Literal["not_carried", "no_rest"]


class OnlineTrial(DocumentPart):
    """How much the correction improves the estimator, by process replay of logs with known loads.

    reason: why there are no values, if there are none: the online model does not contain the effects `left_out`, or no
    log has two rests at which a load could be picked and released. traces: the logs. simulated: loads were added to the
    recorded torque of a log, while all joints were at rest. held_out: a log that was not fitted. seconds: of all logs.
    changes: evaluated changes of the load; 0 with elastic gears, where loads cannot be simulated. identified: without
    the correction, or with the baseline if one is given.
    """

    reason: OnlineReason | None = None
    left_out: list[str] = []
    traces: list[str] = []
    simulated: bool = True
    held_out: bool = False
    seconds: float = 0.0
    changes: int = 0
    identified: OnlineFigures | None = None
    corrected: OnlineFigures | None = None


class FrequencyResponse(DocumentPart):
    """Frequency response from the torque of a joint (from 1) to its speed, over the whole motion. magnitude, in `unit`,
    and phase_deg: by name, `measured` and each model along the measured motion. coherence: share of the measured
    speed's power that follows the measured torque linearly; if it is far below 1, the response is not reliable."""

    joint: int
    unit: str
    hz: list[float]
    coherence: list[float]
    magnitude: dict[str, list[float]]
    phase_deg: dict[str, list[float]]


class Provenance(DocumentPart):
    """When, by which version of deltatwin, from what: SHA-256 of each input file by its name."""

    at: str
    version: str
    inputs: dict[str, str]


class Diagnosis(DocumentPart):
    """Where the gap lies, which effect causes it, how far it shrinks.

    plain: parameters of the base model fitted without effects. base: refitted together with the effects. tests: the
    correction on logs that are used for nothing else. given: effects that the description already contains. follows:
    quantities on which the residual depends, strongest first. located: the same as torques and forces, if the residual
    is above the noise. moved: base parameters compared with the baseline's, if one is given. rivals: alternative
    models that a further motion must separate, best first. online: how much the correction improves the estimator; only
    for a Delta. frequency_response: measured, and of the models before and after.
    """

    schema_: Literal["deltatwin.diagnosis/2"] = Field("deltatwin.diagnosis/2", alias="schema")
    made: Provenance | None = None
    robot: str
    traces: list[str]
    verdict: Verdict
    effects: list[NamedEffect]
    cannot_tell: list[Caution]
    ranking: list[Ranked]
    probability_none: float
    probability_unknown: float
    plain: dict[str, float]
    base: dict[str, Estimate]
    where: Where
    gap: Gap
    tests: list[Unseen] = []
    given: list[str]
    follows: list[Follows] = []
    located: list[Located] = []
    moved: dict[str, Moved] = {}
    rivals: list[Rival] = []
    online: OnlineTrial | None = None
    frequency_response: list[FrequencyResponse] = []


def named_joints(joints: Sequence[int]) -> str:
    """`joint 2`, or `joints 1, 2 and 3`; nothing of none. joints: numbers, from 1."""
    if len(joints) < 2:
        return "".join(f"joint {joint}" for joint in joints)
    return f"joints {', '.join(map(str, joints[:-1]))} and {joints[-1]}"


def placed(name: str, joints: Sequence[int]) -> str:
    """An effect in words, and where it acts. joints: numbers, from 1; none: the whole robot.

    Example:
        >>> placed("joint_offset", [3]), placed("tool_mass", [])
        ('joint offset in joint 3', 'tool mass')
    """
    return words(name) + (f" in {named_joints(joints)}" if joints else "")
