"""The loop closed over Zenoh: what the feed-forward is worth, and that the robot is safe when it goes away."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.inbox import Inbox
from drivers.motion import Planner, Trajectory
from drivers.plant.live import STALE_CYCLES, FeedforwardIntake, LiveRun
from drivers.plant.plant import Plant
from drivers.plant.truth import PlantTruth
from schemas.messages import FEEDFORWARD
from schemas.robot import Geometry, Identified, JointParameter, Mass, Parameter, Robot
from service.experiment.closed_loop import FEEDBACK, follow, tracking, variants

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
        give(1, 7.0)
        found = [intake.at(cycle) for cycle in range(1, 7)]
        assert [None if torque is None else float(torque[0]) for torque in found] == [7.0, 7.0, 7.0, 7.0, None, None]

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
