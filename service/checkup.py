"""What can this machine do, what is each of it needed for, and how is it to be had? Nothing is changed and kept."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from replay.realtime import PRIORITY

PROGRAM_S = 10.0  # that a program may take to say which version it is
CAPABILITIES = {"CAP_NET_ADMIN": 12, "CAP_NET_RAW": 13, "CAP_IPC_LOCK": 14, "CAP_SYS_ADMIN": 21, "CAP_SYS_NICE": 23}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
COMPILERS = ("cc", "gcc", "clang")
EXTRAS = {  # module: extra, what for
    "mujoco": ("simulate", "simulate, closed-loop, experiment, blindtest"),
    "pinocchio": ("chain", "arms described by a URDF"),
    "foxglove": ("view", "view"),
    "dask": ("dask", "--backend dask of blindtest and fleet"),
}
SOCKET_PATH = 107  # bytes of the path of a local socket, at most
LONGEST_SOCKET = len("/deltatwin/a-robot-of-a-long-name.estimator.sock")
_CLONE_NEWNET = 0x40000000
_MCL_ALL = 3  # MCL_CURRENT | MCL_FUTURE


@dataclass(frozen=True)
class Check:
    """One thing. has: True, False, or None where it cannot be told. found: what there is. needed: what for. remedy: how
    to get it, empty where it is there."""

    name: str
    has: bool | None
    found: str
    needed: str
    remedy: str = ""


def examine(folder: Path = Path()) -> list[Check]:
    """Look at this machine. folder: where recordings would go."""
    groups = (_system, _rights, _programs, _extras)
    return [*(check for group in groups for check in group()), *_places(folder)]


def bundle(checks: Sequence[Check]) -> dict[str, Any]:
    """What a bug report should say of this machine: no names of host or user, no environment, no paths of the home."""
    return {
        "checks": [asdict(check) for check in checks],
        "versions": {"deltatwin": _version("deltatwin"), "python": platform.python_version(), **_dependencies()},
        "machine": {
            "system": platform.system(),
            "kernel": _without_names(f"{platform.release()} {platform.version()}"),
            "libc": " ".join(platform.libc_ver()),
            "architecture": platform.machine(),
            "processors": os.cpu_count(),
            "processor": _field(Path("/proc/cpuinfo"), "model name"),
            "memory": _field(Path("/proc/meminfo"), "MemTotal"),
            "container": Path("/.dockerenv").exists() or Path("/run/.containerenv").exists(),
        },
    }


def _system() -> list[Check]:
    linux = sys.platform.startswith("linux")
    kernel = f"{platform.system()} {platform.release()}"
    cores = os.cpu_count() or 1
    preempts = Path("/sys/kernel/realtime").exists() or "PREEMPT_RT" in platform.version()
    return [
        Check("Linux", linux, kernel, "all commands on the bus and on EtherCAT; commands on files run anywhere",
              "" if linux else "a Linux host for the live roles"),
        Check("real-time kernel", preempts if linux else None, "PREEMPT_RT" if preempts else "a standard kernel",
              "bounded latency under other load; 1 kHz also runs without it",
              "" if preempts else "a kernel with PREEMPT_RT, such as Debian's package linux-image-rt-amd64"),
        Check("processors", cores >= 2, str(cores), "running the live roles at the same time: two processors",
              "" if cores >= 2 else "a machine with two processors or more"),
    ]  # fmt: skip


def _rights() -> list[Check]:
    fifo, lock = _may_have_priority(), _may_lock_memory()
    limits = "in /etc/security/limits.d/deltatwin.conf: `@realtime - {} {}`, and log in again"
    raw, space = _has("CAP_NET_RAW"), _may_make_namespace()
    return [
        Check("real-time priority", fifo, "SCHED_FIFO granted" if fifo else "SCHED_FIFO refused",
              "live roles: without it their timing is best effort", "" if fifo else limits.format("rtprio", 99)),
        Check("memory lock", lock, _memory_limit(), "live roles: without it a page fault can delay a cycle",
              "" if lock else limits.format("memlock", "unlimited")),
        Check("raw Ethernet", raw, "CAP_NET_RAW" if raw else "no CAP_NET_RAW", "tap, master, segment",
              "" if raw else "sudo, or the capability CAP_NET_RAW for the process"),
        Check("network namespace", space, "can be made" if space else "refused", "ethercat-demo",
              "" if space else "sudo, or a container with CAP_SYS_ADMIN and CAP_NET_ADMIN"),
    ]  # fmt: skip


def _programs() -> list[Check]:
    dumpcap, ip = shutil.which("dumpcap"), shutil.which("ip")
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    return [
        Check("wireshark (dumpcap)", bool(dumpcap), _says(dumpcap), "ethercat-demo, to capture its wire",
              "" if dumpcap else "Debian, Ubuntu: apt install wireshark-common"),
        Check("ip", bool(ip), _says(ip, "-V"), "ethercat-demo, and interfaces for tap and master",
              "" if ip else "Debian, Ubuntu: apt install iproute2"),
        Check("browser", bool(browser), _says(browser), "diagnose --pdf; pages open in any browser",
              "" if browser else "Debian: apt install chromium"),
        Check("C compiler", bool(compiler), _says(compiler), "compiling exported C code only",
              "" if compiler else "Debian, Ubuntu: apt install gcc"),
    ]  # fmt: skip


def _extras() -> list[Check]:
    checks = []
    for module, (extra, needed) in EXTRAS.items():
        there = importlib.util.find_spec(module) is not None
        found = (
            _version({"pinocchio": "pin", "foxglove": "foxglove-sdk"}.get(module, module)) if there else "not installed"
        )
        checks.append(Check(module, there, found, needed, "" if there else f"pip install 'deltatwin[{extra}]'"))
    return checks


def _places(folder: Path) -> list[Check]:
    from schemas.kernel_cache import kept_in

    compiled = any(kept_in().rglob("*.nbc"))
    runtime = Path(os.environ.get("XDG_RUNTIME_DIR") or f"/tmp/deltatwin-{getattr(os, 'getuid', int)()}")
    fits = len(os.fsencode(runtime)) + LONGEST_SOCKET <= SOCKET_PATH
    free = shutil.disk_usage(folder).free
    return [
        Check("compiled kernels", compiled, "kept" if compiled else "none yet", "starting in less than half a minute",
              "" if compiled else "the first command compiles and keeps them, for example `deltatwin demo`"),
        Check("local sockets", fits, "path short enough" if fits else "path too long", "the bus on one host",
              "" if fits else "set XDG_RUNTIME_DIR to a shorter path"),
        Check("disk", free > 1 << 30, f"{free / (1 << 30):.0f} GiB free", "recordings: 1 GiB is an hour at 1 kHz",
              "" if free > 1 << 30 else "free some space, or use `monitor --out` on another disk"),
    ]  # fmt: skip


def _may_have_priority() -> bool:
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        os.sched_setscheduler(0, *before)
    except (OSError, AttributeError):
        return False
    return True


def _may_lock_memory() -> bool | None:
    """A child tries: what is locked stays so."""
    return _child(f"ctypes.CDLL(None).mlockall({_MCL_ALL})")


def _memory_limit() -> str:
    try:
        import resource
    except ImportError:
        return "not on this system"
    most = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if _has("CAP_IPC_LOCK"):
        return "CAP_IPC_LOCK"
    return "unlimited" if most == resource.RLIM_INFINITY else f"{most >> 10} KiB"


def _has(capability: str) -> bool | None:
    """Whether this process has it; None where it cannot be told."""
    effective = _field(Path("/proc/self/status"), "CapEff")
    return None if effective is None else bool(int(effective, 16) >> CAPABILITIES[capability] & 1)


def _may_make_namespace() -> bool | None:
    """A child tries: a process that has entered one cannot go back."""
    return _child(f"ctypes.CDLL(None).unshare({_CLONE_NEWNET})")


def _child(call: str) -> bool | None:
    """Whether a function of the C library gives 0 in a process of its own."""
    if not sys.platform.startswith("linux"):
        return None
    code = f"import ctypes, sys; sys.exit({call} != 0)"
    return subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, check=False).returncode == 0


def _says(program: str | None, option: str = "--version") -> str:
    """Name and version of a program, as it tells it."""
    if program is None:
        return "not on PATH"
    try:
        done = subprocess.run([program, option], capture_output=True, text=True, timeout=PROGRAM_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return "does not start"
    found = re.search(r"\d+(\.\d+)+", done.stdout or done.stderr)
    return f"{Path(program).name} {found[0] if found else ''}".strip()


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _dependencies() -> dict[str, str]:
    """Versions of all that deltatwin names as its dependencies."""
    try:
        required = importlib.metadata.requires("deltatwin") or []
    except importlib.metadata.PackageNotFoundError:
        required = []
    names = dict.fromkeys(match[0] for line in required if (match := re.match(r"[\w.-]+", line)))
    return {name: _version(name) for name in names}


def _field(path: Path, name: str) -> str | None:
    """The value of a line `name : value`."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    found = re.search(rf"^{re.escape(name)}\s*:\s*(.*)$", text, re.MULTILINE)
    return found[1].strip() if found else None


def _without_names(text: str) -> str:
    return text.replace(platform.node(), "host") if platform.node() else text
