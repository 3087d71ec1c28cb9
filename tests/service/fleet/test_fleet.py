"""A fleet of two robots and three days: what changed in which, since when; a run that was stopped goes on; what is
broken is told and ends nothing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from schemas.errors import StorageError
from schemas.fleet_document import Fleet
from schemas.robot import save_robot
from service.cli.main import app
from service.fleet import judge
from service.fleet.judge import Settings, survey
from service.fleet.logs import members
from service.model.effects import CATALOGUE, by_name
from tests.service.diagnosis.logs import ROBOT, record, swing
from tests.service.pages.browser import looked_at

DAYS = ("2026-01-30", "2026-01-31", "2026-02-01")
STUCK = 3.0  # N m of Stribeck friction, in one robot from the second day on
ASKED = ("stribeck_friction", "torque_offset")
FORMS = by_name(CATALOGUE)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    save_robot(ROBOT, folder / "bench.toml")
    for robot, name in enumerate(("cell_1", "cell_2")):
        for number, day in enumerate(DAYS):
            for run in range(2):
                path = folder / name / day / f"run_{run}.csv"
                path.parent.mkdir(parents=True, exist_ok=True)
                record(
                    path,
                    ROBOT,
                    swing(10 * robot + run),
                    5.0,
                    100 * robot + 10 * number + run,
                    STUCK * (robot and number > 0),
                )
    (folder / "cell_1" / DAYS[1] / "cut.csv").write_text("time_s,position_1_rad\n0.0,0.1\n")
    return folder


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fleet") / "out"


@pytest.fixture(autouse=True)
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judge, "catalogue", lambda _: tuple(FORMS[name] for name in ASKED))


def fleet(logs: Path, out: Path) -> dict:
    arguments = ["fleet", str(logs), "--robot", str(logs / "bench.toml"), "--out", str(out), "--jobs", "1", "--json"]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    assert json.loads(done.stdout) == json.loads((out / "fleet.json").read_text())
    return json.loads(done.stdout)


def test_a_run_that_was_killed_goes_on_and_says_what_changed_since_when(
    logs: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    real = judge.diagnose
    monkeypatch.setattr(
        judge,
        "diagnose",
        lambda robot, traces, *a, **k: asked.append(str(traces[0].path)) or real(robot, traces, *a, **k),
    )
    steps = iter(range(5))  # two references, three days

    def stop() -> None:
        if next(steps, None) is None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        survey(members([logs], logs / "bench.toml"), Settings(out), stop)
    before = len(asked)
    kept = sorted(out.rglob("day.json"))
    assert 3 <= len(kept) == before < 6
    kept[0].write_text(kept[0].read_text()[:200])  # a disk that lost what was written last
    (kept[1].parent / ".part-day.json").write_text("{")

    result = fleet(logs, out)
    assert len(asked) == 6 + 1  # each day once, but for the one that was spoilt
    first, second = result["robots"]
    assert [first["robot"], second["robot"]] == ["cell_1", "cell_2"]
    assert first["changes"] == []
    assert [day["verdict"] for day in first["days"]] == ["within_noise"] * 3
    (change,) = second["changes"]
    assert (change["name"], change["joints"], change["gone"]) == ("stribeck_friction", [1, 2, 3], False)
    assert (change["not_on"], change["since"], change["last"]) == DAYS
    assert (change["days"], change["of"]) == (2, 2)
    found = second["days"][2]["effects"][0]["parameters"]
    assert {name: one["value"] for name, one in found.items() if name != "v_s"} == pytest.approx(
        dict.fromkeys([name for name in found if name != "v_s"], STUCK), rel=0.05
    )
    assert second["days"][0]["gap_nm"] < 0.15 * second["days"][1]["gap_nm"]

    bad = [log for day in first["days"] for log in day["logs"] if log["error"]]
    assert [Path(log["log"]).name for log in bad] == ["cut.csv"]
    assert "'torque_1_nm' is missing" in bad[0]["error"]

    page = looked_at(out / "fleet.html")
    assert page["errors"] == page["over"] == []
    assert page["texts"] > 5
    text = (out / "fleet.html").read_text()
    assert "cell_2: stribeck friction, joints 1, 2 and 3" in text
    assert "More friction at low speed (sticking)." in text
    assert "2026-01-31 (not on 2026-01-30)" in text

    # one day anew: only that day is worked out
    changed = logs / "cell_2" / DAYS[2] / "run_1.csv"
    content = changed.read_bytes()
    changed.write_bytes(content[: content.rindex(b"\n", 0, -1) + 1])
    assert fleet(logs, out)["robots"][1]["changes"][0]["days"] == 2
    assert [Path(path).parent.name for path in asked[7:]] == [DAYS[2]]

    # what was kept is damaged: a reference cut in half is made anew, a result that is a pipe is refused
    reference = out / "robots" / "cell_1" / "identified.toml"
    whole = reference.read_text()
    reference.write_text(whole[: len(whole) // 2])
    first, _ = fleet(logs, out)["robots"]
    assert first["error"] is None
    assert reference.read_text() == whole
    assert [day["verdict"] for day in first["days"]] == ["within_noise"] * 3
    result = out / "robots" / "cell_2" / DAYS[1] / "day.json"
    result.unlink()
    os.mkfifo(result)
    with pytest.raises(StorageError, match=r"day\.json: exists and is not a file"):
        fleet(logs, out)
    result.unlink()


def test_a_robot_that_cannot_be_identified_is_told(logs: Path, tmp_path: Path) -> None:
    good, bad = tmp_path / "logs" / "good", tmp_path / "logs" / "bad"
    shutil.copytree(logs / "cell_1" / DAYS[0], good / DAYS[0])
    bad.mkdir()
    (bad / "2026-01-30.csv").write_text("")
    result = fleet_of(tmp_path, logs / "bench.toml")
    told = {robot.robot: robot for robot in result.robots}
    assert "could not be identified on any day; 2026-01-30: none of its 1 logs can be read; " in (
        told["bad"].error or ""
    )
    assert "2026-01-30.csv: empty file" in (told["bad"].error or "")
    assert [day.verdict for day in told["good"].days] == ["within_noise"]


def fleet_of(folder: Path, robot: Path) -> Fleet:
    return survey(members([folder / "logs"], robot), Settings(folder / "out"), lambda: None)


GIVES_BACK = """
import os, sys
from pathlib import Path
from typer.testing import CliRunner
from service.cli.main import app

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")

ask = ["fleet", sys.argv[1], "--jobs", "1", "--out"]
CliRunner().invoke(app, [*ask, sys.argv[2] + "_before"])  # all that it imports is there
pieces = [b"x" * (60_000 + number) for number in range(5000)]  # 300 MB, in pieces that no system maps by themselves
holding = pieces[::50]  # so that what is free lies between
del pieces
before = resident()
done = CliRunner().invoke(app, [*ask, sys.argv[2]])
print(before - resident(), len(holding), type(done.exception).__name__, done.exception, done.output)
"""


def test_nothing_judged_is_an_error_and_the_memory_of_a_day_goes_back(tmp_path: Path) -> None:
    """In a process of its own: another's memory holds what other tests left."""
    (tmp_path / "a.csv").write_text("")
    command = [sys.executable, "-c", GIVES_BACK, str(tmp_path), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    given_back, said = done.stdout.split(maxsplit=1)
    assert int(given_back) > 200e6, said
    assert said.split()[1] == "DataError"
    assert "no day of any robot could be judged" in said
    assert "no robot.toml in its folder, and no --robot" in said
