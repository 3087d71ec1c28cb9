"""A pytest plugin: which functions of `service` each test calls, its fixtures included, and how long it takes."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

HERE = str(Path.cwd())
_now: set[str] = set()
_fixtures: dict[str, set[str]] = {}
_tests: dict[str, dict[str, Any]] = {}


def _call(frame: FrameType, event: str, _: object) -> None:
    if event == "call" and frame.f_code.co_filename.startswith(HERE):
        _now.add(f"{os.path.relpath(frame.f_code.co_filename, HERE)}:{frame.f_code.co_firstlineno}")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: Any) -> Iterator[None]:
    before = set(_now)
    _now.clear()
    try:
        return (yield)
    finally:
        _fixtures.setdefault(fixturedef.argname, set()).update(_now)
        _now.update(before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any) -> Iterator[None]:
    _now.clear()
    started = time.perf_counter()
    sys.setprofile(_call)
    threading.setprofile(_call)
    try:
        return (yield)
    finally:
        sys.setprofile(None)
        calls = set(_now).union(*(_fixtures.get(name, set()) for name in item.fixturenames))
        kept = sorted(call for call in calls if call.startswith("service"))
        _tests[item.nodeid] = {"seconds": time.perf_counter() - started, "calls": kept}


def pytest_sessionfinish() -> None:
    Path(os.environ["DELTATWIN_SURVEY"]).write_text(json.dumps(_tests))
