"""`deltatwin ethercat-demo`: Run simulated drives, master, tap and estimator on one EtherCAT wire, and check them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import AsJson
from service.cli.output import as_json, conclude, console, table


def command(
    out: Annotated[Path, typer.Option(help="Folder for all recordings.")] = Path("ethercat-demo"),
    rate: Annotated[float, typer.Option(min=1.0, help="Cycles per second (Hz).")] = 1000.0,
    duration: Annotated[float, typer.Option(min=10.0, help="Length of each of two pick-and-place runs (s).")] = 12.0,
    product: Annotated[
        float, typer.Option(min=0.1, help="Product that the gripper lifts in the second run (kg).")
    ] = 1.5,
    json: AsJson = False,
) -> None:
    """Run simulated drives and robot, master, passive tap, capture, estimator and monitor on one wire.

    Needs root, `ip` (package iproute2) and `dumpcap` (package wireshark-common), which captures the wire.

    First run: empty gripper, no feed-forward; the robot is identified from the samples of the tap. Second run: the same
    motion with products, tau_FF from the estimator over Zenoh. Then every claim is checked against the recording that
    the simulated robot made itself. Exit code 3 if a claim does not hold.

    Example: sudo deltatwin ethercat-demo --out demo
    """
    import time

    from service.cli.main import MISSED
    from service.demonstration import demonstrate

    begin = time.monotonic()
    checks = demonstrate(
        out,
        rate,
        duration,
        product,
        lambda step: typer.echo(f"{time.monotonic() - begin:5.1f} s  {step}", err=True),
    )
    if json:
        typer.echo(as_json("ethercat-demo", {"checks": [vars(check) for check in checks], "out": str(out)}))
    else:
        said = {True: "[green]holds[/green]", False: "[red]fails[/red]"}
        rows = [(said[check.holds], check.claim, check.measured, check.bound) for check in checks]
        console().print(table(("", "claim", "measured", "bound"), rows, "EtherCAT demonstration", figures=slice(0)))
        held = sum(check.holds for check in checks)
        conclude(
            f"recorded in {out}\n{held} of {len(checks)} claims hold.", "tap", "INTERFACE", "--robot", "ROBOT.toml",
            own="INTERFACE: the network interface on your bus; ROBOT.toml: your robot with its drives",
        )  # fmt: skip
    if not all(check.holds for check in checks):
        raise typer.Exit(MISSED)
