"""What the correction is worth to the estimator: the loads that are simulated, what is counted, what is said."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.simulated.plant.mujoco_delta import Design
from drivers.trace import write_trace
from schemas.axes_description import Axes
from schemas.diagnosis import Diagnosis, OnlineFigures, OnlineTrial
from schemas.messages import PayloadEvent, SampleFlag
from schemas.robot import Robot, save_robot
from schemas.trace import Trace
from service.cli.main import app
from service.diagnosis.documents import worth
from service.diagnosis.documents.online_text import KEEP, NOTE, noted, sentences_of, standing
from service.identification.weighed_picks import Pick, Weighed
from service.model.prediction import motion
from tests.service.subject import EFFECTS, Delta, Hypothesis, Parameters, Term, described
from tests.service.world import BASE, COULOMB, PERIOD, ROBOT, TRUTH, VISCOUS, direction, rigid_torque, stub

NOISE, COUNT = 0.3, 2 * np.pi / (25 * 2**20)  # N m a sample, rad
REST, MOVE = 0.15, 0.45  # s


def known(hypothesis: Hypothesis) -> Robot:
    """The description of the known robot with a hypothesis."""
    robot = described(ROBOT, hypothesis, np.zeros(len(Parameters(hypothesis).values)), np.full(3, NOISE))
    assert isinstance(robot, Robot)
    return robot


KNOWN = known(Hypothesis(BASE))


def stop_and_go(seed: int, moves: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, angle, speed, acceleration of `moves` moves of fifth order between random poses, at rest between them."""
    rng = np.random.default_rng(seed)
    time = np.arange(round((REST + moves * (MOVE + REST)) / PERIOD)) * PERIOD
    poses = 0.45 + rng.uniform(-0.3, 0.3, (moves + 1, 3))
    number = np.minimum((time / (MOVE + REST)).astype(int), moves)
    share = np.clip((time - number * (MOVE + REST) - REST) / MOVE, 0.0, 1.0)[:, None]
    begin, end = poses[number], poses[np.minimum(number + 1, moves)]
    s, way = share, end - begin
    return (
        time,
        begin + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        way * (30 * s**2 - 60 * s**3 + 30 * s**4) / MOVE,
        way * (60 * s - 180 * s**2 + 120 * s**3) / MOVE**2,
    )


def log(seed: int, moves: int = 12, picks: tuple[Pick, ...] = (), viscous: float = 1.0) -> Trace:
    """A log of the known robot, its torque from MuJoCo with the loads as a heavier platform. viscous: times what is
    known."""
    time, *course = stop_and_go(seed, moves)
    made = (course[0], course[1], course[2])
    torque = rigid_torque(Design(TRUTH), made) + viscous * VISCOUS * made[1] + COULOMB * direction(made[1])
    for pick in picks:
        rows = (time >= pick.begin) & (time < pick.end)
        torque[rows] += heavier(pick.mass, made)[rows]
    rng = np.random.default_rng([seed, 1])
    position = np.round((made[0] + 1e-7 * rng.standard_normal(torque.shape)) / COUNT) * COUNT
    return Trace(Path(f"log_{seed}.csv"), time, position, torque + NOISE * rng.standard_normal(torque.shape))


