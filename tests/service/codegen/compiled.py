"""An exported folder with its library, as a user makes it."""

from __future__ import annotations

import subprocess
from pathlib import Path

from typer.testing import CliRunner

from service.cli.main import app
from tests.service.codegen.built import COMPILER


def compiled(robot: Path, folder: Path, rate: float, *more: str, optimised: str = "-O2") -> Path:
    """The library of what `deltatwin export --to c` writes."""
    arguments = ["export", str(robot), "--to", "c", "--rate", f"{rate:g}", "--out", str(folder), *more]
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 0, f"{told.output} {told.exception}"
    path, flags = folder / "libtwin.so", [optimised, "-std=c99", "-ffp-contract=off", "-fPIC", "-shared"]
    subprocess.run([COMPILER or "gcc", *flags, str(folder / "deltatwin.c"), "-o", str(path), "-lm"], check=True)
    return path
