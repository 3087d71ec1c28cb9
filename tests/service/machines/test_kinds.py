"""Kinds of machine: each answers the same questions, so that nobody asks which kind it is."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from schemas.axes_description import Axes, Axis, Description, load_description
from schemas.questions import Question
from schemas.robot import Described, load_robot
from service.estimator import online
from service.identification import of_logs, readings
from service.machines import KINDS as MACHINES
from service.machines import machine_of
from service.machines.machine import MachineModel
from service.model.mechanism import MECHANISMS, DecoupledAxes, Delta, Mechanism, SerialArm, mechanism_of
from tests.service import arm

ROOT = Path(__file__).parents[3]
PRODUCT = ("deltatwin", "drivers", "replay", "schemas", "service")
# A file's own word for its kind becomes a class there, and nowhere else.
BORDERS = ("schemas/axes_description.py", "schemas/robot.py")


@pytest.fixture(params=["delta", "axes", "chain"])
def described(request: pytest.FixtureRequest, tmp_path: Path) -> Description:
    """A description of each kind, as it is before anything was identified."""
    if request.param == "delta":
        return load_robot("d3-1200")
    if request.param == "axes":
        return Axes(name="table", kind="axes", axis=[Axis(), Axis()])
    return load_description(arm.write(tmp_path))


def _asked(kind: type) -> list[str]:
    """Questions without an argument."""
    return [name for name, value in vars(kind).items() if isinstance(value, property) and name[0] != "_"]


def test_every_description_answers_what_is_asked_of_descriptions(described: Description) -> None:
    for name in (*_asked(Described), "called", "known", "identified", "effect"):
        getattr(described, name)
    count = described.count
    assert described.motors.shape == (count, count)
    assert len(described.gear_ratios) == count
    assert len(described.travels) in (0, count)
    assert len(described.joint_names) in (0, count)
    assert described.has_joints_of(described)
    assert all(described.answering(question) in (None, described) for question in Question)


def test_every_mechanism_answers_what_is_asked_of_mechanisms(described: Description) -> None:
    mechanism = mechanism_of(described)
    for name in (name for name, value in vars(Mechanism).items() if name[0] != "_" and not inspect.isclass(value)):
        getattr(mechanism, name)
    assert mechanism.kind == described.kind
    assert mechanism.joints == described.count
    assert mechanism.platform in (None, mechanism)
    assert mechanism.tree in (None, mechanism)
    assert mechanism.direct in (None, mechanism)
    assert mechanism.closed == (mechanism.platform is not None)
    described.check_rigid([])


def test_every_machine_has_limits_of_its_joints(described: Description) -> None:
    assert all(len(values) == described.count for values in vars(machine_of(described).limits()).values())


def test_no_table_of_kinds_lacks_one() -> None:
    kinds = set(get_args(Description))
    for table in (MECHANISMS, MACHINES, of_logs._WAYS, of_logs._ASKED, readings._WAYS):
        assert set(table) == kinds
    assert {load_robot("d3-1200").topics, Axes(name="a", kind="axes", axis=[Axis()]).topics} == set(online._WAYS)


def kinds_asked(source: str, classes: set[str], words: set[str]) -> Iterator[int]:
    """Lines of a module that ask which kind of machine something is, by its class or by its word."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, kind]):
                names = {getattr(one, "id", getattr(one, "attr", "")) for one in ast.walk(kind)}
            case ast.MatchClass(cls=kind):
                names = {getattr(kind, "id", getattr(kind, "attr", ""))}
            case ast.Compare():
                names = {one.value for one in ast.walk(node) if isinstance(one, ast.Constant)}
            case _:
                continue
        if names & (words if isinstance(node, ast.Compare) else classes):
            yield node.lineno


def test_nobody_asks_which_kind_a_machine_is() -> None:
    """Another kind is one more class, and not one more branch wherever it is different."""
    described = {one for kind in get_args(Description) for one in kind.__mro__ if issubclass(one, Described)}
    mechanisms = {one for kind in (Delta, DecoupledAxes, SerialArm) for one in kind.__mro__[:-1]}
    machines = {*MACHINES.values(), MachineModel}
    classes = {kind.__name__ for kind in described | mechanisms | machines} - {"Described", "MachineModel"}
    words = {"delta", "axes", "chain"}
    assert list(kinds_asked('isinstance(x, Robot | Axes)\nx.kind == "delta"\nx == "other"\n', classes, words)) == [1, 2]
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for room in PRODUCT
        for path in sorted((ROOT / room).rglob("*.py"))
        if path.relative_to(ROOT).as_posix() not in BORDERS
        for line in kinds_asked(path.read_text(encoding="utf-8"), classes, words)
    ]
    assert found == []
