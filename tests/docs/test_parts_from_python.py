"""What the documentation shows of Python runs as it stands there."""

from __future__ import annotations

import re
from typing import Any, get_args

import numpy as np

from schemas.diagnosis import Verdict
from tests.conftest import REPOSITORY


def test_the_example_from_python_runs() -> None:
    page = (REPOSITORY / "docs" / "how-to" / "parts-from-python.md").read_text(encoding="utf-8")
    code = "".join(re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL))
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["trace"].torque.shape[1] == 3
    assert found["mass"].max() > 0.5  # the demo's log carries products
    assert np.isfinite(found["torque"]).all()
    identified = found["fitted"].robot.identified
    assert identified.rho_2.value > found["robot"].identified.rho_2.value  # products taken for the robot's own weight
    assert found["found"].verdict in get_args(Verdict)
    assert len(found["gap"]) == 3
    assert 0.1 < max(found["gap"]) < found["trace"].torque.std()
    assert all(rms.shape == (3,) and rms.max() < found["trace"].torque.std() for rms in found["rms"].values())
