"""What ends a command: Ctrl-C, SIGTERM, a terminal that is closed.

It is heard from the first line on. While nothing is begun yet it ends the process at once (`end_at_once`). Then it is
raised as KeyboardInterrupt (`terminate_as_interrupt`), or asked for by loops that must not be torn out of a step
(`stop_requested`). When all is done it ends the process at once again, with the exit code that is due anyway.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

_PR_SET_PDEATHSIG = 1
ENDING = [number for name in ("SIGINT", "SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))]
INTERRUPTED = 130  # exit code of Ctrl-C
SAME_WISH_S = 1.0  # Ctrl-C comes twice: from the terminal, and from who started this process and is stopped as well
RAISE_AGAIN_S = (
    0.01  # after an interrupt that was raised where nothing can be: the code that did so has returned by then
)


class _Interrupt:
    """What came of the signals so far."""

    raised_s = -SAME_WISH_S  # CLOCK_MONOTONIC
    swallowed = False


def _handle(handler: Callable[..., object]) -> None:
    for number in ENDING:
        # a shell starts background jobs with SIGINT ignored; `nohup` means what it says
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def end_at_once(code: int = INTERRUPTED) -> None:
    """Let it end the process where it stands: nothing is begun yet, or all files are whole."""
    sys.excepthook = _not_handed_on  # here: Typer, once imported, keeps to the hook that it has found
    _handle(lambda *_: os._exit(code))
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def end_with(parent: int) -> None:
    """End this process with `parent`, which has started it, in whatever way that does."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended while this one was starting
        os._exit(INTERRUPTED)


def all_is_done() -> None:
    """Let it change nothing any more: while the interpreter takes itself apart it has no handlers but this one, and a
    signal would end a command that did all it should as one that was killed."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def terminate_as_interrupt() -> None:
    """Let SIGTERM, and a terminal that is closed, end a command the way Ctrl-C does: files whole, counts reported.

    The second of two within `SAME_WISH_S` does not tear up what the first one makes whole. An interrupt that was raised
    where no exception gets out, as in what a compiler calls back, an object's end or a library's C code that prints
    what it was told, is raised again.
    """
    sys.unraisablehook = _not_raised
    _handle(_interrupt)


def _interrupt(*_: object) -> None:
    now = time.monotonic()
    if now - _Interrupt.raised_s >= SAME_WISH_S:
        _Interrupt.raised_s = now
        raise KeyboardInterrupt


def _was_raised() -> bool:
    return _Interrupt.raised_s > 0.0


def _not_raised(unraisable: Any) -> None:
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _raise_again()
    elif not _half_built(unraisable):
        sys.__unraisablehook__(unraisable)


def _half_built(unraisable: Any) -> bool:
    """Whether it is of the end of an object that an interrupt left without what its end asks for."""
    of_an_end = getattr(unraisable.object, "__name__", None) == "__del__"
    return _was_raised() and of_an_end and issubclass(unraisable.exc_type, AttributeError)


def _not_handed_on(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt):
        _raise_again()
    else:
        sys.__excepthook__(kind, error, trace)


def _raise_again() -> None:
    _Interrupt.swallowed = True
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, RAISE_AGAIN_S)


def broke(error: BaseException) -> bool:
    """Whether `error` is what an interrupt left behind where it was swallowed or taken for another one: a compiler
    without its result, a module that could not be imported, a class that was not built."""
    if _Interrupt.swallowed or KeyboardInterrupt.__name__ in str(error):  # compiled code tells of it in words alone
        return True
    # or not even so: a library's own C code puts another error in its place while it is imported
    if _while_imported(error) and time.monotonic() - _Interrupt.raised_s < SAME_WISH_S:
        return True
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or (cause.__context__ if isinstance(cause, ImportError) else None)
    return cause is not None


def _while_imported(error: BaseException) -> bool:
    """Whether it came while a module's own lines were run."""
    from traceback import walk_tb  # here: until this file is loaded nobody hears a signal

    frames = (frame for frame, _ in walk_tb(error.__traceback__))
    return isinstance(error, ImportError) or any(frame.f_code.co_name == "<module>" for frame in frames)


def interrupted() -> bool:
    """False, or raises: asked in every round of a loop that an interrupt tears. Who still asks after one came has lost
    it to code that catches everything, as some libraries do while they are imported, or C code that clears what it is
    not told.

    Raises:
        KeyboardInterrupt: there was one.
    """
    if _was_raised():
        raise KeyboardInterrupt
    return False


def stop_requested() -> Callable[[], bool]:
    """A question that is answered True once one of them came, before this was asked, too, see `interrupted`; for
    loops that must not be torn out of a step.
    """
    came: list[int] = [signal.SIGINT] if _was_raised() else []
    _handle(lambda received, _: came.append(received))
    return lambda: bool(came)
