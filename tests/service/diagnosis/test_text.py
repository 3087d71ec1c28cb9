"""The words of a diagnosis, on a document made up so that every figure in them can be told by hand."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from schemas.diagnosis import Advice, Caution, CautionCode, Diagnosis, Estimate, Simulated
from service.diagnosis.documents import text
from tests.service.diagnosis.said import sentences

ONE = {"name": "cogging", "title": "Cogging", "means": "The motor.", "joints": [2], "probability": 0.8,
       "gap_share": 0.64, "confusable_with": ["backlash", "torque_scale"], "settles": "a slow sweep",
       "online": {"carried": False, "reason": "no_online_form"},
       "parameters": {"cosine": {"value": 3.0, "unit": "N m", "ci95": [2.4, 3.6], "meaning": "cosine part of a ripple"},
                      "sine": {"value": 4.0, "unit": "N m", "ci95": [3.2, 4.8], "meaning": "sine part of a ripple"},
                      "order": {"value": 7.0, "unit": "", "ci95": [7.0, 7.0]}}}  # fmt: skip
REGIMES = [{"regime": "load above 3 N m", "share": 0.6, "of_time": 0.33}]
SPECTRUM = [{"from_hz": 0.0, "to_hz": 3.0, "share": 0.2}, {"from_hz": 3.0, "to_hz": 10.0, "share": 0.7}]


def document(**changed: Any) -> Diagnosis:
    """Two joints, of which the first has a gap three times its noise."""
    joints = [{"joint": joint, "rows": 900, "budget_nm2": {}, "before": REGIMES, "after": REGIMES,
               "spectrum_before": SPECTRUM, "spectrum_after": SPECTRUM} for joint in (1, 2)]  # fmt: skip
    gap = {"unit": "N m", "before_nm": [3.0, 1.0], "after_nm": [1.5, 1.0], "noise_floor_nm": [1.0, 0.95],
           "reversal_nm": [0.0, 0.0], "torque_nm": [30.0, 10.0], "shrink": 0.43, "shrink_ci95": [0.4, 0.456],
           "shrink_of_explainable": 0.9, "band_hz": 40.0}  # fmt: skip
    where = {"joints": joints, "left_out_at_rest_and_ends": 0.1, "worst_runs": [{"run": "b", "after_over_noise": 1.46}],
             "bursts": [], "bursts_rhythm_s": None}  # fmt: skip
    made = {"schema": "deltatwin.diagnosis/2", "robot": "r", "traces": ["a", "b", "c"], "verdict": "partly_explained",
            "effects": [ONE], "cannot_tell": [], "ranking": [], "probability_none": 0.0, "probability_unknown": 1.0,
            "plain": {}, "base": {}, "where": where, "gap": gap, "given": []}  # fmt: skip
    return Diagnosis.model_validate(made | changed)


def test_a_candidate_that_is_not_accepted_has_a_reason_and_no_probability() -> None:
    ranking = [{"name": name, "joints": [2], "probability": 0.99, "after_nm": 1.0, "shrink": shrink}
               for name, shrink in (("cogging", 0.4), ("presliding_friction", 0.004))]  # fmt: skip
    other = {"code": "one_run", "advice": "record_runs"}
    weak = other | {"code": "no_shrink", "effect": "presliding_friction", "joints": [2], "share": 0.004}
    said = text.of_candidates(document(ranking=ranking, cannot_tell=[weak, other]))
    assert "99 %" not in said
    assert "Presliding friction in joint 2 fits, but it does not shrink the gap on held-out data (< 1 %)" in said
    assert "only one run" not in said
    assert "In 100 % of the bootstrap draws the residual is above the noise" in said


def test_a_named_effect_is_told_in_one_line() -> None:
    (line, gap), *_ = text.paragraphs(document())[2:]
    assert line == (
        "Most likely cause: cogging in joint 2 (probability 80 %): amplitude of a ripple = 5.0 ± 0.7 N m. It explains "
        "64 % of the gap above the noise. The data cannot separate it from backlash or torque scale."
    )
    # rms of 3 and 1, of 1.5 and 1
    assert gap == (f"On held-out runs ({text.HELD_OUT}) the gap goes from 2.24 to 1.27 N m, a shrink of 43 % [40, 46].")
    two = document(traces=["a", "b"], gap=document().gap.model_dump() | {"after_nm": [4.0, 1.0]})
    assert text.paragraphs(two)[2][1].startswith(
        "On held-out stretches (predicted with parameters fitted to the others; effects were found"
    )
    assert text.paragraphs(two)[2][1].endswith("does not generalise.")
    aside = two.model_copy(update={"cannot_tell": [Caution(code="by_place", advice="look_there")]})
    assert text.paragraphs(aside)[2][1].endswith("given the unmodelled part, the named effects shrink it.")
    work = {"slow_runs": ["b", "c"], "work_before_nm": [4.0, 0.0], "work_after_nm": [2.0, 0.0]}
    line = text.paragraphs(document(gap=document().gap.model_dump() | work))[2][1]
    assert (
        f"On held-out runs ({text.HELD_OUT}), without slow sweeps (b, c) the gap goes from 2.83 to 1.41 N m, a shrink "
        "of 43 % [40, 46]." in line
    )
    for after, said in ((3.1, False), (3.3, True)):  # of 3 N m: 3 % more, 9 % more
        worse = document(effects=[], gap=document().gap.model_dump() | {"after_nm": [after, 1.0]})
        assert any("does not generalise" in line for line in sentences(worse)) is said


def test_the_answer_says_how_much_and_what_to_do() -> None:
    found = text.answer(document())
    (cause,) = found.causes
    assert cause.what == "Cogging in joint 2"
    # a cosine of 3 and a sine of 4: 5, with the root of (3 0.6)^2 + (4 0.8)^2 over it
    assert cause.how_much == ["amplitude of a ripple = 5.0 ± 0.7 N m"]
    assert found.gap == "2.24 N m (10 % of the torque's rms) → 1.27 N m (5.7 % of the torque's rms)"
    assert found.check == ["To be sure, record a slow sweep."]
    sure = document(effects=[ONE | {"confusable_with": [], "probability": 0.9}])
    assert text.answer(sure).check == []
    rivals = [{"effects": [], "probability": 0.5, "shrink": 0.1}] * 2
    assert text.answer(document(rivals=rivals)).check[-1] == text.PLANNED
    assert text.answer(document(rivals=rivals[:1])).check[-1] != text.PLANNED
    assert text.PLANNED not in text.answer(document(rivals=rivals, effects=sure.model_dump()["effects"])).check
    assert text.PLANNED in text.answer(document(rivals=rivals, effects=[], verdict="unexplained")).check
    assert text.PLANNED not in text.answer(document(rivals=rivals, effects=[], verdict="within_noise")).check
    nothing = text.answer(document(effects=[], verdict="unexplained"))
    assert nothing.check == [text.ADVICE["check_description"], text.ADVICE["record_more"]]
    assert nothing.gap == "2.24 N m (10 % of the torque's rms)"
    assert text.answer(document(effects=[], verdict="within_noise")).check == []
    bare = document(gap=document().gap.model_dump() | {"torque_nm": []}, effects=[])
    assert text.answer(bare).gap == "2.24 N m"


def test_many_quantities_are_counted() -> None:
    quantity = {"value": 0.02, "unit": "rad", "ci95": [0.017, 0.023]}
    effect = document(effects=[ONE | {"parameters": {f"angle_{n}": quantity for n in range(8)}}]).effects[0]
    assert text.how_much(effect)[:1] == ["angle 0 = 0.020 ± 0.003 rad (1.1°)"]
    assert text.how_much(effect)[6:] == ["and 2 more, below"]
    seven = document(effects=[ONE | {"parameters": {f"angle_{n}": quantity for n in range(7)}}]).effects[0]
    assert text.how_much(seven)[6:] == ["and 1 more, below"]


@pytest.mark.parametrize(
    ("value", "half", "told"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012 kg"),
        (1.23456, 0.0345, "1.23 ± 0.03 kg"),
        (123.4, 35.0, "123 ± 35 kg"),
        (0.12345, 0.0, "0.123 kg"),
    ],
)
def test_digits_are_those_that_the_interval_leaves(value: float, half: float, told: str) -> None:
    assert text._value(Estimate(value=value, unit="kg", ci95=(value - half, value + half))) == told


def test_each_joint_is_told_against_its_noise() -> None:
    assert text.paragraphs(document())[1] == [
        "Joint 1: 3 N m between model and robot, 3.0 times the noise. 60 % of it occurs here: load above 3 N m (33 % "
        "of the time).",
        "Joint 2: 1 N m between model and robot, 1.1 times the noise.",
    ]
    still = document().where.model_dump()
    still["joints"][1]["rows"] = 0
    still["joints"][0]["before"] = [REGIMES[0] | {"share": 0.19}]
    still["joints"].reverse()
    lines = text.paragraphs(document(where=still))[1]
    assert lines[0] == "Joint 2 hardly moves: no statement about it is possible."
    assert lines[1].endswith("It is spread over the whole motion.")


def test_what_remains_is_told_where_it_lies() -> None:
    burst = {"run": "b", "joint": 1, "from_s": 1.25, "to_s": 1.5, "over_noise": 9.0}
    where = document().where.model_dump() | {"bursts": [burst] * 7, "bursts_rhythm_s": 0.8}
    follows = [{"joint": 1, "what": "motion", "other": 2, "share": 0.3},
               {"joint": 2, "what": "position_error", "other": None, "share": 0.2}]  # fmt: skip
    assert text.paragraphs(document(where=where, follows=follows))[3] == [
        "Unexplained in joint 1: 1.5 times the noise. 60 % of it occurs here: load above 3 N m (33 % of the time). "
        "70 % of it lies at 3 to 10 Hz.",
        "30 % of the residual in joint 1 follows the motion of joint 2.",
        "20 % of the residual in joint 2 follows the position error.",
        "7 stretches are far above the rest of the residual (events), most of them every 0.8 s; strongest first: "
        + ", ".join(["b 1.25 to 1.50 s"] * 6) + ", and 1 more.",
        "The residual is largest in b (1.5 times the noise): look there first.",
    ]  # fmt: skip


def test_what_the_residual_depends_on_is_told_with_what_to_check() -> None:
    pull = {"joint": None, "over": "platform", "alternative": False, "share": 0.46, "share_ci95": [0.3, 0.62],
            "rms": 1.234, "unit": "N", "extremes": [{"value": [9.0, -5.0, 6.0], "at": [-0.3, 0.0, -0.85]}],
            "at_unit": "m"}  # fmt: skip
    torque = {"joint": 2, "over": "angle", "alternative": True, "share": 0.4, "share_ci95": [0.2, 0.6], "rms": 0.98,
              "unit": "N m", "at_unit": "rad",
              "extremes": [{"value": [-2.28], "at": [0.8268]}, {"value": [2.24], "at": [-0.3341]}]}  # fmt: skip
    assert text.paragraphs(document(located=[pull, torque]))[3][1:3] == [
        "46 % [30, 62] of the residual is a force on the platform that depends on its position: 1.23 N rms, at most "
        "(9, -5, 6) N at (-0.3, 0, -0.85) m. Check what pulls or touches there: a hose, a cable, a magnet, a jet of "
        "air.",
        "Alternatively (the data cannot separate the two): 40 % [20, 60] of the residual is a torque in joint 2 that "
        "depends on its angle: 0.98 N m rms, between -2.28 N m at 0.827 rad and 2.24 N m at -0.334 rad. Check what "
        "pulls at the arm or touches it there: a cable, a stop, a cover.",
    ]


def test_what_came_nearest_is_told_where_nothing_is_named() -> None:
    ranked = [{"name": name, "joints": joints, "probability": 0.1, "after_nm": 1.0, "shrink": shrink}
              for name, joints, shrink in (("arm_mass", [1], 0.02), ("cogging", [], 0.05), ("tool_mass", [], -0.1),
                                           ("backlash", [3], 0.04), ("hose_spring", [], 0.01))]  # fmt: skip
    found = sentences(document(effects=[], verdict="unexplained", ranking=ranked))
    assert (
        "Nearest effects of the catalogue, with the shrink of the gap on held-out data: cogging (5 %), backlash in "
        "joint 3 (4 %), arm mass in joint 1 (2 %)."
    ) in found
    assert text.VERDICTS["unexplained"] in found
    caution = {"code": "runs_differ", "advice": "check_runs"}
    said = text.CAUTIONS["runs_differ"] + " " + text.ADVICE["check_runs"]
    open_ = sentences(document(effects=[], verdict="unexplained", cannot_tell=[caution]))
    assert text.VERDICTS["unexplained"] not in open_
    assert open_.count(said) == 1


def test_what_cannot_be_told_names_joints_and_what_to_do() -> None:
    found = text.caution(Caution(code="other_joints", joints=[2, 3], share=0.41, advice="check_base"))
    assert found.startswith(
        "The base model has to be corrected first: 41 % of the gap in joint 2 follows the motion of joint 3,"
    )
    assert found.endswith(text.ADVICE["check_base"])
    limit = Caution(code="at_limit", joints=[1], effect="joint_spring", quantity="rest_angle", advice="check_base")
    assert text.caution(limit).startswith(
        "The nearest effect is joint spring in joint 1, but its rest angle is at the limit"
    )


def test_there_are_words_for_all_that_cannot_be_told_and_for_every_advice() -> None:
    assert set(text.CAUTIONS) == set(get_args(CautionCode))
    assert set(text.ADVICE) == set(get_args(Advice))
    beside = document(cannot_tell=[Caution(code="by_place", advice="look_there")])
    assert (
        "An unmodelled disturbance pulls at the platform everywhere. The named effects were found given any torque "
        "that depends on the platform's position: springs, offsets and weights cannot be separated from it. See below "
        "where and when the residual is largest."
    ) in sentences(beside)
    warm = text.caution(Caution(code="by_scale", joints=[2], advice="log_warm"))
    assert warm.startswith("Part of the residual of joint 2 is proportional to the torque itself")
    belt = text.caution(Caution(code="comes_again", pitch_m=0.0643, advice="look_there"))
    assert "pulls at the platform every 64 mm of its path" in belt
    held = text.caution(Caution(code="torque_held", held_s=0.004, advice="log_quicker"))
    assert held.startswith("The torque is updated only every 4 ms and repeated in between")


def test_a_gap_hardly_above_the_noise_is_called_that() -> None:
    small = document(verdict="explained", gap=document().gap.model_dump() | {"shrink": 0.09})
    assert sentences(small)[0] == text.VERDICTS["hardly"]
    assert sentences(document(verdict="explained"))[0] == text.VERDICTS["explained"]


def test_logs_kept_out_the_baseline_and_the_simulator_are_told() -> None:
    shrunk = {"before_nm": [2.0], "after_nm": [1.0], "shrink": 0.5, "shrink_ci95": [0.4, 0.6]}
    burst = {"run": "t", "joint": 1, "from_s": 1.0, "to_s": 2.0, "over_noise": 9.0}
    simulated = Simulated(
        horizon_s=0.5, windows=3, path_mm=80.0, platform_before_mm=None, platform_after_mm=2.5, platform_floor_mm=0.5,
        joint_before_mrad=[], joint_after_mrad=[], left_out=["torque_delay"],
    )  # fmt: skip
    bursts = [burst, burst | {"from_s": 0.5, "over_noise": 12.0}]
    test = {"trace": "t", "whole": shrunk, "bursts": bursts, "rhythm_s": None, "outside": shrunk, "outside_share": 0.8,
            "simulated": simulated.model_dump()}  # fmt: skip
    moved = {"rho_1": {"before": 1.0, "before_error": 0.0, "after": 1.25, "after_error": 0.05, "unit": ""}}
    lines = sentences(document(tests=[test], moved=moved, given=["tool_mass"]))
    gap = "from 2 to 1 N m, a shrink of 50 % [40, 60]."
    assert (
        f"On the test log t, used for nothing else, the gap goes {gap} Outside the events (80 % of the motion) it goes "
        f"{gap}"
    ) in lines
    assert (
        "2 stretches are far above the rest of the residual (events); strongest first: t 0.50 to 2.00 s, t 1.00 to "
        "2.00 s."
    ) in lines
    assert "ρ1, factor on the inertia: 1 -> 1.25 ± 0.098" in lines
    assert lines[-1] == "The description already contains tool mass."
    assert (
        "In the simulator without torque delay, driven by the recorded torque, the platform's error after 0.5 s goes "
        "from beyond the workspace to 2.5 mm; noise alone gives 0.5 mm."
    ) in lines


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("rho_2", "ρ2, factor on gravity"),
        ("f_v_2", "viscous friction, joint 2"),
        ("f_c_motor_6", "Coulomb friction, motor 6"),
        ("gravity_sin_1", "weight, sine of the angle, joint 1"),
        ("rotor_4", "rotor 4"),
    ],
)
def test_a_parameter_of_the_base_model_in_words(key: str, said: str) -> None:
    assert text.base_in_words(key) == said
