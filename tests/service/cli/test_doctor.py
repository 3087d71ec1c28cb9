"""`deltatwin doctor`: it says what the system itself says, what is missing and how to get it, and no secrets."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from service.checkup import Check, bundle, examine
from service.cli.doctor import _live

PROGRAM = Path(sys.executable).with_name("deltatwin")


def has(name: str) -> bool | None:
    return next(check.has for check in examine() if check.name == name)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("real-time priority", ("chrt", "--fifo", "50", "true")),
        ("network namespace", ("unshare", "--net", "true")),
        ("wireshark (dumpcap)", ("dumpcap", "--version")),
        ("memory lock", (sys.executable, "-c", "from replay.realtime import go_realtime; exit(go_realtime('it'))")),
    ],
)
def test_a_right_or_program_is_there_where_it_can_be_used(name: str, command: tuple[str, ...]) -> None:
    if name == "memory lock" and not has("real-time priority"):
        pytest.skip("needs real-time priority, which the roles ask for together with it")
    if shutil.which(command[0]) is None:
        assert command[0] != "dumpcap" or not has(name)
        pytest.skip(f"needs {command[0]}")
    done = subprocess.run(command, capture_output=True, check=False)
    assert has(name) is (done.returncode == 0)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "as it was"


def test_what_is_missing_comes_with_what_for_and_how(tmp_path: Path) -> None:
    environment = os.environ | {"PATH": str(tmp_path), "XDG_RUNTIME_DIR": f"/{'long' * 30}"}
    done = subprocess.run([PROGRAM, "doctor"], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for said in (
        "wireshark (dumpcap): Debian, Ubuntu: apt install wireshark-common", "ip: Debian, Ubuntu: apt install iproute2",
        "browser: Debian: apt install chromium", "local sockets: set XDG_RUNTIME_DIR to a shorter path",
    ):  # fmt: skip
        assert said in done.stdout
    checks = examine()
    assert len({check.name for check in checks}) == len(checks)
    assert all((check.needed and bool(check.remedy) is (not check.has)) or check.has is None for check in checks)


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("", "Live roles run in real time."),
        ("real-time kernel", "Live roles run with real-time priority, but this kernel does not bound their latency"),
        ("memory lock", "Live roles run, but their timing is best effort."),
    ],
)
def test_real_time_is_claimed_only_with_kernel_and_rights(missing: str, said: str) -> None:
    names = ("real-time kernel", "real-time priority", "memory lock")
    assert _live([Check(name, name != missing, "", "") for name in names]).startswith(said)


def test_the_bundle_names_neither_host_nor_user_and_holds_no_secret(tmp_path: Path) -> None:
    environment = os.environ | {
        "HOME": "/home/somebody",
        "USER": "somebody",
        "API_TOKEN": "sesame",
        "XDG_RUNTIME_DIR": "",
    }
    target = tmp_path / "machine.json"
    done = subprocess.run(
        [PROGRAM, "doctor", "--bundle", target], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    text = target.read_text()
    for secret in ("somebody", "sesame", str(tmp_path), os.getcwd(), platform.node() or "somebody"):
        assert secret not in text
    document = json.loads(text)
    assert document["versions"]["numpy"].count(".") >= 1
    assert document["versions"]["deltatwin"] == bundle([])["versions"]["deltatwin"]
    assert document["machine"]["processors"] == os.cpu_count()
    assert [check["name"] for check in document["checks"]] == [check.name for check in examine()]
    again = subprocess.run([PROGRAM, "doctor", "--bundle", target], capture_output=True, text=True, check=False)
    assert again.stderr == f"deltatwin: {target}: exists already; give another name with --bundle\n"
    assert target.read_text() == text
