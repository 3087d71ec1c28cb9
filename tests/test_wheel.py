"""The wheel in an empty environment: what it lacks no test of the working copy can show."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

LOG = "replay/demo/log.mcap"


def run(*command: str | Path, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    ours = {key: value for key, value in os.environ.items() if key not in ("VIRTUAL_ENV", "PYTHONPATH")}
    return subprocess.run(
        command, cwd=folder, env=ours | environment, capture_output=True, text=True, timeout=250, check=False
    )


def test_the_wheel_works_outside_the_repository(tmp_path: Path) -> None:
    uv = shutil.which("uv")
    if uv is None:
        pytest.skip("needs uv, which builds the wheel")
    built = run(uv, "build", "--wheel", "--offline", "--out-dir", tmp_path, REPOSITORY, folder=tmp_path)
    if built.returncode and "network" in built.stderr.lower():
        pytest.skip("needs the build backend (hatchling) in uv's cache, or the network")
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    # the versions of the lock, which a working copy that runs tests has in the cache
    python, environment = tmp_path / "empty" / "bin" / "python", {"UV_PROJECT_ENVIRONMENT": str(tmp_path / "empty")}
    locked = ("sync", "--frozen", "--offline", "--no-dev", "--no-install-project", "--project", REPOSITORY)
    installed = run(uv, *locked, folder=tmp_path, **environment)
    if installed.returncode and ("network" in installed.stderr.lower() or "cache" in installed.stderr.lower()):
        pytest.skip("needs the dependencies in uv's cache, or the network")
    assert installed.returncode == 0, installed.stderr
    installed = run(uv, "pip", "install", "--offline", "--no-deps", "--python", python, wheel, folder=tmp_path)
    assert installed.returncode == 0, installed.stderr
    command = tmp_path / "empty" / "bin" / "deltatwin"
    assert run(command, "--version", folder=tmp_path).stdout.startswith("deltatwin ")
    shutil.copy(REPOSITORY / LOG, tmp_path)
    for arguments in (("inspect", "log.mcap"), ("convert", "log.mcap", "log.csv"), ("demo", "--help")):
        done = run(command, *arguments, folder=tmp_path)
        assert done.returncode == 0, done.stderr
    lacks = {"simulate": ("--robot", "d3-1200", "--out", "a.csv"), "view": ("--robot", "d3-1200"), "experiment": ()}
    for name, options in lacks.items():  # heavy parts that are installed on demand
        done = run(command, name, *options, folder=tmp_path)
        assert done.returncode == 1
        extra = "view" if name == "view" else "simulate"
        assert re.fullmatch(rf"deltatwin: {name} needs \w+: install deltatwin\[{extra}\]\n", done.stderr)
    where = "import service.pages, replay.demo as d; print(service.pages.__file__, d.LOG.exists(), d.ROBOT.exists())"
    told = run(python, "-c", where, folder=tmp_path).stdout.split()
    assert told[0].startswith(str(tmp_path))
    assert told[1:] == ["True", "True"]
