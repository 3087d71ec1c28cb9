"""Kernels and what they call, each once for each set of argument types, callees before callers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from service.codegen.expressions import Expressions
from service.codegen.source import CodegenError, source_of
from service.codegen.statements import Body
from service.codegen.stores import stored_through
from service.codegen.tree import Function
from service.codegen.types import Nothing, Reference, Several, Type, stored


@dataclass(frozen=True)
class Layout:
    """What is smaller in the generated code than in the service, where a robot does not need all of it.

    constants: name -> (value in the service, value here). shapes: (record, field) -> shape here. fields: (record,
    field) -> a number that it always has. hidden: (record, field) that is not there. names: record -> its name.
    """

    names: Mapping[np.dtype, str]
    constants: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)
    shapes: Mapping[tuple[np.dtype, str], tuple[int, ...]] = field(default_factory=dict)
    fields: Mapping[tuple[np.dtype, str], float] = field(default_factory=dict)
    hidden: frozenset[tuple[np.dtype, str]] = frozenset()

    def constant(self, name: str, value: Any) -> Any:
        before, here = self.constants.get(name, (None, None))
        return here if before is not None and isinstance(value, type(before)) and value == before else value

    def field(self, dtype: np.dtype, name: str) -> Type:
        return stored(dtype[name], self.shapes.get((dtype, name), ()))

    def members(self, dtype: np.dtype) -> list[str]:
        """The fields that a record has here."""
        return [n for n in dtype.names or () if (dtype, n) not in self.hidden and (dtype, n) not in self.fields]

    def constant_field(self, dtype: np.dtype, name: str) -> float | None:
        return self.fields.get((dtype, name))


class Program:
    """functions: in an order in which each calls only those before it. bundles: NamedTuples, by their names."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.functions: list[Function] = []
        self.bundles: dict[str, Several] = {}
        self.sources: dict[str, tuple[CPUDispatcher, tuple[Type, ...]]] = {}
        self._made: dict[tuple[Callable[..., Any], tuple[Type, ...]], Function | None] = {}
        self._names: dict[str, int] = {}

    def function(self, kernel: CPUDispatcher, arguments: tuple[Type, ...]) -> Function:
        """`kernel` for arguments of these types.

        Raises:
            CodegenError: a construct that is not known, or a kernel that calls itself.
        """
        key = kernel.py_func, arguments
        if key not in self._made:
            self._made[key] = None
            self._made[key] = self._lowered(kernel, arguments)
        made = self._made[key]
        if made is None:
            raise CodegenError(f"{kernel.py_func.__module__}: {kernel.py_func.__name__} calls itself")
        return made

    def _lowered(self, kernel: CPUDispatcher, arguments: tuple[Type, ...]) -> Function:
        source = source_of(kernel)
        if len(source.parameters) != len(arguments):
            source.refuse(source.tree, f"called with {len(arguments)} arguments")
        for kind in arguments:
            if isinstance(kind, Several):
                if not kind.title or self.bundles.setdefault(kind.title, kind) != kind:
                    source.refuse(source.tree, f"a tuple as an argument: {kind}")
            elif not isinstance(kind, Reference) and kind == Nothing():
                source.refuse(source.tree, "an argument without a value")
        parameters = list(zip(source.parameters, arguments, strict=True))
        made = Function("", source.where, _about(source.tree), parameters, Nothing())
        Body(Expressions(self, source, dict(parameters)), made).lower()
        made.writes = stored_through(made)
        count = self._names[source.name] = self._names.get(source.name, 0) + 1
        made.name = source.name if count == 1 else f"{source.name}_{count}"
        self.functions.append(made)
        self.sources[made.name] = kernel, arguments
        return made


def _about(tree: Any) -> str:
    import ast

    said = ast.get_docstring(tree) or ""
    return said.split("\n\n")[0]
