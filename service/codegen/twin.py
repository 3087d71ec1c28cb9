"""One description at one sample rate as a C99 header and source: all of the online step, with the state in it.

The arithmetic is that of the kernels (`program`, `c`). What `templates` add is what stands round them in
`service.estimator.estimator`: the state as it begins, the order of answer and look back; and what a controller may do
wrong: no init, another cycle, a figure that no robot has.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from schemas.errors import RobotError
from schemas.messages import TOPICS, HealthFlag, Message
from schemas.robot import Robot
from service.codegen import float32, tunable
from service.codegen.c import UNROLLED, Writer, nested, number, word
from service.codegen.layout import layout_of, optional
from service.codegen.program import Layout, Program
from service.codegen.source import CodegenError
from service.codegen.tree import Function
from service.codegen.types import Array, Record, Scalar
from service.estimator import state
from service.estimator.estimator import LONGEST_PERIOD, SHORTEST_PERIOD
from service.estimator.feedforward import plan_kernel
from service.estimator.friction_health import findings_kernel
from service.estimator.kalman import MAX_LAG
from service.estimator.left_out import left_out
from service.estimator.step import answer_kernel, look_back_kernel

SAME_PERIOD = 1e-3  # relative, of the cycle that init is told
STATIC_BYTES = 65_536  # of a small controller; more are said
IN, OUT = ("sample", "reference"), ("feedforward", "payload", "error", "friction")
ROOTS = {"answer": answer_kernel, "look_back": look_back_kernel, "plan": plan_kernel, "findings": findings_kernel}
# What findings say of the machine; the rest of health is of a process on the bus.
HEALTH = {
    HealthFlag.FRICTION_DRIFT: "friction has drifted from the identified value by more than the description allows",
    HealthFlag.SCALE_DRIFT: "a torque constant has drifted by more than the description allows",
    HealthFlag.COMMAND_REFUTED: "the drives do not follow torque_command: masses are estimated without it",
    HealthFlag.EFFECT_LEFT_OUT: "the description names an effect that the online model leaves out",
}
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_ID = "THE_ID_OF_THIS_CODE"
_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Twin:
    """header, source: of C99. static_bytes: of what it remembers and its settings, where doubles are aligned to eight.
    looked_back: samples that the look back remembers.
    left_out: effect -> why the online model does without. single: in single precision. id: 64 bits of the SHA-256 of
    both texts, which the code says of itself."""

    name: str
    header: str
    source: str
    static_bytes: int
    looked_back: int
    left_out: dict[str, str]
    single: bool
    id: int

    @property
    def digest(self) -> str:
        """SHA-256 of header and source."""
        return hashlib.sha256((self.header + self.source).encode()).hexdigest()


def check_name(name: str) -> str:
    """A name that files, types and functions may begin with.

    Raises:
        CodegenError: C would not take it.
    """
    if not _IDENTIFIER.fullmatch(name) or word(name) != name:
        raise CodegenError(
            f"--name: {name!r}: use at most 31 letters, digits and _, beginning with a letter, and no keyword of C"
        )
    return name


def to_c(robot: Robot, period: float, name: str = "deltatwin", nominal: bool = False, single: bool = False) -> Twin:
    """The online step of `robot` at a sample every `period` s. nominal: also of one that was never identified. single:
    in single precision.

    Raises:
        RobotError: it was not identified, or has an effect that is not known. CodegenError: the name, the period, or a
        construct of a kernel that the generator does not know.
    """
    check_name(name)
    settings, program, functions = lowered(robot, period, nominal)
    layout, roots = program.layout, {root: function.name for root, function in functions.items()}
    writer, macro = Writer(layout, name), name.upper()
    size, looked_back = in_c(layout, state.STEP, single).itemsize, layout.constant("MAX_LAG", MAX_LAG)
    loadable = [_loadable(writer, one) for one in tunable.LOADABLE]
    known = {"name": name, "macro": macro, "version": version("deltatwin"), "robot": said(robot.name)}
    header = template("twin.h").render(
        **known,
        period=period,
        static_bytes=size,
        looked_back=looked_back,
        single=f"In single precision: {float32.ERROR}" if single else "",
        period_literal=number(period, Scalar.REAL),
        effects=", ".join(said(entry.name) for entry in robot.effect) or "none",
        messages=[_message(writer, topic, TOPICS[topic]) for topic in (*IN, *OUT)],
        health=[{"name": flag.name, "value": flag.value, "comment": said} for flag, said in HEALTH.items()],
        loadable=loadable,
    )
    source = template("twin.c").render(
        **known,
        definitions="\n".join(_definitions(writer, program)),
        settings=writer.record(state.SETTINGS),
        step=writer.record(state.STEP),
        described="\n".join(_initial(layout, state.SETTINGS, settings[0], "    ")),
        beginning=[
            (place, _literal(value))
            for place, value in nonzero(layout, state.STATE, state.fresh(settings)["state"][0], "it.state", _member)
        ],
        answers={topic: _zeros(layout, topic, macro) for topic in OUT},
        cleared=_cleared(layout),
        roots=roots,
        loadable=loadable,
        same_period=repr(SAME_PERIOD),
        id=_ID,
        unrolled=UNROLLED,
        growth_share=_literal(tunable.growth_share(settings)),
    )
    if single:
        header, source = float32.in_single(header), float32.in_single(source)
    own = int(hashlib.sha256((header + source).encode()).hexdigest()[:16], 16)
    source = source.replace(_ID, f"UINT64_C({own})")
    return Twin(name, header, source, size, looked_back, left_out(robot, period), single, own)


def lowered(robot: Robot, period: float, nominal: bool) -> tuple[np.ndarray, Program, dict[str, Function]]:
    """(1,) SETTINGS of the estimator, all of its step as trees, and those of `ROOTS` among them.

    Raises:
        RobotError, CodegenError: as `to_c`.
    """
    if robot.identified is None and not nominal:
        raise RobotError(
            f"{robot.origin}: identified: missing: friction would be zero and rho 1; run `deltatwin identify`, "
            "or give --nominal"
        )
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        raise CodegenError(f"a cycle of {period:g} s: must be {SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s")
    settings = state.settings(robot, period, 1)
    program, step = Program(layout_of(robot, settings)), (Array(Record(state.STEP), (1,)),)
    return settings, program, {root: program.function(kernel, step) for root, kernel in ROOTS.items()}


def in_c(layout: Layout, dtype: np.dtype, single: bool = False) -> np.dtype:
    """The record as the generated code lays it out in memory."""
    fields = []
    for name in layout.members(dtype):
        kind = layout.field(dtype, name)
        base = np.dtype("f4") if single and dtype[name].base == np.dtype("f8") else dtype[name].base
        inner = in_c(layout, base, single) if base.fields else base
        fields.append((name, inner, kind.shape) if isinstance(kind, Array) else (name, inner))
    return np.dtype(fields, align=True)


def template(name: str) -> jinja2.Template:
    """One of `templates`."""
    loader = jinja2.FileSystemLoader(_TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, trim_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(name)


def said(text: str) -> str:
    """A text of a description, which may be anything, inside a comment, which ends where it says so."""
    return re.sub(r"[^A-Za-z0-9_. -]", "?", text)


def _definitions(writer: Writer, program: Program) -> list[str]:
    functions = [line for one in program.functions for line in writer.function(one)]
    public = {TOPICS[topic].dtype for topic in (*IN, *OUT)}
    records = writer.records(one for one in nested(state.STEP) if one not in public)
    return [*records, *writer.bundles(program), *writer.used_helpers(), *functions]


def _message(writer: Writer, topic: str, message: Message) -> dict[str, Any]:
    """A message as its text defines it, constants and comments too, less what is of the wire alone."""
    about, notes, constants = texts(message)
    fields = [
        {"declared": writer.member(message.dtype, name), "comment": _comment(notes.get(name, ""))}
        for name in writer.layout.members(message.dtype)
    ]
    told = [{"name": one, "value": value, "comment": _comment(note)} for one, value, note in constants]
    return {"topic": topic, "about": about, "constants": told, "fields": fields}


def texts(message: Message) -> tuple[str, dict[str, str], list[tuple[str, str, str]]]:
    """What a message's text says: of all of it, of each field, and its constants: name, value, note."""
    lines = message.text.splitlines()
    told = {line.split("#", 1)[0].strip(): line.partition("#")[2].strip() for line in lines}
    notes = {text.split()[-1]: note for text, note in told.items() if text and "=" not in text}
    notes |= {"stamp_sec": f"s, {notes.get('header', '')}", "stamp_nanosec": "ns, on top of that"}
    constants = [
        (found[1], found[2], note)
        for text, note in told.items()
        if (found := re.fullmatch(r"uint32 ([A-Z_]+)=(\d+)", text))
    ]
    return lines[0].lstrip("# "), notes, constants


