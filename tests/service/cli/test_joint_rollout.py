"""What `rollout` tells of axes and arms."""

from __future__ import annotations

import math

import pytest

from service.cli.joint_rollout import _thousandths


@pytest.mark.parametrize(("value", "told"), [(1.0234, "1020"), (0.00012345, "0.123"), (math.nan, "ran away")])
def test_a_large_error_has_no_exponent(value: float, told: str) -> None:
    assert _thousandths(value) == told
