"""The loop closed over Zenoh: what the feed-forward is worth, and that the robot is safe when it goes away."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.inbox import Inbox
from drivers.motion import Planner, Trajectory
from drivers.simulated.plant.effects.two_mass_effects import JointElasticity
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_on_bus import STALE_CYCLES, FeedforwardIntake, LiveRun
from drivers.simulated.plant.truth import PlantTruth
from schemas.fitted import JointParameter, Parameter
from schemas.messages import FEEDFORWARD
from schemas.robot import EffectEntry, EffectParameter, Geometry, Identified, Mass, Robot, save_robot
from service.experiment.live_loop import (
    CORRECTED,
    FEEDBACK,
    RIGID,
    Tracking,
    follow,
    ratio,
    tracking,
    variants,
)
from service.experiment.loop_page import page, verdict_of_correction
from service.experiment.pictures import write_page
from service.model import kinematics
from service.model.nominal import pack
from tests.service.pages.browser import looked_at

COULOMB, VISCOUS = [3.0, 2.5, 3.5], [1.0, 0.8, 1.2]


def unhurried(deadline_ns: int) -> int:
    """Two milliseconds a cycle, so that a busy machine does not decide the outcome: stamps go by the plant's clock."""
    time.sleep(0.002)
    return 0


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(
        name=f"loop-{os.getpid()}",
        geometry=Geometry(active_link_length=0.35, passive_link_length=0.86, base_radius=0.19, platform_radius=0.05),
        mass=Mass(active_link=2.6, passive_link=0.6, platform=1.3),
        identified=Identified(
            viscous_friction_nms=JointParameter(value=VISCOUS),
            coulomb_friction_nm=JointParameter(value=COULOMB),
            forearm_inertia_kg=Parameter(value=0.6),
            torque_noise_nm=JointParameter(value=[0.3, 0.3, 0.3]),
        ),
    )


@pytest.fixture(scope="module")
def make_plant(robot: Robot) -> Callable[[], Plant]:
    truth = PlantTruth.nominal(robot).model_copy(
        update={
            "coulomb_friction_nm": COULOMB,
            "viscous_friction_nms": VISCOUS,
            "creep_radps": 0.006,
            "torque_noise_nm": [0.3] * 3,
            "encoder_counts_per_turn": float(2**20),
            "gear_ratio": 25.0,
            "peak_torque_nm": 250.0,
        }
    )
    return lambda: Plant(robot, truth, seed=3)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Trajectory:
    return Planner(robot, 1e-3).pick_and_place(np.random.default_rng(1), 2.6, (3.8,))


@pytest.fixture(scope="module")
def alone(robot: Robot, make_plant: Callable[[], Plant], motion: Trajectory) -> LiveRun:
    return follow(robot, make_plant, motion, None, pace=unhurried)


def test_an_interrupted_run_has_no_figures(robot: Robot, make_plant: Callable[[], Plant], motion: Trajectory) -> None:
    def interrupt(cycle: int) -> None:
        if cycle == 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        follow(robot, make_plant, motion, None, pace=lambda _: 0, progress=interrupt)


def test_variants_are_stages_of_what_was_identified(robot: Robot) -> None:
    feeds = variants(robot)
    assert list(feeds) == [
        FEEDBACK, "M_KH, m_p = 0", "M_Id, m_p = 0", "M_Id+F, m_p = 0", "full, m_p = 0", "full, payload-aware",
    ]  # fmt: skip
    assert feeds[FEEDBACK] is None
    assert feeds["full, payload-aware"] == robot
    stage = feeds["M_Id+F, m_p = 0"]
    assert stage is not None
    assert stage.identified is not None
    assert stage.identified.forearm_inertia_kg.value == 0
    assert stage.identified.coulomb_friction_nm.value == COULOMB


def test_payload_aware_feedforward_tracks_four_times_better(
    robot: Robot, make_plant: Callable[[], Plant], motion: Trajectory, alone: LiveRun
) -> None:
    reference = tracking(robot, FEEDBACK, alone)
    assert reference.helped == 0
    blind = tracking(
        robot, "blind", follow(robot, make_plant, motion, variants(robot)["full, m_p = 0"], pace=unhurried)
    )
    aware = tracking(robot, "aware", follow(robot, make_plant, motion, robot, pace=unhurried))
    assert aware.helped > 0.9
    assert aware.rms < reference.rms / 4
    assert aware.rms < blind.rms / 1.5


