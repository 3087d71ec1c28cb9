"""One description at one sample rate as a function block of IEC 61131-3: for CODESYS, TwinCAT and what else takes the
standard's third edition, as a text and as PLCopen XML.

As `twin` is for C: the kernels' own arithmetic, and round it what a controller may do wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from schemas.messages import TOPICS, FeedforwardSource
from schemas.robot import Robot
from service.codegen import tunable
from service.codegen.c import nested
from service.codegen.pou import DataType, Names, Pou, Variable, as_text
from service.codegen.source import CodegenError
from service.codegen.st import SCALARS, Writer, number
from service.codegen.tree import Function
from service.codegen.twin import HEALTH, IN, OUT, SAME_PERIOD, check_name, lowered, nonzero, said, template, texts
from service.codegen.types import Array, Nothing, Record, Scalar, Several
from service.estimator import state
from service.estimator.left_out import left_out

CODES = {
    "OK": 0, "NOT_READY": -1, "WRONG_PERIOD": -2, "OUT_OF_RANGE": -4, "NOT_FINITE": -5, "OTHER_ARITHMETIC": -6,
}  # fmt: skip


@dataclass(frozen=True)
class Project:
    """types, pous: each behind those that it needs; the block last. left_out: as of a `Twin`."""

    name: str
    robot: str
    types: list[DataType]
    pous: list[Pou]
    left_out: dict[str, str]

    @property
    def about(self) -> str:
        return f"Robot {said(self.robot)}. Made by deltatwin {version('deltatwin')}, deltatwin export --to st"

    @property
    def text(self) -> str:
        """All of it in Structured Text."""
        return as_text(self.types, self.pous, f"{self.about}; do not edit.")


def to_st(robot: Robot, period: float, name: str = "deltatwin", nominal: bool = False) -> Project:
    """The online step of `robot` at a sample every `period` s. nominal: also of one that was never identified.

    Raises:
        RobotError, CodegenError: as `to_c`.
    """
    check_name(name)
    if Names()(name) != name:
        raise CodegenError(f"--name: {name!r}: in Structured Text use no keyword, no __ and no _ at the end")
    settings, program, functions = lowered(robot, period, nominal)
    writer = Writer(program.layout, name)
    kernels = [writer.function(one) for one in program.functions]
    topics = {TOPICS[topic].dtype: topic for topic in (*IN, *OUT)}
    types: list[DataType] = []
    for dtype in nested(state.STEP):
        about, notes = "", {}
        if dtype in topics:
            about, notes = _told(topics[dtype])
        types += writer.structure(dtype, about, notes)
    steps = writer.array(Array(Record(state.STEP), (1,)))
    types += _parameters(writer)
    block = _block(writer, functions, period, settings, robot.fourth_axis is not None, steps)
    around = [_clear(writer, "begin", "state", state.STATE, state.fresh(settings)["state"][0])]
    around += [_clear(writer, "describe", "settings", state.SETTINGS, settings[0]), _arithmetic(name)]
    around += [_zero(writer, topic) for topic in OUT]
    order = _in_order([*types, *(one for one in writer.arrays.values() if one not in types)])
    pous = [*writer.used_helpers(), *kernels, *around, block]
    return Project(name, robot.name, order, pous, left_out(robot, period))


def _told(topic: str) -> tuple[str, dict[str, str]]:
    """What is said of a message and its fields, with its constants."""
    about, notes, constants = texts(TOPICS[topic])
    told = "; ".join(f"{value} {constant}" for constant, value, _ in constants)
    return said_in_st(f"{about}{f' Bits and values: {told}' if told else ''}"), {
        field: said_in_st(note) for field, note in notes.items()
    }


def said_in_st(text: str) -> str:
    """A text inside a comment."""
    return text.encode("ascii", "replace").decode().replace("(*", "( *").replace("*)", "* )")


def _in_order(types: list[DataType]) -> list[DataType]:
    """Each behind those that it holds."""
    known, made = {one.name: one for one in types}, dict[str, DataType]()

    def put(one: DataType) -> None:
        for inner in [member.type for member in one.members] + ([one.array[1]] if one.array else []):
            if inner in known and inner not in made:
                put(known[inner])
        made.setdefault(one.name, one)

    for one in types:
        put(one)
    return list(made.values())


def _parameters(writer: Writer) -> list[DataType]:
    """The structure of what may be loaded."""
    members = []
    for one in tunable.LOADABLE:
        shape = tunable.shape(one)
        kind = writer.array(Array("f8", shape)) if shape else "LREAL"
        note = f"{one.unit}, {one.meaning}; {number(one.low, Scalar.REAL)} to {number(one.high, Scalar.REAL)}"
        members.append(Variable(writer.member(state.SETTINGS, one.name), kind, said_in_st(note)))
    return [DataType(f"{writer.prefix}_parameters_t", tuple(members), comment="parameters that may be loaded")]


def _block(
    writer: Writer, functions: dict[str, Function], period: float, settings: np.ndarray, has_fourth: bool, steps: str
) -> Pou:
    name = writer.prefix
    for helper in ("no_number", "isfinite"):
        writer.helper(helper)
    topic = {one: f"{name}_{one}_t" for one in (*IN, *OUT, "parameters")}
    fourth = [Variable("has_fourth_position", "BOOL", "sample.fourth_position is valid")] if has_fourth else []
    inputs = [
        Variable("init", "BOOL", "for one cycle: start without history; the payload is unknown"),
        Variable("period_s", "LREAL", f"s, of the task's cycle; made for {period:g}"),
        Variable("sample", topic["sample"], "sample of this cycle"),
        Variable("has_position_command", "BOOL", "sample.position_command is valid"),
        Variable("has_torque_command", "BOOL", "sample.torque_command is valid"),
        *fourth,
        Variable("plan", "BOOL", "planned is the motion of a coming cycle"),
        Variable("planned", topic["reference"]),
        Variable("load", "BOOL", "at a standstill: load the parameters and start again"),
        Variable("parameters", topic["parameters"]),
        Variable("ask_findings", "BOOL", "about once a second: fill friction and health"),
    ]
    codes = ", ".join(f"{value} {code}" for code, value in CODES.items())
    health = ", ".join(f"{flag.value} {flag.name}" for flag in HEALTH)
    outputs = [
        Variable("code", "DINT", codes),
        Variable("feedforward", topic["feedforward"], "torque for the drives; zero where code is not 0 or -4"),
        Variable("has_payload", "BOOL", "payload and error are valid; they are a fixed lag old"),
        *(Variable(one, topic[one]) for one in ("payload", "error", "friction")),
        Variable("health", "LINT", health),
        Variable("parameters_now", topic["parameters"]),
    ]
    own = [
        Variable("it", steps), Variable("ready", "BOOL"), Variable("behind", _kind(functions["answer"], 1)),
        Variable("fits", "BOOL"), Variable("done", "BOOL"), *(Variable(one, "LINT") for one in "ij"),
    ]  # fmt: skip
    roots = {}
    for root, function in functions.items():
        ((given, _),) = function.parameters
        roots[root] = f"{writer.named(function)}({Names([writer.named(function)])(given)} := it"
    parts = [f"unused_{n}" for n in range(len(functions["answer"].returns.items))]  # pyright: ignore
    told = ", ".join(f"part_{n} => {'behind' if n == 1 else part}" for n, part in enumerate(parts))
    own += [Variable(part, _kind(functions["answer"], n)) for n, part in enumerate(parts) if n != 1]
    roots["answer"] += f", {told})"
    back = functions["look_back"]
    assert not isinstance(back.returns, Several)
    kind = SCALARS[back.returns] if isinstance(back.returns, Scalar) else "BOOL"
    own.append(Variable("looked", kind))
    roots["look_back"] = f"looked := {roots['look_back']});"
    roots["plan"], roots["findings"] = f"{roots['plan']})", f"{roots['findings']})"
    assert functions["plan"].returns == Nothing()
    body = template("twin.st").render(
        name=name,
        codes=CODES,
        step={one: writer.member(state.STEP, one) for one in state.STEP.names or ()},
        period=number(period, Scalar.REAL),
        same_period=number(SAME_PERIOD, Scalar.REAL),
        roots=roots,
        has_fourth=has_fourth,
        growth_share=number(tunable.growth_share(settings), Scalar.REAL),
        behind_test="" if _kind(functions["answer"], 1) == "BOOL" else "<> 0",
        loadable=[_loadable(writer, one) for one in tunable.LOADABLE],
    )
    return Pou(name, "FUNCTION_BLOCK", body.rstrip().splitlines(), "", inputs, [], outputs, own, "Once a cycle")


def _kind(function: Function, part: int) -> str:
    assert isinstance(function.returns, Several)
    kind = function.returns.items[part]
    assert isinstance(kind, Scalar)
    return SCALARS[kind]


def _loadable(writer: Writer, one: tunable.Loadable) -> dict[str, Any]:
    """Lines that test, take and tell one of the figures."""
    field, shape = writer.member(state.SETTINGS, one.name), tunable.shape(one)
    index = "".join(f"[{axis}]" for axis in "ij"[: len(shape)])
    given, kept = f"parameters.{field}{index}", f"it[0].{writer.member(state.STEP, 'settings')}.{field}{index}"
    low, high = (number(value, Scalar.REAL) for value in (one.low, one.high))
    test = [f"IF (({given} >= {low}) AND ({given} <= {high})) = FALSE THEN", "    fits := FALSE;", "END_IF;"]
    return {
        "tests": _looped(test, shape, 1),
        "takes": _looped([f"{kept} := {given};"], shape, 2),
        "tells": _looped([f"parameters_now.{field}{index} := {kept};"], shape, 0),
    }


def _looped(lines: list[str], shape: tuple[int, ...], depth: int) -> str:
    for axis, count in reversed(list(zip("ij", shape, strict=False))):
        lines = [f"FOR {axis} := 0 TO {count - 1} DO", *(f"    {line}" for line in lines), "END_FOR;"]
    return "\n".join("    " * depth + line for line in lines)


def _clear(writer: Writer, name: str, given: str, dtype: np.dtype, record: Any) -> Pou:
    """A function that gives a record the values of `record`."""
    axes: set[str] = set()
    lines = _zeros(writer, dtype, given, 0, axes)
    for place, value in nonzero(writer.layout, dtype, record, given, writer.member):
        lines.append(f"{place} := {writer.literal(value)};")
    own = f"{writer.prefix}_{name}"
    lines.append(f"{own} := TRUE;")
    local = [Variable(axis, "LINT") for axis in sorted(axes)]
    return Pou(own, "FUNCTION", lines, "BOOL", [], [Variable(given, writer.record(dtype))], [], local)


def _zeros(writer: Writer, dtype: np.dtype, place: str, depth: int, axes: set[str]) -> list[str]:
    """Statements that make every number of a record zero."""
    lines = []
    for name in writer.layout.members(dtype):
        kind, here = writer.layout.field(dtype, name), f"{place}.{writer.member(dtype, name)}"
        shape = kind.shape if isinstance(kind, Array) else ()
        own = [f"axis_{depth + n}" for n in range(len(shape))]
        axes.update(own)
        here += "".join(f"[{axis}]" for axis in own)
        element = kind.element if isinstance(kind, Array) else kind
        if isinstance(element, Record):
            inner = _zeros(writer, element.dtype, here, depth + len(shape), axes)
        else:
            is_real = (element if isinstance(element, str) else dtype[name].base.str[1:])[0] == "f"
            inner = [f"{here} := {'0.0' if is_real else '0'};"]
        for axis, count in reversed(list(zip(own, shape, strict=True))):
            inner = [f"FOR {axis} := 0 TO {count - 1} DO", *(f"    {line}" for line in inner), "END_FOR;"]
        lines += inner
    return lines


def _zero(writer: Writer, topic: str) -> Pou:
    """A function that makes an answer say nothing."""
    dtype, axes = TOPICS[topic].dtype, set[str]()
    lines = _zeros(writer, dtype, "answer", 0, axes)
    if "source" in writer.layout.members(dtype):
        lines.append(f"answer.{writer.member(dtype, 'source')} := {int(FeedforwardSource.NONE)};")
    own = f"{writer.prefix}_zero_{topic}"
    lines.append(f"{own} := TRUE;")
    local = [Variable(axis, "LINT") for axis in sorted(axes)]
    return Pou(own, "FUNCTION", lines, "BOOL", [], [Variable("answer", writer.record(dtype))], [], local)


def _arithmetic(name: str) -> Pou:
    """Whether the controller reckons as the kernels need it: 64 bits, and no number is less than, more than or equal to
    what is none. There are compilers that test the flags of a comparison otherwise."""
    own = f"{name}_keeps_ieee_754"
    body = [
        "none := huge * huge;",
        f"{own} := none > huge;",
        "none := none - none;",
        "IF (none < one) OR (none > one) OR (none = one) OR (none >= one) OR (none <= one) OR (none = none) THEN",
        f"    {own} := FALSE;",
        "END_IF;",
        "IF NOT (none <> none) OR (one + LREAL#2.220446049250313E-16 = one) OR (LREAL#0.1 * 3.0 = LREAL#0.3) THEN",
        f"    {own} := FALSE;",
        "END_IF;",
    ]
    inputs = [Variable("huge", "LREAL"), Variable("one", "LREAL")]
    return Pou(own, "FUNCTION", body, "BOOL", inputs, locals=[Variable("none", "LREAL")])
