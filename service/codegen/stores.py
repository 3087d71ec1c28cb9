"""Which views a function stores through: a pointer to what it only reads is one to constants."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from service.codegen.tree import Assign, Bind, Expr, Fill, Function
from service.codegen.types import Array, Reference, Type


def may_be_constant(kind: Type) -> bool:
    """Whether C hands over a pointer of that type as one to constants: of an array of several axes ISO C does not."""
    return isinstance(kind, Reference) and not (isinstance(kind, Array) and len(kind.shape) > 1)


def stored_through(function: Function) -> set[str]:
    """Parameters and variables that `function` stores through, or hands to what may. Its callees have theirs."""
    stored: set[str] = set()
    names: dict[str, set[str]] = {}  # of a view -> what it is a view of
    for statement in _all(function.body):
        stored |= _stored_by(statement)
        if isinstance(statement, Bind) and isinstance(statement.value.type, Reference):
            roots = _roots(statement.value)
            names.setdefault(statement.name, set()).update(roots)
            if not may_be_constant(statement.value.type):  # is as constant as what it is a view of
                stored |= set() if roots else {statement.name}
                for root in roots:
                    names.setdefault(root, set()).add(statement.name)
        for value in _values(statement):
            stored |= _handed_on(value)
    while True:
        more = {root for name in stored for root in names.get(name, ())} - stored
        if not more:
            return stored
        stored |= more


def _all(statements: Iterable[Any]) -> Iterator[Any]:
    for one in statements:
        yield one
        for part in ("body", "otherwise"):
            yield from _all(getattr(one, part, ()))


def _values(statement: Any) -> Iterator[Expr]:
    return (value for value in vars(statement).values() if isinstance(value, Expr))


def _stored_by(statement: Any) -> set[str]:
    if isinstance(statement, Assign):
        return _roots(statement.target) if statement.target.op in ("field", "index") else set()
    return _roots(statement.array) if isinstance(statement, Fill) else set()


def _handed_on(value: Expr) -> set[str]:
    """Views in `value` that a function stores through, or that become part of values side by side."""
    found: set[str] = set()
    if value.op == "several":
        found = {root for one in value.args if isinstance(one.type, Reference) for root in _roots(one)}
    elif value.op == "call":
        for (name, kind), one in zip(value.value.parameters, value.args, strict=True):
            if isinstance(kind, Reference) and (name in value.value.writes or not may_be_constant(kind)):
                found |= _roots(one)
    return found.union(*map(_handed_on, value.args))


def _roots(view: Expr) -> set[str]:
    """The variables that it is a part of; none where a pointer in values side by side stands between."""
    if view.op == "var":
        return {view.value}
    if view.op == "cond":
        return _roots(view.args[1]) | _roots(view.args[2])
    return _roots(view.args[0]) if view.op in ("field", "index") else set()
