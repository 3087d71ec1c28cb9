"""What the columns of a foreign table may be, from their names, the units that stand there, and their numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.trace.tables import Table
from schemas.columns import CHANNELS
from schemas.errors import DataError
from schemas.units import (
    CLOCK_UNITS,
    OTHER_UNITS,
    POSITION_UNITS,
    TIME_UNITS,
    TORQUE_UNITS,
    is_another,
    tokens,
    unit_of,
)

# Words of column names, English and German, as controllers and loggers write them.
WORDS = {
    "time": {"t", "time", "timestamp", "timestamps", "stamp", "zeit", "zeitstempel", "clock", "when", "date"},
    "position": {"position", "positions", "pos", "q", "qm", "angle", "angles", "winkel", "lage", "phi", "theta"},
    "torque": {
        "torque", "torques", "trq", "tq", "tau", "effort", "efforts", "moment", "drehmoment", "m", "nm", "load",
        "force", "kraft", "vir",
    },
    "command": {
        "set", "soll", "setpoint", "cmd", "command", "commanded", "target", "ref", "reference", "desired", "des",
        "demand", "feedforward", "goal", "qg",
    },
    "other": {
        "velocity", "speed", "vel", "qd", "dq", "qdot", "geschwindigkeit", "drehzahl", "error", "err", "lag",
        "schleppfehler", "deviation", "following", "temp", "temperature", "volt", "volts", "voltage", "acceleration",
        "acc", "accel", "qdd", "ddq", "dqd", "dtau", "omega", "pwm", "status", "enable", "enabled", "ext",
        "external", "limit", "limits", "max", "min", "power", "leistung",
    },
    "current": {"iq", "current", "currents", "curr", "strom"},
    "counter": {"index", "idx", "sample", "samples", "cycle", "cycles", "nr", "row", "seq", "counter", "line", "zeile"},
}  # fmt: skip
FRACTIONS = {"nsec", "nsecs", "nanosec", "nanosecs", "nanos", "usec", "usecs"}  # of a second, which stands elsewhere
OTHER_ALONE = {
    "w",
    "id",
    "u",
}  # a column called so and a number, or nothing else: speed, current along the field, volts
DESIRED = "d"  # `q_d` beside `q`
OF_ANY_JOINT = {"joint", "axis", "link", "achse", "gelenk"}  # words of a joint's name that tell none from another
MEASURED = {"ist", "act", "actual", "meas", "measured", "feedback", "fbk"}
_PARTS = re.compile(r"^(ist|soll)(\w+)$|^(\w+?)(?:s|en)?(ist|soll)wert$")  # Istposition; Lageistwert, Momentensollwert
MOST_DIGITS = 6  # of a number in a column's name that may be a joint's
OVER = 10  # samples over which a rate is taken, so that a reading's steps do not hide it
FOLLOWS = 0.02  # of a column, rms, that its being a position's rate leaves; of no machine is the torque nothing else
OTHER = "other"  # role of a column whose name or unit says that it is neither
FILETIMES = 1.19e17, 1.37e17  # 100 ns since 1601: years 1978 to 2035
LEAST_HZ = 20.0  # of logs that hold dynamics; a unit of time that gives a lower rate is not believed


@dataclass(frozen=True)
class Channels:
    """Which column is what. Each of the lists has an entry a joint; empty where there is none.

    order: how the joints were told apart. doubts: what of that is to be checked.
    """

    time: str | None = None
    position: Sequence[str] = ()
    torque: Sequence[str] = ()
    position_command: Sequence[str] = ()
    torque_command: Sequence[str] = ()
    reasons: Sequence[str] = field(default=())
    order: Sequence[str] = field(default=())
    doubts: Sequence[str] = field(default=())


def guess(table: Table, joints: int | None, called: Sequence[str] = ()) -> Channels:
    """Channels by their names, and by how smooth they are where names say nothing. joints: of the robot, if known.
    called: names of its joints, where its description has them."""
    time = _time(table)
    clocks = {time, *table.time_of.values()} - {None}
    roles = _roles([name for name in table.columns if name not in clocks], table)
    named = _named_channels(table, roles, called)
    if named.get("position") and (named.get("torque") or named.get("torque_command")):
        order = [f"joints are assigned by the names of the description: {_numbered(named['position'])}"]
        return Channels(time, **named, reasons=["columns are recognised by their names"], order=order)
    names = [name for name in roles if _moves(table.columns[name])]
    found: dict[str, list[str]] = {}
    for told in (names, list(roles)):  # a joint that rests all through is one where without it they do not go together
        found = {role: [name for name in told if roles[name] == role] for role in CHANNELS}
        if len(found["position"]) == len(found["torque"]) == (joints or len(found["position"])) > 0:
            break
    else:
        found = {role: [name for name in names if roles[name] == role] for role in CHANNELS}
    reasons, doubts = ["columns are recognised by their names"], list[str]()
    wanted = joints or len(found["torque"] or found["torque_command"])
    found = {role: _measured(columns, wanted) for role, columns in found.items()}
    if not (found["position"] and (found["torque"] or found["torque_command"])):
        by_shape = _by_smoothness(table, names, joints, roles)
        if by_shape:
            found |= dict(zip(("position", "torque"), by_shape, strict=True))
            reasons = []
            doubts = ["the names give no hint: the smoother columns are taken as positions, the rougher as torques"]
    ordered = {role: _by_joint(columns) for role, columns in found.items()} | {r: c for r, c in named.items() if c}
    ordered |= {role: _as_ordered(columns, ordered["position"]) for role, columns in ordered.items()}
    count = joints or len(ordered["position"])
    kept = {role: columns if len(columns) == count else [] for role, columns in ordered.items()}
    if ordered["torque"] and not kept["torque"]:  # something was measured: no command stands for it
        kept["torque_command"] = []
    ordered = kept
    partly = bool(ordered["torque"] or ordered["torque_command"]) and any(named.values())
    order, open_ones = _told_order(table, ordered, called, partly)
    return Channels(time, **ordered, reasons=reasons, order=order, doubts=doubts + open_ones)


def are_runs(tables: Sequence[Table], position: Sequence[str] | None, torque: Sequence[str] | None) -> bool:
    """Whether files are runs of one machine, not parts of one log: the first has all by itself what a log has, and the
    others have the same columns. position, torque: columns that the user names."""
    first, *others = tables
    if any(list(table.columns) != list(first.columns) for table in others):
        return not others
    found = guess(first, None)
    alone = [
        given or own for given, own in ((position, found.position), (torque, found.torque or found.torque_command))
    ]
    return not others or all(names and set(names) <= set(first.columns) for names in alone)


def _named_channels(
    table: Table, roles: Mapping[str, str | None], called: Sequence[str]
) -> dict[str, list[str]]:  # fmt: skip
    """Columns by role that bear the names of the description's joints, in its order; of a role none where not all
    do."""
    found = {}
    for role in CHANNELS if called else ():
        of_role = [name for name in roles if roles[name] == role]
        found[role] = _by_name(of_role, called, {name: [name, table.paths.get(name, "")] for name in of_role})
    return found


def _by_name(columns: Sequence[str], called: Sequence[str], spelled: Mapping[str, Sequence[str]]) -> list[str]:
    """For each joint the one column that bears its name; empty where there is none, or several. spelled: the names of
    a column, its own and others that the file has for it."""
    words = _telling(called)
    of_joint: dict[str, list[str]] = {joint: [] for joint in called}
    for column in columns:
        hits = [j for j in called if any(_contains(tokens(name), words[j]) for name in spelled[column])]
        longest = max((len(words[joint]) for joint in hits), default=0)  # "elbow_2" is not "elbow"
        if len(best := [joint for joint in hits if len(words[joint]) == longest]) == 1:
            of_joint[best[0]].append(column)
    chosen = [_measured(of_joint[joint], 1) for joint in called]
    return [one[0] for one in chosen] if all(len(one) == 1 for one in chosen) else []


def _telling(called: Sequence[str]) -> dict[str, list[str]]:
    """The words of each joint's name; without those of any joint, where the others tell all joints apart."""
    whole = {joint: tokens(joint) for joint in called}
    short = {joint: [word for word in words if word not in OF_ANY_JOINT] for joint, words in whole.items()}
    tell = len({tuple(words) for words in short.values()}) == len(called)
    return short if tell and all(any(len(w) > 1 and w.isalpha() for w in words) for words in short.values()) else whole


