"""The bus between real processes: any start order, restarts, stuck subscribers, garbage, two of one role."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.bus import SOURCES, open_bus, runtime_folder
from drivers.inbox import Inbox, sending
from drivers.sequence import SequenceCounter
from schemas.errors import BusError, RobotError
from schemas.messages import SAMPLE, Role, set_stamp

PEER = Path(__file__).with_name("bus_peer.py")


class Peer:
    """A `bus_peer.py` process and what it said."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(PEER), "bench", *arguments], stdout=subprocess.PIPE, text=True
        )

    def hear(self, wanted: str) -> dict:
        """The next line that has the key `wanted`."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            said = json.loads(line)
            if wanted in said:
                return said
        raise AssertionError(f"process ended without saying {wanted!r}")

    def finish(self) -> dict:
        """End a counting peer and return its counts."""
        self.process.send_signal(signal.SIGTERM)
        return self.hear("end")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def peer(bus_folder: Path) -> Iterator[Callable[..., Peer]]:
    started: list[Peer] = []

    def start(*arguments: str) -> Peer:
        started.append(Peer(*arguments))
        return started[-1]

    yield start
    for one in started:
        one.kill()


def numbered(start: int, stop: int) -> list[bytes]:
    records = SAMPLE.empty(stop - start)
    records["sequence"] = np.arange(start, stop)
    return [record.tobytes() for record in records]


def collect(inbox: Inbox, count: int, until) -> np.ndarray:
    taken: list[np.ndarray] = []
    until(lambda: (taken.append(inbox.take()[0]) or True) and sum(map(len, taken)) >= count)
    return np.concatenate(taken)


@pytest.mark.parametrize(("sender", "counter"), [("PLAYER", "MONITOR"), ("MASTER", "ESTIMATOR")])
@pytest.mark.parametrize("sender_first", [True, False])
def test_any_start_order_carries_every_sample(peer, sender: str, counter: str, sender_first: bool) -> None:
    def send() -> Peer:
        return peer(sender, "send", "400", "0.00025")

    if sender_first:
        sending = send()
        sending.hear("ready")
        counting = peer(counter, "count")
    else:
        counting = peer(counter, "count")
        counting.hear("ready")
        sending = send()
    sending.hear("sent")
    while counting.hear("received")["received"] < 400:
        pass
    end = counting.finish()
    assert (end["received"], end["newest"], end["lost"], end["repeated"]) == (400, 399, 0, 0)


def test_subscriber_killed_and_started_again_hears_again(bus_folder: Path, peer, until) -> None:
    with open_bus("bench", Role.ROBOT) as bus:
        publisher = bus.publisher("sample")
        first = peer("OBSERVER", "count")
        first.hear("ready")
        until(lambda: publisher.heard)
        first.kill()
        until(lambda: not publisher.heard and Role.OBSERVER not in bus.alive)
        second = peer("OBSERVER", "count")
        second.hear("ready")
        until(lambda: publisher.heard and Role.OBSERVER in bus.alive)
        for payload in numbered(0, 100):
            publisher.put(payload)
        while second.hear("received")["received"] < 100:
            pass


@pytest.mark.parametrize("role", ["PLAYER", "MASTER"])
def test_publisher_killed_and_started_again_is_heard_as_a_restart(bus_folder: Path, peer, role: str, until) -> None:
    with open_bus("bench", Role.MONITOR) as bus:
        inbox, counter = bus.subscribe("sample"), SequenceCounter()
        for _ in range(2):
            sending = peer(role, "send", "200", "0.001")
            counter.update_many(collect(inbox, 200, until)["sequence"])
            assert bus.alive == {Role.MONITOR, Role[role]}
            sending.kill()
            until(lambda: bus.alive == {Role.MONITOR})
    assert (counter.restarts, counter.lost, counter.repeated, counter.out_of_order) == (1, 0, 0, 0)


@pytest.mark.parametrize(("me", "victim"), [(Role.PLAYER, "MONITOR"), (Role.MASTER, "ESTIMATOR")])
def test_stopped_subscriber_costs_the_others_nothing_and_comes_back(
    bus_folder: Path, peer, me: Role, victim: str, until
) -> None:
    with open_bus("bench", me) as bus:
        publisher = bus.publisher("sample")
        stuck, healthy = peer(victim, "count"), peer("OBSERVER", "count")
        until(lambda: len(bus.alive) == 3)
        payloads = numbered(0, 3000)
        for payload in payloads[:100]:
            publisher.put(payload)
        while stuck.hear("received")["received"] < 100:
            pass
        stuck.process.send_signal(signal.SIGSTOP)
        for payload in payloads[100:2000]:  # many times what is buffered for it
            publisher.put(payload)
            time.sleep(0.001)
        stuck.process.send_signal(signal.SIGCONT)
        while stuck.hear("received")["received"] <= 100:
            pass
        for payload in payloads[2000:]:
            publisher.put(payload)
            time.sleep(0.001)
        while healthy.hear("received")["received"] < 3000:
            pass
        while stuck.hear("newest")["newest"] < 2999:
            pass
        kept, hurt = healthy.finish(), stuck.finish()
    assert (kept["received"], kept["lost"], kept["repeated"], kept["out_of_order"]) == (3000, 0, 0, 0)
    assert hurt["lost"] > 0
    assert hurt["received"] + hurt["lost"] == 3000


def test_second_process_of_a_role_gets_one_clear_error(peer) -> None:
    first = peer("PLAYER", "count")
    first.hear("ready")
    error = peer("PLAYER", "count").hear("error")["error"]
    assert error == f"robot 'bench': another player is running (process {first.process.pid})"
    assert [Role.ESTIMATOR.noun, Role.ROBOT.noun, Role.OBSERVER.noun] == [
        "estimator", "simulated robot", "`view` or `top`",
    ]  # fmt: skip
    first.kill()  # leaves its socket and lock file behind
    peer("PLAYER", "count").hear("ready")


def test_one_robot_does_not_hear_the_other(bus_folder: Path, until) -> None:
    with (
        open_bus("left", Role.PLAYER) as left,
        open_bus("right", Role.PLAYER) as right,
        open_bus("left", Role.MONITOR) as monitor,
    ):
        inbox, publisher = monitor.subscribe("sample"), left.publisher("sample")
        until(lambda: publisher.heard)
        assert not right.publisher("sample").heard
        right.publisher("sample").put(numbered(7, 8)[0])
        publisher.put(numbered(1, 2)[0])
        assert collect(inbox, 1, until)["sequence"].tolist() == [1]


def test_garbage_is_counted_and_passed_over(bus_folder: Path, until) -> None:
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox = monitor.subscribe("sample")
        publisher = player.publisher("sample")
        until(lambda: publisher.heard)
        good = numbered(0, 2)
        for payload in (b"", b"garbage", good[0][:-1], good[0] + b"\0", b"\xff" * len(good[0]), good[1]):
            publisher.put(payload)
        assert collect(inbox, 1, until).tobytes() == good[1]
        assert inbox.rejected == 5


def test_full_inbox_keeps_the_newest_and_leaves_a_hole(bus_folder: Path, until) -> None:
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox, counter = monitor.subscribe("sample", capacity=64), SequenceCounter()
        publisher = player.publisher("sample")
        until(lambda: publisher.heard)
        publisher.put(numbered(0, 1)[0])
        counter.update_many(collect(inbox, 1, until)["sequence"])
        for payload in numbered(1, 3000):  # many times what is buffered anywhere
            publisher.put(payload)
            time.sleep(0.0001)
        records: list[np.ndarray] = []
        until(lambda: bool(records.append(inbox.take()[0]) or records[-1]["sequence"].max(initial=0) == 2999))
        counter.update_many(np.concatenate(records)["sequence"])
        assert len(records[0]) <= 64
        assert counter.newest == 2999
        assert counter.lost == 2999 - sum(map(len, records)) >= 2900
        assert counter.repeated == counter.out_of_order == 0


def test_what_waits_in_an_inbox_takes_little_more_than_its_bytes(bus_folder: Path, until) -> None:
    """Zenoh keeps the whole buffer that a message was read into as long as the message waits."""

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    payloads = numbered(0, 3000)
    with open_bus("bench", Role.MONITOR) as bus, open_bus("bench", Role.PLAYER) as player:
        inbox, publisher = bus.subscribe("sample"), player.publisher("sample")
        until(lambda: publisher.heard)
        before = resident()
        for payload in payloads:
            publisher.put(payload)
            time.sleep(0.0002)
        time.sleep(0.2)
        grown = resident() - before
        assert len(inbox.take()[0]) > 2500
    assert grown < 3000 * 4096


def test_wait_ends_with_a_message_at_its_limit_or_with_an_interrupt(bus_folder: Path, until) -> None:
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox, publisher = monitor.subscribe("sample"), player.publisher("sample")
        until(lambda: publisher.heard)
        begin = time.monotonic()
        assert not inbox.wait(0.05)
        assert 0.05 <= time.monotonic() - begin < 5.0
        publisher.put(numbered(0, 1)[0])
        assert inbox.wait(30.0)
        assert inbox.wait(0.0)  # until it is taken
        records, arrival = inbox.take()
        assert records["sequence"].tolist() == [0]
        assert begin * 1e9 < arrival[0] <= time.monotonic_ns()
        assert records.flags.writeable  # another kind of array would compile another kernel
        publisher.put(b"")  # a foreign empty message is garbage, our own nudges are not
        until(lambda: not inbox.wait(0.01) and inbox.rejected == 1)
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(KeyboardInterrupt):
            inbox.wait(30.0)


def test_sending_times_are_those_of_the_sender_if_they_can_be(bus_folder: Path, until) -> None:
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox, publisher = monitor.subscribe("sample", clock=sending), player.publisher("sample")
        until(lambda: publisher.heard)
        before = time.time_ns()
        publisher.put(numbered(0, 1)[0])
        after = time.time_ns()
        time.sleep(0.2)
        _, sent = inbox.take()
        assert before - 1_000_000 <= sent[0] <= after + 1_000_000


@pytest.mark.parametrize("ahead_s", [None, 3600, -3600])
def test_a_stamp_that_cannot_be_believed_is_replaced_by_the_time_of_taking(ahead_s: float | None) -> None:
    stamp = None
    if ahead_s is not None:
        time_ns = SimpleNamespace(as_nanos=lambda: time.time_ns() + int(ahead_s * 1e9))
        stamp = SimpleNamespace(get_time_as_ntp64=lambda: time_ns)
    before = time.time_ns()
    sample: Any = SimpleNamespace(timestamp=stamp)
    assert before <= sending(sample) <= time.time_ns()


def test_two_sources_are_noticed(bus_folder: Path, until) -> None:
    with open_bus("bench", Role.MONITOR) as monitor, open_bus("bench", Role.PLAYER):
        until(lambda: Role.PLAYER in monitor.alive)
        assert not monitor.duplicate_source
        with open_bus("bench", Role.TAP):
            until(lambda: monitor.duplicate_source)
        until(lambda: not monitor.duplicate_source)
    assert Role.MONITOR not in SOURCES


def test_user_configuration_replaces_the_sockets_and_finds_doubles(bus_folder: Path, tmp_path: Path, until) -> None:
    quiet = '"scouting": {"multicast": {"enabled": false}, "gossip": {"enabled": false}}'
    hub = tmp_path / "hub.json5"
    hub.write_text(f'{{"mode": "peer", {quiet}, "listen": {{"endpoints": ["tcp/127.0.0.1:37447"]}}}}')
    leaf = tmp_path / "leaf.json5"
    leaf.write_text(
        f'{{"mode": "client", {quiet}, "connect": {{"endpoints": ["tcp/127.0.0.1:37447"]}}, "listen": {{}}}}'
    )
    with open_bus("bench", Role.PLAYER, hub) as player:
        assert not list(runtime_folder().glob("*.sock"))
        with open_bus("bench", Role.MONITOR, leaf) as monitor:
            inbox, publisher = monitor.subscribe("sample"), player.publisher("sample")
            until(lambda: publisher.heard)
            publisher.put(numbered(3, 4)[0])
            assert collect(inbox, 1, until)["sequence"].tolist() == [3]
        (runtime_folder() / "bench.player.pid").unlink()  # as on another host: only the network can tell
        with pytest.raises(BusError, match="another player is running elsewhere"):
            open_bus("bench", Role.PLAYER, leaf)


def test_a_user_configuration_needs_no_right_to_lock_memory(bus_folder: Path, tmp_path: Path) -> None:
    """Shared memory, on by default, does: Zenoh would not open at all."""
    settings = tmp_path / "alone.json5"
    settings.write_text('{"mode": "peer", "scouting": {"multicast": {"enabled": false}}, "listen": {"endpoints": []}}')
    code = f"""
