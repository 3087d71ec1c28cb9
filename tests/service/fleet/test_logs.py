"""Which robot and which day a log is of, by where it lies and what it says itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace import write_trace
from schemas.errors import DataError
from schemas.trace import Trace
from service.fleet.logs import members, natural

LAYOUTS = {
    "robot, day": (["a/2026-01-02/x.csv", "a/2026-01-01/x.csv", "b/20260103/y.csv.gz"], "."),
    "day, robot": (["2026-01-02/a/x.csv", "2026-01-01/a/x.csv", "2026-01-03/b/y.csv.gz"], "."),
    "day in the name": (["a/x_2026-01-02.csv", "a/2026.01.01_x.csv", "b/y-20260103.csv.gz"], "."),
    "folder of each robot given": (["a/2026-01-02/x.csv", "a/2026-01-01/x.csv", "b/2026-01-03/y.csv.gz"], "a b"),
    "files given": (["a/2026-01-02/x.csv", "a/2026-01-01/x.csv", "b/2026-01-03/y.csv.gz"], "files"),
}  # fmt: skip


def lay(folder: Path, names: list[str]) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_robots_and_days_by_folders_and_names(tmp_path: Path, layout: str) -> None:
    names, given = LAYOUTS[layout]
    lay(tmp_path, [*names, "a/notes.md"])
    paths = [tmp_path / name for name in (names if given == "files" else given.split())]
    found = {robot.name: list(robot.days) for robot in members(paths)}
    assert found == {"a": ["2026-01-01", "2026-01-02"], "b": ["2026-01-03"]}


def test_a_description_marks_a_robot_and_is_its_own(tmp_path: Path) -> None:
    lay(tmp_path, ["hall/a/robot.toml", "hall/a/day_10/x.csv", "hall/a/day_9/x.csv", "hall_b/x.csv"])
    a, b = members([tmp_path], Path("other.toml"))
    assert (a.name, a.description, list(a.days)) == ("hall/a", tmp_path / "hall/a/robot.toml", ["day_9", "day_10"])
    assert (b.name, b.description, list(b.days)) == ("hall_b", Path("other.toml"), ["x"])


def test_a_day_alone_finds_the_description_of_its_robot(tmp_path: Path) -> None:
    lay(tmp_path, ["a/robot.toml", "a/2026-01-01/x.csv"])
    for given in ("a/2026-01-01", "a/2026-01-01/x.csv"):
        (robot,) = members([tmp_path / given])
        assert (robot.name, robot.description) == ("a", tmp_path / "a/robot.toml")


def test_recordings_say_robot_and_day_themselves(tmp_path: Path) -> None:
    row = np.zeros((2, 3))
    for name, robot, start in (("1", "left", 1.7e9), ("2", "right", 1.7e9), ("3", "left", 1.7e9 + 86_400)):
        write_trace(Trace(Path("x"), start + np.array([0.0, 0.001]), row, row), tmp_path / f"{name}.mcap", robot)
    left, right = members([tmp_path])
    assert (Path(left.name).name, list(left.days)) == ("left", ["2023-11-14", "2023-11-15"])
    assert (Path(right.name).name, list(right.days)) == ("right", ["2023-11-14"])


def test_stamps_since_power_on_are_no_day(tmp_path: Path) -> None:
    row = np.zeros((2, 3))
    write_trace(Trace(Path("x"), np.array([0.0, 0.001]), row, row), tmp_path / "run.mcap", "left")
    (robot,) = members([tmp_path])
    assert list(robot.days) == ["run"]


def test_a_log_without_a_date_among_dated_ones_has_no_place(tmp_path: Path) -> None:
    lay(tmp_path, ["a/2026-01-01.csv", "a/2026-13-01.csv"])
    (robot,) = members([tmp_path])
    assert list(robot.days) == ["2026-01-01"]
    assert [log.name for log in robot.strays] == ["2026-13-01.csv"]


def test_a_folder_without_logs_is_named(tmp_path: Path) -> None:
    lay(tmp_path, ["notes.md"])
    with pytest.raises(DataError, match="no logs in it"):
        members([tmp_path])
    with pytest.raises(DataError, match="gone: no such file or folder"):
        members([tmp_path / "gone"])


def test_numbers_sort_as_numbers() -> None:
    assert sorted(["day_10", "day_9", "9", "day"], key=natural) == ["9", "day", "day_9", "day_10"]