def _contains(words: Sequence[str], part: Sequence[str]) -> bool:
    """Whether `part` stands in `words`, one word behind the other."""
    starts = range(len(words) - len(part) + 1)
    return len(part) > 0 and any(list(words[k : k + len(part)]) == list(part) for k in starts)


def _as_ordered(columns: list[str], positions: Sequence[str]) -> list[str]:
    """`columns` in the order of the joints of `positions`, where both name the same joints; else as they are."""
    own, wanted = {_joint_words(name): name for name in columns}, [_joint_words(name) for name in positions]
    if len(own) == len(columns) == len(wanted) and set(own) == set(wanted):
        return [own[joint] for joint in wanted]
    return columns


def _joint_words(name: str) -> tuple[str, ...]:
    """What of a column's name is neither its quantity nor its unit."""
    known = MEASURED.union(*WORDS.values(), POSITION_UNITS, TORQUE_UNITS, OTHER_UNITS, ("wert", DESIRED))
    return tuple(word for word in tokens(name) if word not in known)


def _told_order(
    table: Table, ordered: Mapping[str, Sequence[str]], called: Sequence[str], partly: bool
) -> tuple[list[str], list[str]]:  # fmt: skip
    """How several joints are told apart: what is certain, and what is to be checked. partly: positions or torques bear
    the description's names, and not both."""
    positions = ordered["position"]
    if len(positions) < 2:
        return [], []
    if partly:
        torques = ordered["torque"] or ordered["torque_command"]
        known = f"positions {_numbered(positions)}; torques {_numbered(torques)}"
        line = f"only the positions or only the torques bear names of the description: {known}"
        return [], [f"{line}; the description calls them {', '.join(called)}"]
    paths = [table.paths.get(name, "") for name in positions]
    known = f"; the file has {', '.join(paths)}" if all(paths) else ""
    if known and called:
        return [], [f"joints are assigned by their order in the file{known}; the description has {', '.join(called)}"]
    if _numbers_of(positions) is not None:
        return [f"joints are assigned by the numbers in the names: {_numbered(positions)}{known}"], []
    line = f"joints are assigned by their order in the file: {_numbered(positions)}{known}"
    if called:
        return [], [f"{line}; the description has {', '.join(called)}, the columns do not"]
    return [f"{line}; the description has no names for them"], []


