"""What a Zenoh configuration of the user's lets in and out, looked at before its session opens."""

from __future__ import annotations

import datetime
import ipaddress
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh
from cryptography import x509
from cryptography.x509.oid import NameOID

from drivers.security.rights import common_name
from schemas.errors import BusError, DeltatwinError
from schemas.files import read_bytes
from schemas.messages import Role

SOON = datetime.timedelta(days=30)  # a certificate that expires within says so at every start

MAX_PEM_BYTES = 1 << 16

_TLS = "transport/link/tls"
_FILES = (
    "root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key",
)  # fmt: skip
_ENCRYPTED = frozenset({"tls", "quic"})
_ON_THE_HOST = frozenset({"unixsock-stream", "unixpipe"})


def load_certificate(path: Path, error: type[DeltatwinError] = BusError) -> x509.Certificate:
    """The first certificate of a PEM file.

    Raises:
        error: the file cannot be read or holds none.
    """
    try:
        return x509.load_pem_x509_certificate(read_bytes(path, MAX_PEM_BYTES, error))
    except ValueError as cause:
        raise error(f"{path}: not a certificate in PEM") from cause


def find_files(config: zenoh.Config, folder: Path) -> None:
    """Let certificates and keys that are named without a folder be those beside the configuration, in `folder`."""
    tls = json.loads(config.get_json(_TLS))
    for name in _FILES:
        if tls[name] and (found := folder / tls[name]).exists():
            config.insert_json5(f"{_TLS}/{name}", json.dumps(str(found.absolute())))


def check(config: zenoh.Config, path: Path, robot: str, role: Role, insecure: bool) -> list[str]:
    """Refuse what would let strangers speak; what else there is to say about the configuration, one line each.

    Raises:
        BusError: it leaves the host without TLS, certificates on both sides and access control (and not `insecure`), or
            a certificate has expired or belongs to another role.
    """
    open_door = next(_open_doors(config), None)
    if open_door and not insecure:
        raise BusError(
            f"{path}: {open_door}: anyone who can reach it could move the robot; "
            "make keys with `deltatwin keys`, or give --insecure"
        )
    notes = [f"{path}: {open_door}: anyone who can reach it can send as any role (--insecure)"] if open_door else []
    tls = json.loads(config.get_json(_TLS))
    for file in dict.fromkeys(Path(tls[name]) for name in _FILES if tls[name] and name.endswith("certificate")):
        notes += _check_certificate(file, robot, role)
    for file in dict.fromkeys(Path(tls[name]) for name in _FILES if tls[name] and name.endswith("key")):
        if file.exists() and (mode := file.stat().st_mode & 0o777) & 0o077:
            notes.append(f"{file}: a private key that others may read (mode {mode:04o}); chmod 600 it")
    return notes


def _check_certificate(path: Path, robot: str, role: Role) -> list[str]:
    certificate, now = load_certificate(path), datetime.datetime.now(datetime.UTC)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name = str(names[0].value) if names else ""
    if name.startswith("deltatwin/") and name not in (common_name(robot, role), common_name(None, role)):
        raise BusError(f"{path}: the certificate of {name!r}, not of {common_name(robot, role)!r}")
    until = certificate.not_valid_after_utc
    if until <= now:
        raise BusError(f"{path}: expired on {until:%Y-%m-%d %H:%M} UTC; make new ones with `deltatwin keys`")
    if certificate.not_valid_before_utc > now:
        raise BusError(
            f"{path}: valid from {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC, and this host's clock says "
            f"{now:%Y-%m-%d %H:%M}"
        )
    if until - now > SOON:
        return []
    return [f"{path}: expires in {(until - now).days} days, on {until:%Y-%m-%d %H:%M} UTC; renew with `deltatwin keys`"]


def _open_doors(config: zenoh.Config) -> Iterator[str]:
    """Why strangers could speak, one reason at a time; none if nothing leaves the host or all of it is guarded."""
    outside = [
        (verb, endpoint)
        for section, verb in (("listen", "listens on"), ("connect", "connects to"))
        for endpoint in _endpoints(config, section)
        if not _stays(endpoint)
    ]
    for verb, endpoint in outside:
        protocol, _, rest = endpoint.partition("/")
        if protocol not in _ENCRYPTED or "enable_mtls" in rest:
            yield f"{verb} {endpoint} without TLS and certificates on both sides"
    searches = _setting(config, "scouting/multicast/enabled") is not False
    protocols = _setting(config, "transport/link/protocols")
    if searches and not (protocols and set(protocols) <= _ENCRYPTED | _ON_THE_HOST):
        yield "looks for others by multicast (scouting/multicast/enabled)"
    if not outside and not searches:
        return
    tls = _setting(config, _TLS)
    if tls["enable_mtls"] is not True:
        yield "asks for no certificate (transport/link/tls/enable_mtls)"
    control = _setting(config, "access_control")
    if control["enabled"] is not True or control["default_permission"] != "deny":
        yield "has no access control that denies what is not allowed (access_control)"
    if any(not subject.get("cert_common_names") for subject in control["subjects"] or []):
        yield "has an access control subject without cert_common_names"


def _setting(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _endpoints(config: zenoh.Config, section: str) -> list[str]:
    """Endpoints of the mode that is set: they may be given as one list or a list a mode, each as text or an object."""
    found = _setting(config, f"{section}/endpoints")
    if isinstance(found, dict):
        found = found.get(_setting(config, "mode") or "peer")
    return [one["endpoint"] if isinstance(one, dict) else str(one) for one in found or []]


def _stays(endpoint: str) -> bool:
    """Whether nothing at this endpoint leaves the host."""
    protocol, _, rest = endpoint.partition("/")
    if protocol in _ON_THE_HOST:
        return True
    host = rest.split("#")[0].split("?")[0].rpartition(":")[0].strip("[]").lower()
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
