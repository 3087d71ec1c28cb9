"""The yardstick of the diagnosis: scores of known answers, seeds that stay apart, answers that are kept whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import TraceError
from tests.bench import bench_diagnosis as bench
from tests.bench import diagnosis_scores as scores
from tests.bench.diagnosis_scores import Answer, Name


def answer(effects: list[str], named: dict[str, float], **given: object) -> Answer:
    names = [Name(name, [], probability) for name, probability in named.items()]
    values: dict[str, object] = {"lift": 2.0, "verdict": "explained", "claimed": 0.5, "before": 2.0, "after": 1.0}
    return Answer("pair", 1, {name: [] for name in effects}, named=names, **{**values, **given})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("effects", "named", "first", "f1", "false"),
    [
        (["backlash", "tool_mass"], ["backlash", "tool_mass"], True, 1.0, 0),
        (["backlash", "tool_mass"], ["tool_mass"], True, 2 / 3, 0),
        (["backlash", "tool_mass"], ["air_drag", "tool_mass"], False, 0.5, 1),
        (["torque_offset"], ["asymmetric_friction"], True, 1.0, 0),
        (["backlash"], [], False, 0.0, 0),
        ([], ["air_drag"], False, 0.0, 1),
        ([], [], False, 1.0, 0),
    ],
)
def test_scores_of_known_answers(effects: list[str], named: list[str], first: bool, f1: float, false: int) -> None:
    one = answer(effects, dict.fromkeys(named, 1.0))
    assert scores.first_right(one) is first
    assert scores.f1(one) == pytest.approx(f1)
    assert scores.false_names(one) == false


def test_what_corrects_a_wrong_description_counts_neither_way() -> None:
    one = answer(["backlash"], {"tool_mass": 1.0, "backlash": 0.9, "air_drag": 0.6}, misdescribed=["platform"])
    assert scores.first_right(one)
    assert scores.false_names(one) == 1
    assert scores.false_names(answer(["backlash"], {"tool_mass": 1.0})) == 1
    assert scores.first_right(answer(["tool_mass"], {"tool_mass": 1.0}, misdescribed=["platform"]))


@pytest.mark.parametrize(
    ("effects", "disturbances", "verdict", "right"),
    [
        (["backlash"], [], "explained", True),
        (["backlash"], [], "partly_explained", False),
        (["backlash"], ["magnet"], "partly_explained", True),
        (["backlash"], ["magnet"], "explained", False),
        ([], ["magnet"], "unexplained", True),
        ([], [], "within_noise", True),
        ([], [], "unexplained", False),
    ],
)
def test_verdict(effects: list[str], disturbances: list[str], verdict: str, right: bool) -> None:
    assert scores.verdict_right(answer(effects, {}, disturbances=disturbances, verdict=verdict)) is right


def test_joints_are_right_where_all_are_and_no_others() -> None:
    one = Answer("single", 1, {"cogging": [2]}, named=[Name("cogging", [2], 1.0), Name("backlash", [1], 0.9)])
    assert scores.joints_right(one) == [True]
    assert scores.joints_right(Answer("single", 1, {"cogging": [2]}, named=[Name("cogging", [1, 2], 1.0)])) == [False]


def test_names_at_a_probability_are_counted_by_decile() -> None:
    some = [answer(["backlash"], {"backlash": 0.97, "air_drag": 0.91, "tool_mass": 0.35}), answer(["air_drag"], {})]
    found = scores.reliability(some)
    assert {decile: (one.value, one.count) for decile, one in found.items()} == {9: (0.5, 2), 3: (0.0, 1)}
    certain = scores.certain_true(some)
    assert certain is not None
    assert (certain.value, certain.count) == (0.5, 2)


def test_intervals_are_those_of_the_tables() -> None:
    assert np.round(scores.proportion(9, 10), 4).tolist() == [0.555, 0.9975]  # Clopper and Pearson 1934
    assert scores.proportion(10, 10)[1] == 1.0
    assert np.round(scores.rate(0, 10), 3).tolist() == [0.0, 0.369]  # Garwood 1936: 3.689
    assert np.round(scores.rate(3, 1), 3).tolist() == [0.619, 8.767]
    assert scores.mean_interval([1.0, 0.0, 1.0]) == pytest.approx(scores.proportion(2, 3))
    assert scores.mean_interval([1.0] * 3) == pytest.approx(scores.proportion(3, 3))
    assert scores.mean_interval([0.0] * 3) == pytest.approx(scores.proportion(0, 3))


def test_figures_of_a_family_leave_out_what_cannot_be_found() -> None:
    some = [
        answer(["backlash"], {"backlash": 1.0}),
        answer(["backlash"], {"air_drag": 1.0}),
        answer(["backlash"], {}, lift=1.01),
        answer([], {}, verdict="within_noise"),
        answer(["backlash"], {}, error="refused"),
    ]
    found = scores.family_figures(some)
    assert (found["first"].value, found["first"].count) == (0.5, 2)
    assert (found["quiet"].value, found["quiet"].count) == (1.0, 1)
    assert (found["false"].value, found["false"].count) == (0.25, 4)
    claim = scores.quantile_of(some[:1], scores.claim_error, 0.5)
    assert claim is not None
    assert claim.value == 0.0


def test_seeds_that_report_are_never_those_that_calibrate() -> None:
    assert not set(bench.seeds_of("report", 0, 500)) & set(bench.seeds_of("calibrate", 0, 10_000))
    with pytest.raises(ValueError, match="--first 9999 --cases 2: seeds from 10000 are of the set report"):
        bench.seeds_of("calibrate", 9999, 2)


def test_kept_answers_are_not_asked_again(tmp_path: Path) -> None:
    kept = tmp_path / "answers.jsonl"
    first, second = answer(["backlash"], {"backlash": 1.0}), Answer("single", 10_003, {}, error="refused")
    for one in first, second:
        bench.keep(kept, one)
    assert bench.kept_in(kept) == {("pair", 1): first, ("single", 10_003): second}
    assert bench.run([("single", 10_003), ("pair", 1)], kept, jobs=1) == [second, first]
    kept.write_text(kept.read_text() + '{"family": "pair"\n')
    with pytest.raises(TraceError, match=r"answers.jsonl, line 3: not an answer of this bench"):
        bench.kept_in(kept)


def test_a_stop_is_told_from_a_fault_in_whatever_it_comes_wrapped() -> None:
    wrapped = SystemError("returned a result with an exception set")
    wrapped.__cause__ = SystemError("returned a result with an exception set")
    assert not bench.interrupted(wrapped)
    wrapped.__cause__.__cause__ = KeyboardInterrupt()
    assert bench.interrupted(wrapped)
    assert bench.interrupted(KeyboardInterrupt())


def test_the_gap_is_that_of_the_joints_that_move(tmp_path: Path) -> None:
    rng, time = np.random.default_rng(0), np.arange(4000) * 1e-3
    angle = np.stack([np.sin(6 * time), np.sin(5 * time), 0 * time], axis=1)
    off = 2.0 * np.sin(2 * np.pi * 7 * time)
    torque = np.stack([off, off, 50 * off], axis=1) + 3 * np.sin(2 * np.pi * 200 * time)[:, None]
    torque += 1e-3 * rng.standard_normal(torque.shape)
    names = [f"{what}_{j}_{unit}" for what, unit in (("position", "rad"), ("torque", "nm")) for j in (1, 2, 3)]
    write(tmp_path / "test_a.csv", ["time_s", *names], np.column_stack([time, angle, torque]))
    (tmp_path / "predicted").mkdir()
    models = [f"torque_model_{j}_nm" for j in (1, 2, 3)]
    write(tmp_path / "predicted" / "test_a.csv", ["time_s", *models], np.column_stack([time, 0 * angle]))
    assert bench.gap(tmp_path, tmp_path / "predicted") == pytest.approx(2 / np.sqrt(2), rel=0.02)


def write(path: Path, names: list[str], rows: np.ndarray) -> None:
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")


def test_every_figure_has_its_place_in_the_results() -> None:
    document = json.loads((Path(__file__).parents[1] / "results" / "diagnosis.json").read_text())
    known = {one["key"] for one in document["figures"]}
    every = [answer(["backlash"], {"backlash": p / 10}) for p in range(10)]
    assert {key for key in bench.overall(every)} <= known
    assert {f"{family}_{key}" for family in bench.FAMILIES for key in ("verdict", "false")} <= known
