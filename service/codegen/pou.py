"""What a project in IEC 61131-3 is made of, as a text and as PLCopen XML write it alike: data types, functions and
function blocks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

# Words of the standard, its functions and blocks, and words of CODESYS and TwinCAT beside; case does not count.
RESERVED = frozenset((Path(__file__).parent / "templates" / "reserved.txt").read_text(encoding="utf-8").split())


class Variable(NamedTuple):
    """type: of a data type's name, an elementary type or `ARRAY ...`."""

    name: str
    type: str
    comment: str = ""


class DataType(NamedTuple):
    """members: of a structure; else `array`: (count, element) of an array from 0 on."""

    name: str
    members: tuple[Variable, ...] = ()
    array: tuple[int, str] | None = None
    comment: str = ""


@dataclass(frozen=True)
class Pou:
    """A function or a function block. returns: of a function. body: lines."""

    name: str
    kind: Literal["FUNCTION", "FUNCTION_BLOCK"]
    body: list[str]
    returns: str = ""
    inputs: list[Variable] = field(default_factory=list)
    in_outs: list[Variable] = field(default_factory=list)
    outputs: list[Variable] = field(default_factory=list)
    locals: list[Variable] = field(default_factory=list)
    comment: str = ""

    @property
    def sections(self) -> list[tuple[str, list[Variable]]]:
        """Of its declaration, by their words."""
        own = [("VAR_INPUT", self.inputs), ("VAR_IN_OUT", self.in_outs), ("VAR_OUTPUT", self.outputs)]
        return [*own, ("VAR", self.locals)]


class Names:
    """Names of one scope as the standard takes them: no two underscores in a row nor at an end, none of its words, and
    no two that differ by case alone."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._made: dict[str, str] = {}
        self._taken = {name.lower() for name in taken}

    def __call__(self, name: str) -> str:
        if name not in self._made:
            base = re.sub(r"_+", "_", name).strip("_") or "v"
            if base[0].isdigit():
                base = f"v_{base}"
            found, count = f"{base}_v" if base.lower() in RESERVED else base, 2
            while found.lower() in self._taken:
                found, count = f"{base}_v{count}", count + 1
            self._taken.add(found.lower())
            self._made[name] = found
        return self._made[name]


def as_text(types: Iterable[DataType], pous: Iterable[Pou], head: str) -> str:
    """A project as one text, each definition behind those that it needs. head: what its first comment says."""
    lines = [f"(* {head} *)", ""]
    for one in types:
        lines += _type(one)
    for pou in pous:
        lines += _pou(pou)
    return "\n".join(lines)


def _type(one: DataType) -> list[str]:
    lines = [f"(* {one.comment} *)"] if one.comment else []
    if one.array is not None:
        count, element = one.array
        return [*lines, "TYPE", f"    {one.name} : ARRAY [0..{count - 1}] OF {element};", "END_TYPE", ""]
    members = [f"        {_declared(member)}" for member in one.members]
    return [*lines, "TYPE", f"    {one.name} : STRUCT", *members, "    END_STRUCT;", "END_TYPE", ""]


def _pou(pou: Pou) -> list[str]:
    lines = [f"(* {pou.comment} *)"] if pou.comment else []
    lines.append(f"{pou.kind} {pou.name}" + (f" : {pou.returns}" if pou.returns else ""))
    for word, variables in pou.sections:
        if variables:
            lines += [word, *(f"    {_declared(one)}" for one in variables), "END_VAR"]
    return [*lines, *(f"    {line}" for line in pou.body), f"END_{pou.kind}", ""]


def _declared(one: Variable) -> str:
    return f"{one.name} : {one.type};" + (f" (* {one.comment} *)" if one.comment else "")
