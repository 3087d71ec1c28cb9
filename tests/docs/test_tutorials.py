"""The tutorials are run as they are written, in an empty folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from docs.making.tutorials import TUTORIALS, TutorialError, blocks, commands, run, stands
from service.pages import BROWSERS

NAMES = sorted(path.stem for path in TUTORIALS.glob("*.md") if path.stem != "index")
RUN_ELSEWHERE = ("ethercat",)  # with what it leaves looked at: `tests/service/test_ethercat_demo.py`
QUICK = ("servo-axis",)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in NAMES if n not in RUN_ELSEWHERE]
)
@pytest.mark.timeout(3000)
@pytest.mark.flaky(reruns=1)  # live roles on a machine that does something else just then
def test_a_tutorial_does_what_it_says(name: str, tmp_path: Path) -> None:
    if name == "arm":
        pytest.importorskip("pinocchio")
    page, photographs = TUTORIALS / f"{name}.md", any(map(shutil.which, BROWSERS))
    assert run(page, tmp_path, tmp_path if photographs else None)
    shown = [block.name for block in blocks(page.read_text(encoding="utf-8")) if block.kind == "picture"]
    assert all(is_drawn(tmp_path / picture) for picture in shown) or not photographs


def test_from_an_own_csv_to_a_named_cause_in_ten_commands_or_fewer() -> None:
    assert 4 <= len(commands((TUTORIALS / "csv-to-cause.md").read_text(encoding="utf-8"))) <= 10


@pytest.mark.parametrize("name", NAMES)
def test_every_tutorial_has_a_picture_or_an_answer(name: str) -> None:
    kinds = {block.kind for block in blocks((TUTORIALS / f"{name}.md").read_text(encoding="utf-8"))}
    assert "bash" in kinds
    for block in blocks((TUTORIALS / f"{name}.md").read_text(encoding="utf-8")):
        if block.kind == "picture":
            assert (TUTORIALS / block.name).is_file(), "python -m docs.making.tutorials --pictures"


def test_an_answer_that_does_not_come_is_told(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text('```toml title="a.txt"\nmass 3.0\n```\n```bash\ncat a.txt\n```\n```text\nmass 2.9\n```\n')
    assert run(page, made(tmp_path / "one")) == "mass 3.0\n"
    page.write_text("```bash\necho mass\n```\n```text\nlength 2.5\n```\n")
    with pytest.raises(TutorialError, match=r"'length 2.5' is not in the output"):
        run(page, made(tmp_path / "two"))
    page.write_text("```bash\nexit 3\n```\n")
    with pytest.raises(TutorialError, match="exit code 3"):
        run(page, made(tmp_path / "three"))


@pytest.mark.parametrize(
    ("line", "said", "holds"),
    [
        ("mass 2.5 kg", "mass 3.0 kg", True),
        ("mass 2.5 kg", "mass 3.1 kg", False),
        ("mass 2.5 kg", "mass 1.0 kg\nmass 2.4 kg", True),
        ("mass 2.5 kg", "mass 2.5 g", False),
        ("mass -2.5 kg", "mass 2.5 kg", False),
        ("shrink 0.01", "shrink 0.02", True),
        ("shrink 0.01", "shrink 0.03", False),
        ("1e-06 rad", "1.1e-06 rad", True),
        ("1e-06 rad", "1e-05 rad", False),
        ("joint 2", "joint 3", False),
        ("2 of 2", "1 of 2", False),
        ("on 2026-03-02", "on 2026-03-01", False),
        ("version 1.2.3", "version 1.2.4", False),
        ("takes 30 ms of 4 m", "takes 90 ms of 4 m", True),
        ("takes 30 ms of 4 m", "takes 30 ms of 9 m", False),
        ("3,5;7", "3,6;7", True),
        ("│ full │ 0.174", "full   0.180", True),
    ],
)
def test_a_figure_that_went_stale_is_seen(line: str, said: str, holds: bool) -> None:
    assert stands(line, said) is holds


def is_drawn(picture: Path) -> bool:
    """Whether a photograph shows more than its background: what compresses to next to nothing does not."""
    content = picture.read_bytes()
    width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    return content.startswith(b"\x89PNG") and len(content) > width * height / 50


def made(folder: Path) -> Path:
    folder.mkdir()
    return folder
