"""Structured Text of IEC 61131-3 from the same trees as the C: a second printer, not a second model.

Views become what they are views of, in full, where the C has pointers: the standard has none. What several values side
by side are in C are outputs of a function. A choice inside an expression, and what stands behind an `and` or `or` that
may decide without it, become an `IF` before the statement: the standard leaves open whether all of it is worked out.
Functions that the standard does not have are written out, once each (`st_functions`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from service.codegen.pou import DataType, Names, Pou, Variable
from service.codegen.program import Layout
from service.codegen.source import CodegenError
from service.codegen.st_functions import FUNCTIONS
from service.codegen.tree import Assign, Bind, Do, Expr, Fill, For, Function, If, Leave, Return, named
from service.codegen.types import Array, Record, Reference, Scalar, Several, Type

SCALARS = {Scalar.BOOL: "BOOL", Scalar.INT: "LINT", Scalar.UINT: "ULINT", Scalar.REAL: "LREAL"}
STORED = {
    "f8": "LREAL",
    "f4": "REAL",
    "i8": "LINT",
    "u8": "ULINT",
    "i4": "DINT",
    "u4": "UDINT",
    "i2": "INT",
    "u1": "USINT",
}
_BINARY = {
    "mul": ("*", 6), "div": ("/", 6), "add": ("+", 5), "sub": ("-", 5),
    "lt": ("<", 4), "le": ("<=", 4), "gt": (">", 4), "ge": (">=", 4), "eq": ("=", 3), "ne": ("<>", 3),
}  # fmt: skip
_BITS = {"bitand": "AND", "bitor": "OR", "bitxor": "XOR"}
_OWN = {"sqrt": "SQRT", "sin": "SIN", "cos": "COS", "tan": "TAN", "exp": "EXP", "log": "LN", "acos": "ACOS",
        "asin": "ASIN", "atan": "ATAN", "fabs": "ABS"}  # fmt: skip
_ROUNDINGS = {"round": "even", "trunc": "whole", "ceil": "ceil", "floor": "floor"}
# What may stop a controller where a test before it has said that it is not to be worked out.
_STOPPING = frozenset({"call", "at", "div", "floordiv", "mod", "power", "math", "cond"})
_SKIPPED = "is_skipped"  # the rest of a loop's turn
_ATOM, _UNARY, _LOOSE = 9, 8, 0


def number(value: Any, kind: Scalar) -> str:
    """A constant that is a number."""
    if kind is Scalar.BOOL:
        return "TRUE" if value else "FALSE"
    if kind is Scalar.UINT:
        return f"ULINT#{value}"
    if kind is Scalar.INT:
        if value == -(2**63):
            return "(-9223372036854775807 - 1)"
        return str(value) if value >= 0 else f"({value})"
    mantissa, _, exponent = repr(float(value)).partition("e")
    mantissa += "" if "." in mantissa else ".0"
    said = f"{mantissa}E{int(exponent)}" if exponent else mantissa
    # a literal that a REAL holds as well is the same whichever of the two a compiler takes it for
    exact = float(np.float32(value)) == value and abs(value) < 1e30
    if exact:
        return said if not said.startswith("-") else f"({said})"
    return f"LREAL#{said}" if not said.startswith("-") else f"(-LREAL#{said[1:]})"


class Writer:
    """prefix: of the names of types and functions. types: arrays that were asked for, each before what holds it."""

    def __init__(self, layout: Layout, prefix: str) -> None:
        self.layout, self.prefix = layout, prefix
        self.arrays: dict[str, DataType] = {}
        self.helpers: set[str] = set()
        self.powers: set[int] = set()
        self._fields: dict[np.dtype, Names] = {}

    def record(self, dtype: np.dtype) -> str:
        return f"{self.prefix}_{self.layout.names[dtype]}_t"

    def member(self, dtype: np.dtype, name: str) -> str:
        """A field's name in its structure."""
        return self._fields.setdefault(dtype, Names())(name)

    def element(self, element: str | Record) -> str:
        return self.record(element.dtype) if isinstance(element, Record) else STORED[element]

    def typed(self, kind: Type) -> str:
        """The type of a variable."""
        if isinstance(kind, Scalar):
            return SCALARS[kind]
        if isinstance(kind, Record):
            return self.record(kind.dtype)
        assert isinstance(kind, Array)
        return self.array(kind)

    def array(self, kind: Array) -> str:
        """An array's own type: of rows, whose type has a name too, so that a row can be handed on."""
        inner = self.element(kind.element) if len(kind.shape) == 1 else self.array(Array(kind.element, kind.shape[1:]))
        base = self.element(kind.element).lower().removeprefix(f"{self.prefix}_").removesuffix("_t")
        name = f"{self.prefix}_{base}_{'_'.join(map(str, kind.shape))}_t"
        self.arrays.setdefault(name, DataType(name, array=(kind.shape[0], inner)))
        return name

    def structure(self, dtype: np.dtype, comment: str = "", notes: dict[str, str] | None = None) -> list[DataType]:
        """The type of a record, behind those of its arrays that are not yet there."""
        before, members = set(self.arrays), []
        for name in self.layout.members(dtype):
            kind = self.layout.field(dtype, name)
            own = STORED[dtype[name].str[1:]] if isinstance(kind, Scalar) else self.typed(kind)
            members.append(Variable(self.member(dtype, name), own, (notes or {}).get(name, "")))
        new = [one for name, one in self.arrays.items() if name not in before]
        return [*new, DataType(self.record(dtype), tuple(members), comment=comment)]

    def named(self, function: Function) -> str:
        return Names()(f"{self.prefix}_{function.name}")

    def helper(self, name: str) -> str:
        """The name of one of `FUNCTIONS`, which is then among those that are written, with what it calls."""
        if name not in self.helpers:
            self.helpers.add(name)
            for other in FUNCTIONS[name].calls:
                self.helper(other)
        return f"{self.prefix}_{name}"

    def power(self, exponent: int) -> str:
        self.powers.add(exponent)
        return f"{self.prefix}_power_{exponent if exponent >= 0 else f'minus_{-exponent}'}"

    def literal(self, value: Any) -> str:
        """A number of a record; what the standard has no literal of is worked out."""
        if isinstance(value, float | np.floating):
            if math.isnan(value):
                return f"{self.helper('no_number')}(huge := 1.0E300)"
            if math.isinf(value):
                endless = f"{self.helper('endless')}(huge := 1.0E300)"
                return endless if value > 0 else f"(-{endless})"
            return number(value, Scalar.REAL)
        return number(int(value), Scalar.INT)

    def used_helpers(self) -> list[Pou]:
        """What the functions written so far need beside each other."""
        made = [FUNCTIONS[name].pou(self.prefix) for name in FUNCTIONS if name in self.helpers]
        for exponent in sorted(self.powers):
            made.append(_power(self.power(exponent), exponent))
        return made

    def function(self, function: Function) -> Pou:
        """One kernel."""
        return _Body(self, function).pou()


