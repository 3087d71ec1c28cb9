"""Who may speak across hosts: real TLS sessions on loopback, where two ranges of ports stand for two hosts."""

from __future__ import annotations

import datetime
import errno
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from drivers.bus import Bus, open_bus
from drivers.inbox import Inbox
from drivers.security.certificates import Host, make_keys, parse_hosts
from drivers.security.check import check
from drivers.security.rights import SOURCES, readers, writers
from schemas.errors import BusError, StorageError
from schemas.messages import SAMPLE, TOPICS, Role
from schemas.zenoh_keys import topic_key
from tests.conftest import REPOSITORY

QUIET = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
DAY = datetime.timedelta(days=1)
CREDENTIALS = ("listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key")
SETTLED_S = 0.4  # what is going to arrive on loopback has arrived by then


def free_ports() -> int:
    """First of as many free ports as two hosts have roles, below those that the kernel gives to any connection."""
    count = 2 * len(Role)
    for first in range(12000 + os.getpid() % 800 * 25, 32768 - count, count):
        try:
            for port in range(first, first + count):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return first
    raise AssertionError("no free ports")


@pytest.fixture
def hosts() -> list[Host]:
    first = free_ports()
    return parse_hosts(f"127.0.0.1:{first},127.0.0.1:{first + len(Role)}")


@pytest.fixture
def keys(tmp_path: Path, hosts: list[Host]) -> list[Path]:
    """The folders of two hosts, with keys of robot `bench` whose samples come from a player."""
    return make_keys(tmp_path / "keys", hosts, "bench", Role.PLAYER).folders


def configuration(folder: Path, role: Role) -> Path:
    return folder / f"{role.name.lower()}.json5"


def run_as(folder: Path, role: Role) -> Bus:
    return open_bus("bench", role, configuration(folder, role))


def intruder(path: Path, **changes: object) -> zenoh.Session:
    """A session with the configuration at `path`, TLS settings changed, that searches nobody and takes no part."""
    settings = json.loads("\n".join(line for line in path.read_text().splitlines() if not line.startswith("//")))
    tls = settings["transport"]["link"]["tls"]
    for name in tls:
        if isinstance(tls[name], str):
            tls[name] = str(path.parent / tls[name])
    tls.update(changes)
    if tls["listen_certificate"] is None:
        settings["listen"]["endpoints"] = []  # it calls only
    settings["access_control"]["enabled"] = False  # its own rules bind nobody who does not want to be bound
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


def numbered(topic: str, number: int) -> bytes:
    record = TOPICS[topic].empty(1)
    record["sequence"] = number
    return record.tobytes()


def heard(inbox: Inbox, least: int = 0) -> list[int]:
    """Sequence numbers of what came: at least `least` of them, however long a busy host takes, and what else came."""
    came: list[int] = []
    give_up = time.monotonic() + 30.0
    settled = time.monotonic() + SETTLED_S
    while time.monotonic() < give_up and (len(came) < least or time.monotonic() < settled):
        time.sleep(0.02)
        came += inbox.take()[0]["sequence"].tolist()
    return came


def forge(session: zenoh.Session, topic: str, number: int = 99) -> None:
    session.put(topic_key("bench", topic), numbered(topic, number))


def eavesdrop(session: zenoh.Session) -> tuple[list[str], zenoh.Subscriber]:
    caught: list[str] = []

    def note(sample: zenoh.Sample) -> None:
        caught.append(str(sample.key_expr))

    handler = zenoh.handlers.Callback(note, indirect=False)
    return caught, session.declare_subscriber("deltatwin/**", handler, allowed_origin=zenoh.Locality.REMOTE)


