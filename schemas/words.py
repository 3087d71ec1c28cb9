"""How are shares, counts and values written? Alike in every message, table and page."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal


def percent(share: float, decimals: int = 0) -> str:
    """A share in percent. What is not all of it, or not nothing, does not round to it, and nothing has no sign.

    Example:
        >>> percent(0.42), percent(-0.0004, 1), percent(0.9996), percent(1.0), percent(0.002), percent(0.0123, 1)
        ('42 %', '0.0 %', '> 99 %', '100 %', '< 1 %', '1.2 %')
    """
    least = 10.0**-decimals
    whole = 100.0 - least
    if whole + least / 2 <= 100 * share < 100.0:
        return f"> {whole:.{decimals}f} %"
    if decimals == 0 and 0.0 < 100 * share < least / 2:
        return f"< {least:.0f} %"
    return f"{fixed(100 * share, decimals)} %"


def fixed(value: float, decimals: int) -> str:
    """A value to so many decimals; nothing has no sign.

    Example:
        >>> fixed(-0.0004, 2), fixed(-1.25, 1)
        ('0.00', '-1.2')
    """
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def interval(shares: Iterable[float], decimals: int = 0) -> str:
    """The bounds of a share, in percent, behind the share.

    Example:
        >>> interval((-0.0004, 0.123), 1)
        '[0.0, 12.3]'
    """
    return f"[{', '.join(fixed(100 * share, decimals) for share in shares)}]"


def part_of(share: float) -> str:
    """A share before what it is of: in percent, or as so many times all of it.

    Example:
        >>> part_of(0.51), part_of(1.0), part_of(12852486.0)
        ('51 % of', '100 % of', '13000000 times')
    """
    return f"{percent(share)} of" if share <= 1.0 else f"{significant(share, 2)} times"


def change(ratio: float, decimals: int = 0) -> str:
    """A ratio as a change in percent, with its sign.

    Example:
        >>> change(1.171), change(0.9997, 1), change(0.88)
        ('+17 %', '0.0 %', '-12 %')
    """
    rounded = round(100 * (ratio - 1), decimals) + 0.0
    return f"{rounded:+.{decimals}f} %" if rounded else f"{0.0:.{decimals}f} %"


def significant(value: float, digits: int = 3) -> str:
    """A value to so many digits, without an exponent.

    Example:
        >>> significant(112.3, 2), significant(0.0004567), significant(0.0)
        ('110', '0.000457', '0')
    """
    return f"{Decimal(f'{value:.{digits}g}'):f}"


def counted(count: int, what: str) -> str:
    """So many of it.

    Example:
        >>> counted(1, "joint"), counted(3, "joint")
        ('1 joint', '3 joints')
    """
    return f"{count} {what}" + ("" if count == 1 else "s")


def words(name: str) -> str:
    """A name of a document as it is read.

    Example:
        >>> words("presliding_friction")
        'presliding friction'
    """
    return name.replace("_", " ")
