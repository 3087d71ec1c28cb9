"""One diagnosis, made once, that several tests look at."""

from __future__ import annotations

import pytest

from tests.service.diagnosis.reference import run
from tests.service.subject import diagnose


@pytest.fixture(scope="session")
def findings() -> diagnose.Findings:
    """Three logs of a robot with friction that Stribeck described and a cogging motor."""
    return run()