@pytest.mark.parametrize("kind", ["plain", "no certificate", "foreign CA", "expired", "of another robot"])
def test_intruder_neither_reads_nor_writes(
    bus_folder: Path, tmp_path: Path, hosts: list[Host], keys: list[Path], until: Callable, kind: str
) -> None:
    a, b = keys
    with run_as(a, Role.PLAYER) as player, run_as(b, Role.ESTIMATOR) as estimator:
        inbox, publisher = estimator.subscribe("sample"), player.publisher("sample")
        reference = estimator.subscribe("reference")
        until(lambda: publisher.heard)
        # In the player's place on the second host: it calls the estimator, and the estimator calls it.
        mine = configuration(b, Role.PLAYER)
        if kind == "plain":
            settings = {
                "mode": "client", "scouting": QUIET, "listen": {"endpoints": []},
                "connect": {"endpoints": [hosts[1].reached(Role.ESTIMATOR).replace("tls/", "tcp/")], "timeout_ms": 500},
            }  # fmt: skip
            with pytest.raises(zenoh.ZError):
                zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
            return
        if kind == "no certificate":
            strange = intruder(mine, **dict.fromkeys(CREDENTIALS))
        elif kind == "foreign CA":
            there = make_keys(tmp_path / "foreign", hosts, "bench", Role.PLAYER).folders[1]
            strange = intruder(configuration(there, Role.PLAYER), root_ca_certificate=str(b / "ca.pem"))
        elif kind == "expired":
            make_keys(tmp_path / "keys", hosts, "bench", Role.PLAYER, valid=-DAY)
            strange = intruder(mine)
        else:
            make_keys(tmp_path / "keys", hosts, "other", Role.PLAYER)
            strange = intruder(mine)
        with strange:
            caught, _ = eavesdrop(strange)
            time.sleep(SETTLED_S)
            for topic in ("sample", "reference"):
                forge(strange, topic)
            publisher.put(numbered("sample", 1))
            assert heard(inbox, 1) == [1]
            assert heard(reference) == []
            assert caught == []


def test_the_same_intruder_with_the_players_own_certificate_is_let_in(
    bus_folder: Path, keys: list[Path], until: Callable
) -> None:
    """What the test above holds against: with the right certificate the same code is heard."""
    with run_as(keys[0], Role.ESTIMATOR) as estimator:
        inbox = estimator.subscribe("sample")
        with intruder(configuration(keys[1], Role.PLAYER)) as player:
            until(lambda: Role.ESTIMATOR in estimator.alive and len(estimator._session.info.peers_zid()) == 1)
            forge(player, "sample", 7)
            until(lambda: inbox.wait(0.1))
            assert inbox.take()[0]["sequence"].tolist() == [7]


@pytest.mark.parametrize("calls", ["monitor calls", "is called by the monitor"])
def test_a_role_writes_only_what_is_its_own(
    bus_folder: Path, hosts: list[Host], keys: list[Path], until: Callable, calls: str
) -> None:
    """Whichever end calls: the certificate of the one that is called counts as much."""
    reader, thief = (Role.MASTER, Role.MONITOR) if calls == "is called by the monitor" else (Role.PLAYER, Role.MONITOR)
    listener = Role.MASTER if reader is Role.MASTER else Role.ESTIMATOR
    with (
        run_as(keys[0], listener) as victim,
        run_as(keys[0], Role.OBSERVER) as observer,
        run_as(keys[0], Role.ESTIMATOR if listener is Role.MASTER else Role.PLAYER) as rightful,
    ):
        topic = "feedforward" if listener is Role.MASTER else "sample"
        inbox, seen = victim.subscribe(topic), observer.subscribe(topic)
        health = observer.subscribe("health")
        publisher = rightful.publisher(topic)
        until(lambda: publisher.heard and len(observer.alive) == 3)
        with intruder(configuration(keys[1], thief)) as session:
            watched, _ = eavesdrop(session)
            until(lambda: len(session.info.peers_zid()) == 3)
            time.sleep(SETTLED_S)
            for forged in ("sample", "reference", "feedforward", "payload", "error"):
                forge(session, forged)
            forge(session, "health", 5)
            publisher.put(numbered(topic, 1))
            assert heard(inbox, 1) == [1]
            assert heard(seen, 1) == [1]
            assert heard(health, 1) == [5]  # its own right, so the link stands
            assert watched == []  # `deltatwin/**` is more than it may ask for