def heavier(mass: float, made: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """Torque (N, 3) N m that `mass` more at the platform takes, by MuJoCo."""
    loaded = TRUTH.model_copy(update={"platform_kg": TRUTH.platform_kg + mass})
    return rigid_torque(Design(loaded), made) - rigid_torque(Design(TRUTH), made)


def loaded(seed: int, viscous: float = 1.0) -> worth.Loaded:
    trace = log(seed)
    along = motion(trace)
    (case,) = worth._simulated(KNOWN, Delta.of(ROBOT), [trace])
    real = log(seed, picks=case.picks, viscous=viscous)
    return worth.Loaded(real, along, Delta.of(ROBOT), case.picks, None)


def test_a_simulated_load_takes_what_a_heavier_platform_takes_in_mujoco() -> None:
    trace = log(1, moves=4)
    picks = (Pick(0.7, 1.3, 2.0), Pick(1.9, np.inf, 0.5))
    made = worth.carrying(KNOWN, trace, motion(trace), picks)
    _, *course = stop_and_go(1, 4)
    for pick in picks:
        rows = (trace.time >= pick.begin) & (trace.time < pick.end)
        wanted = heavier(pick.mass, (course[0], course[1], course[2]))[rows]
        found = (made.torque - trace.torque)[rows]
        assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.01 * np.sqrt(np.mean(wanted**2))
    empty = (trace.time < 0.7) | ((trace.time >= 1.3) & (trace.time < 1.9))
    np.testing.assert_array_equal(made.torque[empty], trace.torque[empty])
    assert made.torque_command is None


def test_a_load_is_measured_as_late_as_the_torque() -> None:
    trace = log(1, moves=4)
    delay = Term(EFFECTS["torque_delay"], (), np.zeros((1, 0)), (0.004,))
    late = known(Hypothesis(replace(BASE, timing=0.0), (delay,)))
    picks, along = (Pick(0.7, np.inf, 2.0),), motion(trace)
    at_once, later = (worth.carrying(robot, trace, along, picks).torque - trace.torque for robot in (KNOWN, late))
    rows = np.arange(1000, 2000)
    assert np.abs(later[rows] - at_once[rows]).max() > 0.2
    np.testing.assert_allclose(later[rows], at_once[rows - 4], atol=0.01)


def test_loads_come_and_go_where_all_joints_rest() -> None:
    trace = log(2)
    (case,) = worth._simulated(KNOWN, Delta.of(ROBOT), [log(3, moves=4), trace])[:1]
    assert case.trace.name == "log_2"  # the one with most rests first
    _, _, speed, _ = stop_and_go(2, 12)
    changes = np.array([start for start, _, _ in case.changes])
    assert len(changes) == 11  # the rests between 12 moves
    assert np.abs(speed[np.round(changes / PERIOD).astype(int)]).max() == 0.0
    assert np.diff(changes).min() >= worth.SEEN
    assert {mass for _, _, mass in case.changes} == {0.0, 1.0, 3.0}
    told = np.full(len(trace), np.uint32(SampleFlag.LOADED))
    assert worth._simulated(KNOWN, Delta.of(ROBOT), [replace(trace, flags=told)]) == []


def test_figures_with_loads_that_were_really_there_tell_a_right_description_from_a_wrong_one() -> None:
    case, none = loaded(4), Hypothesis(BASE)
    floor = 0.3 * float(np.sqrt(2 * 40.0 * PERIOD))
    right = worth._figures(KNOWN, [case], none, floor)
    assert right.right >= len(case.changes) - 1
    assert right.trusted > 0.5
    assert right.false_events == 0
    assert right.feedforward_over_noise < 2.5
    assert KNOWN.identified is not None
    rubbed = loaded(4, viscous=4.0)
    wrong = worth._figures(KNOWN, [rubbed], none, floor)
    assert wrong.feedforward_over_noise > 3 * right.feedforward_over_noise
    assert standing(wrong, right, len(case.changes)) == "better"
    assert standing(right, wrong, len(case.changes)) == "worse"


def test_an_event_is_false_where_no_change_explains_it() -> None:
    clock = np.arange(0.0, 4.0, 0.1)
    event = np.zeros(40, int)
    event[[12, 19, 25, 33]] = PayloadEvent.PICK, PayloadEvent.PICK, PayloadEvent.RELEASE, PayloadEvent.PICK
    sure = np.ones(40)
    found = Weighed(clock, np.zeros(40), sure, sure, sure, np.zeros(40, bool), event)
    trace = log(1, moves=4)
    case = worth.Loaded(trace, motion(trace), Delta.of(ROBOT), (Pick(1.05, 2.35, 1.0),), None)
    assert worth._false_events(found, clock, case) == 2  # 1.2 s and 2.5 s are the pick's and the release's


def figures(right: int = 5, trusted: float = 0.5, false_events: int = 1, feedforward: float = 1.0) -> OnlineFigures:
    return OnlineFigures(
        right=right, trusted=trusted, false_events=false_events, feedforward_nm=feedforward,
        feedforward_over_noise=10 * feedforward,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (figures(), "same"),
        (figures(right=6), "same"),  # one change is chance
        (figures(right=7, false_events=9, feedforward=9.0), "better"),
        (figures(right=3, false_events=0, feedforward=0.1), "worse"),
        (figures(false_events=2, trusted=0.9), "worse"),
        (figures(false_events=0), "better"),
        (figures(trusted=0.55, feedforward=0.5), "better"),  # half a change of trust decides nothing
        (figures(trusted=0.3, feedforward=0.5), "worse"),
        (figures(feedforward=1.04), "same"),
        (figures(feedforward=1.06), "worse"),
    ],
)
def test_what_weighs_more_decides(after: OnlineFigures, said: str) -> None:
    assert standing(figures(), after, changes=10) == said