class _Body:
    """Writes one function. before: lines that must run ahead of the statement that is being written."""

    def __init__(self, writer: Writer, function: Function) -> None:
        self.writer, self.made = writer, function
        self.name = writer.named(function)
        self.names = Names([self.name])
        self.views: dict[str, tuple[int, ...]] = {}  # name -> which of its places it may be a view of here
        self.places: dict[str, list[str]] = {}  # name -> all that it is a view of somewhere
        self.choices = _choices(function.body)
        self.bundles: dict[str, dict[str, str]] = {}  # name -> field -> what stands for it
        self.locals: dict[str, str] = {}
        self.before: list[str] = []

    def pou(self) -> Pou:
        inputs, in_outs = [], []
        for name, kind in self.made.parameters:
            for field, own, item in self._flat(name, kind):
                (inputs if isinstance(item, Scalar) else in_outs).append(Variable(own, self.writer.typed(item)))
                if field:
                    self.bundles.setdefault(name, {})[field] = own
        outputs = []
        if self.made.many:
            assert isinstance(self.made.returns, Several)
            for n, kind in enumerate(self.made.returns.items):
                outputs.append(Variable(self.names(f"part_{n}"), self.writer.typed(kind)))
        for name, kind in self.made.variables.items():
            if isinstance(kind, Scalar):
                self.locals[self.names(name)] = SCALARS[kind]
        body = self.block(self.made.body)
        if body and body[-1] == "RETURN;":
            body.pop()
        if not isinstance(self.made.returns, Scalar):
            body.append(f"{self.name} := TRUE;")
        returns = SCALARS[self.made.returns] if isinstance(self.made.returns, Scalar) else "BOOL"
        own = [Variable(name, kind) for name, kind in self.locals.items()]
        return Pou(self.name, "FUNCTION", body, returns, inputs, in_outs, outputs, own, self.made.where)

    def _flat(self, name: str, kind: Type) -> list[tuple[str, str, Type]]:
        """A parameter, or one for each of the values side by side in it: (field, name, type)."""
        if not isinstance(kind, Several):
            return [("", self.names(name), kind)]
        pairs = zip(kind.names, kind.items, strict=True)
        return [(field, self.names(f"{name}_{field}"), item) for field, item in pairs]

    def local(self, name: str, kind: str) -> str:
        """A variable of its own, which may be there already."""
        own = self.names(name)
        self.locals[own] = kind
        return own

    def fresh(self, kind: str) -> str:
        return self.local(f"made_{sum(name.startswith('made_') for name in self.locals) + 1}", kind)

    # expressions

    def text(self, value: Expr, least: int = _LOOSE) -> str:
        """`value`, in brackets where it binds looser than `least`."""
        found, binds = self._written(value)
        return found if binds >= least else f"({found})"

    def _written(self, value: Expr) -> tuple[str, int]:
        if value.op in _BINARY:
            return self._binary(value)
        if value.op in _BITS:
            return self._bits(value)
        if value.op in ("all", "any"):
            return self._logic(value)
        return getattr(self, f"_{value.op}")(value)

    def _const(self, value: Expr) -> tuple[str, int]:
        assert isinstance(value.type, Scalar)
        if value.type is Scalar.REAL:
            return self.writer.literal(value.value), _ATOM
        return number(value.value, value.type), _ATOM

    def _var(self, value: Expr) -> tuple[str, int]:
        if value.value not in self.views:
            return self.names(value.value), _ATOM
        which = self.views[value.value]
        if len(which) > 1:
            raise CodegenError(f"{self.made.where}: {value.value} may be one of two views in a test or a loop's bounds")
        return self.places[value.value][next(iter(which))], _ATOM

    def _field(self, value: Expr) -> tuple[str, int]:
        return self._read(value)

    def _index(self, value: Expr) -> tuple[str, int]:
        return self._read(value)

    def _read(self, value: Expr) -> tuple[str, int]:
        narrow = self._narrow(value)
        place = self.place(value)
        return (f"{narrow}_TO_LINT({place})" if narrow else place), _ATOM

    def place(self, value: Expr, keep: str = "") -> str:
        """Where a number is stored, or what is viewed. keep: indices are kept under this name, so that the place stays
        the same when what they were worked out from changes."""
        if value.op == "field":
            holder = value.args[0].type
            assert isinstance(holder, Record)
            return f"{self.place(value.args[0], keep)}.{self.writer.member(holder.dtype, value.value)}"
        if value.op == "index":
            base = self.place(value.args[0], keep)
            index = self.text(value.args[1])
            if keep and not value.args[1].is_constant:
                own = self.local(f"{keep}_{base.count('[') + 1}", "LINT")
                self.before.append(f"{own} := {index};")
                index = own
            return f"{base}[{index}]"
        return self.text(value)

    def _narrow(self, value: Expr) -> str:
        """The type that a number is stored as, where that is not what it is worth."""
        if not isinstance(value.type, Scalar):
            return ""
        holder = next((one.type for one in value.args), None)
        if value.op == "field" and isinstance(holder, Record):
            code = holder.dtype[value.value].base.str[1:]
        elif value.op == "index" and isinstance(holder, Array) and isinstance(holder.element, str):
            code = holder.element
        else:
            return ""
        return STORED[code] if code not in ("f8", "i8", "u8") else ""

    def _item(self, value: Expr) -> tuple[str, int]:
        base = value.args[0]
        if base.op == "call":
            return self._parts(base)[value.value], _ATOM
        assert base.op == "var"
        if isinstance(value.value, str):
            return self.bundles[base.value][value.value], _ATOM
        if base.value in self.bundles:
            return self.bundles[base.value][str(value.value)], _ATOM
        index = self.text(value.args[1]) if len(value.args) > 1 else str(value.value)
        return f"{self.names(base.value)}[{index}]", _ATOM

    def _at(self, value: Expr) -> tuple[str, int]:
        return f"{self.writer.helper('at')}(place := {self.text(value.args[0])}, count := {value.value})", _ATOM

    def _within(self, value: Expr) -> tuple[str, int]:
        return self.text(value.args[0]), _ATOM

    def _cast(self, value: Expr) -> tuple[str, int]:
        (of,) = value.args
        assert isinstance(value.type, Scalar)
        narrow = self._narrow(of)
        inner = self.place(of) if narrow else self.text(of)
        return f"{narrow or self._kind(of)}_TO_{SCALARS[value.type]}({inner})", _ATOM

    def _kind(self, value: Expr) -> str:
        assert isinstance(value.type, Scalar)
        return SCALARS[value.type]

    def _neg(self, value: Expr) -> tuple[str, int]:
        return f"(-{self.text(value.args[0], _ATOM)})", _ATOM

    def _invert(self, value: Expr) -> tuple[str, int]:
        return f"(-{self.text(value.args[0], _ATOM)} - 1)", _ATOM

    def _not(self, value: Expr) -> tuple[str, int]:
        return negated(self.text(value.args[0])), _UNARY

    def _binary(self, value: Expr) -> tuple[str, int]:
        sign, binds = _BINARY[value.op]
        left, right = (self.text(one, binds + n if binds >= 5 else 5) for n, one in enumerate(value.args))
        return f"{left} {sign} {right}", binds

    def _bits(self, value: Expr) -> tuple[str, int]:
        if value.type is Scalar.BOOL:
            return f" {_BITS[value.op]} ".join(self.text(one, _UNARY) for one in value.args), 1
        one, other = (self.text(part) for part in value.args)
        return f"{self.writer.helper(value.op)}(one := {one}, other := {other})", _ATOM

    def _logic(self, value: Expr) -> tuple[str, int]:
        """`and`, `or`: of what may be worked out whatever the first says, as such; else step by step."""
        word = "AND" if value.op == "all" else "OR"
        if not any(_stops(one) for one in value.args[1:]):
            return f" {word} ".join(self.text(one, _UNARY) for one in value.args), 1
        own = self.fresh("BOOL")
        lines = self._into(own, value.args[0])
        for one in value.args[1:]:
            test = own if value.op == "all" else negated(own)
            lines += [f"IF {test} THEN", *_deeper(self._into(own, one)), "END_IF;"]
        self.before += lines
        return own, _ATOM

    def _into(self, own: str, value: Expr) -> list[str]:
        """Lines that give the variable `own` a value, and what must run ahead of them."""
        outer, self.before = self.before, []
        text = self.text(value)
        lines, self.before = [*self.before, f"{own} := {text};"], outer
        return lines

    def _cond(self, value: Expr) -> tuple[str, int]:
        own = self.fresh(self.writer.typed(value.type))
        self.before += self._chosen(own, value)
        return own, _ATOM

    def _chosen(self, own: str, value: Expr) -> list[str]:
        outer, self.before = self.before, []
        test, one, other = value.args
        head = self.text(test)
        ahead, self.before = self.before, outer
        body = [_deeper(self._into(own, part)) for part in (one, other)]
        return [*ahead, f"IF {head} THEN", *body[0], "ELSE", *body[1], "END_IF;"]

    def _floordiv(self, value: Expr) -> tuple[str, int]:
        return self._two("floor_of", value)

    def _mod(self, value: Expr) -> tuple[str, int]:
        return self._two("rest_of", value)

    def _two(self, helper: str, value: Expr) -> tuple[str, int]:
        one, by = (self.text(part) for part in value.args)
        return f"{self.writer.helper(helper)}(value := {one}, divisor := {by})", _ATOM

    def _power(self, value: Expr) -> tuple[str, int]:
        return f"{self.writer.power(value.value)}(value := {self.text(value.args[0])})", _ATOM

    def _math(self, value: Expr) -> tuple[str, int]:
        name = value.value
        texts = [self.text(one) for one in value.args]
        if name in _ROUNDINGS:
            return f"{self.writer.helper(_ROUNDINGS[name])}(value := {texts[0]})", _ATOM
        if name in _OWN:
            return f"{_OWN[name]}({texts[0]})", _ATOM
        if name == "pow":
            return f"EXPT({texts[0]}, {texts[1]})", _ATOM
        if name in ("max", "min", "abs") and value.type is Scalar.INT:
            name = f"{name}_whole"
        helper = {"max": "max_of", "min": "min_of"}.get(name, name)
        wanted = FUNCTIONS.get(helper)
        if wanted is None or len(wanted.inputs) != len(texts):
            raise CodegenError(f"{self.made.where}: {name} has no form in Structured Text")
        given = ", ".join(f"{one.name} := {text}" for one, text in zip(wanted.inputs, texts, strict=True))
        return f"{self.writer.helper(helper)}({given})", _ATOM

    def _call(self, value: Expr) -> tuple[str, int]:
        return f"{self.writer.named(value.value)}({', '.join(self._arguments(value))})", _ATOM

    def _arguments(self, value: Expr) -> list[str]:
        """By name: of a call. Views are places, so their indices are worked out ahead."""
        function: Function = value.value
        names, given = Names([self.writer.named(function)]), []
        for (name, kind), one in zip(function.parameters, value.args, strict=True):
            if isinstance(kind, Several):
                assert one.op == "var"
                given += [f"{names(f'{name}_{field}')} := {self.bundles[one.value][field]}" for field in kind.names]
            elif isinstance(kind, Scalar):
                given.append(f"{names(name)} := {self.text(one, 5)}")
            else:
                own = f"viewed_{sum(local.startswith('viewed_') for local in self.locals) + 1}"
                given.append(f"{names(name)} := {self.place(one, own)}")
        return given

    def _parts(self, call: Expr, names: Sequence[str] = ()) -> list[str]:
        """Values side by side that a call returns, each in a variable of its own."""
        assert isinstance(call.type, Several)
        function: Function = call.value
        inner = Names([self.writer.named(function)])
        for name, kind in function.parameters:
            for field in kind.names if isinstance(kind, Several) else ("",):
                inner(f"{name}_{field}" if field else name)
        kinds = [SCALARS[kind] for kind in call.type.items if isinstance(kind, Scalar)]
        parts = [self.local(names[n], kind) if names else self.fresh(kind) for n, kind in enumerate(kinds)]
        told = [f"{inner(f'part_{n}')} => {part}" for n, part in enumerate(parts)]
        done = self.local("done", "BOOL")
        arguments = ", ".join([*self._arguments(call), *told])
        self.before.append(f"{done} := {self.writer.named(function)}({arguments});")
        return parts

    # statements

    def block(self, statements: Iterable[Any]) -> list[str]:
        lines: list[str] = []
        for statement in statements:
            lines += self._statement(statement)
        return lines

    def _statement(self, statement: Any) -> list[str]:
        """Lines of one, with what runs ahead of it; once for each place where a view in it may be one of several."""
        if not isinstance(statement, If | For):
            for name in sorted(named(statement)):
                which = self.views.get(name, ())
                if len(which) > 1:
                    return self._for_each(name, which, statement)
        outer, self.before = self.before, []
        written = getattr(self, f"_{type(statement).__name__.lower()}_lines")(statement)
        lines, self.before = [*self.before, *written], outer
        return lines

    def _for_each(self, name: str, which: tuple[int, ...], statement: Any) -> list[str]:
        lines = []
        for n in which:
            self.views[name] = (n,)
            head = f"{'ELSIF' if lines else 'IF'} {self.names(f'{name}_is')} = {n} THEN"
            lines += [head, *_deeper(self._statement(statement))]
        self.views[name] = which
        return [*lines, "END_IF;"]

    def _inner(self, statements: Iterable[Any]) -> tuple[list[str], dict[str, tuple[int, ...]]]:
        """A block that may run, and what views are behind it; they are put back as they are before."""
        before = dict(self.views)
        lines = self.block(statements)
        behind, self.views = self.views, before
        return lines, behind

    def _merge(self, *behind: dict[str, tuple[int, ...]]) -> None:
        """What views may be behind blocks of which one has run."""
        for name in {name for one in behind for name in one}:
            self.views[name] = tuple(sorted({n for one in behind for n in one.get(name, ())}))

    def _assign_lines(self, statement: Assign) -> list[str]:
        target, value = statement.target, statement.value
        narrow = self._narrow(target)
        if value.op == "cond" and target.op == "var" and not narrow:
            return self._chosen(self.names(target.value), value)
        text = self.text(value)
        return [f"{self.place(target)} := {f'{self._kind(value)}_TO_{narrow}({text})' if narrow else text};"]

    def _bind_lines(self, statement: Bind) -> list[str]:
        name, value = statement.name, statement.value
        if isinstance(value.type, Reference):
            return self._view(name, value)
        assert isinstance(value.type, Several)
        if value.op == "call":
            parts = self._parts(value, [f"{name}_{n}" for n in range(len(value.type.items))])
            self.bundles[name] = {str(n): part for n, part in enumerate(parts)}
            return []
        if not value.type.names:
            kind = self.writer.array(Array("f8", (len(value.type.items),)))
            own = self.local(name, kind)
            return [f"{own}[{n}] := {self.text(item)};" for n, item in enumerate(value.args)]
        lines, held = [], {}
        for field, item in zip(value.type.names, value.args, strict=True):
            if isinstance(item.type, Scalar):
                held[field] = self.local(f"{name}_{field}", SCALARS[item.type])
                lines.append(f"{held[field]} := {self.text(item)};")
            else:
                held[field] = self.place(item, f"{name}_{field}")
        self.bundles[name] = held
        return lines

    def _view(self, name: str, value: Expr) -> list[str]:
        if value.op == "cond":
            test, one, other = value.args
            return self._if_lines(If(test, [Bind(name, one)], [Bind(name, other)]))
        place, known = self.place(value, name), self.places.setdefault(name, [])
        if place not in known:
            known.append(place)
        which = known.index(place)
        self.views[name] = (which,)
        return [f"{self.local(f'{name}_is', 'LINT')} := {which};"] if name in self.choices else []

    def _fill_lines(self, statement: Fill) -> list[str]:
        array = statement.array
        assert isinstance(array.type, Array)
        place, value = self.place(array, "filled"), self.text(statement.value)
        if isinstance(array.type.element, str) and array.type.element not in ("f8", "i8"):
            value = f"{self._kind(statement.value)}_TO_{STORED[array.type.element]}({value})"
        return _looped(place, array.type.shape, value, self, statement.first)

    def _do_lines(self, statement: Do) -> list[str]:
        call = statement.call
        if isinstance(call.type, Several):
            self._parts(call)
            return []
        kind = SCALARS[call.type] if isinstance(call.type, Scalar) else "BOOL"
        own = self.local("done" if kind == "BOOL" else f"unused_{kind.lower()}", kind)
        return [f"{own} := {self.text(call)};"]

    def _if_lines(self, statement: If) -> list[str]:
        head = self.text(statement.test)
        body, one = self._inner(statement.body)
        lines = [f"IF {head} THEN", *_deeper(body or [";"])]
        rest = statement.otherwise
        if len(rest) == 1 and isinstance(rest[0], If):
            outer, self.before = self.before, []
            before = dict(self.views)
            inner = self._if_lines(rest[0])
            ahead, self.before = self.before, outer
            other, self.views = self.views, before
            self._merge(one, other)
            if not ahead:
                return [*lines, f"ELS{inner[0]}", *inner[1:]]
            return [*lines, "ELSE", *_deeper([*ahead, *inner]), "END_IF;"]
        body, other = self._inner(rest)
        self._merge(one, other)
        if body:
            lines += ["ELSE", *_deeper(body)]
        return [*lines, "END_IF;"]

    def _for_lines(self, statement: For) -> list[str]:
        own = self.local(statement.name, "LINT")
        start, step = self.text(statement.start), statement.step
        if statement.stop.is_constant:
            last = str(statement.stop.value - (1 if step > 0 else -1))
        else:
            last = f"{self.text(statement.stop, 5)} {'-' if step > 0 else '+'} 1"
        by = "" if step == 1 else f" BY {step}"
        turn = _whole_turns(statement.body)
        if _goes_on(turn):
            self.local(_SKIPPED, "BOOL")
            turn = [Assign(_skipped(), Expr("const", Scalar.BOOL, value=False)), *_guarded(turn)]
        body, behind = self._inner(turn)
        self._merge(self.views, behind)
        return [f"FOR {own} := {start} TO {last}{by} DO", *_deeper(body or [";"]), "END_FOR;"]

    def _leave_lines(self, statement: Leave) -> list[str]:
        assert statement.word == "break"
        return ["EXIT;"]

    def _return_lines(self, statement: Return) -> list[str]:
        value = statement.value
        if value is None:
            return ["RETURN;"]
        if not self.made.many:
            return [f"{self.name} := {self.text(value)};", "RETURN;"]
        texts = [self.text(one) for one in value.args] if value.op == "several" else self._parts(value)
        return [*(f"{self.names(f'part_{n}')} := {text};" for n, text in enumerate(texts)), "RETURN;"]


