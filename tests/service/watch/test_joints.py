"""The watch over an arm and over servo axes: what comes on is told, on the bus too, and nothing else."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from drivers.trace import read_trace
from schemas.axes_description import Axes, Description, load_description, save_description
from schemas.chain_description import Chain
from schemas.messages import JOINT_SAMPLE, LOAD, OF_JOINTS, FindingVerdict, HealthFlag, Role, WatchState
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.model.hypothesis import Hypothesis
from service.model.scene import Scene
from service.model.torque import predict
from service.monitor.monitor_node import Monitor
from service.monitor.readback import read_recording
from service.monitor.writer import WriterThread
from service.watch import live_gap, watch_node
from service.watch.changed_effect import ToolLoad
from service.watch.examine import examine
from service.watch.kept import EARLY_ARM_S, Kept
from service.watch.state_machine import RISEN, Patience, Rise, Watch
from service.watch.watch_node import Examination, WatchNode
from tests.service import arm
from tests.service.sines import sines
from tests.service.watch.logs import KNOWN

PERIOD, ONSET, SECONDS = 4e-3, 18.0, 34.0
PATIENCE = Patience(learn=8.0, after=9.0)
KILOGRAM = arm.LINK.format(name="tool", xyz="0 0 0", mass=1, ixx=0.006, iyy=0.006, izz=0.006)
PARTS = ((0.9, 0.25), (0.35, 0.8), (0.08, 2.1))
LONGEST_S = 240.0  # of a diagnosis beside other work


def _stream(seed: int, seconds: float = SECONDS) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """(N,) s, angle, speed, acceleration (N, 3), and (N, 1) whether the change is at work."""
    clock = np.arange(round(seconds / PERIOD)) * PERIOD
    return clock, sines(seed, clock, PARTS), (clock >= ONSET)[:, None]


def _axes_log(seed: int, coulomb_2: float = 0.0, unit: float = 1.0, seconds: float = SECONDS) -> Trace:
    """Two axes, one of them a pendulum. coulomb_2: that comes on. unit: of position and torque, 0.1 for linear axes."""
    clock, signals, late = _stream(seed, seconds)
    q, v, a = (signal[:, :2] for signal in signals)
    torque = a * (0.4, 0.25) + v * (0.8, 0.5) + np.tanh(v / 0.01) * (1.5, 1.0)
    if unit == 1.0:
        torque[:, 0] += 3.0 * np.sin(q[:, 0])
    torque[:, 1:] += late * coulomb_2 * np.tanh(v[:, 1:] / 0.01)
    torque += np.random.default_rng(seed).normal(0, 0.02, q.shape)
    return Trace(Path(f"run_{seed}.csv"), clock, q * unit, torque, angular=unit == 1.0)


@cache
def _axes(unit: str) -> Description:
    described = Axes.model_validate({"name": "bench", "kind": "axes", "axis": [{"unit": unit}] * 2})
    scale = 1.0 if unit == "rad" else 0.1
    return identify_axes(described, [_axes_log(seed, unit=scale, seconds=12.0) for seed in range(2)]).robot


def _arm_log(change: str) -> Trace:
    pytest.importorskip("pinocchio")
    clock, signals, late = _stream(7)
    needed = arm.torque(*signals)
    if change == "load":
        loaded = arm.torque(*signals, urdf=arm.URDF.replace('<link name="tool"/>', KILOGRAM))
        needed = np.where(late, loaded, needed)
    rubs = np.array(arm.COULOMB) * np.where(late & (change == "friction"), (1.0, 1.5, 1.0), 1.0)
    needed = needed + signals[2] * arm.ROTOR + signals[1] * arm.VISCOUS + np.sign(signals[1]) * rubs + arm.OFFSET
    return Trace(Path("bus"), clock, signals[0], needed + np.random.default_rng(1).normal(0, arm.NOISE, needed.shape))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Description:
    """The identified arm."""
    pytest.importorskip("pinocchio")
    folder = tmp_path_factory.mktemp("small")
    robot = load_description(arm.write(folder))
    assert isinstance(robot, Chain)
    logs = [read_trace(arm.record(folder / f"log_{seed}.csv", seed), robot) for seed in range(2)]
    save_description(identify_axes(robot, logs).robot, folder / "known.toml")
    return load_description(folder / "known.toml")


def through(robot: Description, trace: Trace) -> tuple[np.ndarray, Rise | None]:
    """The messages of a watch, and the first rise."""
    watch, samples, told, rise = Watch(robot, PATIENCE), trace.samples(JOINT_SAMPLE), [], None
    for k in range(0, len(samples), 125):
        told += watch.add(samples[k : k + 125])
        rise = rise or watch.rise()
    return np.concatenate(told), rise


@pytest.mark.parametrize("machine", ["delta", "rad", "m", "small"])
def test_what_a_look_needs_is_compiled_before_the_first_sample(
    machine: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """A look whose robot moves predicts its torque; one that stands still compiles nothing, and the next one has to."""
    robot = KNOWN if machine == "delta" else request.getfixturevalue("small") if machine == "small" else _axes(machine)
    predicted: list[Hypothesis] = []

    def noted(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
        predicted.append(hypothesis)
        return predict(scene, hypothesis)

    monkeypatch.setattr(live_gap, "predict", noted)
    watch = Watch(robot)
    watch.warm_up()
    assert predicted
    assert watch.learnt == 0.0
    assert watch.state == WatchState.LEARNING


@pytest.mark.parametrize("unit", ["rad", "m"])
def test_unchanged_axes_raise_no_alarm(unit: str) -> None:
    told, rise = through(_axes(unit), _axes_log(5, unit=1.0 if unit == "rad" else 0.1))
    assert rise is None
    assert {WatchState(int(state)) for state in told["state"]} == {WatchState.LEARNING, WatchState.WATCHING}
    steady = told[told["state"] == WatchState.WATCHING]
    assert (steady["joints"] == 2).all()
    assert (steady["ratio"][:, :2] < RISEN).all()
    assert (steady["gap"][:, :2] > 0).all()
    for name in ("gap", "floor", "level", "ratio", "trend"):
        assert (told[name][:, 2:] == 0).all(), name


@pytest.mark.parametrize("unit", ["rad", "m"])
def test_friction_of_an_axis_that_comes_on_is_named(unit: str) -> None:
    robot = _axes(unit)
    _, rise = through(robot, _axes_log(5, coulomb_2=0.4, unit=1.0 if unit == "rad" else 0.1))
    assert rise is not None
    assert rise.joints.tolist() == [False, True]
    assert rise.since == pytest.approx(ONSET, abs=1.5)
    finding = examine(robot, rise, ())
    (found,) = finding.diagnosis.effects
    assert (found.name, found.joints) == ("friction_level", [2])
    after, left = (np.sqrt(np.mean(np.square(values))) for values in (finding.after_nm, finding.left_nm))
    assert f"reduces the gap from {after:.3g} to {left:.3g} {finding.diagnosis.gap.unit} rms" in finding.text
    assert found.parameters["coulomb"].value == pytest.approx(0.4, rel=0.05)
    assert found.parameters["coulomb"].unit == ("N m" if unit == "rad" else "N")


def test_friction_of_an_arm_that_comes_on_is_named(small: Description) -> None:
    _, rise = through(small, _arm_log("friction"))
    assert rise is not None
    assert rise.joints.tolist() == [False, True, False]
    finding = examine(small, rise, ())
    (found,) = finding.diagnosis.effects
    assert (found.name, found.joints) == ("friction_level", [2])
    assert found.parameters["coulomb"].value == pytest.approx(0.5 * arm.COULOMB[1], rel=0.03)
    assert finding.text.startswith("small: gap of joint 2 higher since")


def test_a_load_that_comes_on_an_arm_is_named(small: Description) -> None:
    _, rise = through(small, _arm_log("load"))
    assert rise is not None
    assert rise.since == pytest.approx(ONSET, abs=1.5)
    (found,) = examine(small, rise, ()).diagnosis.effects
    assert (found.name, found.joints) == (ToolLoad.name, [])
    assert found.parameters["mass"].value == pytest.approx(1.0, rel=0.05)


def test_an_unchanged_arm_raises_no_alarm(small: Description) -> None:
    told, rise = through(small, _arm_log("nothing"))
    assert rise is None
    assert WatchState.RAISED not in {WatchState(int(state)) for state in told["state"]}


def test_what_an_arm_picks_up_is_left_out_from_before_the_estimator_tells_it(small: Description) -> None:
    """It takes a second of motion to see a pick."""
    kept, samples = Kept(small), _arm_log("nothing").samples(JOINT_SAMPLE)
    loads = LOAD.empty(len(samples))
    for name in ("stamp_sec", "stamp_nanosec"):
        loads[name] = samples[name]
    clock = np.arange(len(samples)) * PERIOD
    loads["mass"], loads["mass_random"] = np.where((clock > 12.0) & (clock < 15.0), 0.8, 0.0), 0.01
    for k in range(0, len(samples), 125):
        kept.add(samples[k : k + 125])
        kept.carry(loads[k : k + 125])
    trace = kept.trace(0.0, SECONDS, "bus")
    loaded = trace.time[trace.flags != 0]
    assert loaded.min() == pytest.approx(12.0 - EARLY_ARM_S, abs=0.15)
    assert loaded.max() == pytest.approx(15.0, abs=0.15)


def test_a_change_of_an_axis_is_found_published_stored_and_recorded(
    bus_folder: Path, tmp_path: Path, until: Callable[[Callable[[], bool]], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch_node, "NICENESS", 0)  # beside other tests it would hardly ever be its turn
    robot, description, recording, said = _axes("rad"), tmp_path / "known.toml", tmp_path / "run.mcap", []
    save_description(robot, description)
    samples = _axes_log(5, coulomb_2=0.4).samples(JOINT_SAMPLE)
    writer = WriterThread(recording, robot.name, topics=OF_JOINTS)
    with (
        open_bus(robot.name, Role.ROBOT) as source_bus,
        open_bus(robot.name, Role.MONITOR) as monitors,
        open_bus(robot.name, Role.WATCH) as watching,
    ):
        source = source_bus.publisher(OF_JOINTS.sample)
        monitor = Monitor(monitors, writer, HealthFlag(0), OF_JOINTS)
        examination = partial(Examination, description, None, tmp_path / "found")
        role = WatchNode(Watch(robot, PATIENCE), watching, examination, said.append)
        until(lambda: {Role.ROBOT, Role.MONITOR} <= watching.alive)
        until(lambda: source.wait_until_heard(1.0))
        with role.health:
            for k in range(0, len(samples), 125):
                for sample in samples[k : k + 125]:
                    source.put(sample.tobytes())
                monitor.step()
                role.step()
                time.sleep(0.01)
            assert any("gap has risen" in line for line in said), said
            give_up = time.monotonic() + LONGEST_S
            while not any("friction level" in line for line in said):
                assert time.monotonic() < give_up, said
                monitor.step()
                role.step()
                time.sleep(0.05)
            role.close()
        until(lambda: (monitor.step(), monitor.tally.received[OF_JOINTS.finding] == 1)[-1])
    writer.close()
    assert role.counts()["received"] + role.counts()["lost"] == len(samples)
    recorded = read_recording(recording)
    gap, (finding,) = recorded[OF_JOINTS.gap].records, recorded[OF_JOINTS.finding].records
    assert {WatchState.LEARNING, WatchState.RAISED} <= {WatchState(int(state)) for state in gap["state"]}
    assert finding["verdict"] in (FindingVerdict.EXPLAINED, FindingVerdict.PARTLY_EXPLAINED)
    assert (finding["joints"], finding["count"]) == (0b10, 2)
    assert bytes(finding["effect"]).rstrip(b"\0") == b"friction_level"
    assert (finding["before"][2:] == 0).all()
    (folder,) = (tmp_path / "found").iterdir()
    assert json.loads((folder / "finding.json").read_text())["text"] in said[-1]
    assert read_trace(folder / "after.mcap", robot).position.shape[1] == 2
