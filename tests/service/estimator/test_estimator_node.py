"""The estimator behind a bus: what its health says."""

import time

import numpy as np
import pytest

from drivers.bus import LINK_S, open_bus
from schemas.messages import REFERENCE, FeedforwardSource, HealthFlag, Role
from service.estimator.estimator import Estimator
from service.estimator.estimator_node import STALE_NS, EstimatorNode, run
from service.estimator.keep import Keeper
from tests.service.world import stub

KEPT = "friction.json"
TOPICS = ("feedforward", "payload", "error", "friction", "health")


class Bench:
    """A node on a bus, its source, and everything that it says, by topic."""

    def __init__(self, robot, player, bus, until, keeper):
        self._inboxes, self._until = {topic: player.subscribe(topic) for topic in TOPICS}, until
        self._samples, self.plan = player.publisher("sample"), player.publisher("reference").put
        self.node, self.sent, self.said = (
            EstimatorNode(robot, bus, HealthFlag(0), keeper),
            0,
            {topic: [] for topic in TOPICS},
        )
        until(lambda: self._samples.heard and Role.ESTIMATOR in player.alive)
        time.sleep(LINK_S)

    def take(self, records):
        """One after the other."""
        for record in records:
            self._samples.put(record.tobytes())
            self.sent += 1
            self._until(lambda: self.node.step() or self.node._received == self.sent)

    def report(self):
        """All messages so far by topic, and the newest health."""
        self.node.report()

        def heard() -> bool:
            for topic, inbox in self._inboxes.items():
                self.said[topic].extend(inbox.take()[0])
            health = self.said["health"]
            return bool(health) and health[-1]["received"] == self.sent and self.counted() >= health[-1]["published"]

        self._until(heard)
        return self.said, self.said["health"][-1]

    def until_health_says(self, flag):
        """Of its own accord."""
        told, inbox = self.said["health"], self._inboxes["health"]
        self._until(lambda: told.extend(inbox.take()[0]) or any(flag & HealthFlag(int(one["flags"])) for one in told))

    def counted(self):
        """How many that is, health aside."""
        return sum(len(told) for topic, told in self.said.items() if topic != "health")


@pytest.fixture
def bench(bus_folder, tmp_path, robot, until):
    Estimator(robot, 1e-3).warm_up()
    with open_bus(robot.name, Role.PLAYER) as player, open_bus(robot.name, Role.ESTIMATOR) as bus:
        yield Bench(robot, player, bus, until, Keeper(tmp_path / KEPT, robot))


@pytest.mark.parametrize(
    ("share", "drifted"), [([0.1, 0.1, 0.1], False), ([0.0, 0.5, 0.0], True)], ids=["within", "beyond"]
)
def test_health_says_that_friction_is_not_what_was_identified(bench, tmp_path, robot, make, share, drifted, capsys):
    """The description allows 30 %, each joint; the flag is in the health that others hear, with the friction that it is
    about, which is kept."""
    known = make(3.0, noise=0.25)
    found = robot.identified
    direction = np.clip(known.theta_dot / 0.01, -1, 1)
    known.samples["torque"] += share * (
        found.viscous_friction_nms.value * known.theta_dot + found.coulomb_friction_nm.value * direction
    )
    bench.take(known.samples)
    told, health = bench.report()
    assert "learnt friction will be stored here" in capsys.readouterr().err
    assert len(told["payload"]) > 2900
    assert (np.diff([one["sequence"] for one in told["payload"]]) == 1).all(), "no more than a thousand a second come"
    assert (told["friction"][-1]["drift"] > robot.limits.friction_drift).any() == drifted
    assert (HealthFlag.FRICTION_DRIFT in HealthFlag(int(health["flags"]))) == drifted
    bench.node.close()
    assert "used with weight 100%" in Keeper(tmp_path / KEPT, robot).begin(Estimator(robot, 1e-3))


