"""Every key of a TOML file, from the Pydantic model that checks it: type, bounds, default, comment."""

from __future__ import annotations

import inspect
import io
import re
import tokenize
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from docs.making.markdown import cell, code, prose, table

_BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
_NAMES = {float: "number", int: "integer", str: "text", bool: "true or false", Any: "any"}
_DECLARED = re.compile(r"^ {4}(\w+): ")


@dataclass(frozen=True)
class Key:
    """A key as it stands in a file (`drive.joint[].sign`) and what its model says of it. inner: the table behind it."""

    path: str
    field: FieldInfo
    meaning: str
    inner: tuple[type[BaseModel], ...]


def keys(model: type[BaseModel], above: str = "") -> Iterator[Key]:
    """All keys of a model, those of inner tables included, each once."""
    model.model_rebuild()  # names of classes that stand further down in their file become these
    for name, field in model.model_fields.items():
        path, inner = f"{above}{field.alias or name}", tuple(dict.fromkeys(_models(field.annotation)))
        yield Key(path, field, _comments(model).get(name, ""), inner)
        mark = "[]." if _is_list(field.annotation) else ".<name>." if _is_dict(field.annotation) else "."
        seen: set[str] = set()
        for table_ in inner:
            for key in keys(table_, path + mark):
                if key.path not in seen:
                    seen.add(key.path)
                    yield key


def page(model: type[BaseModel], title: str, introduction: str) -> str:
    """The reference page of a file whose top table is `model`: a section a table, a row a key."""
    return f"# {title}\n\n{introduction}\n" + _section(model, "", 2, set())


def _section(model: type[BaseModel], above: str, level: int, done: set[type[BaseModel]]) -> str:
    done.add(model)
    heading = f"\n{'#' * level} `[{above.rstrip('.')}]`\n\n" if above else "\n"
    rows = [
        [code(key.path), described(key.field), code(_default(key.field)), cell(key.meaning or _of_tables(key.inner))]
        for key in _own(model)
    ]
    text = heading + prose(model.__doc__ if model.__doc__ != BaseModel.__doc__ else "") + "\n"
    text += table(["Key", "Type", "Default", "Meaning"], rows)
    for key in _own(model):
        mark = "[]." if _is_list(key.field.annotation) else ".<name>." if _is_dict(key.field.annotation) else "."
        for inner in key.inner:
            text += _section(inner, above + key.path + mark, min(level + 1, 4), done)
    return text


def _of_tables(inner: Sequence[type[BaseModel]]) -> str:
    """What a key means that is a table: the first line of what its model says of itself."""
    said = [(one.__doc__ or "").strip().partition("\n")[0] for one in inner if one.__doc__ != BaseModel.__doc__]
    return "; or: ".join(line.partition(". ")[0].rstrip(".") for line in said if line)


def _own(model: type[BaseModel]) -> list[Key]:
    return [key for key in keys(model) if "." not in key.path]


@cache
def _comments(model: type[BaseModel]) -> dict[str, str]:
    """What the source says beside each key, behind it or in lines of its own above, base classes included."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, BaseModel) and kind is not BaseModel:
            found |= _of_source(inspect.getsource(kind))
    return found


def _of_source(source: str) -> dict[str, str]:
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(inspect.cleandoc("\n" + source)).readline)
        if token.type == tokenize.COMMENT
    }
    found: dict[str, str] = {}
    lines = inspect.cleandoc("\n" + source).splitlines()
    for number, line in enumerate(lines, start=1):
        declared = _DECLARED.match(line)
        if not declared:
            continue
        last = number
        while "".join(lines[number - 1 : last]).count("(") > "".join(lines[number - 1 : last]).count(")"):
            last += 1
        above, row = [], number - 1
        while row in comments and lines[row - 1].lstrip().startswith("#") and not lines[row - 1].rstrip().endswith("#"):
            above.insert(0, comments[row])
            row -= 1
        beside = [comments[row] for row in range(number, last + 1) if row in comments]
        found[declared[1]] = " ".join(above + beside).removeprefix("noqa")
    return found


def described(field: FieldInfo) -> str:
    """Type and bounds of a key, as a user would say them."""
    return _bounded(field.annotation, field.metadata)


def _bounded(kind: Any, metadata: Sequence[Any]) -> str:
    bounds: dict[str, Any] = {}
    for one in metadata:
        for inner in (one, *getattr(one, "metadata", ())):
            names = (*_BOUNDS, "min_length", "max_length")
            bounds |= {name: getattr(inner, name) for name in names if getattr(inner, name, None) is not None}
    said = [f"{sign} {bounds[name]}" for name, sign in _BOUNDS.items() if name in bounds]
    low, high = bounds.get("min_length"), bounds.get("max_length")
    if low is not None and low == high:
        said.append(f"{low} entries")
    elif low is not None or high is not None:
        said.append(f"at least {low} entries" if high is None else f"{low or 0} to {high} entries")
    return ", ".join([_type(kind), *said])


def _type(kind: Any) -> str:
    origin, inside = get_origin(kind), get_args(kind)
    if origin is typing.Annotated:
        return _bounded(inside[0], inside[1:])
    if origin is Literal:
        return " or ".join(code(f'"{one}"' if isinstance(one, str) else str(one)) for one in inside)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(one) for one in inside if one is not type(None)))
    if origin in (list, tuple):
        return f"list of {_type(inside[0])}"
    if origin is dict:
        return f"table of {_type(inside[1])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "table"
    return _NAMES.get(kind, getattr(kind, "__name__", str(kind)))


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for inside in get_args(kind):
        yield from _models(inside)


def _is_list(kind: Any) -> bool:
    return get_origin(kind) is list or any(_is_list(one) for one in get_args(kind))


def _is_dict(kind: Any) -> bool:
    return get_origin(kind) is dict or any(_is_dict(one) for one in get_args(kind))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel) or (isinstance(value, list) and any(isinstance(one, BaseModel) for one in value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None else repr(value)
