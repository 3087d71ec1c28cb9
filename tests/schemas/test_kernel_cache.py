"""A kernel must not outlive the sources it was compiled from."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

from schemas import KERNEL_ROOMS

PROJECT = Path(__file__).resolve().parents[2]
ROOMS = ("drivers", "replay", "schemas", "service")


def run(folder: Path) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    code = "from service.model.caller import ask; print(ask())"
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout.strip()


def test_a_change_in_a_called_file_recompiles_its_callers(tmp_path):
    (tmp_path / "schemas").mkdir()
    shutil.copy(PROJECT / "schemas" / "__init__.py", tmp_path / "schemas")
    room = tmp_path / "service" / "model"
    room.mkdir(parents=True)
    (tmp_path / "service" / "__init__.py").touch()
    (room / "__init__.py").touch()
    header = "from numba import njit\nimport schemas\n"
    (room / "caller.py").write_text(
        f"{header}from service.model.called import answer\n\n@njit(cache=True)\ndef ask():\n    return answer()\n"
    )
    (room / "called.py").write_text(f"{header}\n@njit(cache=True)\ndef answer():\n    return 1\n")
    assert run(tmp_path) == "1"
    (room / "called.py").write_text(f"{header}\n@njit(cache=True)\ndef answer():\n    return 2\n")
    assert run(tmp_path) == "2"


def imported(path: Path) -> set[Path]:
    """Our own files that `path` imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            if name.split(".")[0] in ROOMS:
                stem = PROJECT / Path(*name.split("."))
                found |= {p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.exists()}
    return found


def test_all_that_kernels_are_made_of_is_in_the_digest():
    sources = [path for room in ROOMS for path in (PROJECT / room).rglob("*.py")]
    reached, ahead = set(), {path for path in sources if "njit" in path.read_text()}
    while ahead:
        path = ahead.pop()
        reached.add(path)
        ahead |= imported(path) - reached
    strangers = [
        str(path.relative_to(PROJECT))
        for path in sorted(reached)
        if not any(path.is_relative_to(PROJECT / room) for room in KERNEL_ROOMS)
        and path != PROJECT / "service" / "__init__.py"
    ]
    assert not strangers
