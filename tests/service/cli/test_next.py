"""Every command ends with what it comes to and what comes next; a command that it proposes can be pasted and runs."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

import service.cli
from drivers.trace import read_trace, write_trace
from replay.demo import LOG, ROBOT
from schemas.robot import load_robot, save_robot
from schemas.trace import Trace
from service.cli.main import app, summaries
from service.identification.copies import distinct
from service.identification.of_logs import refusal
from tests.service import arm

ENDS = {"conclude", "say_next", "say_headline", "conclude_mjcf", "roll_out", "simulate_joints", "plan_joints", "weigh"}
FOLDER = Path(service.cli.__path__[0])
OWN = re.compile(r"[A-Z][A-Z_]+(?:\.toml)?")  # what stands for something of the user's own
SHORT, LONG = slice(0, 3000), slice(None)  # of the log: 3 s, and all of its 10 s
# Command -> what it is started with in `folder`, and of what the next one is
RUNS = {
    "init": ("--out new.toml --axes 1", "import"),
    "import": ("long.csv --robot robot.toml --yes --out again.mcap", "diagnose"),
    "inspect": ("short.csv --robot plain.toml", "evaluate"),
    "inspect long": ("long.csv --robot plain.toml", "identify"),
    "inspect twice": ("long.csv long.csv --robot plain.toml", "identify"),
    "inspect a copy": ("long.csv copy.csv --robot plain.toml", "evaluate"),
    "inspect arm": ("arm.csv --robot small.toml", "evaluate"),
    "convert": ("short.csv other.mcap --robot robot.toml", "evaluate"),
    "doctor": ("", "demo"),
    "identify": ("long.csv --robot plain.toml --out made.toml", "evaluate|diagnose"),
    "evaluate": ("short.csv --robot plain.toml", "plan-motion"),
    "evaluate long": ("long.csv --robot plain.toml", "identify"),
    "evaluate a copy": ("long.csv copy.csv --robot robot.toml", "estimate|diagnose"),
    "payload": ("short.csv --robot robot.toml", "estimate"),
    "rollout": ("short.csv --robot robot.toml --horizon 0.1", "export|diagnose|evaluate"),
    "keys": ("--hosts 127.0.0.1 --robot robot.toml --out keys", "estimate"),
    "export": ("robot.toml --to mjcf --out robot.xml", "python -m mujoco.viewer"),
    "export urdf": ("robot.toml --to urdf --out robot.urdf", ""),
    "export c": ("robot.toml --to c --out twin", "gcc"),
    "export st": ("robot.toml --to st --out plc", ""),
    "export sheet": ("robot.toml --to sheet --out sheet.md", "export"),
    "simulate": ("--robot d3-1200 --duration 2 --out out.csv", "simulate"),
    "simulate long": ("--robot d3-1200 --motion multisine --out out.csv", "identify"),
    "simulate arm": ("--robot small.toml --motion multisine --duration 1 --out out.csv", "simulate"),
    "plan-motion": ("--robot small.toml --for identify --assume-limits --duration 5 --out motion.csv", "simulate"),
    "view": ("--robot robot.toml --layout layout.json", "view"),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with descriptions and logs."""
    folder = tmp_path_factory.mktemp("next")
    robot = load_robot(ROBOT)
    shutil.copy(ROBOT, folder / "robot.toml")
    save_robot(robot.model_copy(update={"identified": None, "effect": []}), folder / "plain.toml")
    trace = read_trace(LOG, robot)
    for name, rows in (("short", SHORT), ("long", LONG), ("copy", LONG)):
        part = Trace(LOG, trace.time[rows], trace.position[rows], trace.torque[rows])
        write_trace(part, folder / f"{name}.csv")
    arm.write(folder)
    angle = 6e-3 * np.arange(1500)[:, None] + np.arange(3)
    brief = Trace(folder / "arm.csv", 1e-3 * np.arange(1500), 0.3 * np.sin(angle), 5.0 * np.cos(angle))
    write_trace(brief, brief.path)
    return folder


def calls(path: Path) -> set[str]:
    """Names of the functions that a module calls."""
    called = (node.func for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call))
    return {function.id for function in called if isinstance(function, ast.Name)}


@pytest.mark.parametrize("name", summaries())
def test_every_command_says_what_comes_next(name: str) -> None:
    path = FOLDER / f"{name.replace('-', '_')}{'_' * (name == 'import')}.py"
    assert calls(path) & ENDS, f"{name}: no conclusion"


def refuse_what_cannot_be_pasted(line: str, behind: list[str]) -> None:
    """A command that does not parse, reads what is not there, or has a word that stands for something unsaid."""
    program, name, *words = shlex.split(line)
    if program != "deltatwin":
        return
    commands: Any = get_command(app)
    command = commands.get_command(None, name)
    assert command is not None, line
    try:
        given = command.make_context(name, list(words))
    except click.exceptions.Exit:
        return  # --help
    read = [given.params.get(key) or [] for key in ("traces", "trace", "files", "logs", "robot", "source")]
    for path in (one for several in read for one in (several if isinstance(several, list | tuple) else [several])):
        named = OWN.fullmatch(str(path))
        assert named or Path(path).exists() or str(path) == "d3-1200", f"{line}: {path} is not there"
        assert not named or any(str(path) in text for text in behind), f"{line}: what is {path}?"


def ended(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, arguments: str) -> str:
    """What a command says comes next; "" if no command does."""
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, [name, *arguments.split()])
    assert done.exit_code == 0, done.output or done.exception
    lines = done.stdout.splitlines()
    at = max(number for number, line in enumerate(lines) if line.startswith("next: "))
    assert len(lines) <= at + 2, "what comes next is the last thing that is said"
    following = lines[at].removeprefix("next: ")
    if not re.match(r"deltatwin |python -m |gcc ", following):
        assert following.endswith("."), following
        return ""
    refuse_what_cannot_be_pasted(following, lines[at + 1 :])
    return following.removeprefix("deltatwin ")


@pytest.mark.parametrize("run", RUNS)
def test_what_comes_next_can_be_pasted(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: str) -> None:
    arguments, following = RUNS[run]
    shutil.copytree(made, tmp_path / "here")
    said = ended(tmp_path / "here", monkeypatch, run.split()[0], arguments)
    assert re.match(following or "$", said), said


def test_logs_are_asked_as_identify_asks_them(made: Path) -> None:
    robot = load_robot(made / "plain.toml")
    short, long, copy = (read_trace(made / f"{name}.csv", robot) for name in ("short", "long", "copy"))
    assert refusal(robot, [long]) is None
    assert "too little motion" in (refusal(robot, [short]) or "")
    assert "the same motion and torque" in (refusal(robot, [long, copy]) or "")
    assert distinct([long, copy, short]) == [long]  # the short one is the beginning of it
