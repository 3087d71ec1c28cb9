"""What a bench needs of the machine; where it is missing, one line says so and the bench ends."""

from __future__ import annotations

import os
import shutil
import sys

PACKAGES = {"cyclictest": "rt-tests", "ip": "iproute2"}


def need(*tools: str, root: bool = False) -> None:
    """End the bench unless all `tools` are installed and, with `root`, it runs as root."""
    missing = [f"{tool} (package {PACKAGES[tool]})" for tool in tools if shutil.which(tool) is None]
    if root and os.geteuid() != 0:
        missing.append("root (sudo)")
    if missing:
        print(f"skipped: needs {', '.join(missing)}", file=sys.stderr)
        sys.exit(0)
