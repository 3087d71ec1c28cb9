"""How `deltatwin inspect` prints an EtherCAT capture."""

from __future__ import annotations

from typing import Any

from rich.markup import escape

from service.cli.output import say

ROWS_SHOWN = 12


def show_capture(figures: dict[str, Any]) -> None:
    """Print what `drivers.trace.capture_survey.survey_capture` found."""

    say(
        f"[bold]{escape(figures['path'])}[/bold]: {figures['frames']} frames, {figures['ethercat_frames']} EtherCAT, "
        f"{figures['datagrams']} datagrams, {figures['duration_s']:.6g} s"
    )
    stations = ", ".join(f"{station:#06x}" for station in figures["stations"]) or "none"
    say(f"slaves: {figures['slaves']}; configured stations: {stations}")
    for entry in figures["cyclic"]:
        _say_cyclic(entry)
    for name, text in (
        ("cut_frames", "EtherCAT frames that are not whole"),
        ("snapped_frames", "frames snapped by the capture"),
        ("damaged_frames", "frames marked as damaged by the analyzer"),
        ("pseudo_frames", "GPIO events of the analyzer"),
        ("foreign_frames", "packets that carry no Ethernet"),
    ):
        if figures[name]:
            say(f"[yellow]{figures[name]}[/yellow] {text}")
    changes = figures["state_changes"]
    for change in changes[:ROWS_SHOWN]:
        who = "all slaves" if change["station"] is None else f"station {change['station']:#06x}"
        code = f", AL status code {change['al_status_code']:#06x}" if "al_status_code" in change else ""
        say(f"{change['time_s']:12.6f} s  {who}: {change['state']}{code}")
    _more(len(changes))
    for area in figures["mapping"]:
        say(
            f"station {area['station']:#06x} maps {area['bytes']} bytes of {area['direction']} "
            f"({area['physical_address']:#06x}) at logical address {area['logical_address']:#x}"
        )
    if "robot" in figures:
        _show_robot(figures["robot"])
    for finding in figures["findings"]:
        say(f"[yellow]{escape(finding)}[/yellow]")
    say("")


def _say_cyclic(entry: dict[str, Any]) -> None:
    name = f"{entry['command']} {entry['logical_address']:#x}, {entry['bytes']} bytes"
    say(f"[bold]{name}[/bold]: {entry['sent']} sent, {entry['returned']} returned")
    if entry["cycle_s"] is not None:
        jitter = [f"{entry[key] * 1e6:.2f}" for key in ("jitter_std_s", "jitter_p99_s", "jitter_max_s")]
        say(
            f"  cycle {entry['cycle_s'] * 1e6:.2f} µs, jitter {jitter[0]} µs std, {jitter[1]} p99, {jitter[2]} max; "
            f"lost cycles {count(entry['lost_cycles'])}"
        )
    if entry["working_counter"] is not None:
        say(
            f"  working counter {entry['working_counter']}, {count(entry['working_counter_faults'])} below, "
            f"{count(entry['unanswered'])} of them unanswered"
        )


def _show_robot(robot: dict[str, Any]) -> None:
    for joint in (1, 2, 3):
        objects = [entry for entry in robot["objects"] if entry["joint"] == joint]
        say(f"joint {joint}: " + ", ".join(f"{o['object']} at {o['logical_address']:#x}" for o in objects))
    if "error" in robot:
        say(f"[yellow]{escape(robot['error'])}[/yellow]")
        return
    say(f"{robot['samples']} samples")
    changes = robot["drive_state_changes"]
    for change in changes[:ROWS_SHOWN]:
        say(f"{change['stamp_s']:.6f} s  joint {change['joint']}: {change['state'].replace('_', ' ')}")
    _more(len(changes))
    for finding in robot["findings"]:
        say(f"[dim]note:[/dim] {escape(finding)}")


def _more(found: int) -> None:
    if found > ROWS_SHOWN:
        say(f"... {found - ROWS_SHOWN} more (--json)")


def count(value: int) -> str:
    """A number of faults, marked where there are any."""
    return f"[yellow]{value}[/yellow]" if value else "0"