@pytest.mark.parametrize(("scale", "changed"), [(0.03, False), (-0.06, True)], ids=["within", "beyond"])
def test_health_says_that_a_torque_constant_has_changed(bench, robot, make, scale, changed):
    """The description allows 4 %; either way it is learnt, and told."""
    known = make(4.0, noise=0.05)
    known.samples["torque"][:, 1] *= 1.0 + scale
    bench.take(known.samples)
    told, health = bench.report()
    np.testing.assert_allclose(told["friction"][-1]["scale"], [0.0, scale, 0.0], atol=0.008)
    assert (HealthFlag.SCALE_DRIFT in HealthFlag(int(health["flags"]))) == changed


@pytest.mark.parametrize(("late", "refuted"), [(0, False), (3, True)], ids=["at once", "3 ms late"])
def test_health_says_that_drives_do_not_do_what_they_are_told(bench, robot, make, late, refuted):
    """Only of a robot of which `identify` found that they do."""
    known = make(0.4, noise=0.25)
    known.samples["torque_command"] = np.roll(known.torque, -late, axis=0)
    told = robot.identified.model_copy(update={"torque_commanded": True})
    bench.node._robot = robot.model_copy(update={"identified": told})
    bench.take(known.samples)
    _, health = bench.report()
    assert (HealthFlag.COMMAND_REFUTED in HealthFlag(int(health["flags"]))) == refuted


def test_every_sample_is_answered_and_counted(bench, make):
    """At 4 kHz payload and errors are told every fourth cycle; what was lost, doubled and not usable is in the health;
    all that went out is counted."""
    known = make(0.2, period=2.5e-4)
    records = known.samples
    records["position"][400:402] = np.nan
    bench.take(np.delete(records, range(300, 303)))
    bench.take(records[-1:])  # once more
    told, health = bench.report()
    assert len(told["feedforward"]) == 798
    for name in ("payload", "error"):
        assert 170 < len(told[name]) < 200, "once the lag line is full"
    assert (health["received"], health["lost"], health["repeated"], health["invalid"]) == (798, 3, 1, 2)
    assert health["published"] == bench.counted()
    assert 0 < health["latency_median"] <= health["latency_max"] < 60.0  # s

    planned = REFERENCE.empty(2)
    for record, ahead in zip(planned, (0, 1), strict=True):
        record["sequence"], record["position"] = 800 + ahead, known.theta[-1]
        bench.plan(record.tobytes())
    bench.plan(b"no plan")
    time.sleep(LINK_S)
    after = records[-1:].copy()
    after["sequence"] += 1
    bench.take(after)
    told, health = bench.report()
    assert health["rejected"] == 1
    assert told["feedforward"][-1]["source"] == FeedforwardSource.REFERENCE
    assert told["feedforward"][-1]["target_sequence"] == 801, "the newest plan"