def _comment(note: str) -> str:
    return f" /* {note} */" if note else ""


def _loadable(writer: Writer, one: tunable.Loadable) -> dict[str, Any]:
    shape = tunable.shape(one)
    axes = [{"name": axis, "count": count} for axis, count in zip("ij", shape, strict=False)]
    return {
        "name": one.name,
        "declared": writer.member(state.SETTINGS, one.name),
        "unit": one.unit,
        "meaning": one.meaning,
        "low": _literal(one.low),
        "high": _literal(one.high),
        "axes": axes,
        "index": "".join(f"[{axis['name']}]" for axis in axes),
    }


def _initial(layout: Layout, dtype: np.dtype, record: Any, space: str) -> list[str]:
    """Designated initialisers of a record's fields."""
    lines = []
    for name in layout.members(dtype):
        kind, value, own = layout.field(dtype, name), record[name], f"{space}.{word(name)} = "
        if isinstance(kind, Record):
            lines += [f"{own}{{", *_initial(layout, kind.dtype, value, f"{space}    "), f"{space}}},"]
        elif isinstance(kind, Array) and isinstance(kind.element, Record):
            lines.append(f"{own}{{")
            for one in value[: kind.shape[0]]:
                inner = _initial(layout, kind.element.dtype, one, f"{space}        ")
                lines += [f"{space}    {{", *inner, f"{space}    }},"]
            lines.append(f"{space}}},")
        else:
            lines.append(f"{own}{_braces(np.asarray(value))},")
    return lines


