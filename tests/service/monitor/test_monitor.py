"""`deltatwin monitor` as a process on the bus: what it records, what it counts, and what kills it or does not."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from drivers.bus import Bus, Publisher, open_bus
from schemas.messages import FEEDFORWARD, HEALTH, OF_DELTA, SAMPLE, TOPICS, HealthFlag, Role, SampleFlag, topics_of
from service.monitor.tally import Tally

OWN = topics_of(OF_DELTA)

COMMAND = Path(sys.executable).with_name("deltatwin")
Until = Callable[[Callable[[], bool]], None]


class Watched:
    """A monitor process and a player session that feeds it."""

    def __init__(self, bus: Bus, robot: Path) -> None:
        self.bus = bus
        self.health = bus.subscribe("health")
        self.publishers = {topic: bus.publisher(topic) for topic in OWN}
        self.robot = robot
        self.said: list[np.void] = []
        self.process: subprocess.Popen[str] | None = None

    def start(self, output: Path, until: Until, before: Callable[[], None] | None = None) -> subprocess.Popen[str]:
        self.process = subprocess.Popen(
            [COMMAND, "monitor", "--robot", self.robot, "--out", output],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=before,
        )  # fmt: skip
        until(lambda: all(publisher.heard for publisher in self.publishers.values()))
        return self.process

    @property
    def sample(self) -> Publisher:
        return self.publishers["sample"]

    def last_health(self) -> np.void | None:
        self.said += [record for record in self.health.take()[0] if record["role"] == Role.MONITOR]
        return self.said[-1] if self.said else None

    def finish(self, how: int = signal.SIGINT) -> tuple[str, str]:
        assert self.process is not None
        self.process.send_signal(how)
        return self.process.communicate(timeout=60)


@pytest.fixture
def watched(bus_folder: Path, bench_robot: Path) -> Iterator[Watched]:
    with open_bus("bench", Role.PLAYER) as bus:
        one = Watched(bus, bench_robot)
        yield one
        if one.process is not None and one.process.poll() is None:
            one.process.kill()
            one.process.wait()


def numbered(sequence: list[int] | range, flags: int = 0) -> list[bytes]:
    records = SAMPLE.empty(len(sequence))
    records["sequence"], records["flags"] = sequence, flags
    return [record.tobytes() for record in records]


def recorded(path: Path, topic: str) -> np.ndarray:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        data = [m.data for _, _, m in reader.iter_messages([f"/deltatwin/bench/{topic}"], log_time_order=False)]
    return np.frombuffer(b"".join(data), TOPICS[topic].dtype)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_everything_on_the_bus_is_in_a_whole_file(watched: Watched, tmp_path: Path, until: Until, how: int) -> None:
    path = tmp_path / "run.mcap"
    process = watched.start(path, until)
    sent: dict[str, list[bytes]] = {}
    for topic, message in OWN.items():
        records = message.empty(300)
        records["sequence"] = np.arange(300)
        sent[topic] = [record.tobytes() for record in records]
    for n in range(300):
        for topic, publisher in watched.publishers.items():
            publisher.put(sent[topic][n])
        time.sleep(0.0005)
    until(lambda: (h := watched.last_health()) is not None and h["received"] >= 6 * 300)
    out, error = watched.finish(how)
    assert process.returncode == 0, error
    assert "Traceback" not in error
    for topic in OWN:
        if topic != "health":
            assert recorded(path, topic).tobytes() == b"".join(sent[topic]), topic
    health = recorded(path, "health")
    assert health[health["role"] == Role.PLAYER].tobytes() == b"".join(sent["health"])
    own = health[health["role"] == Role.MONITOR]
    assert own["received"][-1] >= 1800
    assert own["lost"].max() == own["rejected"].max() == 0
    assert own["latency_max"].max() > 0  # feed-forward after sample
    assert f"messages to {path}" in out


def test_holes_repeats_disorder_garbage_and_bad_samples_are_counted(
    watched: Watched, tmp_path: Path, until: Until
) -> None:
    path = tmp_path / "run.mcap"
    watched.start(path, until)
    payloads = numbered([0, 1, 2, 5, 6, 6, 8, 7]) + numbered([9, 10], SampleFlag.NOT_A_NUMBER)
    for payload in [*payloads, b"garbage", payloads[0][:-1], b""]:
        watched.sample.put(payload)
    until(lambda: (h := watched.last_health()) is not None and h["received"] >= 10 and h["rejected"] == 3)
    last = watched.last_health()
    assert last is not None
    assert (last["lost"], last["repeated"], last["out_of_order"], last["invalid"]) == (2, 1, 1, 2)
    out, _ = watched.finish()
    assert recorded(path, "sample")["sequence"].tolist() == [0, 1, 2, 5, 6, 6, 8, 7, 9, 10]
    assert "rejected messages: 3" in out
    with path.open("rb") as stream:
        gaps = [m.metadata for m in make_reader(stream).iter_metadata() if m.name == "sequence_gap"]
    assert sum(int(gap["missed"]) for gap in gaps if gap["topic"] == "sample") >= 2


def test_kill_9_costs_at_most_the_last_three_tenths_of_a_second(watched: Watched, tmp_path: Path, until: Until) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    process = watched.start(path, until)
    records = SAMPLE.empty(5000)
    records["sequence"] = np.arange(len(records))
    start = time.monotonic()
    for n, record in enumerate(records[:1700]):  # 1 kHz; killed while they come
        watched.sample.put(record.tobytes())
        time.sleep(max(0.0, start + (n + 1) * 0.001 - time.monotonic()))
    process.kill()
    process.wait()
    repair = subprocess.run([COMMAND, "recover", path, out], capture_output=True, text=True, check=False)
    assert repair.returncode == 0, repair.stderr
    saved = recorded(out, "sample")
    assert saved["sequence"].tolist() == list(range(len(saved)))
    assert len(saved) >= 1700 - 300
    assert f"{len(saved):>10}  /deltatwin/bench/sample" in repair.stdout
    assert "the end was missing or damaged" in repair.stdout


def test_monitor_killed_and_started_again_and_player_restarted(watched: Watched, tmp_path: Path, until: Until) -> None:
    first = watched.start(tmp_path / "a.mcap", until)
    first.kill()
    first.wait()
    until(lambda: not watched.sample.heard)
    watched.start(tmp_path / "b.mcap", until)
    for payload in [*numbered(range(100)), *numbered(range(50))]:  # as a player that starts over
        watched.sample.put(payload)
    until(lambda: (h := watched.last_health()) is not None and h["received"] >= 150)
    watched.finish()
    assert recorded(tmp_path / "b.mcap", "sample")["sequence"].tolist() == [*range(100), *range(50)]
    last = recorded(tmp_path / "b.mcap", "health")[-1]
    assert (last["lost"], last["repeated"], last["out_of_order"]) == (0, 0, 0)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[tuple[Path, Callable[[], None] | None]]:
    """A folder that takes 256 KiB: a file system of that size as root, else a limit on what the process writes."""
    folder = tmp_path / "small"
    folder.mkdir()
    mounted = (
        os.getuid() == 0
        and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], capture_output=True, check=False
        ).returncode
        == 0
    )
    yield folder, None if mounted else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 18, 1 << 18))
    if mounted:
        subprocess.run(["umount", folder], check=True)


def test_full_disk_is_one_error_and_the_monitor_watches_on(
    watched: Watched, small_disk: tuple[Path, Callable[[], None] | None], tmp_path: Path, until: Until
) -> None:
    folder, before = small_disk
    path = folder / "run.mcap"
    process = watched.start(path, until, before)
    noise = np.random.default_rng(0).normal(size=(4000, 12))  # what does not compress
    records = SAMPLE.empty(4000)
    records["sequence"] = np.arange(4000)
    for n, name in enumerate(("position", "torque", "position_command", "torque_command")):
        records[name] = noise[:, 3 * n : 3 * n + 3]
    for record in records:
        watched.sample.put(record.tobytes())
        time.sleep(0.0005)
    until(
        lambda: (
            (h := watched.last_health()) is not None
            and bool(h["flags"] & HealthFlag.DISK_ERROR)
            and h["received"] >= 4000
        )
    )
    last = watched.last_health()
    assert last is not None
    assert last["lost"] == 0  # on the bus nothing was
    assert last["published"] < 4000
    out, error = watched.finish()
    assert process.returncode == 1
    lines = [line for line in error.splitlines() if line.startswith("deltatwin:")]
    assert len(lines) == 1
    assert lines[0].startswith(f"deltatwin: {path}: recording stopped: ")
    assert "Traceback" not in error
    assert "4000" in out
    repair = subprocess.run([COMMAND, "recover", path, tmp_path / "out.mcap"], capture_output=True, check=False)
    assert repair.returncode == 0
    saved = recorded(tmp_path / "out.mcap", "sample")
    assert len(saved) > 500
    assert saved.tobytes() == records[: len(saved)].tobytes()


@pytest.mark.parametrize("place", ["missing/run.mcap", "robot.toml/run.mcap", "/proc/run.mcap"])
def test_a_place_that_cannot_be_written_is_refused_before_anything_runs(
    watched: Watched, tmp_path: Path, place: str
) -> None:
    done = subprocess.run(
        [COMMAND, "monitor", "--robot", watched.robot, "--out", tmp_path / place],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("deltatwin:")]
    assert str((tmp_path / place).parent) in line
    assert "Traceback" not in done.stderr


def test_existing_recording_is_refused(watched: Watched, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"precious")
    done = subprocess.run(
        [COMMAND, "monitor", "--robot", watched.robot, "--out", tmp_path / "run.mcap"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == f"deltatwin: {tmp_path / 'run.mcap'}: exists already; give another name with --out\n"
    assert (tmp_path / "run.mcap").read_bytes() == b"precious"


def test_latency_pairs_feedforward_with_its_sample() -> None:
    tally = Tally(stamped=True)
    samples, answers = SAMPLE.empty(5), FEEDFORWARD.empty(4)
    samples["sequence"], answers["sequence"] = [10, 11, 12, 13, 14], [10, 12, 14, 15]
    tally.add("sample", samples, np.array([1000, 2000, 3000, 4000, 5000]))
    assert tally.latencies(answers, np.array([1100, 3300, 5500, 6000])).tolist() == [100, 300, 500]


def test_health_of_different_roles_is_not_a_hole_in_one_sequence() -> None:
    tally = Tally(stamped=True)
    said = HEALTH.empty(6)
    said["role"] = [Role.PLAYER, Role.MONITOR, Role.PLAYER, Role.MONITOR, Role.PLAYER, Role.MONITOR]
    said["sequence"] = [0, 40, 1, 41, 3, 42]
    assert tally.add("health", said, np.zeros(6, np.int64)) == 1
    assert (tally.count("health").lost, tally.count("health").repeated) == (1, 0)


def test_payload_and_error_of_every_eighth_sample_are_no_loss() -> None:
    tally = Tally(stamped=True)
    for topic in ("payload", "error"):
        said = TOPICS[topic].empty(100)
        said["sequence"] = np.arange(0, 800, 8)
        assert tally.add(topic, said, np.zeros(100, np.int64)) == 0
    assert tally.count().lost == 0
    assert tally.received["error"] == 100


def answered(tally: Tally, sequence: int, every: int = 4) -> None:
    """What an estimator answers to one sample, sent in the nanosecond of its number times ten."""
    for topic in ("feedforward", "payload", "error") if sequence % every == 0 else ("feedforward",):
        said = TOPICS[topic].empty(1)
        said["sequence"] = sequence
        tally.add(topic, said, np.array([10 * sequence]))


def health_of_estimator(tally: Tally, sequence: int, published: int, sent: int) -> None:
    said = HEALTH.empty(1)
    said["role"], said["sequence"], said["published"] = Role.ESTIMATOR, sequence, published
    tally.add("health", said, np.array([sent]))


def test_loss_of_thinned_topics_is_told_by_the_estimators_own_count() -> None:
    tally = Tally(stamped=True)
    for number in range(100):
        answered(tally, number)
    health_of_estimator(tally, 0, 150, 991)  # 100 feed-forward, 25 payload, 25 error; nothing is known of before
    for number in range(100, 200):
        if number in (120, 140, 141):  # of 141 the feed-forward alone, which its own sequence tells
            continue
        answered(tally, number)
    health_of_estimator(tally, 1, 300 - 6, 1951)  # the last ones that came were sent after it
    assert (tally.thinned_lost, tally.count("feedforward").lost, tally.count().lost) == (4, 3, 7)
    health_of_estimator(tally, 2, 300, 1991)
    assert (tally.thinned_lost, tally.count().lost) == (4, 7)
    health_of_estimator(tally, 0, 12, 2500)  # started over: what was lost stays, what is new begins
    assert (tally.thinned_lost, tally.count().lost) == (4, 7)
    health_of_estimator(tally, 1, 15, 2600)
    assert (tally.thinned_lost, tally.count().lost) == (7, 10)


def test_where_nothing_is_stamped_loss_of_thinned_topics_cannot_be_told() -> None:
    tally = Tally(stamped=False)
    answered(tally, 0)
    health_of_estimator(tally, 0, 50, 10)
    health_of_estimator(tally, 1, 100, 20)
    assert (tally.thinned_lost, tally.count().lost) == (None, 0)


def test_a_monitor_that_hears_no_payload_of_a_live_estimator_says_how_much_is_missing(
    watched: Watched, tmp_path: Path, until: Until
) -> None:
    watched.start(tmp_path / "run.mcap", until)
    said, answer = HEALTH.empty(1), FEEDFORWARD.empty(1)
    said["role"] = Role.ESTIMATOR
    for number in range(101):
        if number % 50 == 0:  # it says it gave payload and error with every feed-forward
            said["sequence"], said["published"] = number // 50, 3 * number
            watched.publishers["health"].put(said.tobytes())
        answer["sequence"] = number
        watched.publishers["feedforward"].put(answer.tobytes())
        time.sleep(0.001)
    time.sleep(0.5)
    told, _ = watched.finish()
    assert "lost messages of payload, error, friction together: 200" in told
