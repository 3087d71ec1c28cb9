"""A kernel must not outlive the sources it was compiled from."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]


def run(folder: Path) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    code = "from service.caller import ask; print(ask())"
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout.strip()


def test_a_change_in_a_called_file_recompiles_its_callers(tmp_path):
    (tmp_path / "schemas").mkdir()
    shutil.copy(PROJECT / "schemas" / "__init__.py", tmp_path / "schemas")
    room = tmp_path / "service"
    room.mkdir()
    (room / "__init__.py").touch()
    header = "from numba import njit\nimport schemas\n"
    (room / "caller.py").write_text(
        f"{header}from service.called import answer\n\n@njit(cache=True)\ndef ask():\n    return answer()\n"
    )
    (room / "called.py").write_text(f"{header}\n@njit(cache=True)\ndef answer():\n    return 1\n")
    assert run(tmp_path) == "1"
    (room / "called.py").write_text(f"{header}\n@njit(cache=True)\ndef answer():\n    return 2\n")
    assert run(tmp_path) == "2"
