"""A network interface that raw Ethernet frames are read from and sent on."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct

from schemas.errors import BusError, RoleTakenError

_SIOCGIFFLAGS, _IFF_UP = 0x8913, 1


def open_interface(interface: str, protocol: int) -> socket.socket:
    """A raw socket for the frames of one Ethernet type; those of a `protocol` of 0 come once it is bound to another.

    Raises:
        BusError: it does not exist, is down, or may not be used.
    """
    try:
        socket.if_nametoindex(interface)
    except OSError:
        known = ", ".join(name for _, name in socket.if_nameindex())
        raise BusError(f"{interface}: no such interface (interfaces: {known})") from None
    try:
        wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(protocol))
    except PermissionError:
        raise BusError(f"{interface}: raw Ethernet needs the capability CAP_NET_RAW (run as root)") from None
    try:
        _check_up(interface, wire)
        if protocol:
            wire.bind((interface, protocol))
    except OSError as error:
        wire.close()
        raise BusError(f"{interface}: {error.strerror}") from error
    return wire


def check_interface(interface: str) -> None:
    """Raise unless raw frames can be sent on `interface`.

    Raises:
        BusError: it does not exist, is down, or may not be used.
    """
    open_interface(interface, 0).close()


def claim(interface: str) -> socket.socket:
    """Be the only master on `interface`, whatever its robot is called, until the socket is closed or this process ends:
    an abstract name, which like the interface belongs to the network namespace.

    Raises:
        RoleTakenError: another process of this host is.
    """
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0deltatwin master {interface}")
    except OSError:
        name.close()
        raise RoleTakenError(f"{interface}: already has a master running") from None
    return name


def _check_up(interface: str, wire: socket.socket) -> None:
    request = struct.pack("16sH22x", os.fsencode(interface)[:15], 0)
    if not struct.unpack_from("H", fcntl.ioctl(wire, _SIOCGIFFLAGS, request), 16)[0] & _IFF_UP:
        raise OSError(errno.ENETDOWN, f"the interface is down (ip link set {interface} up)")
