"""The estimator behind a bus: what its health says."""

import time

import numpy as np
import pytest

from drivers.bus import LINK_S, open_bus
from schemas.messages import HealthFlag, Role
from service.estimator.estimator import Estimator
from service.estimator.keep import Keeper
from service.estimator.node import Node


@pytest.mark.parametrize(("share", "drifted"), [(0.1, False), (0.5, True)], ids=["within", "beyond"])
def test_health_says_that_friction_is_not_what_was_identified(bus_folder, tmp_path, robot, make, until, share, drifted):
    """The description allows 30 %; the flag is in the health that others hear, with the friction that it is about,
    which is kept."""
    known = make(3.0, noise=0.25)
    found = robot.identified
    direction = np.clip(known.theta_dot / 0.01, -1, 1)
    known.samples["torque"] += share * (
        found.viscous_friction_nms.value * known.theta_dot + found.coulomb_friction_nm.value * direction
    )
    Estimator(robot, 1e-3).warm_up()
    with open_bus(robot.name, Role.PLAYER) as player, open_bus(robot.name, Role.ESTIMATOR) as bus:
        health, told = player.subscribe("health"), player.subscribe("friction")
        publisher = player.publisher("sample")
        node = Node(robot, bus, HealthFlag(0), Keeper(tmp_path / "friction.json", robot))
        until(lambda: publisher.heard and Role.ESTIMATOR in player.alive)
        time.sleep(LINK_S)
        for record in known.samples:
            publisher.put(record.tobytes())
            node.step()
        node.report()
        said, friction = [], []

        def heard() -> bool:
            said.extend(health.take()[0])
            friction.extend(told.take()[0])
            return bool(said and friction) and said[-1]["received"] == len(known.samples)

        until(heard)
        node.close()
    assert "counted 100%" in Keeper(tmp_path / "friction.json", robot).begin(Estimator(robot, 1e-3))
    assert (friction[-1]["drift"] > robot.limits.friction_drift).any() == drifted
    assert (HealthFlag.FRICTION_DRIFT in HealthFlag(int(said[-1]["flags"]))) == drifted


def test_reports_come_a_thousand_a_second_whatever_sequence_numbers_were_kept(bus_folder, robot, make, until):
    """Every second sample of an 8 kHz bus, from an odd number on: 4 kHz, and a report every fourth."""
    samples = make(0.5, period=2.5e-4).samples
    samples["sequence"] = 2 * np.arange(len(samples)) + 1
    with open_bus(robot.name, Role.PLAYER) as player, open_bus(robot.name, Role.ESTIMATOR) as bus:
        reports, publisher = player.subscribe("payload"), player.publisher("sample")
        node = Node(robot, bus, HealthFlag(0))
        until(lambda: publisher.heard and Role.ESTIMATOR in player.alive)
        time.sleep(LINK_S)
        for record in samples:
            publisher.put(record.tobytes())
            node.step()
        told = []
        until(lambda: told.extend(reports.take()[0]) or len(told) > 400)
    assert (np.diff([report["sequence"] for report in told]) == 8).all()
