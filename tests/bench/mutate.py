"""Small wrong changes to Python source, one at a time: what a slip of the hand would leave behind."""

from __future__ import annotations

import ast
import copy
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
}
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
         "all": "any", "any": "all", "sin": "cos", "cos": "sin"}  # fmt: skip
ABOUT = ("annotation", "returns", "decorator_list", "bases", "keywords")
UNWRAPPED = {"abs", "sqrt", "sorted"}  # calls whose argument alone is left; float is not: a NumPy float is one


Path = tuple[tuple[str, int | None], ...]


@dataclass(frozen=True)
class Mutant:
    """One change. line: of the original. function: the innermost `def` it is in, its first line; 0 for the module.

    outer: qualified name of the outermost `def` whose body it is in, "" for none. compiled: by Numba.
    """

    file: str
    line: int
    function: int
    outer: str
    compiled: bool
    what: str
    path: Path
    change: ast.AST

    @property
    def key(self) -> str:
        """How the list of equivalents names it: file, change, the line's own text and which of several such it is."""
        return f"{self.file}: {self.what}"

    def of(self, source: str) -> str:
        """The changed source."""
        tree = ast.parse(source)
        _replace(tree, self.path, self.change)
        return ast.unparse(ast.fix_missing_locations(tree))


def mutants(file: str, source: str) -> Iterator[Mutant]:
    """Every mutant of a file, in the order of its lines."""
    lines, seen = source.splitlines(), Counter[str]()
    for path, node, function, outer, compiled in _places(ast.parse(source)):
        line = getattr(node, "lineno", 0)
        for what, change in _changes(node):
            text = f"{what} in `{lines[line - 1].strip()}`"
            seen[text] += 1  # like changes to like text are told apart by their number
            text += f" #{seen[text]}" * (seen[text] > 1)
            yield Mutant(file, line, function, outer, compiled, text, path, change)


Place = tuple[Path, ast.AST, int, str, bool]


def _places(tree: ast.Module) -> Iterator[Place]:
    """(where, node, first line of its function, outermost one, compiled) of what acts: no annotation, no message."""

    def walk(node: ast.AST, path: Path, function: int, outer: str, compiled: bool) -> Iterator[Place]:
        scope = ""
        if isinstance(node, ast.FunctionDef):
            function = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            compiled = compiled or any(re.match("kernel|njit|_compiled", ast.unparse(d)) for d in node.decorator_list)
            scope = outer if _body(outer) else f"{outer}{node.name}"
        elif hasattr(node, "lineno"):
            yield path, node, function, outer if _body(outer) else "", compiled
        if isinstance(node, ast.ClassDef):
            scope = f"{outer}{node.name}."
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.keyword) and node.arg == "strict":
            return  # that a zip's parts are as long as each other is checked, and acts on nothing
        for name, value in ast.iter_fields(node):
            if name in ABOUT and not isinstance(node, ast.Call):
                continue
            inside = scope if scope and name == "body" else outer
            for index, item in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(item, ast.AST):
                    yield from walk(item, (*path, (name, index)), function, inside, compiled)

    yield from walk(tree, (), 0, "", False)


def _body(outer: str) -> bool:
    """Whether a name is that of a function, not of the module or a class."""
    return bool(outer) and not outer.endswith(".")


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """What a node may be changed to, and what that is called."""
    yield from _of_value(node)
    yield from _of_operator(node)
    yield from _of_call(node)
    if isinstance(node, ast.IfExp):
        other = copy.deepcopy(node)
        other.body, other.orelse = other.orelse, other.body
        yield "branches swapped", other
    elif _acts(node):
        yield "line dropped", ast.Pass()
    elif isinstance(node, ast.Break):
        yield "break to continue", ast.Continue()
    elif isinstance(node, ast.Continue):
        yield "continue to break", ast.Break()


def _of_value(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        value = node.value
        changed = value + 1 if isinstance(value, int) else (2.0 * value if value else 1.0)
        yield f"{value!r} to {changed!r}", ast.Constant(changed)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} to {not node.value}", ast.Constant(not node.value)


def _of_operator(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    if isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            if type(operator) in COMPARISONS:
                other = copy.deepcopy(node)
                other.ops[index] = COMPARISONS[type(operator)]()
                yield f"{type(operator).__name__} turned", other
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        if not (isinstance(node.left, ast.Constant) and isinstance(node.left.value, str)):
            other = copy.deepcopy(node)
            other.op = OPERATORS[type(node.op)]()
            yield f"{type(node.op).__name__} to {type(other.op).__name__}", other
    elif isinstance(node, ast.AugAssign) and type(node.op) in OPERATORS:
        other = copy.deepcopy(node)
        other.op = OPERATORS[type(node.op)]()
        yield f"{type(node.op).__name__}= to {type(other.op).__name__}=", other
    elif isinstance(node, ast.BoolOp):
        other = copy.deepcopy(node)
        other.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "and/or swapped", other
    elif isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.UAdd) and type(node.operand) is not ast.Constant:
        yield f"{type(node.op).__name__} dropped", copy.deepcopy(node.operand)


def _of_call(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in NAMES:
            other = copy.deepcopy(node)
            if isinstance(other.func, ast.Attribute):
                other.func.attr = NAMES[name]
            else:
                other.func = ast.Name(NAMES[name], ast.Load())
            yield f"{name} to {NAMES[name]}", other
        if name in UNWRAPPED and len(node.args) == 1 and not node.keywords:
            yield f"{name} dropped", copy.deepcopy(node.args[0])


def _acts(node: ast.AST) -> bool:
    """Whether a statement is a bare call or fills an array."""
    if isinstance(node, ast.Assign):
        return isinstance(node.targets[0], ast.Subscript)
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)


def _replace(tree: ast.AST, path: Path, change: ast.AST) -> None:
    node = tree
    for name, index in path[:-1]:
        value = getattr(node, name)
        node = value if index is None else value[index]
    name, index = path[-1]
    if index is None:
        setattr(node, name, change)
    else:
        getattr(node, name)[index] = change
