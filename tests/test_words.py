"""Expressions of this project's own that readers have not understood stay out of what a user reads.

A pattern is here only if it can be recognised without a false alarm; with it is what to say instead.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EFFECTS = ROOT / "service/model/effects"
CODE = ("deltatwin", "drivers", "replay", "schemas", "service", "docs/making")
TEXTS = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
TIMES = "second|minute|hour|day|millisecond|cycle"
PARTS = "joint|axis|motor|drive|robot|log|trace|run|case|turn|metre|column|block|effect|parameter|file|topic"
COUNTED = "N m|kg|samples|cycles|messages|events|rows|increments|regressors?|constants?|figures?|numbers?"
INSTEAD = {
    r"\b(be|is|are|was|were) told\b|\b(told|tells?) apart\b|\buntold\b": "separable, identifiable, ambiguous, unknown",
    r"\btells? (\S+ ){1,6}(apart|from)\b|\bnothing tells\b|\btells more\b": "separates, shows",
    r"\bstrangers?\b": "unmodelled disturbance",
    r"\bst(ands?|ood) in for\b": "mimics, is an alias of",
    r"\bborne out\b|\bearn(s|ed)?\b": "accepted, confirmed on held-out data",
    r"\bgoes by\b": "depends on",
    r"\bkept out\b|\bheld out of everything\b|\bdata left out\b": "held out",
    r"\b(is|are) left (of|in|on|without)\b|\bwhat is left\b(?! out)": "residual, remains unexplained",
    r"\banew\b": "again",
    r"\bstands? still\b": "is repeated, is at rest",
    r"\brivals?\b": "alternative models",
    r"\bhas a memory\b": "is coloured",
    r"\bput right\b": "corrected",
    r"\bc(omes?|ame) along\b": "bundled",
    r"\bno word for\b": "cannot express",
    r"\b(is|are|was|were) taken for\b|\bit stands there\b|\bnothing says so\b": "assumed to be, the file says so",
    r"\bweigh(s|ed|ing)? (by|it|them|the (load|payload|product))\b|\bhangs? (there|on)\b": "payload, estimate",
    r"\bspeaks? (for|against)\b": "sends as, contradicts",
    r"\bgears? (that )?yields?\b": "elastic gears",
    rf"\b({COUNTED}) a ({TIMES}|{PARTS})\b": "per",
}
ANY = re.compile("|".join(INSTEAD), re.IGNORECASE)
# What an expression is allowed for: file and literal
ALLOWED = {
    ("service/rollout/joints.py", "stands still"): "name of a row in `rollout --json`, which is a promise",
}


def literals(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of what a module says to a user: literals of several words, and docstrings that become help texts
    or reference pages. Expressions inside an f-string are left out."""
    seen = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            shown = _is_shown(path, node) if isinstance(node, ast.Module) else node.name == "command"
            if node.body and isinstance(node.body[0], ast.Expr) and not shown:
                seen.add(node.body[0].value)
        elif isinstance(node, ast.JoinedStr):
            seen.update(node.values)
            yield node.lineno, "".join(str(v.value) if isinstance(v, ast.Constant) else "x" for v in node.values)
        elif isinstance(node, ast.Constant) and node not in seen and " " in str(node.value).strip():
            yield node.lineno, str(node.value)


def _is_shown(path: Path, module: ast.Module) -> bool:
    """Whether a module's docstring is: of an effect on its page, of a command in the list of commands."""
    return EFFECTS in path.parents or (ast.get_docstring(module) or "").startswith("`deltatwin ")


def pages() -> list[Path]:
    """Texts, pages of the site, and templates of the reports."""
    site = sorted((ROOT / "docs").rglob("*.md"))
    return [*(ROOT / name for name in TEXTS), *site, *sorted((ROOT / "service/pages/templates").glob("*.html"))]


def findings(where: str, line: int, text: str) -> Iterator[str]:
    """What of our own a text has, each in a line with its place and what to say instead."""
    if (where, text) in ALLOWED:
        return
    if not ANY.search(text):
        return
    for pattern, instead in INSTEAD.items():
        if found := re.search(pattern, text, re.IGNORECASE):
            yield f"{where}:{line}: {found.group()!r}: say {instead}"


@pytest.mark.parametrize("folder", CODE)
def test_messages_and_help_are_in_the_words_of_the_field(folder: str) -> None:
    found = [
        finding
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in literals(path)
        for finding in findings(str(path.relative_to(ROOT)), line, text)
    ]
    assert not found, "\n".join(found)


def test_pages_are_in_the_words_of_the_field() -> None:
    """Names in backquotes are keys and commands, which do not change."""
    found = [
        finding
        for path in pages()
        for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        for finding in findings(str(path.relative_to(ROOT)), line, re.sub(r"`[^`]*`|{{.*?}}|{%.*?%}", "x", text))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "its centre cannot be told", "Backlash stands in for elasticity", "what is left is noise", "5 N m a joint",
        "the torque comes anew every 4 ms", "events a minute", "No cause has earned a name",
        "the run that tells apart what a diagnosis could not", "the whole path on a log that comes along",
    ],
)  # fmt: skip
def test_an_expression_of_our_own_is_found(text: str) -> None:
    assert list(findings("page.md", 1, text))


def test_a_message_is_read_whole_and_code_is_not(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        '"""Not shown: cannot be told."""\n\n\ndef command(rivals):\n    """Shown: put right."""\n'
        '    return f"{len(rivals)} of them, "\\\n        f"5 N m a joint", "key"\n'
    )
    assert [text for _, text in literals(module)] == ["Shown: put right.", "x of them, 5 N m a joint"]
    module.write_text('"""`deltatwin demo`: the whole path on a log that comes along."""\n')
    assert [text for _, text in literals(module)] == ["`deltatwin demo`: the whole path on a log that comes along."]
