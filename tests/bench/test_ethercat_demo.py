"""The one demonstration of the whole EtherCAT chain, as its user runs it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.drivers.ethercat import rig

DEMO = (sys.executable, "-c", "from service.cli.main import main; main()", "ethercat-demo", "--out")


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)


def test_every_claim_holds(tmp_path: Path) -> None:
    rig.require_namespaces()
    if shutil.which("dumpcap") is None:
        pytest.skip("needs dumpcap (wireshark-common) to capture the wire")
    done = run(*DEMO, str(tmp_path / "demo"), "--rate", "500")
    logs = "\n".join(f"{log.name}: {log.read_text()}" for log in sorted((tmp_path / "demo").glob("*.log")))
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}\n{logs}"
    assert done.stdout.count("│ holds") == 6
    assert "│ fails" not in done.stdout
    names = {path.name for path in (tmp_path / "demo").iterdir()}
    assert names >= {"own.mcap", "first.mcap", "second.mcap", "offline.mcap", "wire.pcapng", "identified.toml"}


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    rig.require_namespaces()
    if shutil.which("dumpcap") is None:
        pytest.skip("needs dumpcap (wireshark-common) to capture the wire")
    (tmp_path / "mine").touch()
    done = run(*DEMO, str(tmp_path))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"deltatwin: {tmp_path}: is not empty; give another folder with --out\n"


def test_without_the_right_to_make_a_namespace_it_says_so(tmp_path: Path) -> None:
    rig.require_namespaces()
    done = run("setpriv", "--bounding-set=-sys_admin", "--inh-caps=-sys_admin", *DEMO, str(tmp_path / "demo"))
    assert done.returncode == 1
    assert done.stderr == (
        "deltatwin: network namespace: Operation not permitted; needs the capability CAP_SYS_ADMIN (run as root)\n"
    )
