"""Runs a tutorial as it is written: `python -m docs.making.tutorials csv-to-cause --pictures`.

Of a page, in order: a block with a title is a file to write; a `bash` block is a command to run, in an empty folder
beside the clone; every line of a `text` block must stand in the output of the command above it, its numbers to within a
fifth, for random draws and processors differ, but for what a machine's speed decides;
`<!-- picture: report.html pictures/name.png -->` is a screenshot of a page that the commands wrote.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
CLONE = "deltatwin"  # what a tutorial calls the clone, beside the folder that it works in
SECONDS = 1500  # that a block may take, on a busy machine
_BLOCK = re.compile(
    r"^```(?P<kind>\w+)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<body>.*?)^```$"
    r"|^<!-- picture: (?P<page>\S+) (?P<picture>\S+) -->$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")
_OF_SPEED = re.compile(rf"(?:{_NUMBER.pattern})(?= ?(?:[µmn]s|min)\b)")
_NEAR = 0.2  # of the number that the page shows
_SHOT = ("--window-size=1000,1100", "--hide-scrollbars")
_RULES = re.compile(r"[\u2500-\u257f|]")


class TutorialError(AssertionError):
    """A command failed, or does not say what the page says that it does."""


@dataclass(frozen=True)
class Block:
    """A piece of a page. kind: bash, text, file or picture."""

    kind: str
    body: str
    name: str = ""


def blocks(page: str) -> Iterator[Block]:
    """What of a page is to be run, in order."""
    for found in _BLOCK.finditer(page):
        if found["picture"]:
            yield Block("picture", found["page"], found["picture"])
        elif found["title"]:
            yield Block("file", found["body"], found["title"])
        elif found["kind"] in ("bash", "text"):
            yield Block(found["kind"], found["body"])


def commands(page: str) -> list[str]:
    """Every command of a page."""
    return [
        line for block in blocks(page) if block.kind == "bash" for line in _joined(block.body)
        if line.lstrip().startswith(("deltatwin ", "sudo deltatwin "))
    ]  # fmt: skip


def _joined(body: str) -> list[str]:
    return body.replace("\\\n", " ").splitlines()


def run(path: Path, folder: Path, pictures: Path | None = None) -> str:
    """Run a tutorial in `folder`, which is to be empty; pictures: where to put them. Returns what the commands said.

    Raises:
        TutorialError: see there.
    """
    (folder / CLONE).symlink_to(ROOT)
    work = folder / "work"
    work.mkdir()
    said, everything = "", ""
    for block in blocks(path.read_text(encoding="utf-8")):
        if block.kind == "file":
            (work / block.name).write_text(block.body, encoding="utf-8")
        elif block.kind == "bash":
            said = _ran(block.body, work)
            everything += said
        elif block.kind == "text":
            for line in block.body.splitlines():
                if not stands(line, said):
                    raise TutorialError(f"{path.name}: {line!r} is not in the output of the command:\n{said}")
        elif pictures is not None:
            _photograph(work / block.body, pictures / block.name)
    return everything


def _ran(body: str, work: Path) -> str:
    if os.geteuid() == 0:
        body = re.sub(r"^sudo ", "", body, flags=re.MULTILINE)
    bin_folder = str(Path(sys.executable).parent)
    environment = os.environ | {"PATH": f"{bin_folder}:{os.environ['PATH']}", "COLUMNS": "100", "NO_COLOR": "1"}
    done = subprocess.run(
        ["bash", "-eu", "-c", body], cwd=work, env=environment, text=True, timeout=SECONDS, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if done.returncode:
        raise TutorialError(f"exit code {done.returncode} of\n{body}\n{done.stdout}")
    return done.stdout


def stands(line: str, said: str) -> bool:
    """Whether a line of a page stands in an output, with numbers that are near enough."""
    (wanted, shown), (everything, found) = _plain(line), _plain(said)
    begins = [match.start() for match in re.finditer(rf"(?={re.escape(wanted)})", everything)]
    firsts = [everything[:begin].count("#") for begin in begins]
    return any(all(map(_near, shown, found[first : first + len(shown)])) for first in firsts)


def _near(shown: str, found: str) -> bool:
    """Whether a number is another to within a fifth, or to a step of its last decimal; what is no number is itself."""
    try:
        value, other = float(shown.replace(",", ".")), float(found.replace(",", "."))
    except ValueError:
        return shown == found
    digits, _, power = shown.replace(",", ".").partition("e")
    decimals = len(digits.partition(".")[2])
    step = 10.0 ** (int(power or 0) - decimals) if decimals else 0.0  # one joint is not another
    return abs(other - value) <= 1.001 * max(_NEAR * abs(value), step)


def _plain(text: str) -> tuple[str, list[str]]:
    """A text without its numbers, rules and line ends; and its numbers in order."""
    text = _OF_SPEED.sub("", _RULES.sub(" ", text.replace("...", "").replace("#", "")))
    return " ".join(_NUMBER.sub("#", text).split()), _NUMBER.findall(text)


def _photograph(page: Path, picture: Path) -> None:
    from service.pages import headless

    picture.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [*headless(Path(profile)), *_SHOT, f"--screenshot={picture}", page.as_uri()],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip


def main() -> None:
    """Run those that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("names", nargs="*", help="tutorials; default: all")
    parser.add_argument("--pictures", action="store_true", help="make their pictures again")
    asked = parser.parse_args()
    for path in sorted(TUTORIALS.glob("*.md")):
        if path.stem in asked.names or not asked.names:
            with tempfile.TemporaryDirectory() as folder:
                print(f"== {path.stem}\n{run(path, Path(folder), TUTORIALS if asked.pictures else None)}")


if __name__ == "__main__":
    main()
