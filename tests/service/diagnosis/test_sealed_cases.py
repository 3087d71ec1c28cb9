"""The blind test: its key stays sealed, its table counts right, its backends agree, an interrupted run goes on."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.simulated.plant.families import Draw
from schemas.errors import DataError, StorageError
from schemas.robot import save_robot
from service.cli.main import app
from service.diagnosis import sealed_cases, workers
from service.diagnosis.sealed_page import BOUNDS, missed
from tests.service.diagnosis.logs import ROBOT, record, swing

TIMES = ("seconds", "cpu_seconds")


def key(
    case: int, kind: str, effects: list[str], joints: list[list[int]], lift: float, wrong: str = "", *allowed: str
) -> dict[str, Any]:
    return {
        "case": f"case_{case:03d}", "kind": kind, "effects": effects, "allowed": list(allowed), "joints": joints,
        "severity": 1.0, "wrong": wrong, "noise": 0.3, "lift": lift, "refused": [],
    }  # fmt: skip


KEYS = [key(0, "null", [], [], 1.0), key(1, "catalogue", ["stribeck_friction"], [[0, 1, 2]], 3.0)]


def test_ctrl_c_while_the_maker_loads_says_nothing() -> None:
    code = """
import sys
class Stop:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Stop())
"""
    command = [sys.executable, "-c", code + sealed_cases.MAKER]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small cases as the maker leaves them: one without a gap, one with Stribeck friction."""
    out = tmp_path_factory.mktemp("blind")
    for number, stuck in enumerate((0.0, 3.0)):
        folder = out / "cases" / f"case_{number:03d}"
        folder.mkdir(parents=True)
        save_robot(ROBOT, folder / "robot.toml")
        for seed, name in enumerate(("fit_a", "fit_b", "fit_c", "test_a")):
            record(folder / f"{name}.csv", ROBOT, swing(seed), 3.5, 10 * number + seed, stuck)
    (out / "sealed_key.json").write_text(json.dumps({"nonce": "0", "cases": KEYS}))
    sealed_cases.seal(out)
    return out


@pytest.fixture(scope="module")
def answered(sealed: Path) -> list[dict[str, Any]]:
    """Both cases answered, and which files were opened for the second."""
    global OPENED
    first = sealed_cases.answer(sealed / "cases" / "case_000")
    sys.addaudithook(_listen)
    OPENED = []
    second = sealed_cases.answer(sealed / "cases" / "case_001")
    opened, OPENED = OPENED, None
    return [first, second, {"opened": [path for path in opened if path.startswith(str(sealed))]}]


@pytest.fixture
def blind(sealed: Path, tmp_path: Path) -> Path:
    """A copy to work on."""
    shutil.copytree(sealed, tmp_path / "blind")
    return tmp_path / "blind"


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in TIMES} for row in rows]


OPENED: list[str] | None = None


