"""The wheel in an empty environment: what it lacks no test of the working copy can show."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

LOG = "replay/demo/log.mcap"
ROOMS = ("drivers", "replay", "schemas", "service")
EXAMPLE = """
import deltatwin as dt
robot, log = dt.load_demo()
picked = dt.payload(robot, log)
assert dt.read_trace("log.mcap").torque.tolist() == log.torque.tolist()
assert picked.plot().data and dt.__file__.endswith("site-packages/deltatwin/__init__.py")
print("payload", picked.trace, sum(level.event.name == "PICK" for level in picked.levels))
"""
OWN_EFFECT = """
from dataclasses import dataclass
from deltatwin.effects import Amplitude, Effect
@dataclass(frozen=True)
class Bump(Effect):
    height: Amplitude = Amplitude("N m", "height")
    name = "bump"
    settles = "a slow sweep"
    def regressors(self, scene, joint, nonlinear): ...
"""


def run(*command: str | Path, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    ours = {key: value for key, value in os.environ.items() if key not in ("VIRTUAL_ENV", "PYTHONPATH")}
    return subprocess.run(
        command, cwd=folder, env=ours | environment, capture_output=True, text=True, timeout=250, check=False
    )


@pytest.fixture(scope="module")
def installed_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the bundled log, and with the wheel in an environment `empty`."""
    tmp_path = tmp_path_factory.mktemp("wheel")
    uv = shutil.which("uv")
    if uv is None:
        pytest.skip("needs uv, which builds the wheel")
    built = run(uv, "build", "--wheel", "--offline", "--out-dir", tmp_path, REPOSITORY, folder=tmp_path)
    if built.returncode and "network" in built.stderr.lower():
        pytest.skip("needs the build backend (hatchling) in uv's cache, or the network")
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    only_imports_differ(zipfile.ZipFile(wheel))
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"deltatwin"}
    assert "deltatwin/py.typed" in names
    # the versions of the lock, which a working copy that runs tests has in the cache
    python, environment = tmp_path / "empty" / "bin" / "python", {"UV_PROJECT_ENVIRONMENT": str(tmp_path / "empty")}
    locked = ("sync", "--frozen", "--offline", "--no-dev", "--no-install-project", "--project", REPOSITORY)
    installed = run(uv, *locked, folder=tmp_path, **environment)
    if installed.returncode and ("network" in installed.stderr.lower() or "cache" in installed.stderr.lower()):
        pytest.skip("needs the dependencies in uv's cache, or the network")
    assert installed.returncode == 0, installed.stderr
    installed = run(uv, "pip", "install", "--offline", "--no-deps", "--python", python, wheel, folder=tmp_path)
    assert installed.returncode == 0, installed.stderr
    shutil.copy(REPOSITORY / LOG, tmp_path)
    return tmp_path


def test_the_wheel_works_outside_the_repository(installed_wheel: Path) -> None:
    tmp_path, python = installed_wheel, installed_wheel / "empty" / "bin" / "python"
    command = python.with_name("deltatwin")
    assert run(command, "--version", folder=tmp_path).stdout.startswith("deltatwin ")
    for arguments in (("inspect", "log.mcap"), ("convert", "log.mcap", "log.csv")):
        done = run(command, *arguments, folder=tmp_path)
        assert done.returncode == 0, done.stderr
    lacks = {"simulate": ("--robot", "d3-1200", "--out", "a.csv"), "view": ("--robot", "d3-1200"), "experiment": ()}
    for name, options in lacks.items():  # heavy parts that are installed on demand
        done = run(command, name, *options, folder=tmp_path)
        assert done.returncode == 1
        extra = "view" if name == "view" else "simulate"
        assert re.fullmatch(rf"deltatwin: {name} needs \w+: install deltatwin\[{extra}\]\n", done.stderr)
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "errors.py").write_text("")  # of whoever works here; not ours
    example = run(python, "-c", EXAMPLE, folder=tmp_path)
    assert example.returncode == 0, example.stderr
    assert example.stdout == "payload log 7\n"
    own = tmp_path / "own.py"
    own.write_text(OWN_EFFECT)
    asked = run(command, "evaluate", "log.mcap", "--robot", "d3-1200", "--effects", own, folder=tmp_path)
    assert asked.returncode == 0, asked.stderr


def test_its_demo_runs(installed_wheel: Path) -> None:
    shown = run(installed_wheel / "empty" / "bin" / "deltatwin", "demo", "--out", "shown", folder=installed_wheel)
    assert shown.returncode == 0, shown.stderr
    assert (installed_wheel / "shown" / "demo.html").exists()


def test_the_version_is_that_of_the_tag(tmp_path: Path) -> None:
    """And one that is stated where there is no history, as in an archive of the sources."""
    uv, git = shutil.which("uv"), shutil.which("git")
    if uv is None or git is None:
        pytest.skip("needs uv and git")
    folder = tmp_path / "sources"
    folder.mkdir()
    for name in (".ci", "deltatwin", "pyproject.toml", "README.md", "LICENSE"):
        copy = shutil.copytree if (REPOSITORY / name).is_dir() else shutil.copy
        copy(REPOSITORY / name, folder / name)
    for room in ROOMS:
        (folder / room).mkdir()
    version = re.search(r'^fallback-version = "(.*?)"', (folder / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    assert version
    for tag in (None, "v1.2.3"):
        if tag:
            for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "all"], ["tag", tag]):
                run(git, "-c", "user.name=t", "-c", "user.email=t@example.org", *words, folder=folder)
        built = run(uv, "build", "--wheel", "--offline", "--out-dir", tmp_path / str(tag), folder=folder)
        if built.returncode and "network" in built.stderr.lower():
            pytest.skip("needs the build backend (hatchling) in uv's cache, or the network")
        (wheel,) = (tmp_path / str(tag)).glob("*.whl")
        assert wheel.name.split("-")[1] == (tag or "v" + version[1]).removeprefix("v")


def only_imports_differ(packed: zipfile.ZipFile) -> None:
    """Line by line the wheel's modules are the repository's, but for what rooms import of each other."""
    for name in filter(lambda name: name.endswith(".py"), packed.namelist()):
        inner = name.removeprefix("deltatwin/")
        source = REPOSITORY / (inner if inner.split("/")[0] in ROOMS else name)
        ours, theirs = source.read_text(encoding="utf-8"), packed.read(name).decode()
        changed = [pair for pair in zip(ours.splitlines(), theirs.splitlines(), strict=True) if pair[0] != pair[1]]
        for before, after in changed:
            assert re.sub(rf"\bdeltatwin\.({'|'.join(ROOMS)})\b", r"\1", after, count=1) == before
        for node in ast.walk(ast.parse(theirs)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [one for one in names if one.split(".")[0] in ROOMS], name
