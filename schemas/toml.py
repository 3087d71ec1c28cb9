"""TOML files checked by a Pydantic model, with the one-line errors that name file, key and value."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from schemas.errors import DeltatwinError
from schemas.files import read_bytes

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Three = Annotated[list[float], Field(min_length=3, max_length=3)]

MAX_BYTES = 256 << 10  # the longest description in use, all effects in it, has 20 kB
MAX_DEPTH = 12  # tables and lists in each other; descriptions have four
_QUOTED = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"""|\Z)|"(?:\\.|[^"\\\n])*+"?|' r"'''.*?(?:'''|\Z)|'[^'\n]*+'?|#[^\n]*+", re.DOTALL
)  # strings and comments; one that is open goes to the end, once and not again from each quote in it
MOST_SHOWN = 100  # characters of a value in a message
_TWICE = re.compile(
    r"(?:Cannot overwrite a value|(?:Cannot declare|Duplicate inline table key) (?P<key>.*)) "
    r"\(at (?:line (?P<line>\d+)|end of document)"
)  # in the words of `tomllib`
_LONG_KEY = re.compile(rf"(?<![\w+:-])(?:[\w+:-]++[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")


class TomlTable(BaseModel):
    """A table of a file that a user writes: no key that is not known, no figure that is none."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def read_toml(path: Path, error: type[DeltatwinError]) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        error: the file cannot be read, is longer than `MAX_BYTES`, not text, not TOML, or nested beyond `MAX_DEPTH`.
    """
    raw = read_bytes(path, MAX_BYTES, error)
    too_deep = f"{path}: tables or lists nested more than {MAX_DEPTH} deep"
    try:
        text = raw.decode("utf-8-sig")  # editors of Windows begin a file with a mark
    except UnicodeDecodeError as cause:
        raise error(f"{path}: not a text file (byte {cause.start} is not UTF-8)") from cause
    if _LONG_KEY.search(_QUOTED.sub("s", text)):  # tomllib takes time by the square of its length
        raise error(too_deep)
    try:
        values = tomllib.loads(text)
    except ValueError as cause:  # TOMLDecodeError, and integers of more digits than Python reads
        raise error(f"{path}: {_twice(str(cause), text) or f'not TOML: {cause}'}") from cause
    except RecursionError:
        raise error(too_deep) from None
    if _depth(values) > MAX_DEPTH:
        raise error(too_deep)
    return values


def _twice(found: str, text: str) -> str:
    """Which key or table of `text` is there a second time, and where; empty if `found`, by the parser, is another
    fault."""
    fault = _TWICE.match(found)
    if fault is None:
        return ""
    lines = text.rstrip().split("\n")
    number = int(fault["line"] or len(lines))
    line = lines[number - 1].strip()
    key = re.findall(r"'([^']*)'", fault["key"] or "")  # else the key is in the line, unless its value has several
    name = ".".join(key) or (line if line[0] == "[" else line.partition("=")[0].strip() if "=" in line else "a key")
    return f"line {number}: {name} is there a second time; give each key and each table once"


def _depth(values: Any) -> int:
    depth, level = 0, [values]
    while level:
        depth += 1
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, (dict, list))
        ]
    return depth


_Model = TypeVar("_Model", bound=BaseModel)


def validate(model: type[_Model], values: dict[str, Any], path: Path, error: type[DeltatwinError]) -> _Model:
    """`values` of a file as a `model`; in a `TomlTable` a text or a truth value is no number.

    Raises:
        error: naming file, key and value of the first thing that is wrong.
    """
    try:
        return model.model_validate(values, strict=issubclass(model, TomlTable))
    except ValidationError as cause:
        raise error(f"{path}: {explain(cause)}") from cause


def explain(error: ValidationError) -> str:
    """The first finding of a Pydantic error as `key: what is wrong (got value)`."""
    errors = error.errors()
    return explain_one(next((e for e in errors if e["type"] == "extra_forbidden"), errors[0]))  # misspelt, not absent


def explain_one(first: ErrorDetails) -> str:
    """A finding of a Pydantic error, as `explain` does."""
    key = ".".join(str(part) for part in first["loc"]) or "file"
    if first["type"] == "extra_forbidden":
        return f"{key}: unknown key (value {_shown(first['input'])})"
    if first["type"] == "missing":
        return f"{key}: missing key"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error" and not first["loc"]:
        return message  # of the file as a whole: it names its keys
    return f"{key}: {message}" if first["type"] == "value_error" else f"{key}: {message} (got {_shown(first['input'])})"


def _shown(value: object) -> str:
    """A value of a file as it is shown in a message, however much of it there is."""
    try:
        text = repr(value)
    except ValueError:  # of more digits than Python writes; TOML has them as hexadecimal numbers
        return "a number of thousands of digits"
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
