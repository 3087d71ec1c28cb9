"""Types of what a kernel computes with: scalars, and views of records and arrays whose shapes are known."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np


class Scalar(enum.Enum):
    """What an expression may be worth. Smaller integers are read as INT, which holds them all."""

    BOOL = "bool"
    INT = "int64"
    UINT = "uint64"
    REAL = "float64"
    SINGLE = "float32"  # as it is stored: a kernel makes it REAL before it counts with it


@dataclass(frozen=True)
class Record:
    """A view of a structured record."""

    dtype: np.dtype


@dataclass(frozen=True)
class Array:
    """A view of an array. element: of NumPy's codes ("f8"), or records."""

    element: str | Record
    shape: tuple[int, ...]

    @property
    def item(self) -> Type:
        """What one index gives."""
        if len(self.shape) > 1:
            return Array(self.element, self.shape[1:])
        return self.element if isinstance(self.element, Record) else read_as(self.element)


@dataclass(frozen=True)
class Several:
    """Values side by side: a tuple, or the fields of a NamedTuple."""

    items: tuple[Type, ...]
    names: tuple[str, ...] = ()
    title: str = ""


@dataclass(frozen=True)
class Nothing:
    """What a kernel that returns nothing returns."""


Type = Scalar | Record | Array | Several | Nothing
Reference = Record | Array


def read_as(code: str) -> Scalar:
    """What a number stored as `code` is worth."""
    if code in ("u8", "f4"):
        return Scalar.UINT if code == "u8" else Scalar.SINGLE
    return Scalar.INT if code[0] in "iu" else Scalar.REAL


def stored(dtype: np.dtype, shape: tuple[int, ...] = ()) -> Type:
    """The type of a field of `dtype`, as `shape` of it where it is an array."""
    base, whole = (dtype, shape) if dtype.subdtype is None else (dtype.subdtype[0], shape or dtype.subdtype[1])
    element: str | Record = Record(base) if base.fields else base.str[1:]
    if whole:
        return Array(element, tuple(whole))
    return element if isinstance(element, Record) else read_as(element)


def unified(one: Type, other: Type) -> Type | None:
    """The type of a variable that is now the one, now the other, as Numba has it; None where there is none."""
    if one == other:
        return one
    if {one, other} == {Scalar.INT, Scalar.REAL}:
        return Scalar.REAL
    if isinstance(one, Several) and isinstance(other, Several) and len(one.items) == len(other.items):
        items = [unified(a, b) for a, b in zip(one.items, other.items, strict=True)]
        if one.names == other.names and None not in items:
            return Several(tuple(item for item in items if item is not None), one.names, one.title)
    return None
