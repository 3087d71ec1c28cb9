"""How many small wrong changes the tests notice: uv run python -m tests.bench.bench_mutants --room diagnosis --count 60

The tests of a room run once as they are; what each test calls is written down. Then every mutant is put to the tests
that call the changed function, the fastest first. A change in the body of a Python function is made in a fork of this
process; any other (a kernel, a constant of a module) in a temporary copy of the tree by a process of its own. Killed: a
test fails or does not end in time, or the code cannot be imported. Survivors are listed; `equivalent.txt` beside this
file lists the changes that no test can see, with the reason.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import gc
import io
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.bench import survey as watch
from tests.bench.mutate import Mutant, mutants

ROOT = Path(__file__).parents[2]
ROOMS = ("model", "estimator", "identification", "diagnosis")
EQUIVALENT = Path(__file__).with_name("equivalent.txt")
PAGES = ("blindpage.py", "report.py")  # pictures and prose, looked at in tests/service/pages
LEAST_TIME, TIMES = 120.0, 4.0  # s, and times as long as the tests take on the code as it is


def sites(room: str) -> list[Mutant]:
    """Every mutant of a room."""
    folder = ROOT / "service" / room
    files = [path for path in sorted(folder.rglob("*.py")) if path.name not in PAGES]
    return [m for path in files for m in mutants(str(path.relative_to(ROOT)), path.read_text())]


def copy(to: Path) -> None:
    """The tree as git knows it, with what is not committed."""
    for name in ("drivers", "replay", "schemas", "service", "tests", "pyproject.toml", "README.md"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, to / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, to / name)


def apart(tree: Path, arguments: Sequence[str], limit: float) -> int:
    """Exit code (-1 out of time) of pytest in a copy of the tree."""
    known = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": str(tree / ".kernels")}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", f"--rootdir={tree}", *arguments]
    try:
        done = subprocess.run(command, cwd=tree, timeout=limit, capture_output=True, env={**os.environ, **known})
    except subprocess.TimeoutExpired:
        return -1
    return done.returncode


def here(mutant: Mutant, arguments: Sequence[str], limit: float) -> int:
    """Exit code (-1 out of time) of pytest in a fork of this process with one function changed."""
    child = os.fork()
    if not child:
        signal.alarm(int(limit))
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), 1)
            os.dup2(nothing.fileno(), 2)
        try:
            change(mutant)
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *arguments]))
            code = 0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else code
        except BaseException:
            code = 1
        os._exit(code)
    _, status = os.waitpid(child, 0)
    return -1 if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


def change(mutant: Mutant) -> None:
    """Give the live function the mutant's code, and forget what was kept of its results."""
    path = str(ROOT / mutant.file)
    tree = compile(mutant.of((ROOT / mutant.file).read_text()), path, "exec")
    (code,) = (c for c in _codes(tree) if c.co_qualname == mutant.outer)
    changed = 0
    for kept in gc.get_objects():
        if isinstance(kept, types.FunctionType) and kept.__code__.co_filename == path:
            if kept.__code__.co_qualname == mutant.outer:
                kept.__code__ = code
                changed += 1
        elif isinstance(kept, functools._lru_cache_wrapper) and kept.__module__.startswith("service"):
            kept.cache_clear()
    assert changed, "the function is not in use"
    pool = ThreadPoolExecutor(2)  # threads do not live through a fork
    for module in list(sys.modules.values()):
        if isinstance(getattr(module, "THREADS", None), ThreadPoolExecutor):
            module.THREADS = pool  # pyright: ignore[reportAttributeAccessIssue]


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _codes(part)


def survey(room: str) -> dict[str, dict]:
    """Test -> seconds and the functions (file:line) of `service` it calls, on the code as it is.

    Raises:
        SystemExit: the tests fail as they are.
    """
    started = time.monotonic()
    with contextlib.redirect_stdout(io.StringIO()) as text:
        code = pytest.main(
            ["-x", "-q", "-p", "no:cacheprovider", "--timeout=3000", f"tests/service/{room}"], plugins=[watch]
        )
    if code:
        sys.exit(f"the tests of {room} fail as they are:\n{text.getvalue()[-3000:]}")
    print(f"{room}: its tests take {time.monotonic() - started:.0f} s", flush=True)
    return watch.tests


