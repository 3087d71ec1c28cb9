"""An interpreter for the part of Structured Text that is exported: a published grammar parses it, C does what it says.

Nothing of the exporter is used: the text is read by tree-sitter-iec61131-3-st, precedence is the grammar's. Where the
standard leaves a choice, it is taken against the exporter: AND and OR work out both sides, a conversion to a whole
number rounds halves away from zero, case does not count, and every index is checked.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tree_sitter
import tree_sitter_iec61131_3_st

from schemas.messages import TOPICS
from schemas.robot import Robot
from service.codegen.layout import layout_of
from service.codegen.plc import Project, to_st
from service.codegen.pou import Names
from service.codegen.twin import OUT, in_c
from service.estimator import state
from tests.service.codegen.built import COMPILER, converted, pointer

TYPES = {
    "LREAL": "double", "REAL": "float", "BOOL": "uint8_t", "LINT": "int64_t", "ULINT": "uint64_t", "DINT": "int32_t",
    "UDINT": "uint32_t", "INT": "int16_t", "USINT": "uint8_t", "LWORD": "uint64_t",
}  # fmt: skip
OPERATORS = {"=": "==", "<>": "!=", "AND": "&", "OR": "|", "XOR": "^"}
LIBRARY = {"SQRT": "sqrt", "SIN": "sin", "COS": "cos", "TAN": "tan", "EXP": "exp", "LN": "log", "ATAN": "atan",
           "ASIN": "asin", "ACOS": "acos", "EXPT": "pow", "ABS": "ABSOLUTE"}  # fmt: skip
HEAD = """
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#define ABSOLUTE(x) _Generic((x), double: fabs, default: llabs)(x)
static int64_t place(int64_t index, int64_t count) { if (index < 0 || index >= count) { abort(); } return index; }
"""


class Structured:
    """A block made for `robot`, as a library that `run`s it along samples."""

    def __init__(self, robot: Robot, period: float, folder: Path, project: Project | None = None) -> None:
        self.project = project or to_st(robot, period, nominal=True)
        layout = layout_of(robot, state.settings(robot, period, 1))
        self.dtypes = {topic: in_c(layout, message.dtype) for topic, message in TOPICS.items()}
        text = HEAD + Translated(self.project.text).text + self._loop(period, robot.fourth_axis is not None)
        (folder / "block.c").write_text(text)
        made = subprocess.run(
            [COMPILER or "gcc", "-O0", "-w", "-fwrapv", "-ffp-contract=off", "-fPIC", "-shared",
             str(folder / "block.c"), "-o", str(folder / "block.so"), "-lm"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr[:3000]
        self.library = ctypes.CDLL(str(folder / "block.so"))

    def run(self, samples: np.ndarray, period: float | None = None, begin: bool = True) -> dict[str, np.ndarray]:
        """What it answers: topic -> (N,) records of C, `code` and `has_payload` (N,). period: as the task says, if that
        is another. begin: init in the first cycle."""
        given = converted(samples, self.dtypes["sample"])
        found = {topic: np.zeros(len(given), self.dtypes[topic]) for topic in OUT}
        code, has_payload = np.zeros(len(given), np.int32), np.zeros(len(given), np.int32)
        said = ctypes.c_double(float("nan") if period is None else period)
        pointers = map(pointer, (given, *found.values(), code, has_payload))
        self.library.run(ctypes.c_int64(len(given)), said, ctypes.c_int32(begin), *pointers)
        return found | {"code": code, "has_payload": has_payload}

    def load_peak(self, value: float) -> None:
        """The next cycle is to load the figures of now, but this peak torque, N m."""
        self.library.load_peak(ctypes.c_double(value))

    @property
    def peak(self) -> float:
        """The one in force, N m."""
        self.library.peak.restype = ctypes.c_double
        return self.library.peak()

    def _loop(self, period: float, has_fourth: bool) -> str:
        block = self.project.name.upper()
        structs = [f"typedef struct {{ {fields_of(self.dtypes[topic])} }} of_{topic};" for topic in ("sample", *OUT)]
        given = ", ".join(f"of_{topic} *{topic}" for topic in OUT)
        lines = [
            *structs, f"static struct {block} it;",
            "void load_peak(double value) { it.PARAMETERS = it.PARAMETERS_NOW;",
            "it.PARAMETERS.PEAK = value; it.LOAD = 1; }",
            "double peak(void) { return it.PARAMETERS_NOW.PEAK; }",
            f"void run(int64_t count, double period, int32_t begin, of_sample *sample, {given}, int32_t *code, "
            "int32_t *has)", "{", "for (int64_t n = 0; n < count; n++) {",
            f"it.INIT = (n == 0) && begin; it.PERIOD_S = isnan(period) ? {period!r} : period;",
            "it.HAS_POSITION_COMMAND = it.HAS_TORQUE_COMMAND = it.ASK_FINDINGS = 1;",
            "it.HAS_FOURTH_POSITION = 1;" if has_fourth else "",
            *_copied(self.dtypes["sample"], "it.SAMPLE.{0}", "sample[n].{1}"), f"{block}(&it);", "it.LOAD = 0;",
            "code[n] = it.CODE; has[n] = it.HAS_PAYLOAD;",
        ]  # fmt: skip
        for topic in OUT:
            lines += _copied(self.dtypes[topic], topic + "[n].{1}", f"it.{Names()(topic).upper()}." + "{0}")
        return "\n".join([*lines, "} }", ""])


def fields_of(dtype: np.dtype) -> str:
    kinds = {"f8": "double", "i4": "int32_t", "u4": "uint32_t", "u8": "uint64_t"}
    return " ".join(
        f"{kinds[dtype[name].base.str[1:]]} {name}" + "".join(f"[{count}]" for count in dtype[name].shape) + ";"
        for name in dtype.names or ()
    )


def _copied(dtype: np.dtype, to: str, of: str) -> list[str]:
    lines, names = [], Names()
    for name in dtype.names or ():
        own, shape = names(name).upper(), dtype[name].shape
        if shape:
            one, other = (place.format(f"{own}.at[k]", f"{name}[k]") for place in (to, of))
            lines.append(f"for (int k = 0; k < {shape[0]}; k++) {{ {one} = {other}; }}")
        else:
            lines.append(f"{to.format(own, name)} = {of.format(own, name)};")
    return lines


class Translated:
    """Structured Text as C."""

    def __init__(self, source: str) -> None:
        self._source = source.encode()
        tree = tree_sitter.Parser(tree_sitter.Language(tree_sitter_iec61131_3_st.language())).parse(self._source)
        assert not tree.root_node.has_error, "the grammar does not take it"
        self._counts: dict[str, int] = {}  # of arrays
        self._arrays: dict[str, str] = {}  # type -> of what
        self._members: dict[str, dict[str, str]] = {}
        self._pous: dict[str, list[tuple[str, str, str]]] = {}  # section, name, type
        self._scope: dict[str, tuple[str, str]] = {}  # name -> type, how C reads it
        lines: list[str] = []
        for node in _own(tree.root_node):
            lines += getattr(self, f"_{node.type}")(node)
        self.text = "\n".join(lines) + "\n"

    def _said(self, node: tree_sitter.Node) -> str:
        return self._source[node.start_byte : node.end_byte].decode().upper()

    def _kind(self, node: tree_sitter.Node) -> str:
        name = self._said(node)
        return TYPES.get(name, name)

    # declarations

    def _type_declaration(self, node: tree_sitter.Node) -> list[str]:
        (made,) = (one for one in _own(node) if one.type == "type_definition")
        name, body = self._said(_field(made, "name")), _field(made, "definition")
        if body.type == "array_type":
            bounds = _field(body, "range")
            assert self._said(_field(bounds, "lower")) == "0"
            self._counts[name] = int(self._said(_field(bounds, "upper"))) + 1
            self._arrays[name] = self._said(_field(body, "element_type"))
            kind = self._kind(_field(body, "element_type"))
            return [f"typedef struct {{ {kind} at[{self._counts[name]}]; }} {name};"]
        assert body.type == "structure_type_inline"
        fields = [one for one in _own(body) if one.type == "structure_field"]
        self._members[name] = {self._said(_field(one, "name")): self._said(_field(one, "type")) for one in fields}
        assert len(self._members[name]) == len(fields), f"{name}: two fields of one name"
        lines = [f"{TYPES.get(kind, kind)} {own};" for own, kind in self._members[name].items()]
        return [f"typedef struct {{ {' '.join(lines)} }} {name};"]

    def _variables(self, node: tree_sitter.Node) -> list[tuple[str, str, str]]:
        sections = {"var_input": "in", "var_in_out": "in_out", "var_output": "out", "var_block": "own"}
        found = []
        for section in (one for one in _own(node) if one.type in sections):
            for one in (each for each in _own(section) if each.type == "variable_declaration"):
                found.append(
                    (sections[section.type], self._said(_field(one, "names")), self._said(_field(one, "type")))
                )
        names = [name for _, name, _ in found]
        assert len(set(names)) == len(names), f"two variables of one name: {names}"
        return found

    def _function_declaration(self, node: tree_sitter.Node) -> list[str]:
        name, returns = self._said(_field(node, "name")), self._kind(_field(node, "return_type"))
        assert name not in self._pous, f"two functions {name}"
        variables = self._pous[name] = self._variables(node)
        given = []
        for section, own, kind in variables:
            is_place = section in ("in_out", "out")
            self._scope[own] = kind, f"(*{own})" if is_place else own
            if section != "own":
                given.append(f"{TYPES.get(kind, kind)} {'*' if is_place else ''}{own}")
        self._scope[name] = self._said(_field(node, "return_type")), "result_"
        local = [f"{TYPES.get(kind, kind)} {own} = {{0}};" for section, own, kind in variables if section == "own"]
        body = self._body(node)
        self._scope.clear()
        head = f"static {returns} {name}({', '.join(given)})"
        return [head, "{", f"{returns} result_ = 0;", *local, *body, "return result_;", "}"]

    def _function_block_declaration(self, node: tree_sitter.Node) -> list[str]:
        name, variables = self._said(_field(node, "name")), self._variables(node)
        self._scope = {own: (kind, f"self->{own}") for _, own, kind in variables}
        fields = " ".join(f"{TYPES.get(kind, kind)} {own};" for _, own, kind in variables)
        body = [line.replace("return result_;", "return;") for line in self._body(node)]
        return [f"struct {name} {{ {fields} }};", f"static void {name}(struct {name} *self)", "{", *body, "}"]

    def _body(self, node: tree_sitter.Node) -> list[str]:
        return self._block(node.children_by_field_name("body"))

    # statements

    def _block(self, nodes: list[tree_sitter.Node]) -> list[str]:
        return [line for node in nodes if node.type != "comment" for line in getattr(self, f"_{node.type}")(node)]

    def _empty_statement(self, node: tree_sitter.Node) -> list[str]:
        return []

    def _assignment_statement(self, node: tree_sitter.Node) -> list[str]:
        return [f"{self._text(_field(node, 'left'))} = {self._text(_field(node, 'right'))};"]

    def _return_statement(self, node: tree_sitter.Node) -> list[str]:
        return ["return result_;"]

    def _exit_statement(self, node: tree_sitter.Node) -> list[str]:
        return ["break;"]

    def _if_statement(self, node: tree_sitter.Node) -> list[str]:
        lines = [f"if ({self._text(_field(node, 'condition'))}) {{"]
        lines += self._block(node.children_by_field_name("consequence"))
        for one in _own(node):
            if one.type == "elsif_clause":
                lines += [f"}} else if ({self._text(_field(one, 'condition'))}) {{", *self._body(one)]
            if one.type == "else_clause":
                lines += ["} else {", *self._body(one)]
        return [*lines, "}"]

    def _for_statement(self, node: tree_sitter.Node) -> list[str]:
        own, (start, end) = self._text(_field(node, "control")), (self._text(_field(node, n)) for n in ("start", "end"))
        step = node.child_by_field_name("step")
        by = int(self._said(step)) if step else 1
        sign = "<=" if by > 0 else ">="
        return [f"for ({own} = {start}; {own} {sign} {end}; {own} += {by}) {{", *self._body(node), "}"]

    # expressions

    def _text(self, node: tree_sitter.Node) -> str:
        return getattr(self, f"_{node.type}")(node)

    def _identifier(self, node: tree_sitter.Node) -> str:
        return self._scope[self._said(node)][1]

    def _integer_literal(self, node: tree_sitter.Node) -> str:
        return f"({self._said(node)}LL)"

    def _real_literal(self, node: tree_sitter.Node) -> str:
        return f"({self._said(node)})"

    def _boolean_literal(self, node: tree_sitter.Node) -> str:
        return "1" if self._said(node) == "TRUE" else "0"

    def _typed_literal(self, node: tree_sitter.Node) -> str:
        kind, value = self._said(_field(node, "type")), self._said(_field(node, "value"))
        return f"(({TYPES[kind]}){value}{'ULL' if kind == 'ULINT' else ''})"

    def _parenthesized_expression(self, node: tree_sitter.Node) -> str:
        (inner,) = (one for one in _own(node) if one.is_named)
        return f"({self._text(inner)})"

    def _unary_expression(self, node: tree_sitter.Node) -> str:
        sign = {"NOT": "!", "-": "-"}[self._said(_field(node, "operator"))]
        return f"({sign}{self._text(_field(node, 'operand'))})"

    def _binary_expression(self, node: tree_sitter.Node) -> str:
        sign = self._said(_field(node, "operator"))
        one, other = (self._text(_field(node, side)) for side in ("left", "right"))
        return f"({one} {OPERATORS.get(sign, sign)} {other})"

    def _member_access_expression(self, node: tree_sitter.Node) -> str:
        return f"{self._text(_field(node, 'object'))}.{self._said(_field(node, 'member'))}"

    def _index_expression(self, node: tree_sitter.Node) -> str:
        base = _field(node, "object")
        return f"{self._text(base)}.at[place({self._text(_field(node, 'index'))}, {self._counts[self._of(base)]})]"

    def _of(self, node: tree_sitter.Node) -> str:
        """The type of a place."""
        if node.type == "identifier":
            return self._scope[self._said(node)][0]
        base = self._of(_field(node, "object"))
        if node.type == "index_expression":
            return self._arrays[base]
        return self._members[base][self._said(_field(node, "member"))]

    def _call_expression(self, node: tree_sitter.Node) -> str:
        name = self._said(_field(node, "function"))
        arguments = [one for one in _own(_field(node, "arguments")) if one.is_named]
        if name not in self._pous:
            texts = [self._text(one) for one in arguments]
            if name in LIBRARY:
                return f"{LIBRARY[name]}({', '.join(texts)})"
            of, _, to = name.partition("_TO_")
            rounded = f"round({texts[0]})" if of == "LREAL" and to != "REAL" else f"({texts[0]})"
            return f"(({TYPES[to]}){rounded})"
        given = {self._said(_field(one, "name")): self._text(_field(one, "value")) for one in arguments}
        wanted = [(section, own) for section, own, _ in self._pous[name] if section != "own"]
        assert set(given) == {own for _, own in wanted}, f"{name}: {sorted(given)}"
        texts = [f"{'' if section == 'in' else '&'}{given[own]}" for section, own in wanted]
        return f"{name}({', '.join(texts)})"


def _own(node: tree_sitter.Node) -> Iterator[tree_sitter.Node]:
    return (one for one in node.children if one.type != "comment")


def _field(node: tree_sitter.Node, name: str) -> tree_sitter.Node:
    found = node.child_by_field_name(name)
    assert found is not None, f"{node.type} has no {name}"
    return found
