"""Two hundred documents drawn at random: what a page says is what its plots and tables show."""

from __future__ import annotations

import re
from base64 import b64decode
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.words import counted, percent, significant
from service.diagnosis.sealed_page import BOUNDS, OF_SPEED
from service.experiment.live_loop import ratio
from service.model.effects import CATALOGUE
from service.pages.palette import Colour
from service.rollout.rollout_page import in_figures
from tests.service.pages.browser import plots_of
from tests.service.pages.colours import meanings
from tests.service.pages.drawn import KINDS
from tests.service.pages.kinds import OTHERS

NEVER = {
    "a zero with a sign": r"(?<![\w.])[-−+]0(?:\.0+)?(?![\d.]*[1-9])(?!\w)",
    "one of many": r"(?<![\d.,])1 (?:joints|cases|windows|robots|robot days|days|picks|logs|bounds|runs|cycles)\b",
    "an exponent": r"\d(?:\.\d+)?e[-+]\d",
    "percent without a blank": r"\d%",
    "what is no number": r"\b(?:nan|None|inf)\b",
    "a name of the code": "|".join(rf"\b{effect.name}\b" for effect in CATALOGUE if "_" in effect.name),
}


def text_of(page: str) -> str:
    """What a reader reads."""
    page = re.sub(r"<(script|style|code)\b.*?</\1>|<[^>]+>", " ", page, flags=re.DOTALL)  # nor commands
    return re.sub(r"\s+", " ", unescape(page))


def headline_of(page: str) -> dict[str, str]:
    """tone, answer, number (with what it is of) and step of a page's first box."""
    (tone, box), *more = re.findall(r'<section class="headline (\w+)">(.*?)</section>', page, re.DOTALL)
    assert not more
    parts = {name: text_of(part) for name, part in re.findall(r'<p class="(\w+)">(.*?)</p>', box, re.DOTALL)}
    assert set(parts) == {"answer", "number", "step"}
    return {"tone": tone} | parts


def values(data: Any) -> list[float]:
    """Numbers of a plot, packed or not."""
    if isinstance(data, dict):
        return np.frombuffer(b64decode(data["bdata"]), data["dtype"]).tolist()
    return list(data)


def rms(numbers: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(numbers))))


def bars(page: str) -> list[dict[str, dict[str, Any]]]:
    """Traces by name, of each plot with bars."""
    return [
        {trace.get("name", ""): trace for trace in plot["data"]}
        for plot in plots_of(page)
        if any(trace["type"] == "bar" for trace in plot["data"])
    ]


def of_diagnosis(document: Any, page: str) -> None:
    said, shown = headline_of(page), bars(page)
    levels, budget = shown[0], shown[1]
    before, after = (rms(values(levels[name]["y"])) for name in ("before", "after"))
    assert before == pytest.approx(rms(document.gap.before_nm), rel=1e-5)
    candidates = next((one for one in shown if set(one) <= {"accepted", "not accepted"}), {})
    accepted = set(candidates["accepted"]["y"]) if "accepted" in candidates else set()
    assert accepted == {effect.name.replace("_", " ") for effect in document.effects}
    shrinks = {one.name.replace("_", " "): percent(one.shrink) for one in document.ranking}
    assert {name: text for one in candidates.values() for name, text in zip(one["y"], one["text"], strict=True)} == (
        shrinks
    ), "of what is not accepted no probability"
    if len({one.name for one in document.ranking}) > len(accepted):
        assert "it also has to shrink the gap where" in text_of(page)
    if document.effects:
        assert said["tone"] == "bad"
        assert f"{significant(before)} → {significant(after)} {document.gap.unit}" in said["number"]
        assert said["number"].split(" smaller")[0].split(" larger")[0].strip() == percent(abs(document.gap.shrink))
        for effect in document.effects:
            name = effect.name.replace("_", " ")
            assert name in said["answer"].lower()
            assert name in budget
            assert text_of(page).count(effect.title) <= 2  # its one explanation; "means" may say it again
    else:
        assert said["tone"] == ("good" if document.verdict == "within_noise" else "open")
        times = before / rms(document.gap.noise_floor_nm)
        assert said["number"].strip().startswith(f"{significant(times, 2)} times the noise")
    residual = document.verdict == "partly_explained"
    assert not (residual and re.search(r"\b100 % of the gap above", text_of(page)))
    for joint, total in enumerate(np.sum([values(trace["x"]) for trace in budget.values()], axis=0)):
        assert total == pytest.approx(document.gap.before_nm[joint] ** 2, rel=1e-3)


def of_fleet(document: Any, page: str) -> None:
    said = headline_of(page)
    days = [day for robot in document.robots for day in robot.days]
    told = set(re.findall(r'<section class="one">\s*<h3>([^:<]+):', page))
    assert f"{sum(day.judged for day in days)} of {counted(len(days), 'robot day')} judged" in said["number"]
    assert (said["tone"] == "bad") == bool(told)
    if told:
        assert said["number"].split()[0] == str(len(told))
        assert all(robot in said["answer"] for robot in told)