def negated(test: str) -> str:
    """That `test` is not so; STruC++ knows no NOT of what AND and OR make."""
    return f"(({test}) = FALSE)" if re.search(r" (AND|OR|XOR) ", test) else f"NOT ({test})"


def _looped(place: str, shape: tuple[int, ...], value: str, body: _Body, first: int) -> list[str]:
    lines: list[str] = []
    for n, count in enumerate(shape):
        axis = body.local(f"axis_{n}", "LINT")
        begin = first if n + 1 == len(shape) else 0
        lines.append("    " * n + f"FOR {axis} := {begin} TO {count - 1} DO")
        place += f"[{axis}]"
    lines.append("    " * len(shape) + f"{place} := {value};")
    return lines + ["    " * n + "END_FOR;" for n in reversed(range(len(shape)))]


def _whole_turns(body: list[Any]) -> list[Any]:
    """A loop's body in which what a `continue` leaves out stands in the other branch: the standard has no such word
    before its third edition, and not every compiler takes it."""
    for n, one in enumerate(body):
        rest = body[n + 1 :]
        if isinstance(one, If) and _ends_turn(one.body) and not _goes_on(one.otherwise):
            return [*body[:n], If(one.test, one.body[:-1], _whole_turns([*one.otherwise, *rest]))]
    return body


