"""Certificates and Zenoh configurations for the roles of a robot on several hosts.

Layout: `ca.pem` and `ca.key` on top, a folder a host with `ca.pem` and, for every role, `<role>.pem`, `<role>.key` and
`<role>.json5`, the Zenoh configuration. A host's folder is all that goes to that host; `ca.key` goes nowhere.
"""

from __future__ import annotations

import datetime
import ipaddress
import json
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.peer import peer_settings
from drivers.security.check import MAX_PEM_BYTES, load_certificate
from drivers.security.rights import COMMON_NAME, SOURCES, access_control, common_name
from schemas.errors import StorageError
from schemas.files import read_bytes, whole
from schemas.messages import Role

CA_VALID = datetime.timedelta(days=3650)
ROLE_VALID = datetime.timedelta(days=365)
FIRST_PORT = 7450  # a role listens on its host's first port plus its number

_BACKDATED = datetime.timedelta(days=1)  # a clock that is behind must not find them not yet valid
_NAME = re.compile(r"^[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?$")


@dataclass(frozen=True)
class Host:
    """A host as the others reach it."""

    name: str  # DNS name or address
    first_port: int

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The address, where the name is one."""
        try:
            return ipaddress.ip_address(self.name)
        except ValueError:
            return None

    @property
    def folder(self) -> str:
        """Name of the host's folder."""
        return self.name if self.first_port == FIRST_PORT else f"{self.name}:{self.first_port}"

    def reached(self, role: Role) -> str:
        """The endpoint on which others reach `role` on this host."""
        return f"tls/{self._literal(self.name)}:{self.first_port + role}"

    def listens(self, role: Role) -> str:
        """The endpoint on which `role` listens: the address given, or all of a host given by name."""
        return f"tls/{self._literal(self.name) if self.address else '0.0.0.0'}:{self.first_port + role}"

    def _literal(self, name: str) -> str:
        return f"[{name}]" if ":" in name else name


@dataclass(frozen=True)
class WrittenKeys:
    """What `make_keys` wrote."""

    folders: list[Path]  # one a host
    roles: list[Role]
    valid_until: datetime.datetime
    ca_valid_until: datetime.datetime
    ca_is_new: bool
    replaced: int  # role certificates that were there before


def parse_hosts(text: str) -> list[Host]:
    """Hosts out of `name[:port],…`; an IPv6 address with a port in brackets.

    Raises:
        ValueError: naming what is no host, or is there twice.
    """
    hosts = [_host(part.strip()) for part in text.split(",")]
    if len({(host.name, host.first_port + role) for host in hosts for role in Role}) < len(hosts) * len(Role):
        raise ValueError(f"{text!r}: a host is given twice, or two ports of one host are closer than {len(Role)}")
    return hosts


def _host(text: str) -> Host:
    try:
        return Host(str(ipaddress.ip_address(text)), FIRST_PORT)
    except ValueError:
        pass
    try:
        parts = urlsplit(f"//{text}")
        name, port = parts.hostname or "", parts.port or FIRST_PORT
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}") from None
    host = Host(name, port)
    if (host.address is None and not _NAME.match(name)) or "@" in text or parts.netloc != text:
        raise ValueError(f"{text!r}: not a host name or address, optionally with a port")
    if port + max(Role) > 65535:
        raise ValueError(f"{text!r}: the roles take ports {port} to {port + max(Role)}, and there are 65535")
    return host


def make_keys(
    out: Path,
    hosts: list[Host],
    robot: str | None = None,
    source: Role = Role.TAP,
    valid: datetime.timedelta = ROLE_VALID,
    now: datetime.datetime | None = None,
) -> WrittenKeys:
    """Write keys, certificates and configurations for `hosts` to `out`, signed by the CA in it or by a new one.

    `source` is the one role that may write samples; the other sources get no keys. `robot` None: for every robot.

    Raises:
        StorageError: `out` cannot be written, its CA cannot be used, or `robot` is too long for a certificate.
    """
    now = now or datetime.datetime.now(datetime.UTC)
    if len(longest := max((common_name(robot, role) for role in Role), key=len)) > COMMON_NAME:
        raise StorageError(
            f"robot name {robot!r}: {longest!r} is longer than the {COMMON_NAME} letters of a certificate"
        )
    roles = [role for role in Role if role == source or role not in SOURCES]
    try:
        _folder(out)
        authority, authority_key, is_new = _authority(out, robot, now)
        until = min(now + valid, authority.not_valid_after_utc)
        replaced = 0
        for host in hosts:
            folder = out / host.folder
            _folder(folder)
            for stale in {role.name.lower() for role in Role if role not in roles}:
                for suffix in ("json5", "key", "pem"):
                    (folder / f"{stale}.{suffix}").unlink(missing_ok=True)
            _write(folder / "ca.pem", _pem(authority))
            for role in roles:
                key = ec.generate_private_key(ec.SECP256R1())
                certificate = _certificate(authority, authority_key, key, host, common_name(robot, role), now, until)
                name = role.name.lower()
                replaced += (folder / f"{name}.pem").exists()
                _write(folder / f"{name}.key", _private(key))
                _write(folder / f"{name}.pem", _pem(certificate))
                settings = json.dumps(_settings(host, hosts, robot, role, source), indent=1)
                _write(
                    folder / f"{name}.json5", (_heading(host, robot, role, source, until) + settings + "\n").encode()
                )
    except OSError as error:
        raise StorageError(f"{error.filename or out}: {error.strerror}") from error
    return WrittenKeys(
        [out / host.folder for host in hosts], roles, until, authority.not_valid_after_utc, is_new, replaced
    )


