"""Every command on every kind of machine: it works, or one line names what there is not for that kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.errors import UnansweredError
from service.cli.main import app, summaries
from tests.service import arm
from tests.service.sines import sines

pytest.importorskip("pinocchio")
KINDS = ("axes", "chain")
WITHOUT_A_MACHINE = {
    "blindtest", "demo", "doctor", "ethercat-demo", "experiment", "import", "init", "keys", "latency", "recover",
    "verify",
}  # fmt: skip
# of each command its words after the name; what it says where a kind has no answer, None: it works
ONLINE, FIELDBUS, CODE = (
    "feed-forward torque and payload sample by sample",
    "EtherCAT drives",
    "code for a controller",
)
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
    "replay": ("{log} --robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "estimate": ("--robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "monitor": ("--robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "watch": ("--robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "top": ("--robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "view": ("--robot {robot}", dict.fromkeys(KINDS, ONLINE)),
    "tap": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "master": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "segment": ("nowhere0 --robot {robot}", dict.fromkeys(KINDS, FIELDBUS)),
    "closed-loop": ("--robot {robot} --out {out}", dict.fromkeys(KINDS, "closed loop")),
}
AXES = 'name = "bench"\nkind = "axes"\n[[axis]]\n[[axis]]\ngravity = false\n'


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
@pytest.mark.parametrize("command", TABLE)
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
