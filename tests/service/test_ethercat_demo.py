"""The one demonstration of the whole EtherCAT chain, as its user runs it: by the tutorial."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from docs.making.tutorials import TUTORIALS
from docs.making.tutorials import run as run_tutorial
from drivers.trace.mcap_file import write_samples
from service.demonstration import compare
from service.monitor.readback import read_recording
from service.pages import BROWSERS
from tests.docs.test_tutorials import is_drawn
from tests.drivers.ethercat import rig

DEMO = (sys.executable, "-c", "from service.cli.main import main; main()", "ethercat-demo", "--out")


def run(*command: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    """path: the only folder with programs."""
    environment = None if path is None else os.environ | {"PATH": str(path)}
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=560, env=environment)


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of one run of the tutorial, and what the run said."""
    rig.require_namespaces()
    if os.geteuid() != 0:
        pytest.skip("needs root, as the tutorial says")
    if shutil.which("dumpcap") is None:
        pytest.skip("needs dumpcap (wireshark-common) to capture the wire")
    folder = tmp_path_factory.mktemp("demonstration")
    said = run_tutorial(TUTORIALS / "ethercat.md", folder, folder if any(map(shutil.which, BROWSERS)) else None)
    return folder / "work" / "wire", said


@pytest.mark.timeout(600)  # a minute, several where a busy host compiles first
@pytest.mark.flaky(reruns=1)  # live roles on a machine that does something else just then
def test_every_claim_holds(demonstrated: tuple[Path, str]) -> None:
    out, said = demonstrated
    assert said.count("\nholds ") == 6
    assert "\nfails " not in said
    names = {path.name for path in out.iterdir()}
    assert names >= {"own.mcap", "first.mcap", "second.mcap", "offline.mcap", "wire.pcapng", "identified.toml"}


@pytest.mark.timeout(600)
def test_the_picture_of_its_payload_is_drawn(demonstrated: tuple[Path, str]) -> None:
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("needs a browser to draw")
    assert is_drawn(demonstrated[0].parents[1] / "pictures" / "ethercat.png")


@pytest.mark.timeout(600)
def test_a_cycle_that_differs_or_is_missing_untold_fails_its_claim(
    demonstrated: tuple[Path, str], tmp_path: Path
) -> None:
    out, _ = demonstrated
    other = tmp_path / "other"
    shutil.copytree(out, other)
    samples = read_recording(out / "offline.mcap")["sample"].records
    moved = samples.copy()
    moved["position"][3000, 1] = np.nextafter(moved["position"][3000, 1], 9.0)

    def claims(offline: np.ndarray, missing: int) -> list[bool]:
        (other / "offline.mcap").unlink()
        write_samples([offline], other / "offline.mcap", "d3-1200", other)
        return [check.holds for check in compare(other, 1.5, missing)]

    assert claims(samples, 0) == [True] * 6
    assert claims(moved, 0) == [True, True, True, False, True, True]
    assert claims(np.delete(samples, slice(-24, None)), 0) == [True, True, True, False, True, True]
    assert claims(np.delete(samples, slice(-24, None)), 48) == [True] * 6  # a capture that lost frames, and said so
    renumbered = np.delete(samples, slice(3000, 3024))
    renumbered["sequence"] = np.arange(len(renumbered))
    assert claims(renumbered, 48) == [True, True, False, True, True, True]


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
    setpriv = (str(shutil.which("setpriv")), "--bounding-set=-sys_admin", "--inh-caps=-sys_admin")
    done = run(*setpriv, *DEMO, str(tmp_path / "demo"), path=tmp_path)  # nor are its tools there
    assert done.returncode == 1
    assert done.stderr == (
        "deltatwin: network namespace: Operation not permitted; needs the capability CAP_SYS_ADMIN (run as root)\n"
    )


def test_the_tools_it_lacks_are_named_all_at_once_and_in_its_help(tmp_path: Path) -> None:
    rig.require_namespaces()
    done = run(*DEMO, str(tmp_path / "demo"), path=tmp_path)
    assert done.returncode == 1
    assert done.stderr == (
        "deltatwin: ethercat-demo needs ip and dumpcap, not found on PATH; install iproute2 wireshark-common\n"
    )
    assert not (tmp_path / "demo").exists()
    shown = "".join(run(*DEMO[:-1], "--help").stdout.split())  # however wide
    assert "`dumpcap`(packagewireshark-common)" in shown
