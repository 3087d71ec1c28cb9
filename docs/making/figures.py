"""Measured figures: `results/<bench>.json` is their only source, for the tables of the site and for a figure in a text.

A figure in a text is `{{ figure("speed.step_median") }}`: value and unit as the file has them.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, field_validator

from docs.making.markdown import cell, code, table

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
MACRO = re.compile(r"\{\{ figure\(\"([\w.]+)\"\) \}\}")
BOUND = re.compile(r"0|[≤≥] \S.*|\S+ to \S.*")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?: \d{3}(?!\d))*(?:\.\d+)?(?:e-?\d+)?")


class Figure(BaseModel):
    """One measured figure. commit, date: of the code that was measured, or of the report where that is not known.

    bound: that it is held to, `≤ 4`, `≥ 95 %`, `0.7 to 1.2`, `0`, or `≤ name` of a number in `interval`, `name 2.3`.
    count: of what it was measured on. interval: its spread, or what belongs to it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    key: str
    figure: str
    value: float | int | str
    unit: str
    bound: str | None
    count: int | str | None
    interval: str | None
    machine: str
    commit: str
    date: str

    @field_validator("bound")
    @classmethod
    def _has_a_direction(cls, bound: str | None) -> str | None:
        if bound is not None and not BOUND.fullmatch(bound):
            raise ValueError(f"bound {bound!r} has no direction: write '≤ {bound}' or '≥ {bound}'")
        return bound

    @property
    def missed(self) -> bool:
        """Whether the value, or one end of it, is outside its bound; of `29 of 30` the first number counts."""
        if self.bound is None:
            return False
        values = _numbers(str(self.value).partition(" of ")[0])
        if self.bound.startswith(("≤", "≥")):
            most = self.bound.startswith("≤")
            name = self.bound[1:].strip()
            limit = (_numbers(name) or _numbers((self.interval or "").partition(f"{name} ")[2]))[0]
            return any(value > limit if most else value < limit for value in values)
        least, *_, most = _numbers(self.bound) * 2
        return any(not least <= value <= most for value in values)

    @property
    def text(self) -> str:
        """Value and unit."""
        value = f"{self.value:,}".replace(",", " ") if isinstance(self.value, int) else str(self.value)
        return f"{value} {self.unit}".strip()


class Bench(BaseModel):
    """What one bench has measured. run: the commands that measure it anew."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    bench: str
    title: str
    about: str
    run: list[str]
    figures: list[Figure]


def _numbers(text: str) -> list[float]:
    return [float(found.replace(" ", "")) for found in NUMBER.findall(text)]


@cache
def benches() -> dict[str, Bench]:
    """All benches by name."""
    paths = sorted(RESULTS.glob("*.json"))
    return {path.stem: Bench.model_validate(json.loads(path.read_text(encoding="utf-8"))) for path in paths}


def figure(key: str) -> Figure:
    """The figure `bench.key`.

    Raises:
        KeyError: there is no such figure.
    """
    bench, _, name = key.partition(".")
    if bench in benches():
        for one in benches()[bench].figures:
            if one.key == name:
                return one
    raise KeyError(f"results/{bench}.json has no figure {name!r}")


def store(bench: str, measured: Mapping[str, tuple[float | int | str, int | str | None, str | None]]) -> Path:
    """Put what a bench has measured, key -> (value, count, interval), in place of what its file has; returns the file.

    Text, unit and bound of a figure are written by hand, once; machine, commit and date are those of now.

    Raises:
        KeyError: the file has no such figure.
    """
    path = RESULTS / f"{bench}.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    known = {one["key"]: one for one in document["figures"]}
    for key, (value, count, interval) in measured.items():
        if key not in known:
            raise KeyError(f"{path.name} has no figure {key!r}: write it there, with its unit and bound")
        known[key].update(value=value, count=count, interval=interval, **_here())
    Bench.model_validate(document)
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


def _here() -> dict[str, str]:
    """Where and when something is measured. commit: `-dirty` where files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    commit = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    machine = f"{os.cpu_count()} processors, {platform.processor() or platform.machine()}, {platform.platform()}"
    return {"machine": machine, "commit": commit or "no git", "date": datetime.now(UTC).date().isoformat()}


def filled(text: str) -> str:
    """A page with its figures put in."""
    return MACRO.sub(lambda found: figure(found[1]).text, text)


def page(name: str) -> str:
    """All figures of a bench."""
    bench = benches()[name]
    rows = [
        [cell(one.figure), cell(one.text), _bound(one), cell(one.count or ""), cell(one.interval or "")]
        for one in bench.figures
    ]
    origins = sorted({(one.date, one.commit, one.machine) for one in bench.figures})
    text = f"# {bench.title}\n\n{bench.about}\n\n" + table(
        ["Quantity", "Measured", "Bound", "Count", "Interval, notes"], rows
    )
    text += "\nTo measure it again:\n\n```console\n" + "\n".join(f"$ {command}" for command in bench.run) + "\n```\n"
    text += f"\nSource: `results/{name}.json`.\n\n"
    return text + table(["Date", "Commit", "Machine"], ([date, code(commit), cell(m)] for date, commit, m in origins))


def _bound(one: Figure) -> str:
    return cell(one.bound or "") + (", **missed**" if one.missed else "")


def index() -> str:
    """All benches."""
    text = (
        "# Measured\n\nAll measured values, with counts, bounds and the commit; a few of the commits are no longer in "
        "the history. Unless stated otherwise, they are from simulated robots: we know of no public log of a real "
        "Delta with torque. The machine is shared, so rates are given as ratios to a reference in the same run. A "
        "bound that is missed is marked.\n\n"
    )
    return text + table(
        ["Page", "Content"],
        (
            [f"[{bench.title}]({name}.md)", bench.about.split("\n\n")[0].replace("|", r"\|")]
            for name, bench in benches().items()
        ),
    )