def _numbered(columns: Sequence[str]) -> str:
    return ", ".join(f"{k} is {name!r}" for k, name in enumerate(columns, 1))


def _measured(columns: list[str], count: int) -> list[str]:
    """Of more columns than there are joints those that say that they are measured, if these are as many."""
    said = [name for name in columns if MEASURED & _words(name)]
    return said if len(columns) > count == len(said) > 0 else columns


def _words(name: str) -> set[str]:
    """The words of a column's name, and of those that are two in one (German) both."""
    words = set(tokens(name))
    for word in list(words):
        if parts := _PARTS.match(word):
            words |= {part for part in parts.groups() if part}
    return words


def clocks_of(tables: Sequence[Table], time: str | None) -> list[str | None]:
    """The column that stamps each of several files side by side. time: of the first, where the user says it.

    Raises:
        DataError: their stamps have several units.
    """
    clocks = [next(iter(_named_times(table)), None) for table in tables]
    clocks[0] = time if time in tables[0].columns else clocks[0]
    units = {f"{t.path.name}: {time_unit(t, clock)[0]}" for t, clock in zip(tables, clocks, strict=True) if clock}
    if len({unit.rpartition(" ")[2] for unit in units}) > 1:
        raise DataError(f"stamps of several units ({', '.join(sorted(units))}): write all in one unit")
    return clocks


