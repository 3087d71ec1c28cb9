"""A pytest plugin: which functions of `service` each test calls, its fixtures included, and how long both take."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

HERE = str(Path.cwd())
ROOMS = f"{HERE}/service/"
_known: dict[CodeType, str] = {}
_now: set[str] = set()
_fixtures: dict[str, set[str]] = {}
_made: dict[str, float] = {}
_making = [0.0]  # s of the fixtures made inside the one being made
tests: dict[str, dict[str, Any]] = {}


def _call(frame: FrameType, event: str, _: object) -> None:
    if frame.f_code not in _known:
        name = frame.f_code.co_filename
        _known[frame.f_code] = (
            f"{os.path.relpath(name, HERE)}:{frame.f_code.co_firstlineno}" if name.startswith(ROOMS) else ""
        )
    _now.add(_known[frame.f_code])


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: Any) -> Iterator[None]:
    before = set(_now)
    _now.clear()
    started = time.perf_counter()
    _making.append(0.0)
    try:
        return (yield)
    finally:
        whole = time.perf_counter() - started
        own = whole - _making.pop()
        _making[-1] += whole
        _made[fixturedef.argname] = max(own, _made.get(fixturedef.argname, 0.0))
        _fixtures.setdefault(fixturedef.argname, set()).update(_now)
        _now.update(before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any) -> Iterator[None]:
    _now.clear()
    _making[:] = [0.0]
    started = time.perf_counter()
    sys.settrace(_call)
    threading.settrace(_call)
    try:
        return (yield)
    finally:
        sys.settrace(None)
        calls = set(_now).union(*(_fixtures.get(name, set()) for name in item.fixturenames))
        kept = sorted(calls - {""})
        alone = time.perf_counter() - started - _making[0] + sum(_made.get(name, 0.0) for name in item.fixturenames)
        tests[item.nodeid] = {"seconds": alone, "calls": kept}
