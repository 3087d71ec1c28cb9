"""What has changed, told from a before and an after of one production motion."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.trace import Trace
from service.watch.examine import examine
from service.watch.state_machine import Rise
from tests.service.subject import EFFECTS
from tests.service.watch.logs import KNOWN, log, motion, rest_of
from tests.service.world import VISCOUS

SOME = tuple(EFFECTS[name] for name in ("stribeck_friction", "torque_offset", "joint_spring", "torque_scale"))


def test_a_change_of_friction_is_named_as_one_and_measured() -> None:
    before, after = motion(7.0), rest_of(motion(14.0), 7.0)
    worn = after.torque.copy()
    worn[:, 2] += 0.4 * VISCOUS[2] * after.motion[1][:, 2]
    case = Rise(7.0, np.array([False, False, True]), log(before, before.torque), log(after, worn, seed=1))
    finding = examine(KNOWN, case, SOME)
    (effect,) = finding.diagnosis.effects
    assert (effect.name, effect.joints) == ("friction_level", [3])
    assert effect.parameters["viscous"].value == pytest.approx(0.4 * VISCOUS[2], rel=0.1)
    assert abs(effect.parameters["coulomb"].value) < 0.1
    assert finding.compared
    assert finding.after_nm[2] > 2 * finding.before_nm[2]
    assert finding.left_nm[2] == pytest.approx(finding.before_nm[2], rel=0.1)
    assert "friction level in joint 3" in finding.text


def test_where_the_positions_jump_is_left_out() -> None:
    """As where a log is played round and round."""
    after = motion(10.0)
    worn = after.torque + [0.0, 0.0, 3.0]
    whole = log(after, worn)
    rows = np.r_[2000:5000, 0:4000, 1000:5000]
    position, torque = whole.position[rows], whole.torque[rows]
    jumps = Trace(whole.path, 1e-3 * np.arange(len(rows)), position, torque, position_command=position)
    finding = examine(KNOWN, Rise(0.0, np.array([False, False, True]), None, jumps), SOME)
    (effect,) = finding.diagnosis.effects
    assert (effect.name, effect.joints) == ("torque_offset", [3])
    assert effect.parameters["offset"].value == pytest.approx(3.0, rel=0.05)


def test_what_was_there_before_is_no_change() -> None:
    """A description that is wrong all along: the difference between before and after is nothing."""
    before, after = motion(7.0), rest_of(motion(14.0), 7.0)
    logs = [log(run, run.torque + 1.5, seed) for seed, run in enumerate((before, after))]
    finding = examine(KNOWN, Rise(7.0, np.array([True, False, False]), *logs), SOME)
    assert finding.diagnosis.effects == []
    assert finding.diagnosis.given == ["torque_offset"]
    assert "explains it" in finding.text or "within the noise" in finding.text
