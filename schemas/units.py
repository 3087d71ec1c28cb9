"""Units as logs spell them: of positions, torques and stamps, and of what is none of these."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

# rad (or m), and N m (or N), per unit of a column; of a current or a voltage times its constant
POSITION_SCALES = {
    "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turns": 2 * math.pi, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6,
}  # fmt: skip
TORQUE_SCALES = {
    "N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "kN m": 1e3, "lbf in": 0.112984829, "lbf ft": 1.355817948, "N": 1.0,
    "mN": 1e-3, "kN": 1e3, "A": 1.0, "mA": 1e-3, "V": 1.0,
}  # fmt: skip
SHARES = {"percent": 100.0, "permille": 1000.0}  # units of a rated torque
CONSTANTS = ("A", "mA", "V")  # units that take a torque constant
LINEAR = ("m", "cm", "mm", "um")
TIME_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "filetime": 1e7}  # per second

POSITION_UNITS = {
    "rad": "rad", "radian": "rad", "radians": "rad", "mrad": "mrad", "deg": "deg", "degree": "deg", "degrees": "deg",
    "grad": "deg", "°": "deg", "turns": "turns", "turn": "turns", "rev": "turns", "revs": "turns", "inc": "counts",
    "incs": "counts", "increments": "counts", "inkremente": "counts", "count": "counts", "counts": "counts",
    "cts": "counts", "m": "m", "cm": "cm", "mm": "mm", "um": "um",
}  # fmt: skip
TORQUE_UNITS = {
    "nm": "N m", "mnm": "mN m", "ncm": "N cm", "cnm": "N cm", "knm": "kN m", "lbfin": "lbf in", "inlbf": "lbf in",
    "lbin": "lbf in", "inlb": "lbf in", "inlbs": "lbf in", "lbfft": "lbf ft", "ftlbf": "lbf ft", "ftlb": "lbf ft",
    "ftlbs": "lbf ft", "lbft": "lbf ft", "n": "N", "mn": "mN", "kn": "kN", "%": "percent", "percent": "percent",
    "prozent": "percent", "‰": "permille", "permille": "permille", "promille": "permille", "a": "A", "amp": "A",
    "amps": "A", "ampere": "A", "arms": "A", "ma": "mA", "v": "V",
}  # fmt: skip
CLOCK_UNITS = {unit: unit for unit in TIME_UNITS} | {"sec": "s", "second": "s", "seconds": "s", "msec": "ms"}
# of what is neither a position, a torque nor a stamp that is read
OTHER_UNITS = frozenset({
    "rpm", "w", "kw", "hz", "khz", "bar", "k", "c", "°c", "f", "°f", "kg", "g", "s", "sec", "ms", "us", "ns", "min",
    "h", "j", "pa", "mpa", "db", "kv", "mv", "ohm", "va",
})  # fmt: skip
SPELLED_ONLY = frozenset({
    "m", "a", "v", "n", "s", "c", "k", "f", "g", "h", "j", "w", "ma", "mn", "db", "um", "turn",
})  # fmt: skip
# the latter: what is a word, or names an axis, where it stands in a name without brackets
_RATE = re.compile(r"/ ?(s|sec|min|h)\b|[/ ]s(\^?2|²)|s-[12]|s⁻[¹²]|1/min|u/min")
_TOKEN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöüß]+|\d+|[%‰°]")
_LEFT_OUT = str.maketrans({mark: None for mark in " *·.⋅-_^"})


def unit_of(text: str, known: Mapping[str, str]) -> str | None:
    """The unit of `known` that a text is, however it is spelled: `mN·m`, `Nm`, `lbf-in`.

    Example: unit_of("N·cm", TORQUE_UNITS) == "N cm"
    """
    plain = text.strip().lower().replace("µ", "u").replace("μ", "u")
    return known.get(plain) or known.get(plain.translate(_LEFT_OUT))


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything."""
    known = (POSITION_UNITS, TORQUE_UNITS, CLOCK_UNITS)
    return any(unit_of(text, units) for units in known) or is_another(text)


def is_another(text: str) -> bool:
    """Whether a text is a unit of neither a position, a torque nor a clock: a speed, a temperature, a power."""
    plain = text.strip().lower()
    return plain in OTHER_UNITS or _RATE.search(plain) is not None


def tokens(name: str) -> list[str]:
    """The words and numbers of a column's name: `axis0.actPos` is axis, 0, act, pos."""
    return [token.lower() for token in _TOKEN.findall(name)]


def unit_texts(name: str, stated: str = "") -> list[str]:
    """What may be a column's unit: what the file states, else what stands between brackets in its name, the last
    first."""
    stated = stated.strip()
    return [stated] if stated else re.findall(r"[\[(]([^\])]+)[\])]", name)[::-1]


def said_unit(name: str, stated: str, known: Mapping[str, str]) -> str | None:
    """The unit of `known` that the file states of a column, or else the column's name.

    Example: said_unit("pos_deg", "", POSITION_UNITS) == "deg"
    """
    texts = unit_texts(name, stated)
    found = next((unit for text in texts if (unit := unit_of(text, known))), None)
    if found or any(map(is_unit, texts)):
        return found
    for words in (re.split(r"[^\w%‰°µ]|_", name)[-2:], tokens(name)[-2:]):  # a unit of one letter names an axis too
        spelled = (unit_of(word, known) for word in words if word.lower() not in SPELLED_ONLY)
        if found := next((unit for unit in spelled if unit), None):
            return found
    return None


def unknown_unit(name: str, stated: str) -> str | None:
    """What the file states as a unit, or a name between square brackets, that is the unit of nothing that is known."""
    texts = [stated] if stated else re.findall(r"\[([^\]]+)\]", name)
    return next((t for t in texts if re.search(r"[^\W\d_]", t) and not is_unit(t) and t != "datetime"), None)
