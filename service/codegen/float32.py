"""Generated C in single precision: the same text with another type of number, for processors that have no other."""

from __future__ import annotations

import re

# Against double precision on the logs that it was tried on; a test holds it.
TORQUE_RMS_NM, TORQUE_MOST_NM, MASS_KG = 1.0, 10.0, 0.15
ERROR = (
    f"torque is within {TORQUE_RMS_NM:g} N m rms of double precision on the stored logs, 999 of 1000 cycles within "
    f"{TORQUE_MOST_NM:g} N m, single ones further; trusted masses within {MASS_KG:g} kg"
)
_TOKEN = re.compile(
    r"(?P<other>/\*.*?\*/|\"[^\"\n]*\"|[A-Za-z_]\w*\.h\b)"
    r"|(?P<number>(?<![\w.])\d+\.\d*(?:e[+-]?\d+)?|(?<![\w.])\d+e[+-]?\d+)(?![\w.])"
    r"|(?P<call>\b(?:sqrt|sin|cos|tan|tanh|exp|log|hypot|copysign|atan2|acos|asin|atan|fabs|pow|rint|ceil|floor)(?=\())"
    r"|(?P<type>\bdouble\b)",
    re.DOTALL,
)


def in_single(text: str) -> str:
    """C that counts in `float` where `text` counts in `double`."""
    return _TOKEN.sub(_single, text)


def _single(found: re.Match[str]) -> str:
    if found["number"]:
        return f"{found[0]}F"
    if found["call"]:
        return f"{found[0]}f"
    return "float" if found["type"] else found[0]