def test_reading_as_each_role_needs(bus_folder: Path, keys: list[Path], until: Callable) -> None:
    with (
        run_as(keys[0], Role.ESTIMATOR) as estimator,
        run_as(keys[1], Role.MONITOR) as monitor,
        run_as(keys[1], Role.MASTER) as master,
    ):
        until(lambda: len(estimator.alive) == len(master.alive) == 3)
        rings = {role: bus.subscribe("payload") for role, bus in ((Role.MONITOR, monitor), (Role.MASTER, master))}
        publisher = estimator.publisher("payload")
        until(lambda: publisher.heard)
        publisher.put(numbered("payload", 3))
        assert heard(rings[Role.MONITOR], 1) == [3]
        assert heard(rings[Role.MASTER]) == []


def test_two_sources_cannot_both_write_samples(
    bus_folder: Path, tmp_path: Path, hosts: list[Host], keys: list[Path], until: Callable
) -> None:
    made = make_keys(tmp_path / "keys", hosts, "bench", Role.TAP)
    assert not made.ca_is_new
    assert not list(made.folders[0].glob("player.*"))
    with run_as(keys[0], Role.ESTIMATOR) as estimator, run_as(keys[1], Role.TAP) as tap:
        inbox = estimator.subscribe("sample")
        publisher = tap.publisher("sample")
        until(lambda: publisher.heard)
        old = make_keys(tmp_path / "keys", hosts, "bench", Role.PLAYER).folders[0]  # keys of before, still valid
        with intruder(configuration(old, Role.PLAYER)) as player:
            until(lambda: len(estimator._session.info.peers_zid()) == 2)
            time.sleep(SETTLED_S)
            forge(player, "sample")
            publisher.put(numbered("sample", 4))
            assert heard(inbox, 1) == [4]


def test_second_process_of_a_role_on_another_host_is_refused(
    bus_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, keys: list[Path]
) -> None:
    with run_as(keys[0], Role.PLAYER):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # as on another host: only the network can tell
        with pytest.raises(BusError, match="another player is running elsewhere"):
            run_as(keys[1], Role.PLAYER)


