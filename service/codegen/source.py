"""The Python text of a kernel, what its names stand for, and how it is refused where it says what no back end knows."""

from __future__ import annotations
import __future__

import ast
import inspect
import linecache
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any, NoReturn

from numba.core.registry import CPUDispatcher

from schemas.errors import DeltatwinError


class CodegenError(DeltatwinError):
    """A kernel uses what the generator does not know; names file, line and construct."""


@dataclass(frozen=True)
class Source:
    """A kernel's syntax tree. first: the line of `path` that its first line stands on."""

    function: Callable[..., Any]
    tree: ast.FunctionDef
    path: str
    first: int

    @property
    def name(self) -> str:
        """Unique among kernels: the last part of its module's name, and its own."""
        module = self.function.__module__.rpartition(".")[2]
        own = self.function.__name__.strip("_").removesuffix("_kernel")
        return f"{module}_{own}"

    @property
    def where(self) -> str:
        return f"{Path(self.path).name}:{self.first}"

    @property
    def parameters(self) -> list[str]:
        return [argument.arg for argument in self.tree.args.args]

    def refuse(self, node: ast.AST, why: str) -> NoReturn:
        """
        Raises:
            CodegenError: always.
        """
        line = self.first + getattr(node, "lineno", 1) - 1
        said = ast.unparse(node).splitlines()[0]
        raise CodegenError(f"{self.path}:{line}: {self.function.__name__}: {said!r}: {why}")

    def value(self, node: ast.Name) -> Any:
        """What a name that is no variable stands for."""
        names = self.function.__globals__
        if node.id in names:
            return names[node.id]
        builtins = names["__builtins__"]
        found = builtins if isinstance(builtins, dict) else vars(builtins)
        if node.id not in found:
            self.refuse(node, "an undefined name")
        return found[node.id]


def source_of(kernel: CPUDispatcher) -> Source:
    """The text of `kernel`; of one that was made from a text, that text (its `source`).

    Raises:
        CodegenError: there is none.
    """
    function = kernel.py_func
    made = getattr(function, "source", None)
    path, first = inspect.getsourcefile(function) or "?", function.__code__.co_firstlineno
    if function.__code__.co_freevars:
        raise CodegenError(f"{path}:{first}: {function.__name__}: a kernel inside another function")
    try:
        text = made or textwrap.dedent(inspect.getsource(function))
    except OSError:
        raise CodegenError(f"{path}:{first}: {function.__name__}: its source text is not available") from None
    tree = ast.parse(text).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise CodegenError(f"{path}:{first}: {function.__name__}: there is no function at this line")
    arguments = tree.args
    if not _is_of(made or "".join(linecache.getlines(path)), function):
        raise CodegenError(f"{path}:{first}: {function.__name__}: the file has changed since this process read it")
    source = Source(function, tree, path, first)
    if arguments.defaults or arguments.kwonlyargs or arguments.vararg or arguments.kwarg or arguments.posonlyargs:
        source.refuse(tree, "parameters with defaults or of variable number")
    return source


def _is_of(text: str, function: Callable[..., Any]) -> bool:
    """Whether `text`, of its whole file, is what `function` was compiled from: a file may have been changed since."""
    own = function.__code__
    made = _codes(text).get((own.co_name, own.co_firstlineno))
    parts = ("co_code", "co_names", "co_varnames", "co_consts")
    return made is not None and all(getattr(made, part) == getattr(own, part) for part in parts)


@cache
def _codes(text: str) -> dict[tuple[str, int], CodeType]:
    """What the functions of a file are compiled to, by name and first line."""
    module = compile(text, "?", "exec", flags=__future__.annotations.compiler_flag, dont_inherit=True)
    return {(one.co_name, one.co_firstlineno): one for one in module.co_consts if isinstance(one, CodeType)}