def test_lost_estimator_leaves_the_robot_safe_on_feedback(
    robot: Robot, make_plant: Callable[[], Plant], motion: Trajectory, alone: LiveRun
) -> None:
    at = len(motion) // 2
    run = follow(robot, make_plant, motion, robot, pace=unhurried, lose_estimator_at=at)
    helped = np.isfinite(run.feedforward[:, 0])
    assert helped[at - 200 : at].mean() > 0.9
    last = int(np.flatnonzero(helped)[-1])
    assert at <= last <= at + 2 * STALE_CYCLES + 20  # what was under way when it was killed, then held a little
    assert not helped[last + 1 :].any()
    assert len(run.trace) == len(motion)  # the motion goes on to its end
    assert run.trace.position_command is not None
    assert alone.trace.position_command is not None
    error = np.abs(run.trace.position - run.trace.position_command)
    worst_alone = np.abs(alone.trace.position - alone.trace.position_command).max()
    assert error[last:].max() < 2 * worst_alone
    settled = slice(last + 400, None)
    np.testing.assert_allclose(
        run.trace.position[settled], alone.trace.position[settled], atol=0.1 * worst_alone
    )  # a moment later it cannot be told from a run that never had one
    assert run.trace.torque_command is not None
    step = np.abs(np.diff(run.trace.torque_command, axis=0)).max(axis=1)
    assert step[last : last + 2].max() < 15.0  # integrators take the torque over: no jump by what was fed, 30 N m


def followed(name: str, error: float, late: int = 0, helped: float = 1.0, seed: int = 0) -> Tracking:
    """Ten seconds of a run that is `error` m off, rms, more here and less there."""
    time = np.arange(0.5, 10.5, 1e-3)
    missed = error * np.abs(np.random.default_rng(seed).standard_normal(len(time)))
    return Tracking(name, time, np.zeros((len(time), 3)), np.full(3, error), missed, missed, error, helped, 0.0, late)


class TestVerdict:
    """What a comparison says, and when it says that it says nothing."""

    def test_a_ratio_has_the_true_one_in_its_interval(self) -> None:
        found = ratio(followed(RIGID, 2e-3, seed=1), followed(CORRECTED, 5e-4, seed=2))
        assert found.value == pytest.approx(0.25, rel=0.03)
        assert found.low < 0.25 < found.high
        assert found.high - found.low < 0.03
        same = ratio(followed(RIGID, 2e-3, seed=1), followed(CORRECTED, 2e-3, seed=2))
        assert same.low < 1.0 < same.high

    def test_late_cycles_spoil_what_is_fed_and_nothing_else(self) -> None:
        assert not followed(RIGID, 1e-3, late=99).spoilt  # of 10 000
        assert followed(RIGID, 1e-3, late=101).spoilt
        assert followed(CORRECTED, 1e-3, helped=0.98).spoilt
        assert followed(CORRECTED, 1e-3, helped=0.0).spoilt  # the estimator said nothing at all
        assert not followed(FEEDBACK, 1e-3, late=5000, helped=0.0).spoilt  # nothing has to come in time

    @pytest.mark.parametrize(
        ("error", "late", "answer", "step"),
        [
            (5e-4, 0, "With the correction the platform follows 2 times as well as with the rigid model.",
             "run the estimator with this feed-forward:"),
            (2e-3, 0, "With the correction the platform follows worse than with the rigid model: 2 times the error.",
             "keep the rigid model: the correction makes the tracking worse here."),
            (1e-3, 0, "With the correction the platform follows as well as with the rigid model: this run shows no "
             "difference.", "a longer --duration narrows the interval."),
            (5e-4, 700, "These results are not valid: the computer was too slow.",
             "Stop other programs on this computer, or give a lower --rate, and run it again."),
        ],
    )  # fmt: skip
    def test_it_says_what_the_correction_is_worth_and_what_to_do(
        self, error: float, late: int, answer: str, step: str
    ) -> None:
        runs = [followed(FEEDBACK, 5e-3), followed(RIGID, 1e-3), followed(CORRECTED, error, late)]
        said = verdict_of_correction(runs, "backlash in joint 2", ["backlash"], (Path("i.toml"), Path("c.toml")))
        assert said.answer == answer
        assert said.step == step
        following = {5e-4: "c.toml", 2e-3: "i.toml"}.get(error) if not late else None
        assert said.following == (f"deltatwin estimate --robot {following}" if following else "")
        if late:
            assert said.lines[0] == "corrected tau_FF: 700 of 10000 cycles began late, 0.0 % had no feed-forward."
        else:
            assert said.number == f"{error / 1e-3:.2g} times"
            assert said.lines[0].startswith("Platform error, feedback alone → rigid tau_FF → corrected tau_FF: ")
            assert said.lines[1] == "The correction: backlash in joint 2."
            assert said.lines[2].startswith("The online model does not contain backlash")

    def test_the_page_begins_with_it(self, tmp_path: Path) -> None:
        runs = [followed(FEEDBACK, 5e-3), followed(RIGID, 1e-3), followed(CORRECTED, 5e-4)]
        said = verdict_of_correction(runs, "backlash in joint 2", [], (Path("i.toml"), Path("c.toml")))
        write_page(page("d3", "ideal", (1.0,), runs, runs, said), tmp_path / "page.html")
        body = (tmp_path / "page.html").read_text(encoding="utf-8").partition("<body>")[2]
        first = body.partition('<section class="headline good">')
        assert re.sub(r"<.*?>", "", first[0]).strip() == "Closed loop: d3"
        assert f"{said.answer}</p>" in first[2].partition("</section>")[0]
        assert "corrected tau_FF" in body
        seen = looked_at(tmp_path / "page.html")
        assert seen["errors"] == []
        assert seen["over"] == []


