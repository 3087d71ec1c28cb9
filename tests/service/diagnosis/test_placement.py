"""What goes as well with a joint elsewhere than the URDF has it is no effect of the joint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.axes_description import load_axes
from service.diagnosis.documents.text import caution
from service.diagnosis.evidence import placement
from service.diagnosis.evidence.placement import Placement
from service.diagnosis.findings import Findings
from service.diagnosis.pipeline import diagnose
from service.model.effects import catalogue
from service.model.effects.base import Amplitude, Effect
from service.model.scene import Scene
from tests.service import arm

pytest.importorskip("pinocchio")
ELSEWHERE = arm.URDF.replace('xyz="0.05 0 0.1"', 'xyz="0.09 0 0.1"')


@dataclass(frozen=True)
class StandIn(Effect):
    """What the arm asks for whose second joint is 40 mm further out, by MuJoCo, under another name."""

    a: Amplitude = Amplitude("", "of the torque")
    name = "stand_in"
    per_joint = False
    own_joint = False
    kinds = frozenset({"chain"})
    settles = "nothing"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        motion = scene.segment
        moved = [motion.theta, motion.theta_dot, motion.theta_ddot]
        return (arm.torque(*moved, urdf=ELSEWHERE) - arm.torque(*moved))[..., None]


def found(folder: Path, urdf: str, monkeypatch: pytest.MonkeyPatch) -> Findings:
    """Of four runs with friction on joint 2 that grows with the square of speed, the arm's links as `urdf` has them."""
    monkeypatch.setattr(arm, "SECONDS", 6.0)
    monkeypatch.setattr(arm, "COULOMB", (0.02, 0.02, 0.02))  # which jumps between two samples
    logs = []
    for seed in range(4):
        speed = arm.motion(seed)[1][1][:, 1]
        drag = np.zeros((len(speed), 3))
        drag[:, 1] = 0.3 * speed * np.abs(speed)
        logs.append(arm.record(folder / f"log_{seed}.csv", seed, drag, urdf=urdf))
    robot = load_axes(arm.write(folder))
    drag_effect = next(effect for effect in catalogue() if effect.name == "nonlinear_viscous_friction")
    return diagnose(robot, [read_trace(log, robot) for log in logs], [drag_effect, StandIn()])


def test_what_a_wrong_urdf_explains_as_well_is_not_named(tmp_path, monkeypatch) -> None:
    told = found(tmp_path, ELSEWHERE, monkeypatch)
    assert told.best.names == ("nonlinear_viscous_friction",)
    codes = {(one.code, one.effect): one for one in told.cannot_tell}
    assert ("rivalled", "stand_in") in codes
    where = codes["misplaced", None]
    assert where.joints == [2]
    assert where.share is not None
    assert 0.3 < where.share <= 1.0
    assert "joint 2" in caution(where)


def test_a_joint_is_elsewhere_by_as_much_as_a_urdf_may_be_off(tmp_path, monkeypatch) -> None:
    """40 mm are two standard deviations of 20 mm, and out of reach of a nanometre."""
    told = found(tmp_path, ELSEWHERE, monkeypatch)
    gap = told.best.loss - told.problem.count
    assert Placement(told.problem, told.split, told.best).beside(told.best) - told.problem.count < 0.05 * gap
    monkeypatch.setattr(placement, "OFF_M", 1e-9)
    monkeypatch.setattr(placement, "OFF_RAD", 1e-9)
    known = Placement(told.problem, told.split, told.best)
    assert known.beside(told.best) == pytest.approx(told.best.loss, rel=1e-3)


def test_a_right_urdf_takes_no_name(tmp_path, monkeypatch) -> None:
    told = found(tmp_path, arm.URDF, monkeypatch)
    assert told.best.names == ("nonlinear_viscous_friction",)
    assert "misplaced" not in {one.code for one in told.cannot_tell}