def test_estimator_answers_over_tls(bus_folder: Path, keys: list[Path], bench_robot: Path, until: Callable) -> None:
    """The real command in a process of its own, on the other host."""
    estimate = subprocess.Popen(
        [sys.executable, "-m", "deltatwin", "estimate", "--robot", str(bench_robot),
         "--zenoh-config", str(configuration(keys[1], Role.ESTIMATOR))],
        cwd=REPOSITORY, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert estimate.stderr is not None
    assert any("estimating for bench" in line for line in estimate.stderr), "compiling takes its time on a busy host"
    try:
        with run_as(keys[0], Role.PLAYER) as player, run_as(keys[0], Role.MONITOR) as monitor:
            inbox, publisher = monitor.subscribe("feedforward"), player.publisher("sample")
            until(lambda: Role.ESTIMATOR in monitor.alive and publisher.heard)
            record = SAMPLE.empty(1)
            for number in range(300):
                record["sequence"], record["stamp_nanosec"] = number, number * 1_000_000
                publisher.put(record.tobytes())
                time.sleep(0.001)
            answered: list[int] = []
            until(lambda: (answered.extend(inbox.take()[0]["sequence"].tolist()) or True) and len(answered) == 300)
            assert sorted(answered) == list(range(300))
    finally:
        estimate.terminate()
        estimate.wait(20)


def test_nothing_listens_on_the_network_by_default(bus_folder: Path) -> None:
    def mine() -> set[str]:
        links = (os.readlink(entry.path) for entry in os.scandir("/proc/self/fd") if os.path.islink(entry.path))
        return {link[8:-1] for link in links if link.startswith("socket:[")}

    def network() -> set[str]:
        tables = [Path("/proc/self/net", name) for name in ("tcp", "tcp6", "udp", "udp6")]
        return {line.split()[9] for table in tables if table.exists() for line in table.read_text().splitlines()[1:]}

    before = mine()
    with open_bus("bench", Role.ESTIMATOR), open_bus("bench", Role.PLAYER):
        own = mine() - before
        assert own, "the sockets of the session"
        assert not own & network()


def write(path: Path, **settings: object) -> Path:
    path.write_text(json.dumps({"mode": "peer", "scouting": QUIET} | settings))
    return path


LOCAL = {"endpoints": ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447", "unixsock-stream//run/x.sock"]}
GUARDED = {"enabled": True, "default_permission": "deny", "rules": [], "subjects": [], "policies": []}
MTLS = {"link": {"tls": {"enable_mtls": True}}}


@pytest.mark.parametrize(
    ("settings", "door"),
    [
        ({"listen": {"endpoints": ["tcp/192.168.4.20:7447"]}}, r"listens on tcp/192\.168\.4\.20:7447 without TLS"),
        ({}, r"listens on tcp/\[::\]:0 without TLS"),  # what Zenoh does unless told
        ({"listen": LOCAL, "connect": {"endpoints": ["udp/cell:7447"]}}, "connects to udp/cell:7447 without TLS"),
        ({"listen": LOCAL, "connect": {"endpoints": {"peer": ["tcp/cell:7447"]}}}, "connects to tcp/cell:7447"),
        ({"listen": LOCAL, "scouting": {}}, "looks for others by multicast"),
        ({"listen": {"endpoints": ["tls/cell:7447"]}, "access_control": GUARDED}, "asks for no certificate"),
        (
            {"listen": {"endpoints": ["tls/a:7447#enable_mtls=false"]}, "transport": MTLS, "access_control": GUARDED},
            r"listens on tls/a:7447#enable_mtls=false without TLS and certificates on both sides",
        ),
        ({"listen": {"endpoints": ["tls/cell:7447"]}, "transport": MTLS}, "has no access control"),
        (
            {
                "listen": {"endpoints": ["tls/cell:7447"]}, "transport": MTLS,
                "access_control": GUARDED | {"default_permission": "allow"},
            },
            "has no access control",
        ),
        (
            {
                "listen": {"endpoints": ["tls/cell:7447"]}, "transport": MTLS,
                "access_control": GUARDED | {"subjects": [{"id": "all"}]},
            },
            "has an access control subject without cert_common_names",
        ),
    ],
)  # fmt: skip
def test_configuration_that_lets_strangers_speak_is_refused(
    bus_folder: Path, tmp_path: Path, settings: dict, door: str
) -> None:
    path = write(tmp_path / "user.json5", **settings)
    with pytest.raises(BusError, match=rf"user\.json5: {door}.*deltatwin keys.*--insecure") as refusal:
        open_bus("bench", Role.PLAYER, path)
    assert "\n" not in str(refusal.value)
    (note,) = check(zenoh.Config.from_file(str(path)), path, "bench", Role.PLAYER, insecure=True)
    assert "--insecure" in note


def test_what_stays_on_the_host_needs_no_keys(tmp_path: Path) -> None:
    for settings in ({"listen": LOCAL, "connect": LOCAL}, {"mode": "client", "listen": {}, "connect": LOCAL}):
        path = write(tmp_path / "user.json5", **settings)
        assert check(zenoh.Config.from_file(str(path)), path, "bench", Role.PLAYER, insecure=False) == []


def test_insecure_is_taken_and_said(bus_folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = write(tmp_path / "user.json5", listen={"endpoints": [f"tcp/0.0.0.0:{free_ports()}"]})
    with open_bus("bench", Role.PLAYER, path, insecure=True):
        assert "can send as any role (--insecure)" in capfd.readouterr().err


def test_command_line_refuses_and_names_the_way_out(bus_folder: Path, tmp_path: Path, bench_robot: Path) -> None:
    path = write(tmp_path / "user.json5", listen={"endpoints": ["tcp/0.0.0.0:7447"]})
    told = subprocess.run(
        [sys.executable, "-m", "deltatwin", "monitor", "--robot", str(bench_robot), "--zenoh-config", str(path)],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert told.returncode == 1
    line = told.stderr.strip().splitlines()[-1]
    assert line.startswith("deltatwin: ")
    assert "deltatwin keys" in line
    assert "--insecure" in line


@pytest.mark.parametrize(("left", "told"), [(31, 0), (29, 1)])
def test_expiry_is_told_thirty_days_ahead(bus_folder: Path, tmp_path: Path, hosts: list[Host], left: int, told: int,
                                          capfd: pytest.CaptureFixture) -> None:  # fmt: skip
    folder = make_keys(tmp_path / "keys", hosts, "bench", valid=left * DAY + DAY / 2).folders[0]
    with run_as(folder, Role.TAP):
        lines = capfd.readouterr().err.splitlines()
    assert len(lines) == told
    assert all("tap.pem: expires in 29 days" in line for line in lines)


def test_expired_certificate_is_refused_in_one_line(bus_folder: Path, tmp_path: Path, hosts: list[Host]) -> None:
    folder = make_keys(tmp_path / "keys", hosts, "bench", valid=-DAY).folders[0]
    with pytest.raises(BusError, match=r"tap\.pem: expired on \d{4}-\d\d-\d\d .*deltatwin keys"):
        run_as(folder, Role.TAP)


def test_clock_that_is_behind_is_named(bus_folder: Path, tmp_path: Path, hosts: list[Host]) -> None:
    tomorrow = datetime.datetime.now(datetime.UTC) + 3 * DAY
    folder = make_keys(tmp_path / "keys", hosts, "bench", now=tomorrow).folders[0]
    with pytest.raises(BusError, match=r"ca\.pem: valid from .* this host's clock"):
        run_as(folder, Role.TAP)


@pytest.mark.parametrize(("robot", "role"), [("bench", Role.ESTIMATOR), ("other", Role.PLAYER)])
def test_certificate_of_another_role_or_robot_is_refused(
    bus_folder: Path, keys: list[Path], robot: str, role: Role
) -> None:
    with pytest.raises(BusError, match=rf"the certificate of 'deltatwin/bench/player', not of 'deltatwin/{robot}/"):
        open_bus(robot, role, configuration(keys[0], Role.PLAYER))


def test_key_that_others_may_read_is_told(bus_folder: Path, keys: list[Path], capfd: pytest.CaptureFixture) -> None:
    (keys[0] / "player.key").chmod(0o644)
    with run_as(keys[0], Role.PLAYER):
        assert "player.key: a private key that others may read (mode 0644)" in capfd.readouterr().err


def test_files_are_private_and_the_ca_is_never_replaced(tmp_path: Path, hosts: list[Host]) -> None:
    out = tmp_path / "keys"
    first = make_keys(out, hosts, "bench")
    authority, tap = (out / "ca.pem").read_bytes(), (first.folders[0] / "tap.pem").read_bytes()
    for path in (out, *out.rglob("*")):
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path
    assert not list(out.rglob("*/ca.key")), "the CA's key leaves with no host"
    again = make_keys(out, hosts, "bench")
    assert (again.ca_is_new, again.replaced) == (False, 2 * len(first.roles))
    assert (out / "ca.pem").read_bytes() == authority
    assert (first.folders[0] / "tap.pem").read_bytes() != tap
    (out / "ca.key").unlink()
    with pytest.raises(StorageError, match=r"ca\.key: No such file"):
        make_keys(out, hosts, "bench")
    assert (out / "ca.pem").read_bytes() == authority


def test_a_folder_that_is_there_stays_and_planted_links_lead_nowhere(tmp_path: Path, hosts: list[Host]) -> None:
    out, elsewhere = tmp_path / "keys", tmp_path / "elsewhere"
    out.mkdir(mode=0o755)
    out.chmod(0o755)
    elsewhere.mkdir()
    host = out / hosts[0].folder
    host.symlink_to(elsewhere)
    with pytest.raises(StorageError, match="not a folder: keys are written only to a folder"):
        make_keys(out, hosts)
    assert list(elsewhere.iterdir()) == []
    host.unlink()
    host.mkdir(mode=0o700)
    (elsewhere / "mine").write_text("mine")
    (host / "tap.key").symlink_to(elsewhere / "mine")
    make_keys(out, hosts)
    assert out.stat().st_mode & 0o777 == 0o755
    assert (elsewhere / "mine").read_text() == "mine"
    assert not (host / "tap.key").is_symlink()
    host.chmod(0o777)
    with pytest.raises(StorageError, match="others may write in it"):
        make_keys(out, hosts)
    assert host.stat().st_mode & 0o777 == 0o777


def test_a_ca_is_whole_or_there_is_none(tmp_path: Path, hosts: list[Host], monkeypatch: pytest.MonkeyPatch) -> None:
    """On a disk that is full once the key of it is written."""
    real = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if path.name.endswith("ca.pem"):
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match="No space left"):
        make_keys(tmp_path / "keys", hosts)
    monkeypatch.undo()
    assert list((tmp_path / "keys").iterdir()) == []
    make_keys(tmp_path / "keys", hosts)


def test_foreign_ca_key_is_named(tmp_path: Path, hosts: list[Host]) -> None:
    for name in ("one", "two"):
        make_keys(tmp_path / name, hosts)
    (tmp_path / "two" / "ca.key").replace(tmp_path / "one" / "ca.key")
    with pytest.raises(StorageError, match=r"one/ca\.key: not the key of .*one/ca\.pem"):
        make_keys(tmp_path / "one", hosts)


def test_keys_for_every_robot(bus_folder: Path, tmp_path: Path, hosts: list[Host], until: Callable) -> None:
    a, b = make_keys(tmp_path / "keys", hosts, None, Role.PLAYER).folders
    with run_as(a, Role.PLAYER) as player, run_as(b, Role.ESTIMATOR) as estimator:
        inbox, publisher = estimator.subscribe("sample"), player.publisher("sample")
        until(lambda: publisher.heard)
        publisher.put(numbered("sample", 1))
        assert heard(inbox, 1) == [1]
        assert Role.PLAYER in estimator.alive


def test_every_topic_has_its_writer_and_its_readers() -> None:
    for source in SOURCES:
        for topic in TOPICS:
            assert writers(topic, source)
            assert {Role.MONITOR, Role.OBSERVER} <= set(readers(topic))
        assert writers("sample", source) == (source,)
        for topic in ("feedforward", "payload", "error"):
            assert writers(topic, source) == (Role.ESTIMATOR,)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("cell,press", [("cell", 7450), ("press", 7450)]),
        ("10.0.0.2:8000, fe80::1", [("10.0.0.2", 8000), ("fe80::1", 7450)]),
        ("[fe80::1]:8000", [("fe80::1", 8000)]),
    ],
)
def test_hosts(text: str, found: list[tuple[str, int]]) -> None:
    assert [(host.name, host.first_port) for host in parse_hosts(text)] == found


@pytest.mark.parametrize(
    "text", ["", "a,,b", "a b", "a/b", "a:x", "a:70000", "a:65530", "a,a", "a:7450,a:7453", "../a", "user@a"]
)
def test_what_is_no_host_is_named(text: str) -> None:
    with pytest.raises(ValueError, match="'"):
        parse_hosts(text)


def test_robot_name_too_long_for_a_certificate(tmp_path: Path, hosts: list[Host]) -> None:
    with pytest.raises(StorageError, match="longer than the 64 letters"):
        make_keys(tmp_path / "keys", hosts, "r" * 60)


def test_folder_that_cannot_be_written_is_named(tmp_path: Path, hosts: list[Host]) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=r"file"):
        make_keys(tmp_path / "file" / "keys", hosts)


def test_ipv6_endpoints_are_bracketed_and_names_listen_everywhere() -> None:
    six, name = parse_hosts("fe80::1,cell")
    assert six.listens(Role.TAP) == six.reached(Role.TAP) == "tls/[fe80::1]:7454"
    assert (name.listens(Role.ESTIMATOR), name.reached(Role.ESTIMATOR)) == ("tls/0.0.0.0:7451", "tls/cell:7451")
