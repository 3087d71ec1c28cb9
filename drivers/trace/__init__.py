"""Traces from and to files: CSV (plain, gzip), MCAP and, read only, EtherCAT captures and the formats of
`drivers.trace.tables`, into one `schemas.trace.Trace`.

An unusable file is an error, a bad row is flagged.

`TraceError` (file, line, column, value): a file that cannot be opened, is empty, binary, a broken gzip or not a whole
MCAP; a column that is missing or there twice; text where a number belongs; a line with more fields than the header;
fewer than two samples; time that mostly does not rise; more than a tenth of the positions beyond half a turn
(degrees for radians, a wrong gear ratio); messages of another schema.

Kept as they are, flagged in `Trace.flags` (and so in `.samples()`) and counted in `Trace.findings` with their lines:
NaN, empty or infinite positions and torques (NOT_A_NUMBER) and commands (NO_COMMAND); stamps that go back
(TIME_BACKWARDS) or repeat (REPEATED); a step above 1.5 periods (GAP_BEFORE); a joint that moves further in a cycle
than a joint can (JUMP); positions outside the joint range (OUT_OF_RANGE).

Left out and reported, because they cannot be kept: a last line that is cut off, a row without a time stamp. Channels
with stamps of their own are brought to those of the first position column; that is reported too.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drivers.trace.tables import READERS
from schemas.axes_description import Description
from schemas.columns import CHANNELS, Columns, load_columns
from schemas.errors import TraceError
from schemas.files import opened, whole
from schemas.messages import OF_DELTA, OF_JOINTS, TOPICS
from schemas.questions import Question, as_delta
from schemas.trace import UNNAMED, Trace

MAPPINGS = Path(__file__).parent / "mappings"
CAPTURE_ENDINGS = (".pcap", ".pcapng", ".cap")
LAYOUT = {
    "separator",
    "decimal",
    "thousands",
    "encoding",
    "header_line",
    "data_line",
    "topic",
}  # keys of Columns that say where
TABLE_ENDINGS = tuple(READERS)
CSV_ENDINGS = (".csv", ".csv.gz", ".txt", ".txt.gz", ".tsv")


def read_trace(path: str | Path, robot: Description | None = None, columns: Columns | None = None) -> Trace:
    """Read a recorded trace.

    robot: gives the joint range, the gear ratio of motor-side columns, its own `[columns]`, and the topic where an MCAP
    holds several robots. columns: the mapping of a foreign table; wins over the robot's. Without either, our own CSV.

    Raises:
        TraceError: the file is unusable (see the module), or not of as many axes, of the same kind, as described.
    """
    path = Path(path)
    if path.name.endswith(CAPTURE_ENDINGS):
        if robot is None:
            raise TraceError(f"{path}: a capture is read with its robot description (--robot): layout and scaling")
        from drivers.trace.capture_trace import read_capture

        return read_capture(path, as_delta(robot, Question.FIELDBUS))
    own = None if robot is None else robot.mapping
    fallback = find_columns(own) if isinstance(own, str) else own
    if path.name.endswith(".mcap"):
        from drivers.trace.mcap_file import read_mcap, robots_and_start

        if not (columns or fallback) or (told := robots_and_start(path)) is None or told[0]:
            return read_mcap(path, robot)
    mapping = columns or fallback
    if path.name.endswith(CSV_ENDINGS) and not (mapping and (mapping.beside or _is_codesys(path))):
        from drivers.trace.csv_file import read_csv

        return read_csv(path, robot, columns, fallback)
    if path.name.endswith((*TABLE_ENDINGS, *CSV_ENDINGS)) or path.is_dir():
        if mapping is None:
            if path.is_dir():
                from drivers.trace.tables.bag_files import parts_of

                parts_of(path)
            raise TraceError(f"{path}: the meaning of its columns is not known: first run deltatwin import {path.name}")
        return _foreign(path, robot, mapping)
    if not path.exists():
        raise TraceError(f"{path}: No such file or directory")
    endings = ", ".join((".csv", ".csv.gz", *TABLE_ENDINGS, ".pcap", ".pcapng"))
    raise TraceError(f"{path}: unknown kind of trace: its name must end in one of {endings}")


def _is_codesys(path: Path) -> bool:
    from drivers.trace.tables.codesys import FIRST_LINE

    with opened(path, TraceError) as stream:
        return stream.read(len(FIRST_LINE)) == FIRST_LINE.encode()


def _foreign(path: Path, robot: Description | None, columns: Columns) -> Trace:
    from drivers.data_frames import pl
    from drivers.trace.from_columns import assemble, plan
    from drivers.trace.stated_units import contradictions
    from drivers.trace.tables import joined, read_table

    layout = columns.model_dump(include=LAYOUT, exclude_defaults=True)
    tables = [read_table(path, layout or None), *(read_table(path.parent / name) for name in columns.beside)]
    own = {entry.time for role in CHANNELS for entry in columns.channel(role) if entry.time}
    stems = [other.path.name.split(".")[0] for other in tables]
    clocks = [next((name[len(stem) + 1 :] for name in own if name.startswith(f"{stem}:")), None) for stem in stems]
    table = joined(tables, clocks)
    wanted = plan(list(table.columns), columns, path)
    frame = pl.DataFrame({str(index): values for index, values in enumerate(table.columns.values())})
    stated = {index: table.units.get(name, "") for index, name in enumerate(table.columns)}
    notes = contradictions(wanted, columns, stated)
    return assemble(frame, wanted, columns, robot, path, notes, table.epoch_ns, "row")


def find_columns(name: str | Path) -> Columns:
    """The mapping in a TOML file, or one that comes with deltatwin, by its name (`emps`, `twincat_scope`).

    Raises:
        TraceError: there is neither, or the mapping is wrong.
    """
    shipped = {path.stem: path for path in MAPPINGS.glob("*.toml")}
    if not Path(name).exists() and str(name) not in shipped:
        raise TraceError(f"{name}: no such mapping file; bundled ones are: {', '.join(sorted(shipped))}")
    return load_columns(shipped.get(str(name), Path(name)))


def write_trace(
    trace: Trace, path: str | Path, robot: str = UNNAMED, show: Callable[[int], object] = lambda done: None
) -> None:
    """Write a trace in the format its name ends in; a reader never sees half a file.

    robot: name in the topic of an MCAP. show: called now and then with how many samples are written.

    Raises:
        StorageError: the file cannot be written. TraceError: the format cannot hold the trace.
    """
    path = Path(path)
    with whole(path) as partial:
        if path.name.endswith(".mcap"):
            from drivers.trace.mcap_file import write_samples

            # a Delta's message where it can hold them: three joints that turn
            topic = (OF_DELTA if trace.angular and trace.position.shape[1] == 3 else OF_JOINTS).sample
            write_samples([trace.samples(TOPICS[topic])], partial, robot, trace.path, show, topic)
        elif path.name.endswith(CSV_ENDINGS):
            from drivers.trace.csv_file import write_csv

            write_csv(trace, partial)
        else:
            raise TraceError(f"{path}: unknown kind of trace: its name must end in .csv, .csv.gz or .mcap")
