"""What kernels call and IEC 61131-3 does not have, as functions in its own terms.

Conversions to whole numbers are held to no rounding: controllers round halves to even, away from zero, or cut; what is
made of it here is the same on all of them.
"""

from __future__ import annotations

from typing import NamedTuple

from service.codegen.pou import Pou, Variable

_LARGEST = "1.7976931348623157E308"


class Made(NamedTuple):
    """body: lines in which `@` stands for the function's own name and `@name` for another of `FUNCTIONS`."""

    name: str
    returns: str
    inputs: tuple[Variable, ...]
    body: tuple[str, ...]
    own: tuple[Variable, ...] = ()
    calls: tuple[str, ...] = ()
    comment: str = ""

    def pou(self, prefix: str) -> Pou:
        """It, with the names of a project that begins them with `prefix`."""
        lines = []
        for line in self.body:
            for other in self.calls:
                line = line.replace(f"@{other}", f"{prefix}_{other}")
            lines.append(line.replace("@", f"{prefix}_{self.name}"))
        return Pou(
            f"{prefix}_{self.name}", "FUNCTION", lines, self.returns, list(self.inputs), [], [], list(self.own),
            self.comment,
        )  # fmt: skip


def _of(kind: str, *names: str) -> tuple[Variable, ...]:
    return tuple(Variable(name, kind) for name in names)


def _choice(name: str, kind: str, sign: str) -> Made:
    body = (f"IF other {sign} one THEN", "    @ := other;", "ELSE", "    @ := one;", "END_IF;")
    return Made(name, kind, _of(kind, "one", "other"), body)


def _bits(name: str, word: str) -> Made:
    body = (f"@ := LWORD_TO_LINT(LINT_TO_LWORD(one) {word} LINT_TO_LWORD(other));",)
    return Made(name, "LINT", _of("LINT", "one", "other"), body)


def _rounded(name: str, test: str, change: str, comment: str) -> Made:
    body = ("@ := @whole(value := value);", f"IF {test} THEN", f"    @ := @whole(value := value) {change};", "END_IF;")
    return Made(name, "LINT", _of("LREAL", "value"), body, (), ("whole",), comment)


