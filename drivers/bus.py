"""The Zenoh bus of one robot: sessions that find each other without a router, publishers, inboxes.

Every role listens on a Unix socket of its own in a per-user folder and keeps trying to reach the roles numbered below
it, so any start order and any restart works, and no pair is linked twice. Nothing is sent outside the host unless the
user brings a Zenoh configuration. Real-time privileges have to be taken before `open_bus` (`replay.realtime`), because
the threads of the session inherit them.

What a subscriber that stops reading can do: the kernel and Zenoh buffer about 460 messages for it (0.11 s at 4 kHz).
When they are full a publisher waits `PATIENCE_S` of drivers/peer.py once, then passes that subscriber over, without
waiting, for as long as it takes nothing. The others miss nothing, link and session stay, and the subscriber, should it
come back, sees the hole in the sequence. (Blocking publishers would close the link instead and lose all until it is up
again.)
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import zenoh

from drivers.inbox import WAKE_S, Inbox, arrival
from drivers.peer import THREADS, peer_settings
from drivers.ros import NOTE, ROUTER, RosNode
from drivers.security.check import check, find_files
from schemas.errors import BusError, RoleTakenError
from schemas.messages import TOPICS, Role
from schemas.zenoh_keys import liveliness_key, robot_key, topic_key

LINK_S = 0.5  # by then every role that runs has linked up with one that has just come
NOTICES = 4096  # of roles that come and go; more than anybody leaves unread
SOURCES = frozenset({Role.PLAYER, Role.ROBOT, Role.TAP})  # roles that publish `sample`

_SOCKET_PATH_BYTES = 107  # sun_path of Linux, without its closing zero


def runtime_folder() -> Path:
    """The folder of the sockets: mode 0700, in XDG_RUNTIME_DIR or, without one, in the temporary folder.

    Raises:
        BusError: it cannot be made, or belongs to somebody else.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(base) / "deltatwin" if base else Path(tempfile.gettempdir()) / f"deltatwin-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            raise BusError(f"runtime folder {folder}: not a folder of this user's")
        folder.chmod(0o700)
    except OSError as error:
        raise BusError(f"runtime folder {folder}: {error.strerror}") from error
    return folder


def _endpoint(folder: Path, robot: str, role: Role) -> str:
    path = folder / f"{robot}.{role.name.lower()}.sock"
    if len(os.fsencode(path)) > _SOCKET_PATH_BYTES:
        raise BusError(f"socket {path}: longer than {_SOCKET_PATH_BYTES} bytes; shorten the robot name or the folder")
    return f"unixsock-stream/{path}"


def _own_config(folder: Path, robot: str, role: Role, ros: bool) -> zenoh.Config:
    settings: dict[str, Any] = peer_settings(
        _endpoint(folder, robot, role), [_endpoint(folder, robot, other) for other in Role if other < role]
    ) | {"timestamping": {"enabled": {"peer": True}}}  # one host, one clock
    if ros:  # whom the router knows is linked directly, as ROS 2 has it
        settings["connect"]["endpoints"].append(ROUTER)
        settings["listen"]["endpoints"].append("tcp/127.0.0.1:0")
        settings["scouting"]["gossip"]["enabled"] = True
    return zenoh.Config.from_json5(json.dumps(settings))


def _user_config(path: Path) -> zenoh.Config:
    try:
        path.read_bytes()
        config = zenoh.Config.from_file(str(path))
        find_files(config, path.parent)
        # It gains nothing at a hundred bytes, and is on by default: whoever may lock no memory could open no session.
        config.insert_json5("transport/shared_memory/enabled", "false")
        return config
    except OSError as error:
        raise BusError(f"{path}: {error.strerror}") from error
    except zenoh.ZError as error:
        raise BusError(f"{path}: not a Zenoh configuration: {_first_line(error)}") from error


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


