"""The typed tree that a kernel becomes, from which each back end writes its language."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from service.codegen.types import Several, Type


@dataclass(frozen=True)
class Expr:
    """op: `const`, `var`, `field`, `index`, `cast`, `call`, `math`, `cond`, `several`, `item` or an operator's name.

    value: of a constant; the name of a variable, field or function of math; a `Function` that is called; which item.
    """

    op: str
    type: Type
    args: tuple[Expr, ...] = ()
    value: Any = None

    @property
    def is_constant(self) -> bool:
        return self.op == "const"


@dataclass(frozen=True)
class Assign:
    """A number into a variable or a place in memory."""

    target: Expr
    value: Expr


@dataclass(frozen=True)
class Bind:
    """A name for a view, or for values side by side."""

    name: str
    value: Expr


@dataclass(frozen=True)
class Fill:
    """Every number of an array; of its last axis only from `first` on."""

    array: Expr
    value: Expr
    first: int = 0


@dataclass(frozen=True)
class Do:
    """A call for its effect."""

    call: Expr


@dataclass(frozen=True)
class If:
    test: Expr
    body: list[Any]
    otherwise: list[Any]


@dataclass(frozen=True)
class For:
    """Counts from `start` to before `stop` by `step`, a constant; both are worked out once, before."""

    name: str
    start: Expr
    stop: Expr
    step: int
    body: list[Any]


@dataclass(frozen=True)
class Return:
    """value: None where the kernel returns nothing."""

    value: Expr | None


@dataclass(frozen=True)
class Leave:
    """word: `break` or `continue`."""

    word: str


@dataclass
class Function:
    """One kernel for one set of argument types. writes: the parameters and variables through which it stores."""

    name: str
    where: str
    about: str
    parameters: list[tuple[str, Type]]
    returns: Type
    variables: dict[str, Type] = field(default_factory=dict)
    body: list[Any] = field(default_factory=list)
    writes: set[str] = field(default_factory=set)

    @property
    def many(self) -> bool:
        """Whether it returns values side by side."""
        return isinstance(self.returns, Several)


def named(value: Any) -> set[str]:
    """Variables in an expression, a statement or several, also in what is inside them; and those that it sets."""
    if isinstance(value, Expr):
        own = {value.value} if value.op == "var" else set()
        return own.union(*map(named, value.args))
    if isinstance(value, list):
        return set().union(*map(named, value))
    if isinstance(value, Assign | Bind | Fill | Do | If | For | Return):
        own = {value.name} if isinstance(value, Bind | For) else set()
        return own.union(*map(named, vars(value).values()))
    return set()