_MADE = (
    Made("endless", "LREAL", _of("LREAL", "huge"), ("@ := huge * huge;",), comment="infinity, of 1.0E300"),
    Made(
        "no_number", "LREAL", _of("LREAL", "huge"),
        ("made := huge * huge;", "@ := made - made;"), _of("LREAL", "made"), comment="not a number, of 1.0E300",
    ),
    Made("isnan", "BOOL", _of("LREAL", "value"), ("@ := ((value >= 0.0) OR (value < 0.0)) = FALSE;",)),
    Made("isinf", "BOOL", _of("LREAL", "value"), (f"@ := ABS(value) > LREAL#{_LARGEST};",)),
    Made("isfinite", "BOOL", _of("LREAL", "value"), (f"@ := ABS(value) <= LREAL#{_LARGEST};",)),
    Made(
        "at", "LINT", _of("LINT", "place", "count"),
        ("@ := place;", "IF place < 0 THEN", "    @ := place + count;", "END_IF;"),
        comment="an index, from the end where it is below zero",
    ),
    Made(
        "rest_of", "LINT", _of("LINT", "value", "divisor"),
        ("@ := value - (value / divisor) * divisor;", "IF (value - (value / divisor) * divisor <> 0) "
         "AND ((value < 0) <> (divisor < 0)) THEN", "    @ := value - (value / divisor) * divisor + divisor;",
         "END_IF;"),
        comment="the rest of a division, with the sign of the divisor",
    ),
    Made(
        "floor_of", "LINT", _of("LINT", "value", "divisor"),
        ("@ := value / divisor;", "IF ((value / divisor) * divisor <> value) AND ((value < 0) <> (divisor < 0)) THEN",
         "    @ := value / divisor - 1;", "END_IF;"),
        comment="a division, rounded down",
    ),
    Made(
        "whole", "LINT", _of("LREAL", "value"),
        ("IF (value >= -LREAL#9.223372036854775808E18) AND (value < LREAL#9.223372036854775808E18) THEN",
         "    found := LREAL_TO_LINT(value);",
         "    IF (value >= 0.0) AND (LINT_TO_LREAL(found) > value) THEN", "        found := found - 1;",
         "    ELSIF (value < 0.0) AND (LINT_TO_LREAL(found) < value) THEN", "        found := found + 1;",
         "    END_IF;", "ELSE", "    found := -9223372036854775807 - 1;", "END_IF;", "@ := found;"),
        _of("LINT", "found"), comment="towards zero, whichever way the controller rounds",
    ),
    Made(
        "even", "LINT", _of("LREAL", "value"),
        ("found := @whole(value := value);", "rest := ABS(value - LINT_TO_LREAL(found));",
         "IF (rest > 0.5) OR ((rest = 0.5) AND ((found / 2) * 2 <> found)) THEN",
         "    IF value > 0.0 THEN", "        found := found + 1;", "    ELSE", "        found := found - 1;",
         "    END_IF;", "END_IF;", "@ := found;"),
        (Variable("found", "LINT"), Variable("rest", "LREAL")), ("whole",), "to the nearest, halves to even",
    ),
    _rounded("floor", "LINT_TO_LREAL(@whole(value := value)) > value", "- 1", "down"),
    _rounded("ceil", "LINT_TO_LREAL(@whole(value := value)) < value", "+ 1", "up"),
    _choice("max_of", "LREAL", ">"),
    _choice("min_of", "LREAL", "<"),
    _choice("max_whole", "LINT", ">"),
    _choice("min_whole", "LINT", "<"),
    Made("abs_whole", "LINT", _of("LINT", "value"), ("@ := ABS(value);",)),
    _bits("bitand", "AND"),
    _bits("bitor", "OR"),
    _bits("bitxor", "XOR"),
    Made(
        "copysign", "LREAL", _of("LREAL", "value", "sign"),
        ("@ := ABS(value);", "IF sign < 0.0 THEN", "    @ := -ABS(value);", "END_IF;"),
        comment="the sign of zero is plus",
    ),
    Made(
        "tanh", "LREAL", _of("LREAL", "value"),
        ("far := ABS(value);", "IF far < 1.0E-3 THEN", "    made := far - far * far * far / 3.0;",
         "ELSIF far < 20.0 THEN", "    grown := EXP(2.0 * far);", "    made := (grown - 1.0) / (grown + 1.0);",
         "ELSIF far >= 20.0 THEN", "    made := 1.0;", "ELSE", "    made := value;", "END_IF;",
         "@ := made;", "IF value < 0.0 THEN", "    @ := -made;", "END_IF;"),
        _of("LREAL", "far", "grown", "made"),
    ),
    Made(
        "hypot", "LREAL", _of("LREAL", "one", "other"), ("@ := SQRT(one * one + other * other);",),
    ),
    Made(
        "atan2", "LREAL", _of("LREAL", "one", "other"),
        ("IF other > 0.0 THEN", "    @ := ATAN(one / other);", "ELSIF (other < 0.0) AND (one >= 0.0) THEN",
         "    @ := ATAN(one / other) + LREAL#3.141592653589793;", "ELSIF other < 0.0 THEN",
         "    @ := ATAN(one / other) - LREAL#3.141592653589793;", "ELSIF one > 0.0 THEN",
         "    @ := LREAL#1.5707963267948966;", "ELSIF one < 0.0 THEN", "    @ := -LREAL#1.5707963267948966;",
         "ELSE", "    @ := 0.0;", "END_IF;"),
    ),
)  # fmt: skip
FUNCTIONS = {one.name: one for one in _MADE}
