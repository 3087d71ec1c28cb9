"""Expressions of a kernel, typed as Numba types them.

Widths below 64 bits count as 64, of which every value is the same. A construct that is not here is refused, with file
and line: what a back end writes is what the kernel says, or nothing.
"""

from __future__ import annotations

import ast
import enum
import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numba.core.registry import CPUDispatcher

from service.codegen.source import Source
from service.codegen.tree import Expr
from service.codegen.types import Array, Nothing, Record, Reference, Scalar, Several, Type

if TYPE_CHECKING:
    from service.codegen.program import Program

BOOL, INT, UINT, REAL, SINGLE = Scalar.BOOL, Scalar.INT, Scalar.UINT, Scalar.REAL, Scalar.SINGLE
_ARITHMETIC = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.FloorDiv: "floordiv", ast.Mod: "mod"}
_BITS = {ast.BitAnd: "bitand", ast.BitOr: "bitor", ast.BitXor: "bitxor"}
_COMPARISONS = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}
# Functions of one or two reals, in `math` or in NumPy, that C's math.h has under the same name.
_REAL_FUNCTIONS = {
    "sqrt", "sin", "cos", "tan", "tanh", "exp", "log", "hypot", "copysign", "atan2", "acos", "asin", "atan", "fabs",
}  # fmt: skip
_REAL_TESTS = {"isfinite", "isnan", "isinf"}
_ROUNDINGS = {"ceil": "ceil", "floor": "floor"}


def constant(value: Any) -> Expr:
    """A number, or what stands for one; anything else is `static`, and can be called or asked for an attribute."""
    if isinstance(value, bool | np.bool_):
        return Expr("const", BOOL, value=bool(value))
    if isinstance(value, int | np.integer) and not isinstance(value, enum.Enum):
        return Expr("const", INT, value=int(value))
    if isinstance(value, float | np.floating):
        return Expr("const", REAL, value=float(value))
    return Expr("static", Nothing(), value=value)


