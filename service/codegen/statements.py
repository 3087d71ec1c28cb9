"""Statements of a kernel."""

from __future__ import annotations

import ast
from typing import Any

from service.codegen.expressions import INT, REAL, SINGLE, Expressions, constant
from service.codegen.tree import Assign, Bind, Do, Expr, Fill, For, Function, If, Leave, Return
from service.codegen.types import Array, Nothing, Reference, Scalar, Several, Type, unified

_PASSES = 6  # until the types of variables that a loop carries are known; two are what it takes


class Body:
    """Lowers the statements of one kernel into a `Function`."""

    def __init__(self, expressions: Expressions, function: Function) -> None:
        self.expressions, self.function = expressions, function
        self.source, self.variables = expressions.source, expressions.variables
        self._parameters = {name for name, _ in function.parameters}
        self._names = [one for one in ast.walk(self.source.tree) if isinstance(one, ast.Name)]
        loops = [one for one in ast.walk(self.source.tree) if isinstance(one, ast.For)]
        self._inside = {loop: {id(one) for one in ast.walk(loop)} for loop in loops}
        self._temporaries = 0

    def lower(self) -> None:
        """Fill body, variables and the type that is returned.

        Raises:
            CodegenError: a construct that is not known, or types that do not settle.
        """
        for _ in range(_PASSES):
            before = dict(self.variables), self.function.returns
            self._temporaries = 0
            self.function.body = self._block(self.source.tree.body)
            if (dict(self.variables), self.function.returns) == before:
                break
        else:
            self.source.refuse(self.source.tree, "the types of its variables cannot be determined")
        if self.function.returns != Nothing() and not _ends(self.function.body):
            self.source.refuse(self.source.tree, "a path that returns no value")
        own = {name: kind for name, kind in self.variables.items() if name not in self._parameters}
        self.function.variables = own

    def _block(self, nodes: list[ast.stmt]) -> list[Any]:
        return [statement for node in nodes for statement in self._statement(node)]

    def _statement(self, node: ast.stmt) -> list[Any]:
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            self.source.refuse(node, f"{type(node).__name__} is not supported")
        return method(node)

    def _expr(self, node: ast.Expr) -> list[Any]:
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return []
        call = self.expressions.lower(node.value)
        if call.op != "call":
            self.source.refuse(node, "an expression without effect")
        return [Do(call)]

    def _pass(self, node: ast.Pass) -> list[Any]:
        return []

    def _break(self, node: ast.Break) -> list[Any]:
        return [Leave("break")]

    def _continue(self, node: ast.Continue) -> list[Any]:
        return [Leave("continue")]

    def _return(self, node: ast.Return) -> list[Any]:
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            self._returns(node, Nothing())
            return [Return(None)]
        value = self.expressions.lower(node.value)
        if isinstance(value.type, Reference) or value.op == "static":
            self.source.refuse(node, "it returns a view of an array")
        self._returns(node, value.type)
        if value.type == Nothing():
            return [Do(value), Return(None)]
        return [Return(self.expressions.cast(node, value, self.function.returns))]

    def _returns(self, node: ast.Return, kind: Type) -> None:
        before = self.function.returns
        found = kind if before == Nothing() else unified(before, kind)
        if found is None:
            self.source.refuse(node, f"returns {kind} here, {before} elsewhere")
        self.function.returns = found

    def _if(self, node: ast.If) -> list[Any]:
        test = self.expressions.as_test(node.test)
        if test.is_constant:  # a robot's layout decides
            return self._block(node.body if test.value else node.orelse)
        return [If(test, self._block(node.body), self._block(node.orelse))]

    def _for(self, node: ast.For) -> list[Any]:
        call = node.iter
        is_range = isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"
        if not is_range or not isinstance(node.target, ast.Name) or node.orelse or call.keywords:  # pyright: ignore
            self.source.refuse(node, "a loop over anything but a range")
        bounds = [self.expressions.number(one) for one in call.args]  # pyright: ignore[reportAttributeAccessIssue]
        start, stop = (constant(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = bounds[2] if len(bounds) > 2 else constant(1)
        if {start.type, stop.type} != {INT} or not step.is_constant or step.value == 0:
            self.source.refuse(node, "a range that is not of integers, or whose step is not a constant")
        name = self._counter(node)
        statements: list[Any] = []
        start, stop = (self._once(bound, statements) for bound in (start, stop))
        if start.is_constant and stop.is_constant:
            reached = range(start.value, stop.value, step.value)
            if reached:
                self.expressions.counters[name] = min(reached), max(reached)
        if start.is_constant and start.value >= 0 and step.value > 0:
            self.expressions.rising.add(name)
        self.variables[name] = INT
        body = self._block(node.body)
        self.expressions.counters.pop(name, None)
        self.expressions.rising.discard(name)
        del self.variables[name]
        return [*statements, For(name, start, stop, step.value, body)]

    def _counter(self, node: ast.For) -> str:
        """The name of the loop's variable, which nothing else may set, nor read behind the loop."""
        assert isinstance(node.target, ast.Name)
        name = node.target.id
        inside, others = self._inside[node], [one for one in self._names if one.id == name]
        if name == "_" and all(isinstance(one.ctx, ast.Store) for one in others):
            self._temporaries += 1
            return f"turn_{self._temporaries}"
        for other in others:
            set_inside = isinstance(other.ctx, ast.Store) and id(other) in inside and other is not node.target
            if set_inside or (id(other) not in inside and not self._of_another_loop(other)):
                self.source.refuse(other, f"the loop variable {name!r} is used outside its loop, or set in it")
        return name

    def _of_another_loop(self, name: ast.Name) -> bool:
        return any(
            isinstance(loop.target, ast.Name) and loop.target.id == name.id and id(name) in inside
            for loop, inside in self._inside.items()
        )

    def _once(self, value: Expr, statements: list[Any]) -> Expr:
        """`value`, worked out before where it might be another later."""
        if value.is_constant:
            return value
        return self._keep(value, statements)

    def _keep(self, value: Expr, statements: list[Any]) -> Expr:
        self._temporaries += 1
        name = f"kept_{self._temporaries}"
        self.variables[name] = value.type
        target = Expr("var", value.type, value=name)
        is_view = isinstance(value.type, Reference | Several)
        statements.append(Bind(name, value) if is_view else Assign(target, value))
        return target

    def _assign(self, node: ast.Assign) -> list[Any]:
        if isinstance(node.value, ast.IfExp) and isinstance(node.targets[0], ast.Tuple):
            return self._choose(node, node.value)
        value = self.expressions.lower(node.value)
        if value.op == "static":
            self.source.refuse(node, "no value")
        statements: list[Any] = []
        if len(node.targets) > 1 and isinstance(value.type, Scalar) and not value.is_constant:
            value = self._keep(value, statements)
        for target in node.targets:
            statements += self._store(node, target, value)
        return statements

    def _choose(self, node: ast.Assign, choice: ast.IfExp) -> list[Any]:
        """`a, b = one if test else other`, which is what an `if` does."""
        test = self.expressions.as_test(choice.test)
        one, other = (
            self._assign(ast.copy_location(ast.Assign(node.targets, value), node))
            for value in (choice.body, choice.orelse)
        )
        return [If(test, one, other)]

    def _annassign(self, node: ast.AnnAssign) -> list[Any]:
        return self.source.refuse(node, "annotated variables are not supported")

    def _augassign(self, node: ast.AugAssign) -> list[Any]:
        load = ast.copy_location(_loaded(node.target), node.target)
        before, by = self.expressions.place(load), self.expressions.number(node.value)
        if before.type is SINGLE and by.type is REAL:  # Numba counts in the wider of the two
            before = Expr("cast", REAL, (before,))
        if not isinstance(before.type, Scalar) or before.type is SINGLE:
            self.source.refuse(node, f"{before.type} changed by {by.type}")
        return self._store(node, node.target, self.expressions.operate(node, type(node.op), before, by))

    def _store(self, node: ast.stmt, target: ast.expr, value: Expr) -> list[Any]:
        if isinstance(target, ast.Tuple):
            return self._spread(node, target, value)
        if isinstance(target, ast.Name):
            return self._set(node, target.id, value)
        if isinstance(target, ast.Subscript) and any(isinstance(one, ast.Slice) for one in ast.walk(target.slice)):
            return [self._sliced(target, value)]
        place = self.expressions.place(target)
        if isinstance(place.type, Array) and isinstance(value.type, Scalar):
            return [self._fill(node, place, value)]
        if not isinstance(place.type, Scalar):
            self.source.refuse(node, "a value stored into something that is not a number")
        if place.type is INT and value.type is REAL:
            self.source.refuse(node, "a real number stored as an integer")
        wanted = REAL if place.type is SINGLE else place.type  # which the back end makes narrow as it stores
        return [Assign(place, self.expressions.cast(node, value, wanted))]

    def _set(self, node: ast.stmt, name: str, value: Expr) -> list[Any]:
        before = self.variables.get(name)
        kind = value.type if before is None else unified(before, value.type)
        if kind is None or kind == Nothing():
            self.source.refuse(node, f"{name!r} is {before}, but {value.type} here")
        if name in self._parameters and kind != before:
            self.source.refuse(node, f"the type of the parameter {name!r} changes")
        self.variables[name] = kind
        if isinstance(kind, Scalar):
            return [Assign(Expr("var", kind, value=name), self.expressions.cast(node, value, kind))]
        if isinstance(kind, Several) and value.op != "several":
            self.source.refuse(node, "one name for a tuple")
        return [Bind(name, value)]

    def _spread(self, node: ast.stmt, target: ast.Tuple, value: Expr) -> list[Any]:
        """Values side by side, each to its own target; all are worked out before the first is stored."""
        statements: list[Any] = []
        if not isinstance(value.type, Several) or len(value.type.items) != len(target.elts):
            self.source.refuse(node, "the numbers of values and targets differ")
        if value.op == "several":
            items = list(value.args)
            if not _apart(target, items):
                items = [one if one.is_constant else self._keep(one, statements) for one in items]
        else:
            whole = value if value.op == "var" else self._keep(value, statements)
            items = [Expr("item", kind, (whole,), n) for n, kind in enumerate(value.type.items)]
        for one, item in zip(target.elts, items, strict=True):
            statements += self._store(node, one, item)
        return statements

    def _sliced(self, target: ast.Subscript, value: Expr) -> Fill:
        """`a[:] = x`, `a[:, 1:] = x`."""
        places = target.slice.elts if isinstance(target.slice, ast.Tuple) else [target.slice]
        array = self.expressions.lower(target.value)
        if not isinstance(array.type, Array) or len(places) > len(array.type.shape):
            self.source.refuse(target, "a slice of something that is not an array")
        first = 0
        for n, place in enumerate(places):
            if not isinstance(place, ast.Slice) or place.upper is not None or place.step is not None:
                self.source.refuse(target, "a slice that is neither `:` nor `n:`")
            if place.lower is not None:
                lower = self.expressions.number(place.lower)
                if not lower.is_constant or n + 1 != len(array.type.shape):
                    self.source.refuse(target, "a slice that starts at no constant, or is not along the last axis")
                first = lower.value
        return self._fill(target, array, value, first)

    def _fill(self, node: ast.AST, array: Expr, value: Expr, first: int = 0) -> Fill:
        assert isinstance(array.type, Array)
        if not isinstance(array.type.element, str) or not value.is_constant:
            self.source.refuse(node, "an array filled with something that is not a constant, or an array of records")
        kind = REAL if array.type.element[0] == "f" else INT
        return Fill(array, self.expressions.cast(node, value, kind), first)


def _loaded(target: ast.expr) -> ast.expr:
    """The same place, read."""
    if isinstance(target, ast.Name):
        return ast.Name(target.id, ast.Load())
    if isinstance(target, ast.Attribute):
        return ast.Attribute(target.value, target.attr, ast.Load())
    assert isinstance(target, ast.Subscript)
    return ast.Subscript(target.value, target.slice, ast.Load())


def _apart(target: ast.Tuple, items: list[Expr]) -> bool:
    """Whether no target is read by a later value."""
    names = [one.id if isinstance(one, ast.Name) else None for one in target.elts]
    return None not in names and not any(_reads(item, names[m]) for n, item in enumerate(items) for m in range(n))


def _reads(value: Expr, name: str | None) -> bool:
    return (value.op == "var" and value.value == name) or any(_reads(one, name) for one in value.args)


def _ends(body: list[Any]) -> bool:
    """Whether every way through `body` returns."""
    last = body[-1] if body else None
    if isinstance(last, If):
        return _ends(last.body) and _ends(last.otherwise)
    return isinstance(last, Return)