def time_unit(table: Table, name: str) -> tuple[str, bool]:
    """Unit of a column of stamps, and whether the file or the name says so; else by the rate that it gives.

    Raises:
        DataError: it says a unit that is not read.
    """
    known = table.columns[name][np.isfinite(table.columns[name])]
    if len(known) and FILETIMES[0] < known.min() <= known.max() < FILETIMES[1]:  # no other clock counts there
        return "filetime", True
    texts = table.unit_texts(name)
    if "datetime" in texts:
        return "datetime", True
    if said := next((unit for text in texts if (unit := unit_of(text, CLOCK_UNITS))), None):
        return said, True
    if other := table.unknown_unit(name) or next(filter(is_another, texts), None):
        raise DataError(
            f"{table.path}: stamps in {name!r} are in {other!r}: only s, ms, us and ns are read; or give --rate HZ"
        )
    for unit in ("ns", "us", "ms", "s"):
        if unit in tokens(name.replace("µ", "u")):
            return unit, True
    step = _step(table.columns[name])
    return next(
        (unit for unit, per_second in TIME_UNITS.items() if unit != "filetime" and per_second / step >= LEAST_HZ), "s"
    ), False


def rate_hz(table: Table, clock: str) -> float:
    """Samples a second by a column of stamps."""
    return TIME_UNITS.get(time_unit(table, clock)[0], 1.0) / _step(table.columns[clock])


def _time(table: Table) -> str | None:
    if named := _named_times(table):
        return named[0]
    first = next(iter(table.columns))
    alone = _role(first, table) in (None, OTHER) and not table.layout.get("beside")
    counts = (WORDS["counter"] | FRACTIONS) & set(tokens(first))
    return first if alone and not counts and _rises(table.columns[first]) else None


def _named_times(table: Table) -> list[str]:
    """Columns that rise and are called stamps, or dates; the clocks of a TwinCAT export."""
    rising = [name for name, values in table.columns.items() if _rises(values) and not FRACTIONS & set(tokens(name))]
    named = [name for name in rising if WORDS["time"] & set(tokens(name)) or table.units.get(name) == "datetime"]
    if not named and table.kind.startswith("TwinCAT"):
        named = [name for name in table.columns if name in table.time_of.values()]
    return named