def order(mutant: Mutant, tests: dict[str, dict]) -> list[str]:
    """Tests that call the function of a mutant, fastest first; of its file where that cannot be seen, else all."""
    ranked = sorted(tests, key=lambda name: tests[name]["seconds"])
    mine = [n for n in ranked if f"{mutant.file}:{mutant.function}" in tests[n]["calls"]]
    if not mine or mutant.compiled or mutant.function == 0:
        near = [n for n in ranked if any(call.startswith(f"{mutant.file}:") for call in tests[n]["calls"])]
        mine = [*mine, *(n for n in near if n not in mine)]
        if mutant.compiled:
            mine += [n for n in ranked if n not in mine]
    return mine or ranked


def users(tree: Path, file: str) -> set[Path]:
    """`file` and every file that imports it, directly or not: kernels of theirs may have it compiled in."""
    sources = {
        path: path.read_text() for room in ("service", "drivers", "replay") for path in (tree / room).rglob("*.py")
    }
    found, grown = {tree / file}, True
    while grown:
        names = [".".join(path.relative_to(tree).with_suffix("").parts).removesuffix(".__init__") for path in found]
        pattern = re.compile(rf"(?:from|import) (?:{'|'.join(map(re.escape, names))})\b")
        more = {path for path, text in sources.items() if path not in found and pattern.search(text)}
        found, grown = found | more, bool(more)
    return found


def forget(tree: Path, file: str) -> None:
    """Throw away the compiled kernels of `file` and its users."""
    stale = {(path.parent.name, path.stem) for path in users(tree, file)}
    for kernel in (tree / ".kernels").rglob("*.nb?"):
        if (kernel.parent.name.rsplit("_", 1)[0], kernel.name.split(".")[0]) in stale:
            kernel.unlink()


def room_of(room: str, count: int, seed: int) -> tuple[int, int]:
    """Killed and tried of a room, told one by one."""
    known = {line.split(" # ")[0].strip() for line in EQUIVALENT.read_text().splitlines() if " # " in line}
    every = sites(room)
    chosen = random.Random(f"{room} {seed}").sample(every, min(count, len(every)))
    tests = survey(room)
    print(f"{room}: {len(every)} mutants, {len(chosen)} tried", flush=True)
    killed = tried = 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder)
        copy(tree)
        for number, mutant in enumerate(chosen, 1):
            place = f"{mutant.file}:{mutant.line} {mutant.what}"
            if mutant.key in known:
                print(f"{number:4d} equivalent {place}", flush=True)
                continue
            names = order(mutant, tests)
            limit = max(LEAST_TIME, TIMES * sum(tests[name]["seconds"] for name in names))
            started = time.monotonic()
            if mutant.outer and not mutant.compiled:
                code = here(mutant, names, limit)
            else:
                changed = tree / mutant.file
                original = changed.read_text()
                changed.write_text(mutant.of(original))
                forget(tree, mutant.file)
                code = apart(tree, names, limit)
                changed.write_text(original)
                forget(tree, mutant.file)
            tried += 1
            killed += code != 0
            word = {0: "SURVIVED", -1: "late"}.get(code, "killed")
            print(f"{number:4d} {word:10s} {time.monotonic() - started:5.0f} s  {place}", flush=True)
    return killed, tried


def main() -> None:
    """The rooms asked for, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", choices=ROOMS, action="append", help="default: all four")
    parser.add_argument("--count", type=int, default=60, help="mutants a room")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    result = {room: room_of(room, asked.count, asked.seed) for room in asked.room or ROOMS}
    for room, (killed, tried) in result.items():
        print(f"{room}: {killed} of {tried} killed, {100 * killed / max(tried, 1):.0f} %")


if __name__ == "__main__":
    main()
