"""C99 of kernels: one `static` function each, in the order and with the rounding of the service.

Nothing is contracted or reordered: a compiler that keeps to IEEE 754 (gcc and clang with `-ffp-contract=off`, without
`-ffast-math`) makes the bits that Numba's does. What Python does and C does not is a small function each: a rest with
the sign of its divisor, an index from the end, the choice of `max` where a number is none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from service.codegen.program import Layout, Program
from service.codegen.stores import may_be_constant
from service.codegen.tree import Assign, Bind, Do, Expr, Fill, For, Function, If, Leave, Return, named
from service.codegen.types import Array, Nothing, Record, Reference, Scalar, Several, Type, stored

SCALARS = {Scalar.BOOL: "bool", Scalar.INT: "int64_t", Scalar.UINT: "uint64_t", Scalar.REAL: "double"}
STORED = {
    "f8": "double",
    "f4": "float",
    "i8": "int64_t",
    "u8": "uint64_t",
    "i4": "int32_t",
    "u4": "uint32_t",
    "i2": "int16_t",
    "u1": "uint8_t",
}
ZERO = {Scalar.BOOL: "false", Scalar.INT: "0", Scalar.UINT: "0U", Scalar.REAL: "0.0"}
# of C99, of its headers that are included, and what GNU C knows beside
_RESERVED = frozenset({
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "float",
    "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof",
    "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "bool", "true", "false",
    "asm", "typeof", "linux", "unix", "at", "within", "main",
})  # fmt: skip
_BINARY = {
    "mul": ("*", 6), "div": ("/", 6), "add": ("+", 5), "sub": ("-", 5),
    "lt": ("<", 4), "le": ("<=", 4), "gt": (">", 4), "ge": (">=", 4), "eq": ("==", 3), "ne": ("!=", 3),
    "bitand": ("&", 2), "bitor": ("|", 2), "bitxor": ("^", 2), "all": ("&&", 1), "any": ("||", 1),
}  # fmt: skip
_ATOM, _UNARY, _LOOSE = 9, 8, 0
UNROLLED = 4  # turns, of joints and matrices, up to which a loop is said to be written out: gcc does not at -O2
# Beyond these a real is no int64, and the conversion is not defined in C; what it gives here is what x86 gives.
HELPERS = {
    "within": """static inline int64_t within(int64_t place, int64_t count)
{
    CHECK((place >= 0) && (place < count));
    (void)count;
    return place;
}""",
    "at": """static inline int64_t at(int64_t place, int64_t count)
{
    const int64_t found = (place < 0) ? (place + count) : place;
    CHECK((found >= 0) && (found < count));
    return found;
}""",
    "rest": """static inline int64_t rest_of(int64_t value, int64_t by)
{
    const int64_t left = value % by;
    return ((left != 0) && ((left < 0) != (by < 0))) ? (left + by) : left;
}""",
    "floor": """static inline int64_t floor_of(int64_t value, int64_t by)
{
    const int64_t whole = value / by;
    return (((value % by) != 0) && ((value < 0) != (by < 0))) ? (whole - 1) : whole;
}""",
    "whole": """static inline int64_t whole_of(double value)
{
    return ((value >= -9223372036854775808.0) && (value < 9223372036854775808.0)) ? (int64_t)value : INT64_MIN;
}""",
    "max": """static inline double max_of(double one, double other)
{
    return (other > one) ? other : one;
}""",
    "min": """static inline double min_of(double one, double other)
{
    return (other < one) ? other : one;
}""",
    "max_whole": """static inline int64_t max_whole(int64_t one, int64_t other)
{
    return (other > one) ? other : one;
}""",
    "min_whole": """static inline int64_t min_whole(int64_t one, int64_t other)
{
    return (other < one) ? other : one;
}""",
    "abs_whole": """static inline int64_t abs_whole(int64_t value)
{
    return (value < 0) ? -value : value;
}""",
}


def number(value: Any, kind: Scalar) -> str:
    """A constant."""
    if kind is Scalar.BOOL:
        return "true" if value else "false"
    if kind is Scalar.REAL:
        if math.isnan(value):
            return "(double)NAN"
        if math.isinf(value):
            return "(double)INFINITY" if value > 0 else "(-(double)INFINITY)"
        return repr(float(value)) if math.copysign(1.0, value) > 0 else f"({float(value)!r})"
    if kind is Scalar.UINT:
        return f"UINT64_C({value})"
    if value == -(2**63):
        return "INT64_MIN"
    text = str(value) if abs(value) < 2**31 else f"INT64_C({value})"
    return text if value >= 0 else f"({text})"


def word(name: str) -> str:
    """`name` as C takes it."""
    return f"{name}_" if name in _RESERVED else name


class Writer:
    """prefix: of the names of types."""

    def __init__(self, layout: Layout, prefix: str) -> None:
        self.layout, self.prefix = layout, prefix
        self.helpers: set[str] = set()
        self.powers: set[int] = set()

    # types

    def record(self, dtype: np.dtype) -> str:
        return f"{self.prefix}_{self.layout.names[dtype]}"

    def element(self, element: str | Record) -> str:
        return self.record(element.dtype) if isinstance(element, Record) else STORED[element]

    def declared(self, kind: Type, name: str, read_only: bool = False) -> str:
        """A variable, parameter or field of a view; views are pointers. read_only: nothing is stored through it."""
        if read_only:
            return f"const {self.declared(kind, name)}"
        if isinstance(kind, Scalar):
            return f"{SCALARS[kind]} {name}"
        if isinstance(kind, Record):
            return f"{self.record(kind.dtype)} *{name}"
        if isinstance(kind, Array):
            inner = "".join(f"[{count}]" for count in kind.shape[1:])
            return (
                f"{self.element(kind.element)} (*{name}){inner}" if inner else f"{self.element(kind.element)} *{name}"
            )
        assert isinstance(kind, Several)
        return f"{self.bundle(kind)} *{name}"

    def bundle(self, kind: Several) -> str:
        return f"{self.prefix}_{kind.title.lower()}"

    def result(self, function: Function) -> str:
        return f"{function.name}_result"

    def member(self, dtype: np.dtype, name: str) -> str:
        """The declaration of a record's field."""
        kind = self.layout.field(dtype, name)
        if isinstance(kind, Record):
            return f"{self.record(kind.dtype)} {word(name)}"
        if isinstance(kind, Array):
            return f"{self.element(kind.element)} {word(name)}" + "".join(f"[{count}]" for count in kind.shape)
        return f"{STORED[dtype[name].str[1:]]} {word(name)}"

    # expressions

    def text(self, value: Expr, least: int = _LOOSE) -> str:
        """`value`, in brackets where it binds looser than `least`."""
        found, binds = self._written(value)
        return found if binds >= least else f"({found})"

    def _written(self, value: Expr) -> tuple[str, int]:
        method = getattr(self, f"_{value.op}", None)
        if method is not None:
            return method(value)
        if value.op in _BINARY:
            return self._binary(value)
        raise AssertionError(value.op)

    def _const(self, value: Expr) -> tuple[str, int]:
        assert isinstance(value.type, Scalar)
        return number(value.value, value.type), _ATOM

    def _var(self, value: Expr) -> tuple[str, int]:
        return word(value.value), _ATOM

    def _field(self, value: Expr) -> tuple[str, int]:
        return self._read(value, self._field_place(value))

    def _index(self, value: Expr) -> tuple[str, int]:
        return self._read(value, self._index_place(value))

    def _read(self, value: Expr, place: str) -> tuple[str, int]:
        """What stands at a place; in C a narrow number would be reckoned with as an `int`."""
        return (f"(int64_t){place}", _UNARY) if self._narrow(value) else (place, _ATOM)

    def place(self, value: Expr) -> str:
        """Where a number is stored."""
        if value.op == "field":
            return self._field_place(value)
        return self._index_place(value) if value.op == "index" else self.text(value)

    def _field_place(self, value: Expr) -> str:
        base = value.args[0]
        if base.op in ("var", "item"):
            return f"{self.text(base, _ATOM)}->{word(value.value)}"
        return f"{self.text(base, _ATOM)}.{word(value.value)}"

    def _index_place(self, value: Expr) -> str:
        return f"{self.text(value.args[0], _ATOM)}[{self.text(value.args[1])}]"

    def _item(self, value: Expr) -> tuple[str, int]:
        base = value.args[0]
        if len(value.args) > 1:
            return f"{self.text(base, _ATOM)}[{self.text(value.args[1])}]", _ATOM
        if isinstance(value.value, str):
            return f"{self.text(base, _ATOM)}->{word(value.value)}", _ATOM
        if base.op == "var" and not base.value.startswith("kept_"):
            return f"{self.text(base, _ATOM)}[{value.value}]", _ATOM
        return f"{self.text(base, _ATOM)}.part_{value.value}", _ATOM

    def _at(self, value: Expr) -> tuple[str, int]:
        self.helpers.add("at")
        return f"at({self.text(value.args[0])}, {value.value})", _ATOM

    def _within(self, value: Expr) -> tuple[str, int]:
        self.helpers.add("within")
        return f"within({self.text(value.args[0])}, {value.value})", _ATOM

    def _cast(self, value: Expr) -> tuple[str, int]:
        assert isinstance(value.type, Scalar)
        of = value.args[0]
        inner = self.place(of) if of.op in ("field", "index") else self.text(of, _UNARY)
        return f"({SCALARS[value.type]}){inner}", _UNARY

    def _neg(self, value: Expr) -> tuple[str, int]:
        return f"-{self.text(value.args[0], _ATOM)}", _UNARY

    def _invert(self, value: Expr) -> tuple[str, int]:
        return f"~{self.text(value.args[0], _ATOM)}", _UNARY

    def _not(self, value: Expr) -> tuple[str, int]:
        return f"!({self.text(value.args[0])})", _UNARY

    def _cond(self, value: Expr) -> tuple[str, int]:
        test, one, other = (self.text(part, 1) for part in value.args)
        return f"({test}) ? {one} : {other}", _LOOSE

    def _binary(self, value: Expr) -> tuple[str, int]:
        sign, binds = _BINARY[value.op]
        if binds >= 5:
            left, right = value.args
            return f"{self.text(left, binds)} {sign} {self.text(right, binds + 1)}", binds
        # of what binds looser than a sum, brackets are for the reader and for -Wparentheses
        return f" {sign} ".join(self.text(part, 5) for part in value.args), binds

    def _floordiv(self, value: Expr) -> tuple[str, int]:
        self.helpers.add("floor")
        return f"floor_of({self._list(value.args)})", _ATOM

    def _mod(self, value: Expr) -> tuple[str, int]:
        self.helpers.add("rest")
        return f"rest_of({self._list(value.args)})", _ATOM

    def _power(self, value: Expr) -> tuple[str, int]:
        self.powers.add(value.value)
        return f"power_{_count(value.value)}({self.text(value.args[0])})", _ATOM

    def _math(self, value: Expr) -> tuple[str, int]:
        name, arguments = value.value, self._list(value.args)
        if name in ("round", "trunc", "ceil", "floor"):
            self.helpers.add("whole")
            inner = {"round": f"rint({arguments})", "trunc": arguments}.get(name, f"{name}({arguments})")
            return f"whole_of({inner})", _ATOM
        if name in ("max", "min", "abs"):
            helper = name if value.type is Scalar.REAL else f"{name}_whole"
            self.helpers.add(helper)
            return f"{helper if value.type is Scalar.INT else f'{name}_of'}({arguments})", _ATOM
        if value.type is Scalar.BOOL:
            return f"{name}({arguments}) != 0", _BINARY["ne"][1]
        return f"{name}({arguments})", _ATOM

    def _call(self, value: Expr) -> tuple[str, int]:
        return f"{value.value.name}({', '.join(self._argument(one) for one in value.args)})", _ATOM

    def _argument(self, value: Expr) -> str:
        if isinstance(value.type, Record):
            return self.address(value)
        return self.text(value)

    def address(self, value: Expr) -> str:
        """A pointer to the record that `value` is a view of."""
        if value.op in ("var", "item"):
            return self.text(value)
        return f"&{self.text(value, _ATOM)}"

    def _list(self, values: Sequence[Expr]) -> str:
        return ", ".join(self.text(one) for one in values)

    # statements

    def block(self, function: Function, statements: Iterable[Any], depth: int) -> list[str]:
        lines = []
        for statement in statements:
            written = getattr(self, f"_{type(statement).__name__.lower()}")(function, statement)
            lines += ["    " * depth + line for line in written]
        return lines

    def _assign(self, function: Function, statement: Assign) -> list[str]:
        target, value = statement.target, self.text(statement.value)
        narrow = self._narrow(target)
        if narrow:
            value = f"({narrow}){self.text(statement.value, _UNARY)}"
        return [f"{self.place(target)} = {value};"]

    def _narrow(self, target: Expr) -> str:
        """The type that a number is stored as, where that is not what it is worth."""
        if not isinstance(target.type, Scalar):
            return ""
        if target.op == "field":
            holder = target.args[0].type
            assert isinstance(holder, Record)
            code = holder.dtype[target.value].base.str[1:]
        elif target.op == "index":
            array = target.args[0].type
            assert isinstance(array, Array)
            assert isinstance(array.element, str)
            code = array.element
        else:
            return ""
        return STORED[code] if code not in ("f8", "i8", "u8") else ""

    def _bind(self, function: Function, statement: Bind) -> list[str]:
        value, name = statement.value, word(statement.name)
        if isinstance(value.type, Record):
            return [f"{name} = {self.address(value)};"]
        if isinstance(value.type, Array):
            return [f"{name} = {self.text(value)};"]
        if value.op == "call":
            return [f"{name} = {self.text(value)};"]
        assert isinstance(value.type, Several)
        if value.type.names:
            fields = zip(value.type.names, value.args, strict=True)
            return [f"{name}->{word(field)} = {self._argument(item)};" for field, item in fields]
        return [f"{name}[{n}] = {self.text(item)};" for n, item in enumerate(value.args)]

    def _fill(self, function: Function, statement: Fill) -> list[str]:
        array = statement.array
        assert isinstance(array.type, Array)
        lines, places = [], ""
        for n, count in enumerate(array.type.shape):
            first = statement.first if n + 1 == len(array.type.shape) else 0
            lines.append("    " * n + f"for (int64_t axis_{n} = {first}; axis_{n} < {count}; axis_{n}++) {{")
            places += f"[axis_{n}]"
        depth, value = len(array.type.shape), self.text(statement.value, _UNARY)
        kept_as = STORED[array.type.element] if isinstance(array.type.element, str) else ""
        value = value if kept_as in ("double", "int64_t") else f"({kept_as}){value}"
        lines.append("    " * depth + f"{self.text(array, _ATOM)}{places} = {value};")
        return lines + ["    " * n + "}" for n in reversed(range(depth))]

    def _do(self, function: Function, statement: Do) -> list[str]:
        void = "" if statement.call.type == Nothing() else "(void)"
        return [f"{void}{self.text(statement.call)};"]

    def _if(self, function: Function, statement: If) -> list[str]:
        lines = [f"if ({self.text(statement.test)}) {{", *self.block(function, statement.body, 1)]
        rest = statement.otherwise
        while len(rest) == 1 and isinstance(rest[0], If):
            lines += [f"}} else if ({self.text(rest[0].test)}) {{", *self.block(function, rest[0].body, 1)]
            rest = rest[0].otherwise
        if rest:
            lines += ["} else {", *self.block(function, rest, 1)]
        return [*lines, "}"]

    def _for(self, function: Function, statement: For) -> list[str]:
        name, step = word(statement.name), statement.step
        sign, move = ("<", f"{name}++" if step == 1 else f"{name} += {step}")
        if step < 0:
            sign, move = ">", f"{name}--" if step == -1 else f"{name} -= {-step}"
        start, stop = self.text(statement.start), self.text(statement.stop, 5)
        head = f"for (int64_t {name} = {start}; {name} {sign} {stop}; {move}) {{"
        lines = [head, *self.block(function, statement.body, 1), "}"]
        if statement.start.is_constant and statement.stop.is_constant:
            turns = len(range(statement.start.value, statement.stop.value, step))
            return ["UNROLLED", *lines] if turns <= UNROLLED else lines
        return lines

    def _leave(self, function: Function, statement: Leave) -> list[str]:
        return [f"{statement.word};"]

    def _return(self, function: Function, statement: Return) -> list[str]:
        value = statement.value
        if value is None:
            return ["return;"]
        if function.many and value.op == "several":
            return [f"return ({self.result(function)}){{{self._list(value.args)}}};"]
        return [f"return {self.text(value)};"]

    # definitions

    def signature(self, function: Function) -> str:
        if function.many:
            kind = self.result(function)
        else:
            kind = SCALARS[function.returns] if isinstance(function.returns, Scalar) else "void"
        given = ", ".join(
            f"const {self.declared(kind, word(name))}"
            if isinstance(kind, Several)  # what is side by side is read alone, whatever its pointers point to
            else self.declared(kind, word(name), may_be_constant(kind) and name not in function.writes)
            for name, kind in function.parameters
        )
        return f"static {kind} {function.name}({given or 'void'})"

    def function(self, function: Function) -> list[str]:
        lines = []
        if function.many:
            assert isinstance(function.returns, Several)
            parts = [f"    {self.declared(kind, f'part_{n}')};" for n, kind in enumerate(function.returns.items)]
            lines += ["typedef struct {", *parts, f"}} {self.result(function)};", ""]
        lines += [f"/* {function.where} */", self.signature(function), "{"]
        body = self.block(function, _without_first_zeros(function), 1)
        lines += [f"    {line}" for line in self._variables(function)]
        lines += [f"    (void){word(name)};" for name, _ in function.parameters if not _uses(body, word(name))]
        if body and body[-1] == "    return;":
            body.pop()
        return [*lines, *body, "}", ""]

    def _variables(self, function: Function) -> list[str]:
        lines, made = [], {one.name: one.value for one in _binds(function.body)}
        for name, kind in function.variables.items():
            own = word(name)
            if isinstance(kind, Scalar):
                lines.append(f"{SCALARS[kind]} {own} = {ZERO[kind]};")
            elif isinstance(kind, Reference):
                lines.append(f"{self.declared(kind, own, name not in function.writes)} = 0;")
            elif isinstance(kind, Several) and made[name].op == "call":
                lines.append(f"{self.result(made[name].value)} {own};")
            elif isinstance(kind, Several) and kind.names:
                lines += [f"{self.bundle(kind)} {own}_held;", f"{self.bundle(kind)} *{own} = &{own}_held;"]
            else:
                assert isinstance(kind, Several)
                lines.append(f"double {own}[{len(kind.items)}];")
        return lines

    def records(self, dtypes: Iterable[np.dtype]) -> list[str]:
        """Definitions of records, each behind those that it holds."""
        lines = []
        for dtype in dtypes:
            members = [f"    {self.member(dtype, name)};" for name in self.layout.members(dtype)]
            lines += ["typedef struct {", *members, f"}} {self.record(dtype)};", ""]
        return lines

    def bundles(self, program: Program) -> list[str]:
        lines = []
        for kind in program.bundles.values():
            pairs = zip(kind.names, kind.items, strict=True)
            members = [f"    {self.declared(item, word(name))};" for name, item in pairs]
            lines += ["typedef struct {", *members, f"}} {self.bundle(kind)};", ""]
        return lines

    def used_helpers(self) -> list[str]:
        """What functions and the text written so far need of `HELPERS`, and powers."""
        lines = [line for name, text in HELPERS.items() if name in self.helpers for line in (*text.splitlines(), "")]
        for exponent in sorted(self.powers):
            body = _products(abs(exponent))
            lines += [f"static inline double power_{_count(exponent)}(double value)", "{", *body]
            lines += ["    return 1.0 / made;" if exponent < 0 else "    return made;", "}", ""]
        return lines


