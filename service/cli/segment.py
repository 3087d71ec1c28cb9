"""`deltatwin segment`: Simulate three EtherCAT drives and their robot on a network interface."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import robot_file
from service.cli.output import conclude
from service.stopping import interrupted

if TYPE_CHECKING:
    from drivers.simulated.segment.wire import Switches


def command(
    interface: Annotated[
        str, typer.Argument(metavar="INTERFACE", help="Ethernet interface to answer on, e.g. one end of a veth pair.")
    ],
    robot: Annotated[Path, robot_file(" with its drives and their process data.")],
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="True parameters of the simulated robot where they differ (TOML)."),
    ] = None,
    rate: Annotated[float, typer.Option(min=1.0, help="Cycles per second of the master (Hz).")] = 1000.0,
    product: Annotated[
        float, typer.Option(min=0.0, help="Mass that the gripper lifts when it is switched on (kg).")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the sensors' noise.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Recording of the run by the simulated robot itself (.mcap).")
    ] = None,
) -> None:
    """Simulate an EtherCAT segment of three CiA 402 drives that move a simulated Delta robot.

    Any master can bring it into operation. Lines on standard input cause faults: `break N` cuts the cable before drive
    N, `silence N` makes drive N miss the process data (the working counter is too low), `trip N` puts drive N into
    fault, `mend` undoes the first two; `product KG` sets the mass of the product.

    Example: ip link add bus0 type veth peer name seg0; ip link set bus0 up; ip link set seg0 up;
    deltatwin segment seg0 --robot d3.toml
    """
    import sys

    from drivers.ethercat.cia402 import scales
    from drivers.ethercat.pdo import joint_pdos
    from drivers.simulated.plant.plant import make_plant
    from drivers.simulated.segment.wire import EthercatSegment, serve
    from drivers.trace import write_trace
    from drivers.trace.mcap_file import to_trace
    from replay.realtime import go_realtime
    from schemas.axes_description import load_delta
    from schemas.files import check_folder
    from schemas.questions import Question

    if out:
        check_folder(out.parent)
    description = load_delta(robot, Question.FIELDBUS)
    plant, _ = make_plant(description, truth or "ideal", 1 / rate, seed)
    segment = EthercatSegment(joint_pdos(description), scales(description), plant)
    segment.switches.product = product
    with _listening(segment.switches):
        go_realtime("segment")
        print(f"segment: 3 drives of {description.name} on {interface}", file=sys.stderr, flush=True)
        try:
            serve(interface, segment, interrupted)
        except KeyboardInterrupt:
            pass
        finally:
            if out and segment.cycles:
                write_trace(to_trace(segment.trace, out), out, description.name)
    frameless = int((segment.trace["flags"] != 0).sum())
    said = f"{segment.cycles} cycles in operation, {frameless} of them without a frame"
    if out and segment.cycles:
        conclude(said, "inspect", out, "--robot", robot)
    else:
        own = "INTERFACE: the other end of the cable"
        conclude(said, "master", "INTERFACE", "--robot", robot, own=own)


@contextmanager
def _listening(switches: Switches) -> Iterator[None]:
    """Listen to standard input in a thread that ends with the block."""
    over, end = os.pipe()
    listener = threading.Thread(target=_listen, args=(switches, over))
    listener.start()
    try:
        yield
    finally:
        os.close(end)
        listener.join()
        os.close(over)


def _listen(switches: Switches, over: int) -> None:
    """over: descriptor that is ready when there is nobody left to listen for."""
    import select
    import sys

    if sys.stdin is None:
        return
    rest, heard = b"", sys.stdin.fileno()
    while over not in select.select([heard, over], [], [])[0] and (came := os.read(heard, 1 << 12)):
        *lines, rest = (rest + came).split(b"\n")
        for line in (each.decode(errors="replace") for each in lines):
            try:
                throw(switches, line)
                print(f"segment: switched: {line.strip()}", file=sys.stderr, flush=True)
            except ValueError as error:
                print(f"segment: {error}", file=sys.stderr, flush=True)


def throw(switches: Switches, line: str) -> None:
    """Carry out one line of standard input.

    Raises:
        ValueError: it is not a switch.
    """
    name, _, number = line.strip().partition(" ")
    if name == "mend" and not number:
        switches.broken_before = switches.silent = 0
        return
    if name == "product":
        switches.product = max(0.0, float(number))
        return
    if name not in ("break", "silence", "trip") or number not in ("1", "2", "3"):
        raise ValueError(f"{line.strip()!r}: give break, silence or trip and a drive 1..3; mend; or product and a mass")
    drive = int(number)
    if name == "break":
        switches.broken_before = drive
    elif name == "silence":
        switches.silent |= 1 << drive - 1
    else:
        switches.trip |= 1 << drive - 1