def _rises(values: np.ndarray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 1 and bool(np.mean(steps > 0) > 0.9 and np.mean(steps >= 0) > 0.99)


def _step(values: np.ndarray) -> float:
    steps = np.diff(values[np.isfinite(values)])
    return float(np.median(steps[steps > 0]))


def _moves(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and bool(np.ptp(known) > 0)


def _roles(names: Sequence[str], table: Table) -> dict[str, str | None]:
    """What each column is; `q_d` beside `q` is the command of what `q` measures, `Id` beside `Iq` is no torque."""
    roles = {name: _role(name, table) for name in names}
    spelled = {tuple(tokens(name)): name for name in names}
    for name, role in roles.items():
        without = tuple(word for word in tokens(name) if word != DESIRED)
        if role in ("position", "torque") and spelled.get(without, name) != name:
            roles[name] = f"{role}_command"
        beside = tuple("iq" if word == "id" else word for word in tokens(name))
        if role and role.startswith("torque") and spelled.get(beside, name) != name:
            roles[name] = OTHER
    return roles


def _role(name: str, table: Table) -> str | None:
    words = _words(name)
    if table.layout.get("beside") and ":" not in name:
        words |= set(tokens(table.path.name.split(".")[0]))
    alone = {word for word in tokens(re.sub(r"[\[(].*", "", name)) if not word.isdecimal()}
    if words & WORDS["other"] or (len(alone) == 1 and alone <= OTHER_ALONE) or _of_another_kind(table, name):
        return OTHER
    command = bool(words & WORDS["command"])
    torque = words & (WORDS["torque"] | WORDS["current"]) or table.said_unit(name, TORQUE_UNITS)
    position = words & WORDS["position"] or table.said_unit(name, POSITION_UNITS)
    if bool(torque) == bool(position):
        strong = "torque" if words & (WORDS["torque"] - {"m", "load"}) else "position"
        kind = strong if torque and position else "position" if command and words & {"qg", "goal"} else None
    else:
        kind = "torque" if torque else "position"
    return None if kind is None else f"{kind}_command" if command else kind


def _of_another_kind(table: Table, name: str) -> bool:
    """Whether the unit that the file or the name gives is that of neither a position nor a torque."""
    said = table.unit_texts(name)
    known = any(unit_of(text, units) for text in said for units in (POSITION_UNITS, TORQUE_UNITS))
    return not known and (any(map(is_another, said)) or "rpm" in tokens(name)[-2:])


def no_torque(table: Table, columns: Sequence[str]) -> str | None:
    """Why no torque was recorded; None where there is one, or may be. columns: taken for it."""
    if columns:
        if other := next((name for name in columns if _of_another_kind(table, name)), None):
            return f"{other!r} is in {', '.join(table.unit_texts(other)) or 'another unit'}"
        constant = [name for name in columns if not _moves(table.columns[name])]
        if len(constant) < len(columns):
            return None
        values = table.columns[columns[0]]
        held = f"{values[np.isfinite(values)][0]:g}" if np.isfinite(values).any() else "empty"
        named = f"{', '.join(map(repr, columns))} {'is' if len(columns) == 1 else 'are'}"
        return f"{named} {held} from the first to the last row"
    clocks = {_time(table), *table.time_of.values()}
    roles = {name: _role(name, table) for name in table.columns if name not in clocks}
    may_be = [name for name, role in roles.items() if role is None or role.startswith("torque")]
    return None if may_be else f"no column is a torque by name or unit ({', '.join(list(roles)[:20])})"


def calls_itself_torque(name: str) -> bool:
    """Whether a column's name says that it is a torque, a force or a current."""
    return bool(_words(name) & (WORDS["torque"] | WORDS["current"]))


def is_rate(table: Table, column: str, position: str, clock: str | None) -> bool:
    """Whether a column is the speed or the acceleration that goes with a position, not a torque: it follows from it."""
    stamps = np.arange(len(table), dtype=float) if clock is None else table.columns[clock]
    known = np.isfinite(stamps) & np.isfinite(table.columns[column]) & np.isfinite(table.columns[position])
    known[1:] &= np.diff(stamps, prepend=-np.inf)[1:] > 0
    at, values, time = table.columns[position][known], table.columns[column][known], stamps[known]
    if len(at) < 10 * OVER or not np.ptp(values) > 0:
        return False
    window = np.ones(OVER) / OVER
    with np.errstate(all="ignore"):
        speed = np.gradient(at, time)
        for rate in (speed, np.gradient(speed, time)):
            one, other = (np.convolve(x, window, "valid") for x in (rate, values))
            scale = one @ other / max(one @ one, 1e-300)
            if np.std(other - scale * one) < FOLLOWS * np.std(other):
                return True
    return False


def _by_smoothness(
    table: Table, names: list[str], joints: int | None, roles: Mapping[str, str | None]
) -> tuple[list[str], list[str]] | None:
    """The table split into positions and torques: a position turns smoothly, a torque does not. Never against what a
    name or unit says."""
    names = [name for name in names if roles[name] != OTHER and not str(roles[name]).endswith("command")]
    if len(names) % 2 or (joints and len(names) != 2 * joints):
        return None
    roughness = {}
    for name in names:
        values = table.columns[name]
        values = values[np.isfinite(values)]
        roughness[name] = float(np.std(np.diff(values, 2)) / np.std(values)) if len(values) > 3 else np.inf
    half = len(names) // 2
    smooth = sorted(names, key=roughness.__getitem__)[:half]
    ordered = [name for name in names if name in smooth], [name for name in names if name not in smooth]
    blocks = {tuple(names[:half]), tuple(names[half:]), tuple(names[::2]), tuple(names[1::2])}
    against = [
        name
        for k, columns in enumerate(ordered)
        for name in columns
        if (roles[name] or "").startswith(("torque", "position")[k])
    ]
    return ordered if tuple(ordered[0]) in blocks and not against else None


def _by_joint(names: Sequence[str]) -> list[str]:
    """Names in the order of the joint number in them, where each has another."""
    numbers = _numbers_of(names)
    return list(names) if numbers is None else [name for _, name in sorted(zip(numbers, names, strict=True))]


def _numbers_of(names: Sequence[str]) -> list[int] | None:
    """The joint numbers in names, one after the other; None where they have none."""
    numbers = [[int(one) for one in tokens(name) if one.isdecimal() and len(one) <= MOST_DIGITS] for name in names]
    for place in range(-1, -min((len(n) for n in numbers), default=0) - 1, -1):
        at = [n[place] for n in numbers]
        if len(set(at)) == len(at) and max(at) - min(at) == len(at) - 1:
            return at
    return None