def trial(after: OnlineFigures, held_out: bool = False, changes: int = 10) -> OnlineTrial:
    return OnlineTrial(
        traces=["fit_a"], held_out=held_out, seconds=5.0, changes=changes, identified=figures(), corrected=after
    )


def test_it_says_plainly_what_is_worse_and_what_to_do_then() -> None:
    good, bad = sentences_of(trial(figures(right=9))), sentences_of(trial(figures(right=1), held_out=True))
    assert good == [
        "The estimator works better with the corrected description: it estimates the mass correctly, from 150 ms "
        "on, after 9 of 10 changes of the load (identified: 5), trusts its estimate 50 % of the time (50 %), reports 1 "
        "false event (1), and its feed-forward is off by 10 times the noise (identified: 10).",
        "Tried on loads simulated along fit_a, which were also used for the fit.",
    ]
    assert bad[0].startswith(
        "The estimator works worse with the corrected description than with the identified one: it"
    )
    assert bad[1:] == ["Tried on loads simulated along fit_a, held out of the fit.", KEEP]
    soft = sentences_of(trial(figures(right=0), changes=0))
    assert "gives a feed-forward torque that is off by" in soft[0]
    assert "cannot be simulated on a log. Give logs with known loads (--loaded)." in soft[1]
    silent = sentences_of(OnlineTrial(reason="not_carried", left_out=["joint_elasticity"]))
    assert silent == [
        "The correction was not tried in the estimator: the online model does not contain joint elasticity.", KEEP,
    ]  # fmt: skip
    (unasked,) = sentences_of(OnlineTrial(reason="no_rest"))
    assert "no log has two rests" in unasked


def test_the_advice_stands_on_top_of_the_description_once(tmp_path: Path) -> None:
    save_robot(KNOWN, tmp_path / "corrected.toml")
    text = (tmp_path / "corrected.toml").read_text(encoding="utf-8")
    once = noted(text, trial(figures(right=1)))
    assert tomllib.loads(once) == tomllib.loads(text)
    assert once.endswith(text)
    advice = " ".join(line.removeprefix(NOTE) for line in once.removesuffix(text).splitlines())
    assert advice == " ".join(sentences_of(trial(figures(right=1))))
    assert max(map(len, once.removesuffix(text).splitlines())) <= 120
    again = noted(once, trial(figures(right=9)))
    assert again == noted(text, trial(figures(right=9)))


def findings(robot: object) -> object:
    term = Term(EFFECTS["stribeck_friction"], (0,), np.array([[1.0]]), (0.1,))
    return stub(robot=robot, best=stub(hypothesis=Hypothesis(BASE, (term,))))