def _heading(host: Host, robot: str | None, role: Role, source: Role, until: datetime.datetime) -> str:
    name = role.name.lower()
    return (
        f"// deltatwin {name} of {robot or 'any robot'} on {host.folder}; {source.name.lower()} writes samples.\n"
        f"// {name}.pem is valid until {until:%Y-%m-%d %H:%M} UTC; other files are expected next to this one.\n"
    )


def _settings(host: Host, hosts: list[Host], robot: str | None, role: Role, source: Role) -> dict:
    name = role.name.lower()
    # Lower roles wherever they may run, so that every pair is linked once; its own role elsewhere, to find a double.
    connect = [there.reached(other) for other in Role for there in hosts if other < role]
    connect += [there.reached(role) for there in hosts if there != host]
    link = {
        "protocols": ["tls"],
        "tls": {
            "root_ca_certificate": "ca.pem",
            "listen_certificate": f"{name}.pem",
            "listen_private_key": f"{name}.key",
            "connect_certificate": f"{name}.pem",
            "connect_private_key": f"{name}.key",
            "enable_mtls": True,
            "verify_name_on_connect": True,
        },
    }
    return peer_settings(host.listens(role), connect, link) | {"access_control": access_control(robot, source)}


def _authority(
    out: Path, robot: str | None, now: datetime.datetime
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey, bool]:
    """The CA in `out`; a new one where there is none."""
    paths = out / "ca.pem", out / "ca.key"
    if any(os.path.lexists(path) for path in paths):
        certificate = load_certificate(paths[0], StorageError)
        try:
            key = serialization.load_pem_private_key(read_bytes(paths[1], MAX_PEM_BYTES, StorageError), None)
        except (ValueError, TypeError) as error:
            raise StorageError(f"{paths[1]}: not a private key without passphrase") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey) or certificate.public_key() != key.public_key():
            raise StorageError(f"{paths[1]}: not the key of {paths[0]}")
        if certificate.not_valid_after_utc <= now:
            raise StorageError(
                f"{paths[0]}: expired on {certificate.not_valid_after_utc:%Y-%m-%d}; make a new CA in another folder"
            )
        return certificate, key, False
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, f"deltatwin CA of {robot or 'all robots'}"[:COMMON_NAME])]
    )
    certificate = (
        _builder(name, name, key.public_key(), now, now + CA_VALID)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    with whole(paths[1], 0o600, links=False) as secret:  # both or none, on a disk that is full too
        secret.write_bytes(_private(key))
        _write(paths[0], _pem(certificate))
    return certificate, key, True


def _certificate(
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    key: ec.EllipticCurvePrivateKey,
    host: Host,
    name: str,
    now: datetime.datetime,
    until: datetime.datetime,
) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    where = x509.IPAddress(host.address) if host.address else x509.DNSName(host.name)
    purposes = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    issuer = authority.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    return (
        _builder(authority.subject, subject, key.public_key(), now, until)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(x509.SubjectAlternativeName([where]), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(issuer), critical=False)
        .sign(authority_key, hashes.SHA256())
    )


def _builder(
    issuer: x509.Name,
    subject: x509.Name,
    key: ec.EllipticCurvePublicKey,
    now: datetime.datetime,
    until: datetime.datetime,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .issuer_name(issuer)
        .subject_name(subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, until) - _BACKDATED)
        .not_valid_after(until)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates, key_cert_sign=signs_certificates, crl_sign=signs_certificates,
        content_commitment=False, key_encipherment=False, data_encipherment=False, key_agreement=False,
        encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _folder(path: Path) -> None:
    """Make a folder that nobody else reads; one that is there stays as it is.

    Raises:
        StorageError: it is a link, or others may write in it.
    """
    try:
        path.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        if path.is_symlink() or not path.is_dir():
            raise StorageError(f"{path}: not a folder: keys are written only to a folder") from None
        if os.name == "posix" and stat.S_IMODE(path.stat().st_mode) & (stat.S_IWGRP | stat.S_IWOTH):
            raise StorageError(f"{path}: others may write in it: chmod go-w, or another folder") from None


def _write(path: Path, content: bytes) -> None:
    """Write a whole file of mode 0600; at no moment may others read it. A link is no way to another place."""
    with whole(path, 0o600, links=False) as partial:
        partial.write_bytes(content)
