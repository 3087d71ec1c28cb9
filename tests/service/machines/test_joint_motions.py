"""Motions of axes and arms stay within limits, and what is simulated along them identifies to what it was made of."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.axes_description import Axes, load_axes
from schemas.chain_description import Chain
from service.cli.main import app
from service.machines import machine_of
from service.machines.joint_motions import limits_of, most_telling, multisine
from service.model.description import base_of
from tests.service import arm

KNOWN = (
    'name = "a"\nkind = "axes"\n[[axis]]\n[[axis]]\ngravity = false\n'
    "[identified]\ninertia = { value = [0.4, 0.2] }\noffset = { value = [0.3, -0.5] }\n"
    "gravity_sin = { value = [3.0, 0.0] }\ngravity_cos = { value = [-1.0, 0.0] }\n"
    "viscous_friction = { value = [0.5, 0.8] }\ncoulomb_friction = { value = [1.0, 0.6] }\nfriction_transition = 0.01\n"
)


def run(command: str, *words: object) -> str:
    result = CliRunner().invoke(app, [command, *map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_motion_keeps_the_limits_of_the_urdf_and_those_given(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    chain = load_axes(arm.write(tmp_path))
    assert isinstance(chain, Chain)
    machine = machine_of(chain)
    limits, missing = limits_of(machine, None, 8.0, 60.0)
    assert missing == []
    assert limits.speed.tolist() == [9, 9, 9]
    for seed in range(3):
        found = multisine(machine, base_of(chain), limits, 6.0, 2e-3, np.random.default_rng(seed))
        assert (np.abs(found.theta_dot) <= 9).all()
        assert (np.abs(found.theta_ddot) <= 8.0 + 1e-9).all()
        assert (np.abs(found.theta) < 3).all()
        assert np.abs(arm.torque(found.theta, found.theta_dot, found.theta_ddot)).max() < 61
        ends = [0, -1]
        assert np.abs(found.theta_dot[ends]).max() == np.abs(found.theta_ddot[ends]).max() == 0.0
        step = 2e-3
        np.testing.assert_allclose(np.gradient(found.theta, step, axis=0)[5:-5], found.theta_dot[5:-5], atol=2e-3)
        np.testing.assert_allclose(np.gradient(found.theta_dot, step, axis=0)[5:-5], found.theta_ddot[5:-5], atol=5e-2)


def test_the_best_of_many_motions_tells_more_than_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(KNOWN)
    axes = load_axes(tmp_path / "a.toml")
    machine = machine_of(axes)
    limits, _ = limits_of(machine, 1.0, 5.0, None)
    (_, one), (_, many) = (most_telling(machine, base_of(axes), limits, 6.0, 4e-3, 7, tries) for tries in (1, 12))
    assert np.log(many).sum() < np.log(one).sum() - 1.0


def test_what_is_simulated_identifies_to_what_it_was_made_of(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(KNOWN)
    logs = [tmp_path / f"{seed}.csv" for seed in range(2)]
    for seed, log in enumerate(logs):
        said = run(
            "simulate", "--robot", tmp_path / "a.toml", "--motion", "multisine", "--seed", seed, "--out", log,
            "--duration", 10, "--max-speed", 3, "--max-acceleration", 12,
        )  # fmt: skip
        assert "tracking error" in said
    (tmp_path / "plain.toml").write_text(KNOWN.partition("[identified]")[0])
    run("identify", *logs, "--robot", tmp_path / "plain.toml", "--out", tmp_path / "found.toml")
    found = load_axes(tmp_path / "found.toml")
    assert isinstance(found, Axes)
    assert found.identified is not None
    assert found.identified.inertia.value == pytest.approx([0.4, 0.2], rel=0.03)
    assert found.identified.gravity_sin is not None
    assert found.identified.gravity_sin.value[0] == pytest.approx(3.0, rel=0.02)
    assert found.identified.coulomb_friction.value == pytest.approx([1.0, 0.6], rel=0.06)
    assert found.identified.viscous_friction.value == pytest.approx([0.5, 0.8], rel=0.08)


def test_plan_motion_asks_for_limits_and_its_motion_can_be_simulated(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(KNOWN)
    words = ["plan-motion", "--robot", str(tmp_path / "a.toml"), "--for", "identify", "--duration", "5"]
    words += ["--out", str(tmp_path / "m.csv")]
    refused = CliRunner().invoke(app, words)
    asked = "--max-speed (1 rad/s assumed), --max-acceleration (5 rad/s^2 assumed)"
    assert f"no limit is given for {asked}" in str(refused.exception)
    told = json.loads(run(words[0], *words[1:], "--max-speed", 2, "--max-acceleration", 9, "--json"))
    assert told["assumed"] == []
    table = run(*words, "--max-speed", 2, "--max-acceleration", 9)
    for said in (r"for torque noise of 0\.\d+ N m", r"up to [\d.]+ rad/s, [\d.]+ rad/s\^2, [\d.]+ N m\n"):
        assert re.search(said, table), said
    assert set(told["std_errors"]) >= {"inertia_1", "gravity_sin_1", "f_c_2"}
    said = run(
        "simulate", "--robot", tmp_path / "a.toml", "--motion", tmp_path / "m.csv", "--out", tmp_path / "log.csv"
    )
    assert "4.999 s" in said