def test_with_a_soft_gear_the_platform_hangs_where_the_encoders_do_not_see_it(
    robot: Robot, make_plant: Callable[[], Plant]
) -> None:
    """At rest the link hangs below the motor by torque over stiffness."""
    stiffness = 1500.0
    smooth = make_plant().described.model_copy(update={"coulomb_friction_nm": [0.0] * 3})  # which would hold the motor
    soft = Plant(robot, smooth, (JointElasticity([stiffness, 0.0, 0.0], 0.1),), seed=3)
    still = Planner(robot, 1e-3).slow(np.random.default_rng(1), 1.0)
    run = follow(robot, lambda: soft, still, None, pace=lambda _: 0)
    assert run.trace.position_command is not None
    theta, torque = run.trace.position_command[-1], run.trace.torque[-300:].mean(axis=0)
    model = pack(robot)
    wound = kinematics.forward(model, theta - np.array([torque[0] / stiffness, 0, 0])) - kinematics.forward(
        model, theta
    )
    assert np.linalg.norm(wound) > 1e-3
    np.testing.assert_allclose(run.astray[-300:].mean(axis=0), wound, atol=0.15 * float(np.linalg.norm(wound)))
    found = tracking(robot, FEEDBACK, run)
    assert found.missed[-1] < 0.2 * found.astray[-1]


def test_the_command_compares_rigid_and_corrected_on_a_robot_that_has_the_effect(tmp_path: Path, robot: Robot) -> None:
    save_robot(robot, tmp_path / "robot.toml")
    entry = EffectEntry(name="torque_offset", joints=[1], parameters={"offset": EffectParameter(value=0.5, unit="N m")})
    save_robot(robot.model_copy(update={"effect": [entry]}), tmp_path / "corrected.toml")
    done = subprocess.run(  # it goes to real-time priority, which this process is not to keep
        [sys.executable, "-m", "deltatwin", "closed-loop", "--robot", "robot.toml", "--identified", "robot.toml",
         "--corrected", "corrected.toml", "--effect", "torque_offset", "--duration", "3", "--payload", "1",
         "--out", "loop", "--json"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    found = json.loads((tmp_path / "loop" / "closed_loop.json").read_text(encoding="utf-8"))
    assert [run["name"] for run in found["runs"]] == [FEEDBACK, RIGID, CORRECTED]
    assert found["robot"].startswith("ideal: exactly as described; torque_offset: offset_nm ")
    assert found["counts"] == all(run["counts"] for run in found["runs"])
    assert done.returncode == (0 if found["counts"] else 3), done.stdout + done.stderr  # a busy machine may be too slow
    assert 0 < found["platform_ratio"]["ci95"][0] < found["platform_ratio"]["ci95"][1]
    text = (tmp_path / "loop" / "closed_loop.html").read_text(encoding="utf-8")
    assert "torque_offset" in text


class TestIntake:
    """Which feed-forward torque is in force."""

    def intake(self) -> tuple[FeedforwardIntake, Callable[..., None]]:
        """An intake behind an inbox without a session, and what puts a message into that."""
        waiting: list[bytes] = []
        channel = SimpleNamespace(
            recv=None,
            try_recv=lambda: (
                SimpleNamespace(payload=SimpleNamespace(to_bytes=partial(waiting.pop, 0))) if waiting else None
            ),
        )

        def give(target: int, torque: float, cut: int = 0) -> None:
            record = FEEDFORWARD.empty(1)
            record["target_sequence"], record["torque"] = target, torque
            waiting.append(record.tobytes()[cut:])

        inbox = Inbox(FEEDFORWARD, channel, lambda: None)  # pyright: ignore[reportArgumentType]: what it needs of one
        return FeedforwardIntake(inbox, 50.0), give

    def test_holds_three_cycles_then_lets_go(self) -> None:
        intake, give = self.intake()
        assert intake.at(0) is None
        assert intake.newest is None
        give(1, 7.0)
        found = [intake.at(cycle) for cycle in range(1, 7)]
        assert [None if torque is None else float(torque[0]) for torque in found] == [7.0, 7.0, 7.0, 7.0, None, None]
        assert intake.newest == 1  # from cycle 2 on it was one for an earlier cycle

    def test_waits_for_its_cycle_limits_and_refuses(self) -> None:
        intake, give = self.intake()
        give(12, 9.0)
        give(10, 80.0)
        give(11, float("nan"))
        give(3, 5.0)
        give(10_000, 5.0)
        give(9, 5.0, cut=1)
        assert intake.at(9) is None
        torques = [intake.at(cycle) for cycle in (10, 11, 12)]
        assert [None if torque is None else float(torque[0]) for torque in torques] == [50.0, 50.0, 9.0]
        assert (intake.received, intake.refused) == (5, 4)