def _ends_turn(body: list[Any]) -> bool:
    """Whether its last statement is its one `continue`."""
    return bool(body) and isinstance(body[-1], Leave) and body[-1].word == "continue" and not _goes_on(body[:-1])


def _goes_on(body: list[Any]) -> bool:
    """Whether a `continue` of this loop is anywhere in it."""
    return any(
        (isinstance(one, Leave) and one.word == "continue")
        or (isinstance(one, If) and (_goes_on(one.body) or _goes_on(one.otherwise)))
        for one in body
    )


def _guarded(body: list[Any]) -> list[Any]:
    """The same with a mark in place of `continue`, and behind where it may be set the rest under it."""
    for n, one in enumerate(body):
        if isinstance(one, Leave) and one.word == "continue":
            return [*body[:n], Assign(_skipped(), Expr("const", Scalar.BOOL, value=True))]
        if isinstance(one, If) and _goes_on([one]):
            marked = If(one.test, _guarded(one.body), _guarded(one.otherwise))
            rest = _guarded(body[n + 1 :])
            return [*body[:n], marked, *([If(Expr("not", Scalar.BOOL, (_skipped(),)), rest, [])] if rest else [])]
    return body


def _skipped() -> Expr:
    return Expr("var", Scalar.BOOL, value=_SKIPPED)