class Publisher:
    """A declared publisher: `put` takes the bytes of one message and may be called from any thread but a callback's."""

    def __init__(self, publisher: zenoh.Publisher, attachment: Callable[[], bytes] | None = None) -> None:
        """attachment: makes what goes with each message."""
        self._publisher = publisher
        self.put: Callable[[bytes], None] = publisher.put
        if attachment:
            self.put = lambda message: publisher.put(message, attachment=attachment())

    @property
    def heard(self) -> bool:
        """Whether anybody subscribes at the moment."""
        return self._publisher.matching_status.matching  # pyright: ignore[reportAttributeAccessIssue]: stub says bool

    def wait_until_heard(self, longest: float) -> bool:
        """Wait for a subscriber and until whoever runs has had the time to link up, at most `longest` s; `heard`."""
        begin = time.monotonic()
        while (waited := time.monotonic() - begin) < longest and (waited < LINK_S or not self.heard):
            time.sleep(0.01)
        return self.heard


class Bus:
    """The session of one role of one robot. Made by `open_bus`; closes with its `with` block."""

    def __init__(
        self, session: zenoh.Session, robot: str, role: Role, lock: int, stamped: bool, ros_domain: int | None = None
    ) -> None:
        self.robot = robot
        self.role = role
        self.stamped = stamped  # whether `sending` is Zenoh's stamp: all are on one host, and have one clock
        self._session = session
        self._ros = None if ros_domain is None else RosNode(session, ros_domain, robot, role)
        self._lock = lock
        self._inboxes: list[Inbox] = []
        self._alive: set[Role] = {role}
        self._roles = {liveliness_key(robot, other): other for other in Role}
        liveliness = session.liveliness()
        self._token = liveliness.declare_token(liveliness_key(robot, role))
        # Not a callback: a thread of Zenoh's that asks for an interpreter which ends is torn out of Zenoh's frames,
        # and takes the process with it.
        self._watch = liveliness.declare_subscriber(
            f"deltatwin/{robot_key(robot)}/@/*", zenoh.handlers.RingChannel(NOTICES), history=True
        )
        self._look_ns = 0  # when to look there again

    def _look(self) -> None:
        self._look_ns = time.monotonic_ns() + int(WAKE_S * 1e9)
        while (notice := self._watch.try_recv()) is not None:
            role = self._roles.get(str(notice.key_expr))
            if role is None or role == self.role:
                continue
            if notice.kind == zenoh.SampleKind.PUT:
                self._alive.add(role)
            else:
                self._alive.discard(role)

    @property
    def alive(self) -> frozenset[Role]:
        """Roles of this robot that are running, this one among them."""
        self._look()
        return frozenset(self._alive.copy())

    @property
    def duplicate_source(self) -> bool:
        """Whether more than one role publishes samples; as of `WAKE_S` ago at most, for it is asked in every cycle."""
        if time.monotonic_ns() >= self._look_ns:
            self._look()
        return len(self._alive & SOURCES) > 1

    def publisher(self, topic: str) -> Publisher:
        """A publisher of one of `schemas.messages.TOPICS`."""
        publisher = self._session.declare_publisher(
            self._key(topic),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=False,
        )
        return Publisher(publisher, self._ros.publishes(topic) if self._ros else None)

    def subscribe(self, topic: str, capacity: int = 16384, clock: Callable[[zenoh.Sample], int] = arrival) -> Inbox:
        """An inbox for one of `schemas.messages.TOPICS`, `capacity` messages deep."""
        key, session = self._key(topic), self._session
        inbox = Inbox(
            TOPICS[topic],
            self.channel(topic, zenoh.handlers.RingChannel(capacity)),
            lambda: session.put(key, b"", allowed_destination=zenoh.Locality.SESSION_LOCAL),
            clock,
        )
        self._inboxes.append(inbox)
        return inbox

    def channel(
        self,
        topic: str,
        channel: zenoh.handlers.RingChannel[zenoh.Sample] | zenoh.handlers.FifoChannel[zenoh.Sample],
    ) -> zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]:
        """Zenoh's own subscriber, for what has to be compared with an inbox."""
        if self._ros:
            self._ros.subscribes(topic)
        return self._session.declare_subscriber(self._key(topic), channel)

    def _key(self, topic: str) -> str:
        return self._ros.key(topic) if self._ros else topic_key(self.robot, topic)

    def close(self) -> None:
        """End the threads, close the session and give the role free."""
        for inbox in self._inboxes:
            inbox.close()
        self._session.close()
        os.close(self._lock)

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def open_bus(
    robot: str,
    role: Role,
    zenoh_config: Path | None = None,
    insecure: bool = False,
    ros_domain: int | None = None,
) -> Bus:
    """Open the session of `role` of `robot`; `zenoh_config` replaces every connection setting.

    ros_domain: speak as a node of ROS 2 does (rmw_zenoh), in this domain, and reach the router on this host.

    Raises:
        BusError: another process holds the role, the session cannot be opened, the clock is before 1970, or
            `zenoh_config` leaves the host without saying who may speak (and not `insecure`), or is for our keys and not
            for those of ROS 2.
        RobotError: the robot name cannot be part of a key.
    """
    token = liveliness_key(robot, role)
    folder = runtime_folder()
    if zenoh_config is None:
        config = _own_config(folder, robot, role, ros_domain is not None)
    else:
        config = _user_config(zenoh_config)
        for note in check(config, zenoh_config, robot, role, insecure):
            print(note, file=sys.stderr)
    if ros_domain is not None:
        if json.loads(config.get_json("access_control/enabled")):
            raise BusError(f"{zenoh_config}: its access control is for the keys of deltatwin, not for those of ROS 2")
        print(f"robot {robot!r}, {role.name.lower()}: {NOTE}", file=sys.stderr)
    if time.time() < 0.0:  # Zenoh's clock ends the process where it is
        now = datetime.fromtimestamp(time.time(), UTC)
        raise BusError(f"the clock of this host says {now:%Y-%m-%d %H:%M:%S} UTC; set it: stamps begin in 1970")
    lock = _hold(folder / f"{robot}.{role.name.lower()}.pid", robot, role)
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)  # read when the first session opens
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        os.close(lock)
        raise BusError(f"robot {robot!r}, {role.name.lower()}: Zenoh does not open: {_first_line(error)}") from error
    if zenoh_config is not None and _runs_elsewhere(session, token):
        session.close()
        os.close(lock)
        raise BusError(f"robot {robot!r}: another {role.noun} is running elsewhere on its Zenoh network")
    return Bus(session, robot, role, lock, zenoh_config is None, ros_domain)


