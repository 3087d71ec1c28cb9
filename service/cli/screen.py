"""The screen of `deltatwin top`, in Textual. Only that command imports it."""

from __future__ import annotations

import errno
import sys
from typing import TYPE_CHECKING, ClassVar

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.drivers.linux_driver import LinuxDriver
from textual.widgets import Static

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import RenderableType


class _Terminal(LinuxDriver):
    """Draws on standard output: Textual would draw on standard error, which may be a file."""

    def __init__(self, app: App[Exception], *, debug: bool, mouse: bool, size: tuple[int, int] | None) -> None:
        super().__init__(app, debug=debug, mouse=mouse, size=size)
        assert sys.__stdout__ is not None
        self._file = sys.__stdout__

    @property
    def gone(self) -> bool:
        """Whether what was drawn last could not be written: nobody takes what is drawn after it, and it would wait."""
        return self._writer_thread is not None and not self._writer_thread.is_alive()

    def run_input_thread(self) -> None:
        """Wait for keys; where none can come, for the end: a file that has ended is always ready to be read."""
        if self.input_tty:
            super().run_input_thread()
        else:
            self.exit_event.wait()


class Screen(App[Exception]):
    """What `picture` returns, drawn anew every `interval_s` seconds until `stopped`, q or Ctrl-C, in the terminal's own
    colours. `run` returns the exception of a picture that failed.
    """

    ENABLE_COMMAND_PALETTE = False
    CSS = "#picture { height: 100%; }"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,ctrl+c", "quit", priority=True),
        Binding("ctrl+z", "suspend_process"),
    ]

    def __init__(self, picture: Callable[[], RenderableType], stopped: Callable[[], bool], interval_s: float) -> None:
        """picture: called in the thread that runs the screen."""
        super().__init__(driver_class=_Terminal, ansi_color=True)
        self.theme = "ansi-dark"
        self._picture, self._stopped, self._interval_s = picture, stopped, interval_s

    def compose(self) -> ComposeResult:
        """One text as large as the terminal."""
        yield Static(id="picture")

    def on_ready(self) -> None:
        """Draw from now on: on a busy computer the text is not there before."""
        self.set_interval(self._interval_s, self._draw)

    def _draw(self) -> None:
        if self._stopped():
            self.exit()
            return
        if isinstance(self._driver, _Terminal) and self._driver.gone:
            self.exit(OSError(errno.EIO, "the terminal is gone"))
            return
        try:
            picture = self._picture()
        except Exception as error:  # told by the command, as all others are, once the terminal is as it was
            self.exit(error)
        else:
            self.query_one("#picture", Static).update(picture)