import resource
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
from pathlib import Path
from drivers.bus import open_bus
from schemas.messages import Role
open_bus("bench", Role.PLAYER, Path({str(settings)!r})).close()
"""
    dropped = ("setpriv", "--bounding-set=-ipc_lock", "--inh-caps=-ipc_lock") if os.geteuid() == 0 else ()
    done = subprocess.run((*dropped, sys.executable, "-c", code), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("text", "message"), [(None, "No such file"), ("{mode: 'nonsense'}", "not a Zenoh configuration")]
)
def test_bad_user_configuration_is_named(bus_folder: Path, tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "user.json5"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BusError, match=rf"user\.json5: .*{message}"):
        open_bus("bench", Role.PLAYER, path)


def test_robot_name_that_cannot_be_a_key_or_a_socket_is_refused(bus_folder: Path) -> None:
    with pytest.raises(RobotError, match="a/b"):
        open_bus("a/b", Role.PLAYER)
    with pytest.raises(BusError, match="longer than 107 bytes"):
        open_bus("r" * 120, Role.PLAYER)


def test_runtime_folder_is_private(bus_folder: Path) -> None:
    assert runtime_folder().stat().st_mode & 0o777 == 0o700


def counts(sequences: list[int]) -> tuple[int, int, int, int, int]:
    one_by_one, at_once = SequenceCounter(), SequenceCounter()
    for sequence in sequences:
        one_by_one.update(sequence)
    at_once.update_many(np.array(sequences, np.uint64))
    results = [(c.newest, c.lost, c.repeated, c.out_of_order, c.restarts) for c in (one_by_one, at_once)]
    assert results[0] == results[1]
    return results[0]


@pytest.mark.parametrize(
    ("sequences", "expected"),
    [
        ([5, 6, 7], (7, 0, 0, 0, 0)),  # joining late is no loss
        ([0, 1, 4], (4, 2, 0, 0, 0)),
        ([0, 1, 1, 2, 0], (2, 0, 2, 0, 0)),
        ([0, 2, 1, 3], (3, 0, 0, 1, 0)),
        ([0, 3, 2, 2, 4], (4, 1, 1, 1, 0)),
        ([*range(1000), *range(50)], (49, 0, 0, 0, 1)),
        ([0, 1, 100, *range(2, 50)], (49, 98, 0, 0, 1)),
    ],
)
def test_sequence_counter(sequences: list[int], expected: tuple[int, ...]) -> None:
    assert counts(sequences) == expected


BIG = 2**64 - 1


@pytest.mark.parametrize(
    ("sequences", "expected"),
    [
        ([BIG, *range(1, 40), BIG], (BIG, 0, 0, 0, 2)),  # back by what cannot be a loss, and forth again
        ([0, 2**63, 2**63 + 1], (2**63 + 1, 0, 0, 0, 1)),
        ([0, 1, 2**28], (2**28, 2**28 - 2, 0, 0, 0)),
        ([0, 2**27, 5, 2**27 + 1, 2**27 - 1], (2**27 + 1, 2**27 - 3, 0, 2, 0)),
    ],
)
def test_sequence_counter_takes_any_number(sequences: list[int], expected: tuple[int, ...]) -> None:
    assert counts(sequences) == expected


def test_holes_cost_neither_time_nor_memory() -> None:
    counter = SequenceCounter()
    tracemalloc.start()
    for step in range(200_000):
        counter.update(step * 2**20)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert counter.lost == 199_999 * (2**20 - 1)
    assert held < 100_000


def test_sequence_counter_agrees_with_sets_on_random_traffic() -> None:
    generator = np.random.default_rng(3)
    sent = np.arange(2000)
    kept = sent[generator.random(2000) > 0.05]
    shuffled = kept[np.argsort(kept + generator.uniform(0, 6, len(kept)), kind="stable")]
    doubled = np.repeat(shuffled, np.where(generator.random(len(shuffled)) < 0.03, 2, 1))
    newest, lost, repeated, out_of_order, restarts = counts(doubled.tolist())
    first = int(doubled[0])
    assert newest == doubled.max()
    assert lost == newest - first + 1 - len({number for number in doubled.tolist() if number >= first})
    assert repeated + out_of_order == np.sum(doubled[1:] <= np.maximum.accumulate(doubled)[:-1])
    assert restarts == 0


def test_inbox_reads_the_stamp_it_was_sent(bus_folder: Path, until) -> None:
    record = SAMPLE.empty(1)
    set_stamp(record, 1_700_000_000_123_456_789)
    record["position"] = [[0.1, -0.2, 0.3]]
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox, publisher = monitor.subscribe("sample"), player.publisher("sample")
        until(lambda: publisher.heard)
        publisher.put(record[0].tobytes())
        assert collect(inbox, 1, until).tobytes() == record.tobytes()
