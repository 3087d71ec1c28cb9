"""Every command on every kind of machine: it works, or one line names what there is not for that kind."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.bus import open_bus
from drivers.trace import read_trace
from replay.process import process
from schemas.axes_description import load_description
from schemas.errors import UnansweredError
from schemas.messages import Role
from service.cli.main import app, summaries
from service.monitor.readback import read_recording
from service.supervisor import Supervisor
from tests.service import arm
from tests.service.sines import sines

pytest.importorskip("pinocchio")
KINDS = ("axes", "chain")
WITHOUT_A_MACHINE = {
    "blindtest", "demo", "doctor", "ethercat-demo", "experiment", "import", "init", "keys", "latency", "recover",
    "verify",
}  # fmt: skip
ON_THE_BUS = {"replay", "estimate", "monitor", "top", "watch"}  # processes of their own, see the last test
# of each command its words after the name; what it says where a kind has no answer, None: it works
FIELDBUS, CODE = "EtherCAT drives", "code for a controller"
TABLE: dict[str, tuple[str, dict[str, str | None]]] = {
    "identify": ("{log} {other} --robot {plain} --out {out}.toml", {}),
    "evaluate": ("{log} --robot {robot}", {}),
    "inspect": ("{log} --robot {robot}", {}),
    "convert": ("{log} {out}.csv --robot {robot}", {}),
    "diagnose": ("{log} {other} --robot {plain} --out {out}", {}),
    "payload": ("{log} --robot {robot}", {"axes": "load on a frame"}),
    "rollout": ("{log} --robot {robot}", {}),
    "rollout --commands": ("{log} --robot {robot}", dict.fromkeys(KINDS, "position commands through drives")),
    "fleet": ("{days} --robot {plain} --out {out}", {}),
    "plan-motion --for identify": ("--robot {robot} --out {out}.csv --assume-limits", {}),
    "plan-motion": (
        "--robot {robot} --out {out}.csv --diagnosis {days}",
        dict.fromkeys(KINDS, "separates alternative models"),
    ),
    "simulate": ("--robot {robot} --motion multisine --duration 4 --out {out}.csv", {}),
    "simulate --motion pick": ("--robot {robot} --out {out}.csv", dict.fromkeys(KINDS, "pick-and-place")),
    "simulate --live": ("--robot {robot}", dict.fromkeys(KINDS, "closed loop on the bus")),
    "export --to mjcf": ("{robot} --out {out}.xml", {}),
    "export --to urdf": ("{robot} --out {out}.urdf", {"axes": "URDF"}),
    "export --to c": ("{robot} --out {out}", dict.fromkeys(KINDS, CODE)),
    "export --to st": ("{robot} --out {out}", dict.fromkeys(KINDS, CODE)),
    "export --to fmu": ("{robot} --out {out}.fmu", dict.fromkeys(KINDS, CODE)),
    "export --to sheet": ("{robot} --out {out}.md", dict.fromkeys(KINDS, CODE)),
    "replay": ("{log} --robot {robot}", {}),
    "estimate": ("--robot {robot}", {}),
    "estimate --keep kept.json": ("--robot {robot}", dict.fromkeys(KINDS, "learning of friction")),
    "monitor": ("--robot {robot} --out {out}.mcap", {}),
    "watch": ("--robot {robot}", {}),
    "top": ("--robot {robot}", {}),
    "view": ("--robot {robot}", dict.fromkeys(KINDS, "view in a browser")),
    "tap": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "master": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "segment": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "closed-loop": ("--robot {robot} --out {out}", dict.fromkeys(KINDS, "closed loop")),
}
AXES = """name = "bench"
kind = "axes"
limits = { torque = [20.0, 10.0], speed = [6.0, 6.0] }
[[axis]]
[[axis]]
gravity = false
"""


def _axes(folder: Path) -> Path:
    """Two axes, one of them a pendulum."""
    for seed in range(2):
        time = np.arange(4000) * 4e-3
        q, v, a = (signal[:, :2] for signal in sines(seed, time, ((1.1, 0.2), (0.35, 0.7))))
        torque = a * (0.4, 0.25) + v * (0.8, 0.5) + np.sign(v) * (1.5, 1.0)
        torque[:, 0] += 3.0 * np.sin(q[:, 0])
        torque += np.random.default_rng(seed).normal(0, 0.02, q.shape)
        header = "time_s,position_1_rad,position_2_rad,torque_1_nm,torque_2_nm"
        table = np.column_stack([time, q, torque])
        np.savetxt(folder / f"log_{seed}.csv", table, "%.10g", ",", header=header, comments="")
    (folder / "bench.toml").write_text(AXES)
    return folder / "bench.toml"


def _chain(folder: Path) -> Path:
    for seed in range(2):
        arm.record(folder / f"log_{seed}.csv", seed)
    return arm.write(folder)


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    """Of each kind what stands for the braces in `TABLE`."""
    found = {}
    for kind, make in zip(KINDS, (_axes, _chain), strict=True):
        folder = tmp_path_factory.mktemp(kind)
        plain, logs, known = make(folder), [folder / "log_0.csv", folder / "log_1.csv"], folder / "identified.toml"
        made = CliRunner().invoke(app, ["identify", *map(str, logs), "--robot", str(plain), "--out", str(known)])
        assert made.exit_code == 0, made.output
        for day, log in enumerate(logs, start=1):
            target = folder / "days" / "one" / f"2026-01-0{day}" / "run.csv"
            target.parent.mkdir(parents=True)
            target.write_bytes(log.read_bytes())
        found[kind] = {"plain": plain, "robot": known, "log": logs[0], "other": logs[1], "days": folder / "days"}
    return found


def test_no_command_is_left_out() -> None:
    assert {words.split()[0] for words in TABLE} == set(summaries()) - WITHOUT_A_MACHINE


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", sorted(TABLE.keys() - ON_THE_BUS))
def test_it_works_or_one_line_names_the_question(
    command: str, kind: str, machines: dict[str, dict[str, Path]], tmp_path: Path
) -> None:
    words, unanswered = TABLE[command]
    line = [*command.split(), *words.format(**machines[kind], out=tmp_path / "out").split()]
    result = CliRunner().invoke(app, line)
    said = unanswered.get(kind)
    if said is None:
        assert result.exit_code == 0, f"{result.output}\n{result.exception!r}"
        return
    assert isinstance(result.exception, UnansweredError), f"{result.output}\n{result.exception!r}"
    text = str(result.exception)  # what `main` prints as its one line, with exit code 1
    name = {"axes": "bench", "chain": "small"}[kind]
    assert text.startswith(f"{name}: ")
    assert said in text
    assert "\n" not in text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_on_the_bus_is_answered_recorded_and_shown(
    kind: str, machines: dict[str, dict[str, Path]], tmp_path: Path, bus_folder: Path
) -> None:
    """Each role a process of its own, as a user starts them."""
    robot, run = str(machines[kind]["robot"]), tmp_path / "run.mcap"
    name = {"axes": "bench", "chain": "small"}[kind]
    with open_bus(name, Role.TAP) as bus, Supervisor(tmp_path) as crew:
        monitor = crew.start(lambda: Role.MONITOR in bus.alive, "monitor", "--robot", robot, "--out", run)
        estimator = crew.start(lambda: Role.ESTIMATOR in bus.alive, "estimate", "--robot", robot)
        top = crew.start(lambda: Role.OBSERVER in bus.alive, "top", "--robot", robot)
        watch = crew.start(
            lambda: Role.WATCH in bus.alive, "watch", "--robot", robot, "--learn", 3, "--out", tmp_path / "found"
        )
        for role in (monitor, estimator, top, watch):
            role.wait_ready()
        # at half speed: what is compared are bits, and beside other tests a role may be passed over
        crew.run("replay", machines[kind]["log"], "--robot", robot, "--wait", 20, "--speed", 0.5)
        time.sleep(1.0)  # the last answers
        crew.check()
        shown = top.log.read_text()
    recorded, log = read_recording(run), read_trace(machines[kind]["log"], load_description(robot))
    sent, answers = recorded["joint_sample"].records, recorded["joint_feedforward"].records
    assert len(sent) == len(answers) == len(log)
    np.testing.assert_array_equal(answers["sequence"], sent["sequence"])
    expected = process(load_description(robot), sent)
    for topic, records in zip(("joint_feedforward", "load", "joint_error"), expected, strict=True):
        assert recorded[topic].records.tobytes() == records.tobytes(), topic
    gap = recorded["joint_gap"].records
    assert (gap["joints"] == log.position.shape[1]).all()
    assert np.isfinite(gap["gap"][-1]).all()
    assert (gap["gap"][-1, : log.position.shape[1]] > 0).all()
    assert "torque feed-forward" in shown
    assert ("load, kg" in shown) == (kind == "chain")
    again = read_trace(run)
    np.testing.assert_array_equal(again.torque, log.torque)
