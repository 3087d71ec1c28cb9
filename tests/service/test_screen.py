"""The screen of `deltatwin top` in Textual's own harness: whole at every width, ended by each key, errors handed on."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Group
from textual.pilot import Pilot

from service.cli.output import table
from service.cli.screen import Screen, _Terminal

INTERVAL_S = 0.05
HEAD = ("role", "state", "messages in, out", "lost", "latency, median, p99, max", "status")
ROWS = [("estimator", "runs", "123456, 123456", "0", "32, 45, 310 µs", "no real time, friction drift")]


def text(screen: Screen) -> list[str]:
    """The lines of the terminal as drawn."""
    return ["".join(segment.text for segment in line) for line in screen.screen._compositor.render_strips()]


def run(width: int, act: Callable, picture: Callable, stopped: Callable[[], bool] = lambda: False) -> Screen:
    """A screen of that width in columns while `act` acts on it."""
    screen = Screen(picture, stopped, INTERVAL_S)

    async def played() -> None:
        async with screen.run_test(size=(width, 40)) as pilot:
            await act(screen, pilot)

    asyncio.run(played())
    return screen


@pytest.mark.parametrize("width", [60, 80, 140])
def test_nothing_is_cut_at_any_width(width: int) -> None:
    drawn: list[str] = []

    async def look(screen: Screen, pilot: object) -> None:
        del pilot
        while not any("estimator" in line for line in drawn):
            await asyncio.sleep(INTERVAL_S)
            drawn[:] = text(screen)

    run(width, look, lambda: Group(table(HEAD, ROWS, "bench")))
    words = " ".join(drawn).split()
    for cell in ROWS[0]:
        assert set(cell.split()) <= set(words), drawn
    assert {len(line) for line in drawn} == {width}


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_a_key_ends_it(key: str) -> None:
    async def press(screen: Screen, pilot: Pilot) -> None:
        await pilot.press(key)
        await asyncio.sleep(4 * INTERVAL_S)
        assert not screen.is_running

    assert run(80, press, lambda: Group("bench")).return_code == 0


def test_it_ends_when_a_signal_came() -> None:
    came: list[int] = []

    async def signal(screen: Screen, pilot: object) -> None:
        del pilot
        came.append(1)
        await asyncio.sleep(8 * INTERVAL_S)
        assert not screen.is_running

    run(80, signal, lambda: Group("bench"), lambda: bool(came))


def test_what_fails_while_it_is_drawn_is_handed_on() -> None:
    failed = ValueError("a message of another version")

    def picture() -> Group:
        raise failed

    async def wait(screen: Screen, pilot: object) -> None:
        del pilot
        await asyncio.sleep(8 * INTERVAL_S)
        assert not screen.is_running

    assert run(80, wait, picture).return_value is failed


def test_without_a_keyboard_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that has ended is always ready: who asks again and again takes a processor of its own."""
    asked: list[int] = []
    monkeypatch.setattr(os, "read", lambda *_: asked.append(1) or b"")

    async def waited() -> None:
        screen = Screen(lambda: Group("bench"), lambda: False, INTERVAL_S)
        terminal = _Terminal(screen, debug=False, mouse=False, size=None)
        waits = asyncio.create_task(asyncio.to_thread(terminal.run_input_thread))
        await asyncio.sleep(4 * INTERVAL_S)
        terminal.exit_event.set()
        await waits

    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "__stdin__", nothing)
        asyncio.run(waited())
    assert not asked
