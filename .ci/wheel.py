"""How the wheel is built: the rooms go into the package `deltatwin`, and their imports of each other with them.

In the repository they are folders at the top level, and what is run from there, or installed editable, is these files.
In somebody's environment nothing but `deltatwin` may be at the top level: a folder `schemas/` beside a notebook would
take the place of ours. Lines stay where they are, so that a traceback, a debugger and a type checker find the same.
"""

from __future__ import annotations

import ast
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "deltatwin"
ROOMS = ("drivers", "replay", "schemas", "service")
MADE = ("__pycache__", "*.py[co]", "*.nbi", "*.nbc")  # by running


class Wheel(BuildHookInterface):
    """Hatchling's hook."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Put the rooms into a wheel; an editable installation takes them where they are."""
        if version != "standard":
            return
        self.folder = tempfile.TemporaryDirectory()
        for room in ROOMS:
            target = Path(self.folder.name, room)
            shutil.copytree(Path(self.root, room), target, ignore=shutil.ignore_patterns(*MADE))
            build_data["force_include"][str(target)] = f"{PACKAGE}/{room}"
        own = Path(self.folder.name, PACKAGE)
        shutil.copytree(Path(self.root, PACKAGE), own, ignore=shutil.ignore_patterns(*MADE))
        for path in own.iterdir():
            build_data["force_include"][str(path)] = f"{PACKAGE}/{path.name}"
        for path in Path(self.folder.name).rglob("*.py"):
            path.write_text(inside(path.read_text(encoding="utf-8"), str(path)), encoding="utf-8")


def inside(source: str, name: str) -> str:
    """A module with its imports from rooms as imports from the package.

    Raises:
        ValueError: an import that cannot be changed in its place, `import service.model`; name: of the file.
    """
    lines = source.splitlines(keepends=True)
    for line, module in sorted(_imports(ast.parse(source), name), reverse=True):
        before, rest = lines[line - 1].split(module, 1)
        lines[line - 1] = f"{before}{PACKAGE}.{module}{rest}"
    return "".join(lines)


def _imports(tree: ast.Module, name: str) -> Iterator[tuple[int, str]]:
    """Line, from 1, and module of each import from a room."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level and _room(node.module or ""):
            yield node.lineno, node.module or ""
        if isinstance(node, ast.Import):
            for alias in filter(lambda alias: _room(alias.name), node.names):
                if alias.asname is None or len(node.names) > 1:
                    raise ValueError(f"{name}:{node.lineno}: import {alias.name}: write from {alias.name} import ...")
                yield node.lineno, alias.name


def _room(module: str) -> bool:
    return module.partition(".")[0] in ROOMS
