"""What the documentation claims has a source, what it links is there, and the README stays one that is read."""

from __future__ import annotations

import ast
import html
import re
import shutil
from pathlib import Path

import pytest

from docs.making import figures
from docs.making.pages import FILES
from schemas.messages import TOPICS
from service.cli.live import PAYLOAD
from service.cli.main import summaries
from service.diagnosis.sealed_page import BOUNDS
from service.model.effects import NAMES
from tests.conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
PAGES = sorted([REPOSITORY / "README.md", REPOSITORY / "CHANGELOG.md", *DOCS.rglob("*.md")])
README_LINES = 150

# What reads like a measurement: percent, counts out of counts, deviations, times and sizes of machines, ratios.
WORDS = r"(?:none|all|one|two|three|four|five|six|seven|eight|nine|ten|twelve|twenty|thirty|forty|fifty|hundred|\d+)"
CLAIM = re.compile(
    rf"\bper ?cent\b|\b\w+fold\b|\b{WORDS} (?:out )?of (?:the )?{WORDS}\b|\b\d[\d.]*x\b|\d\s?(?:mrad|mm|kg|N m) rms\b|"
    r"\b(?:within|off by|takes?|took|needs|error of) [\d.]+(?: to [\d.]+)? ?(?:m?s|min|g|kg|mm|mrad|N m)\b|"
    r"\d ?(?:mm|mrad|N m|k?g|m?s) (?:off|wrong|too)\b|\b(?:half|third|quarter|fifth|tenth) (?:less|more|of the time)\b|"
    r"\d\s?%|\b\d[\d ]* of \d|±\s?\d|\d\s?(?:µs|ns|[MG]i?B|samples/s|frames/s)\b|\b\d[\d.]* times\b|\b\d+ lost\b"
)
# Numbers like that which measure nothing, and what they are.
STATED = {
    "how-to/faults.md": {"1 and 5 %": "the fault that the test makes"},
    "how-to/run-on-the-bus.md": {},
    "explanation/diagnosis.md": {"95 %": "the level of an interval"},
    "how-to/import-logs.md": {", percent,": "the name of a unit"},
    "how-to/which-reading.md": {"3 %": "a bound that the code sets"},
    "how-to/ros-2.md": {"20 times": "a rate that the code sets"},
}