def of_rollout(document: Any, page: str) -> None:
    said = headline_of(page)
    growth = {trace["name"]: values(trace["y"]) for trace in plots_of(page)[0]["data"]}
    shown = [robot for robot in document.robots if robot.platform_mm is not None]
    if not shown:
        assert said["tone"] == "bad"
        assert said["number"].strip().startswith("0 of")
        return
    best = shown[-1]
    assert said["number"].strip().startswith(f"{significant(best.platform_mm)} mm")
    assert growth[best.robot][-1] == pytest.approx(best.platform_mm, rel=1e-5)
    assert f"<td>{in_figures(best.platform_mm)}</td>" in page
    floor = document.floor.platform_mm
    if said["tone"] == "good":
        assert best.platform_mm < 1.5 * floor
        assert f"less than 1.5 times the {significant(floor)} mm that noise alone causes" in said["answer"]
    assert "within the noise" not in said["answer"], "which 1.5 times it is not"
    if "more than" in said["answer"]:
        assert best.platform_mm >= 1.5 * floor
        assert f"more than 1.5 times the {significant(floor)} mm" in said["answer"]


def of_blind_test(figures: Any, page: str) -> None:
    page = page.replace("\u00a0", " ")
    told = r"<tr><td>([^<]*)</td><td>([^<]*)</td><td>(\d+)</td><td>([≥≤]) ([\d.]+)</td>"
    said, rows = headline_of(page), re.findall(told, page)
    labels = {label: key for key, (label, _) in BOUNDS.items()}
    assert all(int(count) == figures["counts"][labels[unescape(label)]] for label, _, count, _, _ in rows)
    held = [
        (float(value) >= float(bound)) == (sign == "≥") or float(value) == float(bound)
        for label, value, _, sign, bound in rows
        if labels[unescape(label)] not in OF_SPEED and value != "no such case"
    ]
    assert said["number"].strip().startswith(f"{sum(held)} of {len(held)}")
    assert said["tone"] == ("open" if not held else "good" if all(held) else "bad")
    assert f"over {figures['cases']} case" in said["number"]


def of_closed_loop(runs: Any, page: str) -> None:
    said = headline_of(page)
    if any(run.spoilt for run in runs):
        assert said["tone"] == "open"
        assert "are not valid" in said["answer"]
        return
    before, after = (runs[0], runs[-1]) if len(runs) > 3 else runs[1:]
    found = ratio(before, after)
    assert said["number"].strip().startswith(f"{significant(found.value, 2)} times")
    assert said["tone"] == ("good" if found.high < 1 else "bad" if found.low > 1 else "open")
    page = page.replace("\u00a0", " ")
    for run in runs:
        assert f"<td>{run.name}</td>" in page
        assert f"<td>{run.true_rms * 1e3:.3f}</td>" in page


CHECKS = {
    "diagnosis": of_diagnosis,
    "fleet": of_fleet,
    "rollout": of_rollout,
    "blind test": of_blind_test,
    "closed loop": of_closed_loop,
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_page_says_is_what_it_shows(kind: str, tmp_path: Path) -> None:
    write, count = KINDS[kind]
    for seed in range(count):
        path = tmp_path / f"{seed}.html"
        document = write(np.random.default_rng([len(kind), seed]), path)
        page = path.read_text(encoding="utf-8")
        CHECKS[kind](document, page)
        for what, pattern in NEVER.items():
            found = re.search(pattern, text_of(page))
            assert not found, f"{kind} {seed}: {what}: {text_of(page)[max(found.start() - 60, 0) : found.end() + 20]}"
        path.unlink()


def test_two_hundred() -> None:
    assert sum(count for _, count in KINDS.values()) >= 200


def test_a_colour_has_one_meaning(tmp_path: Path) -> None:
    """Over all plots of all kinds of pages: all colours are of the palette, a name has one, no plot has one twice; a
    band has that of its line."""
    named = {effect.name.replace("_", " ") for effect in CATALOGUE}  # in the order in which they are named
    writers = [partial(write, np.random.default_rng([len(kind), seed]))
               for kind, (write, _) in KINDS.items() for seed in range(8)]  # fmt: skip
    meaning: dict[str, set[str]] = {}
    for write in [*writers, *OTHERS.values()]:
        write(tmp_path / "page.html")
        for name, colours in meanings((tmp_path / "page.html").read_text(encoding="utf-8")).items():
            meaning.setdefault(name, set()).update(colours)
    assert len(meaning) > 15
    assert {name: found for name, found in meaning.items() if len(found) > 1 and name not in named} == {}


def luminance(colour: str) -> float:
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


def contrast(one: str, other: str) -> float:
    """WCAG 2.2: 4.5 for text, 3 for what is large or drawn."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_colours_stand_out_from_both_papers() -> None:
    look = Path("service/pages/templates/look.css").read_text(encoding="utf-8")
    papers = re.findall(r":root\{color-scheme:[\w ]+;(.*?)\}|:root\{(--paper.*?)\}", look)
    light, dark = (dict(re.findall(r"--(\w+):(#\w+)", "".join(one))) for one in papers[:2])
    for theme in (light, dark):
        whole = {
            name: f"#{''.join(2 * c for c in code[1:])}" if len(code) == 4 else code for name, code in theme.items()
        }
        for text in ("ink", "soft", "good", "bad", "open", "told"):
            for paper in ("paper", "box"):
                assert contrast(whole[text], whole[paper]) >= 4.5, (text, paper, whole[text])
        for colour in set(Colour) - {Colour.MEASURED}:  # which is the ink
            assert contrast(colour, whole["paper"]) >= 3.0, (colour.name, whole["paper"])