def _choices(statements: Iterable[Any]) -> set[str]:
    """Names of views that are not the same everywhere."""
    made: dict[str, list[Expr]] = {}

    def look(statements: Iterable[Any]) -> None:
        for one in statements:
            if isinstance(one, Bind) and isinstance(one.value.type, Reference):
                made.setdefault(one.name, []).append(one.value)
            for part in ("body", "otherwise"):
                look(getattr(one, part, []))

    look(statements)
    return {name for name, values in made.items() if values[0].op == "cond" or any(v != values[0] for v in values[1:])}


def _deeper(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _stops(value: Expr) -> bool:
    return value.op in _STOPPING or any(_stops(one) for one in value.args)


def _power(name: str, exponent: int) -> Pou:
    """To a whole power, in the order in which Numba multiplies."""
    body, left = ["made := 1.0;", "square := value;"], abs(exponent)
    while left:
        if left & 1:
            body.append("made := made * square;")
        left >>= 1
        if left:
            body.append("square := square * square;")
    body.append(f"{name} := {'1.0 / made' if exponent < 0 else 'made'};")
    value, own = Variable("value", "LREAL"), [Variable("made", "LREAL"), Variable("square", "LREAL")]
    return Pou(name, "FUNCTION", body, "LREAL", [value], locals=own)