def test_nothing_is_said_of_what_the_online_model_does_not_carry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worth, "corrected", lambda _: KNOWN)
    monkeypatch.setattr(worth, "carried", lambda effect: effect.name != "stribeck_friction")
    found = worth.online_trial(findings(ROBOT), [log(1)], [])  # pyright: ignore[reportArgumentType]
    assert found == OnlineTrial(reason="not_carried", left_out=["stribeck_friction"])
    monkeypatch.setattr(worth, "carried", lambda _: True)
    short = log(1, moves=1)
    found = worth.online_trial(findings(ROBOT), [short], [])  # pyright: ignore[reportArgumentType]
    assert found == OnlineTrial(reason="no_rest")


def test_axes_have_no_estimator(monkeypatch: pytest.MonkeyPatch) -> None:
    axes = Axes.model_construct(kind="axes", name="axes")
    monkeypatch.setattr(worth, "corrected", lambda _: axes)
    assert worth.online_trial(findings(axes), [log(1)], []) is None  # pyright: ignore[reportArgumentType]


def test_diagnose_says_what_its_correction_is_worth(tmp_path: Path) -> None:
    """By loads simulated on its own motion, and on a log with loads that were there."""
    save_robot(ROBOT, tmp_path / "robot.toml")
    logs = []
    for seed in (1, 2, 3):
        write_trace(log(seed), tmp_path / f"log_{seed}.csv")
        logs.append(str(tmp_path / f"log_{seed}.csv"))
    command = ["diagnose", *logs, "--robot", str(tmp_path / "robot.toml"), "--out", str(tmp_path / "out")]
    picks = loaded(5).picks
    write_trace(log(5, picks=picks), tmp_path / "carrying.csv")
    rows = "".join(f"{pick.begin},{min(pick.end, 99)},{pick.mass}\n" for pick in picks)
    (tmp_path / "loads.csv").write_text("from_s,until_s,mass_kg\n" + rows, encoding="utf-8")
    refused = CliRunner().invoke(app, [*command, "--loaded", str(tmp_path / "carrying.csv")])
    assert "--loads: 0 files for 1 logs (--loaded); give one per log" in str(refused.exception)
    for more, traces, held_out in (
        ([], ["log_1"], False),
        (["--loaded", str(tmp_path / "carrying.csv"), "--loads", str(tmp_path / "loads.csv")], ["carrying"], True),
    ):
        done = CliRunner().invoke(app, [*command, *more], catch_exceptions=False)
        assert done.exit_code == 0
        found = Diagnosis.model_validate_json((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8")).online
        assert found is not None
        assert (found.traces, found.simulated, found.held_out) == (traces, not held_out, held_out)
        assert found.corrected is not None
        assert found.corrected.right >= 0.8 * found.changes
        told = sentences_of(found)
        assert told[0] in done.stdout
        page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        unfolded = page.partition("<body")[2].partition("<details")[0]
        assert told[0] in re.sub(r"\s+", " ", unfolded)
        assert (tmp_path / "out" / "corrected.toml").read_text(encoding="utf-8").startswith(NOTE)
    schema = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["online"]
    assert list(schema) == list(OnlineTrial.model_fields)


@pytest.mark.slow
def test_behind_gears_that_yield_feed_forward_alone_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    gear = Term(EFFECTS["joint_elasticity"], (0, 1, 2), np.zeros((3, 0)), (40.0, 0.05, 0.2))
    soft = stub(robot=ROBOT, best=stub(hypothesis=Hypothesis(BASE, (gear,))), problem=stub(band=stub(cutoff_hz=40.0),
                sigma=np.full(3, NOISE)))  # fmt: skip
    monkeypatch.setattr(worth, "corrected", lambda _: KNOWN)
    monkeypatch.setattr(worth, "identified", lambda _: KNOWN)
    found = worth.online_trial(soft, [log(1)], [])  # pyright: ignore[reportArgumentType]
    assert found is not None
    assert found.reason is None
    assert (found.changes, found.simulated) == (0, True)
    assert found.corrected is not None
    assert 0.0 < found.corrected.feedforward_over_noise < 20.0
    assert (found.corrected.right, found.corrected.false_events) == (0, 0)
