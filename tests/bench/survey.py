"""A pytest plugin: which functions of `service` each test calls, its fixtures included, and how long both take."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

HERE = str(Path.cwd())
ROOMS = f"{HERE}/service/"


class Survey:
    """keep(file, tests by name) is called as soon as all tests of a file have passed."""

    def __init__(self, keep: Callable[[str, dict[str, dict[str, Any]]], None]) -> None:
        self._keep = keep
        self._known: dict[CodeType, str] = {}
        self._now: set[str] = set()
        self._fixtures: dict[str, set[str]] = {}
        self._made: dict[str, float] = {}
        self._making = [0.0]  # s of the fixtures made inside the one being made
        self._tests: dict[str, dict[str, dict[str, Any]]] = {}
        self._left = Counter[str]()  # tests of a file that have not run

    def _call(self, frame: FrameType, event: str, _: object) -> None:
        if frame.f_code not in self._known:
            name = frame.f_code.co_filename
            self._known[frame.f_code] = (
                f"{os.path.relpath(name, HERE)}:{frame.f_code.co_firstlineno}" if name.startswith(ROOMS) else ""
            )
        self._now.add(self._known[frame.f_code])

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self._left.update(item.nodeid.split("::")[0] for item in session.items)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        before = set(self._now)
        self._now.clear()
        started = time.perf_counter()
        self._making.append(0.0)
        try:
            return (yield)
        finally:
            whole = time.perf_counter() - started
            own = whole - self._making.pop()
            self._making[-1] += whole
            self._made[fixturedef.argname] = max(own, self._made.get(fixturedef.argname, 0.0))
            self._fixtures.setdefault(fixturedef.argname, set()).update(self._now)
            self._now.update(before)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        self._now.clear()
        self._making[:] = [0.0]
        started = time.perf_counter()
        sys.settrace(self._call)
        threading.settrace(self._call)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            calls = set(self._now).union(*(self._fixtures.get(name, set()) for name in item.fixturenames))
            made = sum(self._made.get(name, 0.0) for name in item.fixturenames)
            seconds = time.perf_counter() - started - self._making[0] + made
            file = item.nodeid.split("::")[0]
            tests = self._tests.setdefault(file, {})
            tests[item.nodeid] = {"seconds": seconds, "calls": sorted(calls - {""})}
            self._left[file] -= 1
            if not self._left[file] and not item.session.testsfailed:
                self._keep(file, tests)
