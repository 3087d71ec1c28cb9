"""A robot and a clean trace file to spoil."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def robot_text() -> str:
    return """name = "d3"
[geometry]
active_link_length = 0.38
passive_link_length = 0.86
base_radius = 0.22
platform_radius = 0.05
[mass]
active_link = 2.6
passive_link = 0.6
platform = 1.4
[drive]
gear_ratio = 5
"""


@pytest.fixture
def own_csv(tmp_path: Path) -> Path:
    """200 rows of our own CSV at 1 kHz with five decimals; row k stands on line k + 2."""
    time = np.arange(200) / 1000
    position = 0.6 * np.sin(2 * np.pi * 2 * time)[:, None] + [0.1, 0.2, 0.3]
    torque = 10 * np.cos(2 * np.pi * 2 * time)[:, None] + [1, 2, 3]
    names = [f"position_{j}_rad" for j in (1, 2, 3)] + [f"torque_{j}_nm" for j in (1, 2, 3)]
    lines = [",".join(["time_s", *names])]
    lines += [",".join(f"{v:.5f}" for v in (t, *p, *m)) for t, p, m in zip(time, position, torque, strict=True)]
    path = tmp_path / "own.csv"
    path.write_text("\n".join(lines) + "\n")
    return path