def nonzero(
    layout: Layout, dtype: np.dtype, record: Any, place: str, member: Callable[[np.dtype, str], str]
) -> list[tuple[str, Any]]:
    """Where a record is not zero, and what it is there. member: what a field is called."""
    found = []
    for name in layout.members(dtype):
        kind, value, here = layout.field(dtype, name), record[name], f"{place}.{member(dtype, name)}"
        if isinstance(kind, Record):
            found += nonzero(layout, kind.dtype, value, here, member)
        elif isinstance(kind, Array) and isinstance(kind.element, Record):
            for n in range(kind.shape[0]):
                found += nonzero(layout, kind.element.dtype, value[n], f"{here}[{n}]", member)
        else:
            shape = kind.shape if isinstance(kind, Array) else ()
            cut = np.asarray(value)[tuple(slice(count) for count in shape)]
            for at in np.argwhere(cut != 0):
                index = "".join(f"[{n}]" for n in at)
                found.append((f"{here}{index}", cut[tuple(at)]))
    return found


def _member(dtype: np.dtype, name: str) -> str:
    return word(name)


def _zeros(layout: Layout, topic: str, macro: str) -> list[str]:
    """Statements that make a message say nothing."""
    dtype = TOPICS[topic].dtype
    values = {"source": f"{macro}_SOURCE_NONE"}
    return [_set("answer", layout, dtype, name, values.get(name, "0")) for name in layout.members(dtype)]


def _cleared(layout: Layout) -> list[str]:
    dtype = TOPICS["sample"].dtype
    unknown = optional(dtype)
    names = layout.members(dtype)
    return [_set("sample", layout, dtype, name, "(double)NAN" if name in unknown else "0") for name in names]


def _set(record: str, layout: Layout, dtype: np.dtype, name: str, value: str) -> str:
    kind = layout.field(dtype, name)
    if not isinstance(kind, Array):
        return f"{record}->{name} = {value};"
    shown = "0.0" if value == "0" else value
    return f"for (int64_t i = 0; i < {kind.shape[0]}; i++) {{ {record}->{name}[i] = {shown}; }}"


def _literal(value: Any) -> str:
    kind = Scalar.REAL if isinstance(value, float | np.floating) else Scalar.INT
    return number(value.item() if isinstance(value, np.generic) else value, kind)


def _braces(values: np.ndarray) -> str:
    if values.ndim:
        return "{" + ", ".join(_braces(one) for one in values) + "}"
    return _literal(values[()])