def _listen(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and OPENED is not None:
        OPENED.append(str(arguments[0]))


def test_the_diagnosis_reads_no_more_than_its_case(sealed: Path, blind: Path, answered: list[dict[str, Any]]) -> None:
    _, with_key, heard = answered
    assert {Path(path).parent for path in heard["opened"]} == {sealed / "cases" / "case_001"}
    assert len(set(heard["opened"])) == 5  # description, three logs to fit, one to test
    (blind / "sealed_key.json").unlink()
    shutil.move(blind / "cases" / "case_001", blind / "alone")
    alone = sealed_cases.answer(blind / "alone")
    assert without_times([alone | {"case": ""}]) == without_times([with_key | {"case": ""}])


def test_robots_that_the_drives_did_not_hold_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And drawn again from other random numbers, which no case of this test or of another seed has."""
    seeds: dict[str, list[int]] = {}
    truth = {"stiffness": np.array([1.0, 2.0]), "mass": np.float64(0.5), "log": Path("fit_a.csv")}
    vain = {"case_000": 0, "case_001": 2, "case_002": 3}  # robots that cannot be held, of the three that are tried

    def simulated(folder: Path, seed: int, draw: Draw) -> dict[str, Any]:
        seeds.setdefault(folder.name, []).append(seed)
        vain[folder.name] -= 1
        if vain[folder.name] >= 0:
            raise DataError(f"{folder.name} fell apart")
        strayed = ["joint 1 strays"] * (folder.name == "case_001")
        return key(int(folder.name[-1]), draw.kind, list(draw.effects), [], 1.0) | {"refused": strayed, "truth": truth}

    monkeypatch.setattr("drivers.simulated.plant.cases.simulate_case", simulated)
    sealed_cases.make(tmp_path, 3, 5, 1, ["three"])
    sealed_cases.seal(tmp_path)
    keys = sealed_cases.unseal(tmp_path)
    assert capsys.readouterr().out == "made\n" * 3
    assert seeds == {"case_000": [5000], "case_001": [5001, 505001, 1005001], "case_002": [5002, 505002, 1005002]}
    assert keys[0]["truth"] == {"stiffness": [1.0, 2.0], "mass": 0.5, "log": "fit_a.csv"}
    nonce = json.loads((tmp_path / "sealed_key.json").read_text())["nonce"]
    assert len(bytes.fromhex(nonce)) == 16, "more than can be tried to find answers by their hash"
    assert [entry.get("kind") for entry in keys] == ["three", "three", None]
    assert sealed_cases.refused(keys) == [
        f"case_001 ({', '.join(keys[1]['effects'])}): 3 draws were refused, then another draw was used; joint 1 strays",
        f"case_002 ({', '.join(keys[2]['effects'])}): 3 draws were refused, then the case was given up; "
        "case_002 fell apart",
    ]


def test_the_makers_process_takes_what_it_is_told_and_says_how_far_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[Path, str]] = []
    through: list[int] = []  # cases that have been told when what was printed goes through the pipe

    def simulated(folder: Path, seed: int, draw: Draw) -> dict[str, Any]:
        made.append((folder, draw.kind))
        return key(int(folder.name[-1]), draw.kind, list(draw.effects), [], 1.0)

    class Process:
        """As `Popen`, in this process."""

        returncode = 0

        def __init__(self, command: list[str], stdout: int, text: bool) -> None:
            assert command[:3] == [sys.executable, "-c", sealed_cases.MAKER]
            assert text
            monkeypatch.setattr(sys, "argv", ["-c", *command[3:]])
            said: Any = io.StringIO()
            said.flush = lambda: through.append(said.getvalue().count("made"))
            with contextlib.redirect_stdout(said):
                print("a word of MuJoCo's")
                sealed_cases.maker()
            self.stdout = said.getvalue().splitlines()

        def __enter__(self) -> Process:
            return self

        def __exit__(self, *error: object) -> None: ...

    monkeypatch.setattr("drivers.simulated.plant.cases.simulate_case", simulated)
    monkeypatch.setattr(sealed_cases.subprocess, "Popen", Process)
    assert list(sealed_cases.made(tmp_path, 4, 5, 1, ["three", "outside"])) == [None] * 4
    assert through[:4] == [1, 2, 3, 4]
    assert [folder for folder, _ in made] == [tmp_path / "cases" / f"case_00{number}" for number in range(4)]
    assert {kind for _, kind in made} == {"three", "outside"}


def test_a_maker_that_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"^the simulation of the cases failed \(exit code 1\)$"):
        list(sealed_cases.made(tmp_path, 1, 1, 1, ["of no kind"]))


def test_a_key_that_was_changed_is_refused(blind: Path) -> None:
    assert sealed_cases.unseal(blind) == KEYS
    key = blind / "sealed_key.json"
    key.write_text(key.read_text().replace("stribeck_friction", "backlash"))
    with pytest.raises(DataError, match="changed after its hash was written"):
        sealed_cases.unseal(blind)


def test_backends_agree_and_stay_on_this_host(blind: Path, answered: list[dict[str, Any]]) -> None:
    psutil = pytest.importorskip("psutil", reason="needs dask[distributed], of the dev dependencies")
    pytest.importorskip("distributed", reason="needs dask[distributed], of the dev dependencies")
    with workers.backend("dask", 1, None):
        own = psutil.Process()
        family = [own, *own.children(recursive=True)]
        listening = [c.laddr.ip for p in family for c in p.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
        by_dask = sealed_cases.answers(blind, lambda: None)
    assert set(listening) == {"127.0.0.1"}
    assert without_times(by_dask) == without_times(answered[:2])
    assert [[effect["name"] for effect in row["named"]] for row in by_dask] == [[], ["stribeck_friction"]]


def row(
    case: int, named: list[tuple[str, list[int]]], verdict: str, claimed: float = 0.5, shrink: float = 0.5,
    probability: float = 1.0, confusable: tuple[str, ...] = (), rivals: tuple[str, ...] = (),
) -> dict[str, Any]:  # fmt: skip
    return {
        "case": f"case_{case:03d}", "verdict": verdict, "claimed": claimed, "shrink": shrink, "rivals": list(rivals),
        "named": [
            {"name": name, "joints": joints, "probability": probability, "confusable": list(confusable)}
            for name, joints in named
        ],
        "before_nm": 1.0, "after_nm": 0.085, "band_hz": 40.0, "period_s": 1e-3,
        "seconds": 10.0 + case, "cpu_seconds": 5.0,
    }  # fmt: skip


def test_a_scheduler_of_ones_own_is_used_and_told_where_it_is_of_no_use(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="needs dask[distributed], of the dev dependencies")
    monkeypatch.setattr(workers, "REACHED_S", 0.3)
    here = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "protocol": "tcp", "processes": False}
    with distributed.LocalCluster(n_workers=0, **here) as cluster:
        for address in ("tcp://127.0.0.1:1", "nowhere://", cluster.scheduler_address):
            with pytest.raises(DataError, match=f"--scheduler {address}: "), workers.backend("dask", 1, address):
                pytest.fail("was taken")
        cluster.scale(1)
        monkeypatch.setattr(workers, "REACHED_S", 20.0)
        with workers.backend("dask", 1, cluster.scheduler_address):
            assert joblib.Parallel()(joblib.delayed(worker_of)(number) for number in (1, 2)) == [(1, True), (2, True)]


def worker_of(number: int) -> tuple[int, bool]:
    """Its argument, and whether a Dask worker ran it."""
    from distributed import get_worker

    return number, bool(get_worker().address)


def test_the_table_counts_right() -> None:
    every = [0, 1, 2]
    keys = [
        key(0, "null", [], [], 1.0),
        key(1, "null", [], [], 1.0),
        key(2, "catalogue", ["backlash"], [[2]], 3.0),
        key(3, "catalogue", ["backlash"], [[1]], 3.0),
        key(4, "catalogue", ["tool_mass"], [[]], 2.0),
        key(5, "catalogue", ["joint_offset"], [[0]], 1.05),
        key(6, "catalogue", ["torque_offset"], [[0]], 2.0),
        key(7, "unknown", ["rail"], [[1]], 2.0),
        key(8, "unknown", ["rail"], [[1]], 2.0),
        key(9, "pair", ["stribeck_friction", "torque_scale"], [every, [1]], 4.0),
        key(10, "pair", ["stribeck_friction", "torque_delay"], [every, []], 4.0),
        key(11, "catalogue", ["backlash"], [[0]], 3.0),
    ]
    rows = [
        row(0, [], "within_noise", 0.0, 0.0),
        row(1, [("backlash", [1])], "explained", 0.1, 0.0),  # named what is not there
        row(2, [("backlash", [3])], "explained", 0.5, 0.5),  # right
        row(3, [("backlash", [1])], "explained", 0.5, 0.52),  # right, on the wrong joint
        row(4, [("arm_mass", [1]), ("tool_mass", [])], "partly_explained", 0.5, 0.5),  # wrong first
        row(5, [], "within_noise", 0.0, 0.0),  # too small to count
        row(6, [("asymmetric_friction", [1])], "explained", 0.5, 0.5),  # no motion tells it from an offset
        row(7, [], "unexplained", 0.0, 0.0),
        row(8, [("cogging", [2])], "explained", 0.5, 0.1),  # out of catalogue, and not said
        row(9, [("torque_scale", [2]), ("stribeck_friction", [1, 2, 3])], "explained", 0.5, 0.5),
        row(10, [("stribeck_friction", [1, 2, 3])], "partly_explained", 0.5, 0.5),
        {"case": "case_011", "error": "DataError: broken"},
    ]
    judged = sealed_cases.judged(rows, keys)
    figures = sealed_cases.summary(judged)
    assert (figures["cases"], figures["failed"], figures["findable_single"]) == (12, 1, 4)
    assert figures["right_first"] == pytest.approx(3 / 4, abs=1e-3)
    assert figures["right_joint"] == pytest.approx(2 / 3, abs=1e-3)
    assert figures["extra_per_case"] == pytest.approx(2 / 9, abs=1e-3)  # backlash in 1, arm_mass in 4
    assert figures["null_clean"] == 0.5
    assert figures["unknown_said"] == 0.5
    assert figures["pair_both"] == 0.5
    assert figures["claim_error_median"] == 0.0
    # floor: noise through the analysis band, 0.3 N m sqrt(2 * 40 Hz * 1 ms)
    assert figures["after_over_floor_median"] == pytest.approx(0.085 / (0.3 * 0.08**0.5), abs=1e-3)
    assert figures["seconds_median"] == 15.0
    assert [figures["counts"][key] for key in ("right_first", "right_joint", "extra_per_case")] == [4, 3, 9]
    assert (figures["counts"]["pair_both"], figures["counts"]["three_f1"]) == (2, 0)

    # a case of 250 Hz has another band, and each its own floor
    slow = sealed_cases.judged([row(0, [], "within_noise", 0.0, 0.0) | {"band_hz": 25.0, "period_s": 4e-3}], keys)
    assert slow[0]["floor_nm"] == pytest.approx(0.3 * (2 * 25.0 * 4e-3) ** 0.5)

    truth, first, table = sealed_cases.confusion(judged)
    count = {(t, f): int(table[i, j]) for i, t in enumerate(truth) for j, f in enumerate(first) if table[i, j]}
    assert count == {
        ("none", "none"): 1, ("none", "backlash"): 1, ("backlash", "backlash"): 2, ("tool_mass", "arm_mass"): 1,
        ("torque_offset", "asymmetric_friction"): 1, ("rail", "unknown"): 1, ("rail", "cogging"): 1,
    }  # fmt: skip


def test_what_is_findable_and_what_is_sure_have_their_bounds() -> None:
    """A lift of 1.1, a probability of 0.9; and figures of time and of claims are medians, or what nine in ten keep."""
    kinds = ("catalogue", "catalogue", "unknown", "unknown", "production")
    lifts = (1.09, 1.11, 1.09, 1.11, 1.11)
    keys = [key(n, kind, ["cogging"], [[0]], lift) for n, (kind, lift) in enumerate(zip(kinds, lifts, strict=True))]
    rows = [
        row(0, [], "within_noise", 0.1, 0.0),
        row(1, [("cogging", [1])], "explained", 0.0, 0.0, probability=0.91),
        row(2, [("backlash", [1])], "explained", 0.0, 0.2, probability=0.89),
        row(3, [("backlash", [1])], "unexplained", 0.4, 0.0, probability=0.91),
        row(4, [("arm_mass", [1])], "partly_explained", 9.0, 0.0, probability=0.5),
    ]
    for one, spent in zip(rows, (1.0, 2.0, 3.0, 4.04, 90.0), strict=True):
        one["cpu_seconds"] = spent
    judged = sealed_cases.judged(rows, keys)
    figures = sealed_cases.summary(judged)
    assert (figures["findable_single"], figures["right_first"], figures["right_joint"]) == (1, 1.0, 1.0)
    assert (figures["unknown_said"], figures["production_told"]) == (1.0, 0.0)
    assert (figures["sure_names"], figures["calibration"], figures["counts"]["calibration"]) == (2, 0.5, 2)
    assert figures["claim_error_median"] == 0.15
    assert figures["claim_error_p90"] == pytest.approx(np.quantile([0.0, 0.1, 0.2, 0.4], 0.9), abs=1e-3)
    assert (figures["cpu_seconds_median"], figures["seconds_median"]) == (3.0, 12.0)
    assert (figures["cases"], figures["failed"], figures["null_clean"]) == (5, 0, None)
    truth, first, table = sealed_cases.confusion(judged)
    assert (truth, first) == (["cogging", "none"], ["backlash", "cogging", "none"])
    assert table.tolist() == [[1, 1, 0], [0, 0, 0]]
    clean = [row(0, [], "unexplained"), row(1, [("cogging", [1])], "within_noise"), row(2, [], "within_noise")]
    nulls = [key(n, "null", [], [], 1.0) for n in range(3)]
    assert sealed_cases.summary(sealed_cases.judged(clean, nulls))["null_clean"] == 0.333
    broken = [{"case": "case_000", "error": "DataError: broken"}]
    nothing = sealed_cases.summary(sealed_cases.judged(broken, keys))
    assert (nothing["cases"], nothing["failed"], nothing["seconds_median"], nothing["calibration"]) == (
        1,
        1,
        None,
        None,
    )


@pytest.mark.parametrize(
    ("named", "effects", "f1"),
    [
        ([], ["cogging"], 0.0), (["cogging"], ["cogging"], 1.0), (["cogging", "backlash"], ["cogging"], 2 / 3),
        (["cogging"], ["cogging", "backlash"], 2 / 3), (["arm_mass", "tool_mass"], ["cogging", "backlash"], 0.0),
        ([], [], 0.0), (["asymmetric_friction", "arm_mass"], ["torque_offset", "backlash", "cogging"], 2 / 5),
    ],
)  # fmt: skip
def test_precision_and_recall_count_alike(named: list[str], effects: list[str], f1: float) -> None:
    """Names that no motion tells apart are one."""
    assert sealed_cases._f1(named, effects) == pytest.approx(f1)


def test_the_gap_is_that_of_all_rows_that_move(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = {"a": np.array([[1.0, np.nan], [3.0, np.nan]]), "b": np.array([[np.nan, 2.0], [np.nan, np.nan]])}
    monkeypatch.setattr("service.model.prediction.motion", lambda trace: f"along {trace}")
    monkeypatch.setattr("service.model.prediction.predict_along", lambda robot, trace, along: {"full": (robot, along)})
    monkeypatch.setattr("service.model.prediction.error_in_band", lambda trace, along, torque: errors[trace])
    assert sealed_cases.measured_gap("robot", ["a", "b"]) == pytest.approx(np.sqrt(14 / 3))
    assert sealed_cases.measured_gap("robot", ["b"]) == 2.0
    assert sealed_cases.measured_gap("robot", []) == 0.0


def test_the_families_figures_count_right() -> None:
    every = [0, 1, 2]
    two, outside = ["backlash", "tool_mass"], ["backlash", "tool_mass", "magnet"]
    keys = [
        key(0, "three", [*two, "cogging"], [[0], every, [1]], 4.0),
        key(1, "three", [*two, "cogging"], [[0], every, [1]], 4.0),
        key(2, "outside", outside, [[0], every, every], 4.0),
        key(3, "outside", outside, [[0], every, every], 4.0),
        key(4, "description", [], [], 2.0, "platform mass", "tool_mass"),
        key(5, "description", [], [], 2.0, "base_radius", "base_radius_error"),
        key(6, "description", [], [], 2.0, "azimuth of an arm", "azimuth_error"),
        key(7, "production", ["cogging"], [[0]], 2.0),
        key(8, "production", ["cogging"], [[0]], 2.0),
        key(9, "production", ["cogging"], [[0]], 2.0),
        key(10, "scope", ["cogging"], [[0]], 2.0, "", "torque_filter"),
        key(11, "scope", ["cogging"], [[0]], 2.0, "", "torque_filter"),
        key(12, "production", ["cogging"], [[0]], 1.09),  # too small to count
        key(13, "scope", ["cogging"], [[0]], 1.09),
    ]
    rows = [
        row(0, [("backlash", [1]), ("tool_mass", []), ("cogging", [2])], "explained"),  # F1 1
        row(1, [("joint_spring", [1]), ("cogging", [2])], "partly_explained", probability=0.8),  # F1 2/5, not sure
        row(2, [("backlash", [1]), ("tool_mass", [])], "partly_explained"),  # F1 1
        row(3, [("hose_spring", []), ("tool_mass", [])], "explained"),  # F1 1/2, one false
        row(4, [("tool_mass", [])], "explained"),
        row(5, [], "unexplained"),
        row(6, [("joint_offset", [1])], "explained"),  # false
        row(7, [("cogging", [1])], "explained"),
        row(8, [("backlash", [1])], "explained", confusable=("cogging",)),  # false, with the truth beside it
        row(9, [], "unexplained", rivals=("cogging", "backlash")),
        row(10, [("cogging", [1]), ("torque_filter", [])], "explained"),
        row(11, [("torque_filter", [])], "partly_explained"),  # true, and not what was asked
        row(12, [], "within_noise"),
        row(13, [], "within_noise"),
    ]
    figures = sealed_cases.summary(sealed_cases.judged(rows, keys))
    wanted = {
        "three_f1": 0.7, "three_first": 0.5, "three_extra": 0.5, "outside_f1": 0.75, "outside_said": 0.5,
        "outside_extra": 0.5, "description_right": 0.667, "description_extra": 0.333, "production_told": 1.0,
        "production_first": 0.333, "scope_first": 0.5, "scope_explained": 0.5,
    }  # fmt: skip
    assert {name: figures[name] for name in wanted} == wanted
    assert figures["sure_names"] == 14
    assert figures["calibration"] == pytest.approx(11 / 14, abs=1e-3)
    assert figures["right_first"] is None  # of the other families
    assert set(wanted) <= set(BOUNDS)
    late = missed(figures)
    assert len(late) == 11  # 10 of these, and calibration
    assert "share of true names among those with a probability of 90 to 100 %" in late


def test_an_interrupted_run_goes_on_and_finishes_once(blind: Path, answered: list[dict[str, Any]]) -> None:
    done, by_hand, _ = answered
    (blind / "answers").mkdir()
    kept = blind / "answers" / "case_000.json"
    kept.write_text(json.dumps(done | {"seconds": 1234.5}))  # as the run before left it
    (blind / "answers" / ".part-case_001.json").write_text("{")  # and what it was writing when it was stopped
    arguments = ["blindtest", "--out", str(blind), "--cases", "2", "--jobs", "1"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output  # whatever the time kept from the run before
    results = json.loads((blind / "results.json").read_text())
    assert [answer["seconds"] == 1234.5 for answer in results["rows"]] == [True, False]
    assert [effect["name"] for effect in by_hand["named"]] == [e["name"] for e in results["rows"][1]["named"]], "loky"
    assert results["summary"]["right_first"] == results["summary"]["null_clean"] == 1.0
    assert np.isclose(results["summary"]["extra_per_case"], 0.0)
    page = (blind / "blindtest.html").read_text()
    assert (blind / "commitment.txt").read_text().split()[1] in page
    again = CliRunner().invoke(app, arguments)
    assert isinstance(again.exception, StorageError)
    assert "holds a finished blind test" in str(again.exception)