def prose(path: Path) -> str:
    """A page without code, comments and the figures that have a source."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->|`[^`\n]*`", "", figures.MACRO.sub("", text), flags=re.DOTALL)
    for stated in STATED.get(path.relative_to(DOCS).as_posix() if DOCS in path.parents else "", {}):
        text = text.replace(stated, "")
    return text


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_no_figure_without_a_source(path: Path) -> None:
    claims = [line for line in prose(path).splitlines() if CLAIM.search(line)]
    assert claims == [], 'a measured figure stands in results/*.json and is put in by {{ figure("bench.key") }}'


@pytest.mark.parametrize(
    "line",
    [
        "a shrink of 43 %",
        "29 of 30 named",
        "takes 3.0 µs",
        "207 times faster",
        "0.05 ± 0.01",
        "0 lost",
        "ten per cent",
        "nine out of ten",
        "2.3x",
        "a tenfold error",
        "0.3 mm rms",
        "within 0.05 s",
        "takes 42 s",
        "3 mm off",
        "a fifth less",
    ],
)
def test_a_claim_is_seen(line: str) -> None:
    assert CLAIM.search(line)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_every_figure_in_a_text_is_there(path: Path) -> None:
    assert "{{" not in figures.filled(path.read_text(encoding="utf-8"))


def test_every_bench_has_its_table() -> None:
    assert figures.benches()
    for name, bench in figures.benches().items():
        assert bench.bench == name
        assert len({one.key for one in bench.figures}) == len(bench.figures)
        page = figures.page(name)
        assert all(one.text.replace("_", r"\_") in page.replace(r"\<", "<") for one in bench.figures)
        assert f"({name}.md)" in figures.index()


def measured(value: float | str, bound: str | None, interval: str | None = None) -> figures.Figure:
    return figures.Figure(
        key="a", figure="a", value=value, unit="", bound=bound, count=None, interval=interval, machine="", commit="",
        date="",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "bound", "interval", "missed"),
    [
        (4.2, "≤ 4", None, True),
        (4, "≤ 4", None, False),
        (0.94, "≥ 0.95", None, True),
        (195.0, "≥ 50", None, False),
        (65_537, "≤ 65 536", None, True),
        (2e-9, "≤ 1e-9", None, True),
        (1.41, "0.7 to 1.2", None, True),
        (0.62, "0.7 to 1.2", None, True),
        (0.9, "0.7 to 1.2", None, False),
        (1, "0", None, True),
        (0, "0", None, False),
        ("26 of 30", "≥ 27", None, True),
        ("29 of 30", "≥ 27", None, False),
        ("94.5 to 100 %", "≥ 95 %", None, True),
        (0.05, "≤ least squares", "least squares 0.0485, torque 0.237", True),
        (1.77, "≤ least squares", "least squares 2.31, torque 26.9", False),
        (3.0, None, None, False),
    ],
)
def test_missed_bound(value: float | str, bound: str | None, interval: str | None, missed: bool) -> None:
    assert measured(value, bound, interval).missed == missed


@pytest.mark.parametrize("bound", ["12", "1", "at least 0.95", "within 5 %", "95 %"])
def test_a_bound_says_its_direction(bound: str) -> None:
    with pytest.raises(ValueError, match="has no direction"):
        measured(1.0, bound)


def test_a_page_marks_what_is_missed_and_quotes_no_empty_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = figures.Bench(
        bench="b", title="B", about="see [C](c.md)", run=[], figures=[measured(5, "≤ 4"), measured(3, "≤ 4")]
    )
    monkeypatch.setattr(figures, "benches", lambda: {"b": bench})
    page = figures.page("b")
    assert page.count("| ≤ 4, **missed** |") == page.count("| ≤ 4 |") == 1
    assert "``" not in page.replace("```", "")
    assert "| see [C](c.md) |" in figures.index()


def test_bounds_of_the_blind_test_are_those_of_the_tool() -> None:
    assert {one.key: (one.figure, one.bound) for one in figures.benches()["blindtest"].figures} == BOUNDS


def test_the_picture_of_top_shows_what_top_shows_and_fetches_nothing() -> None:
    drawing = (DOCS / "how-to" / "pictures" / "top.svg").read_text(encoding="utf-8")
    text = html.unescape(" ".join(re.findall(r"<text[^>]*>([^<]*)</text>", drawing))).replace("\xa0", " ")
    assert not re.search(r"url\((?!#)|href|@font-face", drawing)
    for said in ("joint 3", *(f"error {name}, rms N m" for name in ("M_KH", "M_Id+F", "full")), *filter(None, PAYLOAD)):
        assert said in text


RUN = re.compile(r"uv run (?:--group \w+ )?python -m ([\w.]+)\b")


def writes(module: str, name: str) -> bool:
    """Whether a bench accepts `--store` and, where it calls `store`, gives it that name."""
    path = REPOSITORY / module.replace(".", "/")
    source = (path / "__main__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    given = [(ast.unparse(call.func).rpartition(".")[2], call.args[0]) for call in calls]
    constants = {(called, first.value) for called, first in given if isinstance(first, ast.Constant)}
    return {("add_argument", "--store"), ("store", name)} <= constants


@pytest.mark.parametrize("name", sorted({*figures.benches()} - {"spike_evidence"}))  # a trial whose code was given up
def test_what_stands_in_a_file_of_figures_is_stored_by_its_commands(name: str) -> None:
    found = [(RUN.match(command), command.split()) for command in figures.benches()[name].run]
    last = {told[1]: words for told, words in found if told}  # of a bench in steps the last one stores
    assert last
    assert all(told for told, _ in found)
    for module, words in last.items():
        assert "--store" in words, module
        assert writes(module, name), module


def test_what_a_bench_measures_takes_the_place_of_what_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(figures.RESULTS / "speed.json", tmp_path)
    before = figures.Bench.model_validate_json((tmp_path / "speed.json").read_text(encoding="utf-8")).figures
    monkeypatch.setattr(figures, "RESULTS", tmp_path)
    figures.store("speed", {"step_median": (2.5, 1000, "p99 4")})
    after = figures.Bench.model_validate_json((tmp_path / "speed.json").read_text(encoding="utf-8")).figures
    changed = [one for one, old in zip(after, before, strict=True) if one != old]
    assert [(one.key, one.value, one.unit, one.count, one.interval) for one in changed] == [
        ("step_median", 2.5, "µs", 1000, "p99 4")
    ]
    assert changed[0].commit
    with pytest.raises(KeyError, match=r"speed\.json has no figure 'step_mean'"):
        figures.store("speed", {"step_mean": (2.5, 1000, None)})


def test_readme_is_short() -> None:
    assert len((REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()) <= README_LINES


def test_readme_names_every_command() -> None:
    table = (REPOSITORY / "README.md").read_text(encoding="utf-8").split("## Commands\n")[1].split("## ")[0]
    assert set(re.findall(r"`([a-z-]+)`", table)) >= set(summaries())


def made(path: Path) -> bool:
    """Whether a page is one that is made when the site is built."""
    below = path.relative_to(DOCS).as_posix()
    names = {
        **{f"reference/commands/{name}.md": 0 for name in ("index", *summaries())},
        **{f"reference/messages/{name}.md": 0 for name in ("index", *TOPICS)},
        **{f"reference/effects/{name}.md": 0 for name in ("index", *NAMES)},
        **{f"reference/files/{name}.md": 0 for name in FILES},
        **{f"measured/{name}.md": 0 for name in ("index", *figures.benches())},
        **{f"reference/{name}.md": 0 for name in ("exit-codes", "flags", "python")},
    }
    return below in names or below == "explanation/joint-zero.svg"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_links_lead_somewhere(path: Path) -> None:
    for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", prose(path)):
        if not link.startswith(("http:", "https:")):
            target = (path.parent / link).resolve()
            assert target.exists() or made(target), f"{path.name}: {link}"
