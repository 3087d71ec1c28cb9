"""A log whose torque is not the identified robot's: refused by what is wrong with it, not weighed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.errors import DataError
from schemas.robot import Robot, load_robot
from schemas.trace import Trace
from service.identification.known_torque import refuse_unlike
from service.identification.weighed_picks import payload_history
from service.model.dynamics import PAYLOAD, torque_terms
from service.model.nominal import pack
from service.model.prediction import FULL, motion, predict_along


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(ROBOT)


@pytest.fixture(scope="module")
def log(robot: Robot) -> Trace:
    return read_trace(LOG, robot)


def see(robot: Robot, trace: Trace) -> None:
    along = motion(trace)
    refuse_unlike(robot, trace, along, predict_along(robot, trace, along)[FULL])


def test_a_log_with_picks_of_the_robot_is_its_own(robot: Robot, log: Trace) -> None:
    see(robot, log)


@pytest.mark.parametrize(
    ("turned", "said"),
    [
        (np.diag([-1.0, -1.0, -1.0]), "the torque of joints 1, 2 and 3 has the wrong sign: corrected, the model"),
        (np.diag([1.0, -1.0, 1.0]), "the torque of joint 2 has the wrong sign"),
        (np.eye(3)[[0, 2, 1]], "the torques of joints 2 and 3 are swapped"),
        (10 * np.eye(3), "the torque is 10 times what it should be: wrong unit, or side of the gear"),
        (0.1 * np.eye(3), "the torque is 0.1 times what it should be"),
        (np.eye(3) / 0.112984829, "the torque is 8.85 times what it should be"),
    ],
)  # fmt: skip
def test_a_torque_read_wrongly_is_refused_by_what_is_wrong(
    robot: Robot, log: Trace, turned: np.ndarray, said: str
) -> None:
    wrong = replace(log, torque=log.torque @ turned)
    with pytest.raises(DataError, match=f"log.mcap: {said}") as told:
        payload_history(robot, wrong)
    assert "\n" not in str(told.value)


def test_so_is_a_log_of_another_machine(robot: Robot, log: Trace) -> None:
    """The torque of another moment has nothing to do with the motion."""
    other = replace(log, torque=np.roll(log.torque, len(log) // 3, axis=0))
    with pytest.raises(DataError, match="whatever the payload: is it a log of another robot, or in another unit"):
        payload_history(robot, other)


@pytest.mark.parametrize("mass", [0.5, 3.0, 6.0])
def test_a_payload_all_through_is_none_of_this(robot: Robot, log: Trace, mass: float) -> None:
    along = motion(log)
    load = mass * torque_terms(pack(robot), along.theta, along.theta_dot, along.theta_ddot)[:, PAYLOAD]
    see(robot, replace(log, torque=log.torque + load))