def test_reports_come_a_thousand_a_second_whatever_sequence_numbers_were_kept(bench, robot, make):
    """Every second sample of an 8 kHz bus, from an odd number on: 4 kHz, and a report every fourth, and every event."""
    samples = make(0.8, period=2.5e-4, payload=lambda time: 2.0 * (time > 0.4)).samples
    samples["sequence"] = 2 * np.arange(len(samples)) + 1
    alone = Estimator(robot, 2.5e-4, 2).run(samples).payload
    events = alone["sequence"][alone["event"] > 0]
    off_the_beat = 2 if events[0] % 8 < 6 else 4
    samples["sequence"] += off_the_beat
    events += off_the_beat
    assert (events // 2 % 4).any()
    bench.take(samples)
    told, _ = bench.report()
    told = np.array([report["sequence"] for report in told["payload"]])
    assert len(told) > 600
    assert np.isin(events, told).all()
    beat = told[~np.isin(told, events)]
    assert (np.diff(beat) == 8).all()
    assert (beat // 2 % 4 == 0).all()


def test_a_silent_source_is_told_and_so_is_that_it_is_back(bench, make):
    records = make(0.05).samples
    bench.take(records[:40])
    assert HealthFlag.STALE_INPUT not in bench.node.health.flags
    time.sleep(1.5 * STALE_NS * 1e-9)
    bench.node.step()
    assert HealthFlag.STALE_INPUT in bench.node.health.flags
    bench.until_health_says(HealthFlag.STALE_INPUT)  # at once
    told, _ = bench.report()
    assert told["friction"] == [], "nothing new is known of friction"
    bench.take(records[40:41])
    assert HealthFlag.STALE_INPUT not in bench.node.health.flags


def test_a_slow_source_is_silent_after_twenty_of_its_cycles(bench, make, monkeypatch):
    bench.take(make(0.5, period=1e-2).samples)
    for silence, stale in ((0.199, False), (0.201, True)):
        now = bench.node._heard_ns + round(silence * 1e9)
        monkeypatch.setattr("service.estimator.estimator_node.time", stub(monotonic_ns=lambda now=now: now))
        bench.node.step()
        assert (HealthFlag.STALE_INPUT in bench.node.health.flags) == stale


def test_it_runs_until_it_is_stopped_and_then_keeps_what_it_learnt(bus_folder, tmp_path, robot, make, until):
    """Stopped by Ctrl-C: the last word is health, the file is whole."""
    Estimator(robot, 1e-3).warm_up()
    records, sent = list(make(0.1).samples), []

    def stopped() -> bool:
        if len(sent) == len(records):
            raise KeyboardInterrupt
        until(lambda: samples.heard)
        samples.put(records[len(sent)].tobytes())
        sent.append(1)
        return False

    with open_bus(robot.name, Role.PLAYER) as player, open_bus(robot.name, Role.ESTIMATOR) as bus:
        samples, answers, health = (
            player.publisher("sample"),
            player.subscribe("feedforward"),
            player.subscribe("health"),
        )
        until(lambda: Role.ESTIMATOR in player.alive)
        with pytest.raises(KeyboardInterrupt):
            run(robot, bus, HealthFlag.NO_REALTIME, stopped, Keeper(tmp_path / KEPT, robot))
        heard = []
        until(lambda: heard.extend(health.take()[0]) or any(HealthFlag.STOPPED & int(one["flags"]) for one in heard))
        assert len(answers.take()[0]) == len(records) == heard[-1]["received"]
        assert HealthFlag.NO_REALTIME & int(heard[-1]["flags"])
    assert "used with weight 100%" in Keeper(tmp_path / KEPT, robot).begin(Estimator(robot, 1e-3))


def test_another_sample_rate_needs_two_readings(bench, make, capsys):
    """A burst of garbage after a report is no other rate; two readings that agree are."""
    bench.take(make(0.05).samples)
    slower = make(1.0, period=2e-3).samples
    slower["sequence"] += 50

    def anew(change="changed from 0.001 s to 0.002 s"):
        return f"{change}; starting again" in capsys.readouterr().err

    bench.report()
    bench.take(slower[:16])
    assert not anew()
    nearly = make(0.05, period=2.03e-3).samples[:16]
    nearly["sequence"] += 80
    bench.take(nearly)  # is not the same one
    assert not anew()
    odd = make(0.02, period=1.3e-3).samples[:16]
    odd["sequence"] += 100
    bench.take(odd)  # another reading, of yet another rate
    assert not anew()
    bench.report()
    bench.take(slower[100:132])
    assert anew()
    bench.report()
    bench.take(slower[132:148])
    assert not anew()
    for number, (period, change) in enumerate([(1.85e-3, None), (1.7e-3, "changed from 0.002 s to 0.0017 s")]):
        faster = make(0.1, period=period).samples
        faster["sequence"] += 1000 + 100 * number
        bench.report()
        bench.take(faster[:32])
        assert anew(change) if change else not anew("changed from 0.002 s")
    told, health = bench.report()
    assert len(told["feedforward"]) == health["received"]


def test_stamps_that_stand_still_are_waited_out(bench, tmp_path, make):
    """Nothing goes out until a period can be read; then all of the first samples are answered."""
    records = make(0.1).samples
    stuck = records[:20].copy()
    stuck["stamp_sec"] = stuck["stamp_nanosec"] = 5
    bench.take(stuck)
    told, health = bench.report()
    assert (health["received"], health["published"]) == (20, 0)
    bench.node.close()
    assert not (tmp_path / KEPT).exists(), "nothing was learnt"
    bench.take(records[20:60])
    told, _ = bench.report()
    answered = [int(one["sequence"]) for one in told["feedforward"]]
    assert answered == list(range(answered[0], 60))
    assert answered[0] <= 20