def nested(dtype: np.dtype) -> list[np.dtype]:
    """The records in `dtype`, each before what holds it, itself last."""
    found: list[np.dtype] = []
    for name in dtype.names or ():
        kind = stored(dtype[name])
        inner = kind.element if isinstance(kind, Array) else kind
        if isinstance(inner, Record):
            found += [one for one in nested(inner.dtype) if one not in found]
    return [*found, dtype]


def _count(exponent: int) -> str:
    return str(exponent) if exponent >= 0 else f"minus_{-exponent}"


def _products(exponent: int) -> list[str]:
    """value to the power of `exponent`, in the order in which Numba multiplies."""
    lines, square = ["    double made = 1.0;", "    double square = value;"], False
    while exponent:
        if exponent & 1:
            lines.append("    made = made * square;")
        exponent >>= 1
        if exponent:
            lines.append("    square = square * square;")
    del square
    return lines


def _without_first_zeros(function: Function) -> list[Any]:
    """Its body without zeros into variables that are zero as they are declared."""
    kept, seen = [], set()
    for one in function.body:
        is_zero = isinstance(one, Assign) and one.value.is_constant and str(one.value.value) in ("0", "0.0", "False")
        if is_zero and one.target.op == "var" and one.target.value in function.variables.keys() - seen:
            continue
        kept.append(one)
        seen |= named(one)
    return kept


def _binds(statements: Iterable[Any]) -> list[Bind]:
    found = []
    for one in statements:
        if isinstance(one, Bind):
            found.append(one)
        for part in ("body", "otherwise"):
            found += _binds(getattr(one, part, []))
    return found


def _uses(lines: list[str], name: str) -> bool:
    import re

    return any(re.search(rf"\b{re.escape(name)}\b", line) for line in lines)