def check_free(robot: str, role: Role, zenoh_config: Path | None = None, insecure: bool = False) -> None:
    """Refuse what `open_bus` would, before anything that takes long.

    Raises:
        BusError: another process of this host holds the role, or `zenoh_config` is refused.
    """
    if zenoh_config is not None:
        check(_user_config(zenoh_config), zenoh_config, robot, role, insecure)
    os.close(_hold(runtime_folder() / f"{robot}.{role.name.lower()}.pid", robot, role))


def running() -> list[str]:
    """Roles that hold their locks on this host, as `robot.role`."""
    found = []
    for path in sorted(runtime_folder().glob("*.pid")):
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            found.append(path.stem)
        finally:
            os.close(descriptor)
    return found


def _runs_elsewhere(session: zenoh.Session, token: str) -> bool:
    """Whether somebody holds `token`; asks until links have had the time to come up."""
    give_up = time.monotonic() + LINK_S
    while not (found := any(reply.ok for reply in session.liveliness().get(token, timeout=1.0))):
        if time.monotonic() > give_up:
            break
        time.sleep(0.02)
    return found


def _hold(path: Path, robot: str, role: Role) -> int:
    """Lock `path` for the life of this process, so that a role killed in any way leaves nothing to clean up."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(descriptor, 32).decode(errors="replace").strip()
        os.close(descriptor)
        raise RoleTakenError(f"robot {robot!r}: another {role.noun} is running (process {holder})") from None
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"{os.getpid()}\n".encode())
    return descriptor
