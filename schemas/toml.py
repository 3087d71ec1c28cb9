"""TOML files checked by a Pydantic model, with the one-line errors that name file, key and value."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from schemas.errors import DeltatwinError


def read_toml(path: Path, error: type[DeltatwinError]) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        error: the file cannot be read, is not text or not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as cause:
        raise error(f"{path}: {cause.strerror}") from cause
    except UnicodeDecodeError as cause:
        raise error(f"{path}: not a text file (byte {cause.start} is not UTF-8)") from cause
    except tomllib.TOMLDecodeError as cause:
        raise error(f"{path}: not TOML: {cause}") from cause


_Model = TypeVar("_Model", bound=BaseModel)


def validate(model: type[_Model], values: dict[str, Any], path: Path, error: type[DeltatwinError]) -> _Model:
    """`values` as a `model`.

    Raises:
        error: naming file, key and value of the first thing that is wrong.
    """
    try:
        return model.model_validate(values)
    except ValidationError as cause:
        raise error(f"{path}: {explain(cause)}") from cause


def explain(error: ValidationError) -> str:
    """The first finding of a Pydantic error as `key: what is wrong (got value)`."""
    errors = error.errors()
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])  # a misspelt key, not its absence
    key = ".".join(str(part) for part in first["loc"]) or "file"
    if first["type"] == "extra_forbidden":
        return f"{key}: unknown key (value {first['input']!r})"
    if first["type"] == "missing":
        return f"{key}: missing key"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key}: {message}" if first["type"] == "value_error" else f"{key}: {message} (got {first['input']!r})"