class Expressions:
    """Lowers expressions of one kernel. variables: name -> type, as far as is known."""

    def __init__(self, program: Program, source: Source, variables: dict[str, Type]) -> None:
        self.program, self.source, self.variables = program, source, variables
        self.counters: dict[str, tuple[int, int]] = {}  # loop variables within constant bounds: first, last
        self.rising: set[str] = set()  # loop variables that are never below zero

    def lower(self, node: ast.expr) -> Expr:
        """The typed tree of an expression.

        Raises:
            CodegenError: it uses what is not known.
        """
        found = self.place(node)
        if found.type is SINGLE:
            self.source.refuse(
                node, "a number in single precision: Numba counts on in it, where C does not; np.float64"
            )
        return found

    def place(self, node: ast.expr) -> Expr:
        """The same of what is stored to or widened, which may be of single precision."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            self.source.refuse(node, f"{type(node).__name__} is not supported")
        return method(node)

    def number(self, node: ast.expr) -> Expr:
        """The same of what must be a number."""
        found = self.lower(node)
        if not isinstance(found.type, Scalar):
            self.source.refuse(node, "a number is expected")
        return found

    def cast(self, node: ast.AST, value: Expr, kind: Type) -> Expr:
        """`value` as a `kind`; exact, but for a whole number that is made a real."""
        if value.type == kind:
            return value
        if (kind is REAL and value.type in (INT, BOOL)) or (kind is INT and value.type is BOOL):
            if value.is_constant:
                return Expr("const", kind, value=float(value.value) if kind is REAL else int(value.value))
            return Expr("cast", kind, (value,))
        if isinstance(kind, Several) and isinstance(value.type, Several) and value.op == "several":
            items = zip(value.args, kind.items, strict=True)
            return Expr("several", kind, tuple(self.cast(node, item, wanted) for item, wanted in items))
        return self.source.refuse(node, f"{value.type}, but {kind} is expected")

    def as_test(self, node: ast.expr) -> Expr:
        """What an `if` asks."""
        found = self.number(node)
        if found.type is BOOL:
            return found
        return Expr("ne", BOOL, (found, self.cast(node, constant(0), found.type)))

    def _constant(self, node: ast.Constant) -> Expr:
        if not isinstance(node.value, bool | int | float):
            self.source.refuse(node, "not a number")
        return constant(node.value)

    def _name(self, node: ast.Name) -> Expr:
        if node.id in self.variables:
            return Expr("var", self.variables[node.id], value=node.id)
        return constant(self.program.layout.constant(node.id, self.source.value(node)))

    def _attribute(self, node: ast.Attribute) -> Expr:
        base = self.lower(node.value)
        if base.op == "static":
            if not hasattr(base.value, node.attr):
                self.source.refuse(node, "no such attribute")
            return constant(self.program.layout.constant(node.attr, getattr(base.value, node.attr)))
        if isinstance(base.type, Record):
            return self._field(node, base)
        if isinstance(base.type, Several) and node.attr in base.type.names:
            place = base.type.names.index(node.attr)
            return Expr("item", base.type.items[place], (base,), node.attr)
        if node.attr == "value" and base.type is INT:  # of a choice between members of an enumeration
            return base
        return self.source.refuse(node, "no such field")

    def _field(self, node: ast.Attribute, base: Expr) -> Expr:
        assert isinstance(base.type, Record)
        known = self.program.layout.constant_field(base.type.dtype, node.attr)
        if known is not None:
            return constant(known)
        if node.attr not in self.program.layout.members(base.type.dtype):
            self.source.refuse(node, "no such field")
        return Expr("field", self.program.layout.field(base.type.dtype, node.attr), (base,), node.attr)

    def _subscript(self, node: ast.Subscript) -> Expr:
        base = self.lower(node.value)
        if isinstance(base.type, Several):
            return self._item(node, base)
        if not isinstance(base.type, Array):
            self.source.refuse(node, "this cannot be indexed")
        places = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for place in places:
            if not isinstance(base.type, Array):
                self.source.refuse(node, "more indices than the array has axes")
            base = Expr("index", base.type.item, (base, self._place(place, base.type.shape[0])))
        return base

    def _place(self, node: ast.expr, count: int) -> Expr:
        """An index into an axis of `count`; `const`, a loop variable within it, one that is not below zero (`within`),
        or what is to be wrapped (`at`)."""
        place = self.number(node)
        if place.type is not INT:
            self.source.refuse(node, "an index that is not an integer")
        if place.is_constant:
            found = place.value + count if place.value < 0 else place.value
            if not 0 <= found < count:
                self.source.refuse(node, f"an index beyond an axis of length {count}")
            return constant(found)
        first, last = self.counters.get(place.value, (-1, -1)) if place.op == "var" else (-1, -1)
        if first >= 0 and last < count:
            return place
        return Expr("within" if place.op == "var" and place.value in self.rising else "at", INT, (place,), count)

    def _item(self, node: ast.Subscript, base: Expr) -> Expr:
        assert isinstance(base.type, Several)
        place = self.number(node.slice)
        if place.is_constant:
            return Expr("item", base.type.items[place.value], (base,), place.value)
        if base.op != "var" or set(base.type.items) != {REAL} or base.type.names:
            self.source.refuse(node, "an index into values of different types")
        return Expr("item", REAL, (base, self._place(node.slice, len(base.type.items))))

    def _tuple(self, node: ast.Tuple) -> Expr:
        items = tuple(self.lower(item) for item in node.elts)
        return Expr("several", Several(tuple(item.type for item in items)), items)

    def _unaryop(self, node: ast.UnaryOp) -> Expr:
        if isinstance(node.op, ast.Not):
            return Expr("not", BOOL, (self.as_test(node.operand),))
        value = self.number(node.operand)
        if isinstance(node.op, ast.USub) and value.type in (INT, REAL):
            if value.is_constant:
                return constant(-value.value)
            return Expr("neg", value.type, (value,))
        if isinstance(node.op, ast.Invert) and value.type is INT:
            return constant(~value.value) if value.is_constant else Expr("invert", INT, (value,))
        return self.source.refuse(node, "this operator is not supported for this type")

    def _binop(self, node: ast.BinOp) -> Expr:
        return self.operate(node, type(node.op), self.number(node.left), self.number(node.right))

    def operate(self, node: ast.AST, sign: type, left: Expr, right: Expr) -> Expr:
        """`left sign right`, as Numba types it."""
        if sign is ast.Pow:
            return self._power(node, left, right)
        if sign is ast.Div:
            if UINT in (left.type, right.type):
                self.source.refuse(node, "division of unsigned numbers is not supported")
            return Expr("div", REAL, (self.cast(node, left, REAL), self.cast(node, right, REAL)))
        if sign in _BITS:
            if left.type is BOOL and right.type is BOOL:
                return Expr(_BITS[sign], BOOL, (left, right))
            if REAL in (left.type, right.type):
                self.source.refuse(node, "a bit operation on a real number")
            return self._whole(node, _BITS[sign], left, right)
        if sign not in _ARITHMETIC:
            self.source.refuse(node, f"{sign.__name__} is not supported")
        if REAL in (left.type, right.type):
            if sign in (ast.FloorDiv, ast.Mod):
                self.source.refuse(node, "the remainder of real numbers is not supported")
            return Expr(_ARITHMETIC[sign], REAL, (self.cast(node, left, REAL), self.cast(node, right, REAL)))
        return self._whole(node, _ARITHMETIC[sign], left, right)

    def _whole(self, node: ast.AST, name: str, left: Expr, right: Expr) -> Expr:
        if UINT in (left.type, right.type):
            if left.type is not right.type or name in ("floordiv", "mod"):
                self.source.refuse(node, "signed with unsigned numbers, which Numba converts to a real number")
            return Expr(name, UINT, (left, right))
        left, right = self.cast(node, left, INT), self.cast(node, right, INT)
        if left.is_constant and right.is_constant and not (name in ("floordiv", "mod") and right.value == 0):
            fold: dict[str, Callable[[int, int], int]] = {
                "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b,
                "floordiv": lambda a, b: a // b, "mod": lambda a, b: a % b,
                "bitand": lambda a, b: a & b, "bitor": lambda a, b: a | b, "bitxor": lambda a, b: a ^ b,
            }  # fmt: skip
            return constant(fold[name](left.value, right.value))
        return Expr(name, INT, (left, right))

    def _power(self, node: ast.AST, left: Expr, right: Expr) -> Expr:
        """By a whole constant, which Numba makes products of, or by a real."""
        if left.type is REAL and right.type is INT and right.is_constant:
            return Expr("power", REAL, (left,), right.value)
        if REAL not in (left.type, right.type) or UINT in (left.type, right.type) or INT in (right.type,):
            self.source.refuse(node, "a power of these types is not supported")
        return Expr("math", REAL, (self.cast(node, left, REAL), self.cast(node, right, REAL)), "pow")

    def _compare(self, node: ast.Compare) -> Expr:
        operands = [self.number(one) for one in (node.left, *node.comparators)]
        tests = []
        for n, sign in enumerate(node.ops):
            if type(sign) not in _COMPARISONS:
                self.source.refuse(node, f"{type(sign).__name__} is not supported")
            tests.append(self._comparison(node, _COMPARISONS[type(sign)], operands[n], operands[n + 1]))
        if len(tests) > 1 and any(_calls(operand) for operand in operands[1:-1]):
            self.source.refuse(node, "a call between two comparisons")
        return tests[0] if len(tests) == 1 else Expr("all", BOOL, tuple(tests))

    def _comparison(self, node: ast.AST, name: str, left: Expr, right: Expr) -> Expr:
        if REAL in (left.type, right.type):
            left, right = self.cast(node, left, REAL), self.cast(node, right, REAL)
        elif UINT in (left.type, right.type):
            if left.type is not right.type:
                self.source.refuse(node, "a comparison of signed and unsigned numbers")
        else:
            left, right = self.cast(node, left, INT), self.cast(node, right, INT)
        if left.is_constant and right.is_constant:
            return constant(getattr(operator, name)(left.value, right.value))
        return Expr(name, BOOL, (left, right))

    def _boolop(self, node: ast.BoolOp) -> Expr:
        tests = tuple(self.number(value) for value in node.values)
        if any(test.type is not BOOL for test in tests):
            self.source.refuse(node, "`and` or `or` of a value that is not Boolean")
        decides = isinstance(node.op, ast.Or)  # a test that comes out so
        if any(test.is_constant and test.value == decides for test in tests) and not any(map(_calls, tests)):
            return constant(decides)
        open_ones = tuple(test for test in tests if not test.is_constant or test.value == decides)
        if len(open_ones) < 2:
            return open_ones[0] if open_ones else constant(not decides)
        return Expr("any" if decides else "all", BOOL, open_ones)

    def _ifexp(self, node: ast.IfExp) -> Expr:
        test, chosen = self.as_test(node.test), [self.lower(node.body), self.lower(node.orelse)]
        chosen = [
            constant(int(one.value)) if one.op == "static" and isinstance(one.value, enum.IntEnum) else one
            for one in chosen
        ]
        kinds = {one.type for one in chosen}
        if kinds == {INT, REAL}:
            kinds, chosen = {REAL}, [self.cast(node, one, REAL) for one in chosen]
        if len(kinds) > 1 or isinstance(chosen[0].type, Several | Nothing):
            self.source.refuse(node, "a choice between values of different types")
        if test.is_constant:
            return chosen[0] if test.value else chosen[1]
        return Expr("cond", chosen[0].type, (test, *chosen))

    def _call(self, node: ast.Call) -> Expr:
        called = self.lower(node.func)
        if called.op != "static":
            self.source.refuse(node, "a call of something that is not a function")
        function = called.value
        if isinstance(function, CPUDispatcher):
            return self._kernel(node, function)
        if isinstance(function, type) and issubclass(function, tuple) and hasattr(function, "_fields"):
            return self._bundle(node, function)
        if node.keywords or any(isinstance(one, ast.Starred) for one in node.args):
            self.source.refuse(node, "named arguments of a function")
        arguments = [self.place(one) if function is np.float64 else self.lower(one) for one in node.args]
        return self._builtin(node, function, arguments)

    def _kernel(self, node: ast.Call, function: CPUDispatcher) -> Expr:
        if node.keywords:
            self.source.refuse(node, "named arguments of a kernel")
        arguments = tuple(self.lower(one) for one in node.args)
        if any(not isinstance(one.type, Scalar | Several | Reference) for one in arguments):
            self.source.refuse(node, "an argument that is not a value")
        if any(one.op == "several" for one in arguments):
            self.source.refuse(node, "a tuple made inside a call: assign it to a name first")
        made = self.program.function(function, tuple(one.type for one in arguments))
        return Expr("call", made.returns, arguments, made)

    def _bundle(self, node: ast.Call, kind: Any) -> Expr:
        """A NamedTuple."""
        given = dict(zip(kind._fields, node.args, strict=False))
        given |= {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg}
        if set(given) != set(kind._fields):
            self.source.refuse(node, "not every field is given, or an unknown one")
        items = tuple(self.lower(given[name]) for name in kind._fields)
        return Expr("several", Several(tuple(i.type for i in items), kind._fields, kind.__name__), items)

    def _builtin(self, node: ast.Call, function: Any, arguments: list[Expr]) -> Expr:
        name, kinds = getattr(function, "__name__", "?"), [one.type for one in arguments]
        if function is len and len(arguments) == 1 and isinstance(kinds[0], Array):
            return constant(kinds[0].shape[0])
        if function is len and len(arguments) == 1 and isinstance(arguments[0].value, tuple):
            return constant(len(arguments[0].value))
        if any(not isinstance(kind, Scalar) for kind in kinds):
            self.source.refuse(node, f"{name} of something that is not a number")
        if function in (max, min) and len(arguments) > 1:
            return self._extreme(node, name, arguments)
        if function in (int, np.int64, float, np.float64, bool) and len(arguments) == 1:
            return self._converted(node, function, arguments[0])
        is_math = function is getattr(math, name, None) or function is getattr(np, name, None)
        if function is abs and len(arguments) == 1 and kinds[0] in (INT, REAL):
            return Expr("math", kinds[0], (arguments[0],), "fabs" if kinds[0] is REAL else "abs")
        if function is round and kinds == [REAL]:
            return Expr("math", INT, (arguments[0],), "round")
        if is_math and name in _REAL_FUNCTIONS:
            return Expr("math", REAL, tuple(self.cast(node, one, REAL) for one in arguments), name)
        if is_math and name in _REAL_TESTS and kinds == [REAL]:
            return Expr("math", BOOL, tuple(arguments), name)
        if function in (math.ceil, math.floor) and kinds == [REAL]:
            return Expr("math", INT, tuple(arguments), _ROUNDINGS[name])
        return self.source.refuse(node, f"{name} of {len(arguments)} such arguments is not supported")

    def _extreme(self, node: ast.Call, name: str, arguments: list[Expr]) -> Expr:
        found = arguments[0]
        for one in arguments[1:]:
            kind = REAL if REAL in (found.type, one.type) else INT
            found = Expr("math", kind, (self.cast(node, found, kind), self.cast(node, one, kind)), name)
        return found

    def _converted(self, node: ast.Call, function: Any, value: Expr) -> Expr:
        if function is bool:
            return value if value.type is BOOL else Expr("ne", BOOL, (value, self.cast(node, constant(0), value.type)))
        if function in (float, np.float64):
            return Expr("cast", REAL, (value,)) if value.type is SINGLE else self.cast(node, value, REAL)
        if value.type is UINT:
            return Expr("cast", INT, (value,))
        if value.type is REAL:
            return Expr("math", INT, (value,), "trunc")
        return self.cast(node, value, INT)


def _calls(value: Expr) -> bool:
    return value.op == "call" or any(_calls(one) for one in value.args if isinstance(one, Expr))
