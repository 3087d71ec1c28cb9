"""How many small wrong changes the tests notice: uv run python -m tests.bench.bench_mutants --room diagnosis --count 60

The tests of a room run once as they are; what each test calls is written down, and kept until its file or one it calls
has changed. Then every mutant is put to the tests that call the changed function, the fastest first. A change in the
body of a Python function is made in a fork of this process; any other (a kernel, a constant of a module) in a temporary
copy of the tree by a process of its own. Killed: a test fails that passes without the change, or the code cannot be
imported. Late: many times the CPU time that the tests take as they are. A run that tells neither (no test, wrong usage,
an error of pytest's own) ends the bench. Survivors are listed; `equivalent.txt` beside this file lists the changes that
no test can see, with the reason.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import gc
import hashlib
import io
import json
import os
import pickle
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from numba.core.caching import _CacheLocator, _SourceFileBackedLocatorMixin
from numba.core.serialize import dumps

from tests.bench.mutate import Mutant, mutants
from tests.bench.survey import Survey

ROOT = Path(__file__).parents[2]
SURVEYS = Path.home() / ".cache" / "deltatwin" / "survey"
STORED_RUN = "tests/replay/test_reference.py"  # what the whole estimator said of a log
TESTS = {
    "model": ["tests/service/model"],
    "estimator": ["tests/service/estimator", STORED_RUN],
    "identification": ["tests/service/identification"],
    "diagnosis": ["tests/service/diagnosis"],
    "rollout": ["tests/service/rollout"],
    "planning": ["tests/service/planning"],
    "watch": ["tests/service/watch"],
}
EQUIVALENT = Path(__file__).with_name("equivalent.txt")
PAGES = ("sealed_page.py", "report.py")  # pictures and prose, looked at in tests/service/pages
LEAST_TIME, TIMES = 200.0, 4.0  # s of CPU, kernels compiled anew included, and times what the tests take as they are
WAIT = 600.0  # s by the clock that a test of a mutant may take at least, beside TIMES what it takes as it is
QUICK = 1.0  # s, fixtures included: a test that is put before all others, whatever file it is in
PYTEST = ("-x", "-q", "-p", "no:cacheprovider", "--tb=line", "-n", "0", "-m", "")
PASSED, FAILED, LATE, UNUSED, BROKEN = "SURVIVED", "killed", "late", "UNUSED", "broken"
_UNUSED, _BROKEN = 77, 78  # exit codes of a fork


def sites(room: str) -> list[Mutant]:
    """Every mutant of a room."""
    folder = ROOT / "service" / room
    files = [path for path in sorted(folder.rglob("*.py")) if path.name not in PAGES]
    return [m for path in files for m in mutants(str(path.relative_to(ROOT)), path.read_text())]


def copy(to: Path) -> None:
    """The tree as git knows it, with what is not committed."""
    for name in ("drivers", "replay", "schemas", "service", "tests", "docs", "results", "pyproject.toml", "README.md"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, to / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(source, to / name)
    if (ROOT.parent / "shared").is_dir():
        (to.parent / "shared").symlink_to(ROOT.parent / "shared")


def verdict(code: int, said: str) -> str:
    """What an exit code means; negative: ended by that signal."""
    if code == 0:
        return PASSED
    if code == pytest.ExitCode.TESTS_FAILED:
        return LATE if "from pytest-timeout" in said else FAILED
    if code == -signal.SIGXCPU:
        return LATE
    if code == pytest.ExitCode.INTERRUPTED and "error" in said and "during collection" in said:
        return FAILED
    if code == pytest.ExitCode.USAGE_ERROR and "ImportError while loading conftest" in said:
        return FAILED
    return FAILED if code < 0 else UNUSED if code == _UNUSED else BROKEN


def apart(tree: Path, kernels: Path, tests: Sequence[str], limit: float, wait: float = 0.0) -> tuple[str, str]:
    """Verdict and words of pytest in a copy of the tree. limit: s of CPU; wait: s by the clock of a test, 0 for any."""
    known = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": str(kernels)}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", f"--rootdir={tree}", f"--timeout={wait}", *PYTEST, *tests],
        cwd=tree, env={**os.environ, **known}, preexec_fn=lambda: _bound(limit),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
    )  # fmt: skip
    return verdict(done.returncode, done.stdout), done.stdout


def here(work: Callable[[], int], limit: float) -> tuple[str, str]:
    """Verdict and words of `work`, which answers with an exit code, in a fork of this process. limit: s of CPU."""
    with tempfile.TemporaryFile("w+") as words:
        child = os.fork()
        if not child:
            code = _BROKEN
            try:
                os.setsid()
                _bound(limit)
                os.dup2(words.fileno(), 1)
                os.dup2(words.fileno(), 2)
                code = work()
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # what a test started and did not end
        words.seek(0)
        said = words.read()
    return verdict(os.waitstatus_to_exitcode(status), said), said


def _bound(limit: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))


def changed(mutant: Mutant, tests: Sequence[str], wait: float) -> int:
    """Exit code of the tests with one function of this process changed. wait: s by the clock of a test."""
    if not change(mutant):
        return _UNUSED
    return int(pytest.main([f"--timeout={wait}", *PYTEST, *tests]))


def alone(test: str) -> int:
    """Exit code of a test with nothing changed."""
    return int(pytest.main([*PYTEST, test]))


def change(mutant: Mutant) -> bool:
    """Give the live function the mutant's code, and forget what was kept of its results; whether there is one."""
    path = str(ROOT / mutant.file)
    tree = compile(mutant.of((ROOT / mutant.file).read_text()), path, "exec")
    (code,) = (c for c in _codes(tree) if c.co_qualname == mutant.outer)
    found = False
    for kept in gc.get_objects():
        if isinstance(kept, types.FunctionType) and kept.__code__.co_filename == path:
            if kept.__code__.co_qualname == mutant.outer:
                kept.__code__ = code
                found = True
        elif isinstance(kept, functools._lru_cache_wrapper) and kept.__module__.startswith(("service", "tests")):
            kept.cache_clear()
    return found


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _codes(part)


def survey(room: str) -> dict[str, dict]:
    """Test -> seconds and the functions (file:line) of `service` it calls, on the code as it is.

    The tests are imported into this process, and run in a fork of it, as they are for every mutant: what was run could
    have started threads, and threads do not live through a fork.

    Raises:
        SystemExit: the tests fail as they are.
    """
    with contextlib.redirect_stdout(io.StringIO()) as text:
        code = pytest.main(["-q", "--collect-only", "-p", "no:cacheprovider", "-m", "", *TESTS[room]])
    if code:
        sys.exit(f"the tests of {room} cannot be collected:\n{text.getvalue()[-3000:]}")
    names = re.findall(r"^(\S+\.py)::", text.getvalue(), re.MULTILINE)
    tests: dict[str, dict] = {}
    missing = []
    for file in dict.fromkeys(names):
        kept = _kept(file)
        tests |= kept
        missing += [] if kept else [file]
    if missing:
        tests |= _surveyed(missing)
    print(f"{room}: {len(tests)} tests take {sum(test['seconds'] for test in tests.values()):.0f} s", flush=True)
    return tests


def _surveyed(files: Sequence[str]) -> dict[str, dict]:
    SURVEYS.mkdir(parents=True, exist_ok=True)

    def run() -> int:
        return int(pytest.main(["--timeout=0", *PYTEST, *files], plugins=[Survey(_keep)]))

    word, said = here(run, 3600.0)
    if word != PASSED:
        sys.exit(f"the tests fail as they are:\n{said[-3000:]}")
    return {name: test for file in files for name, test in _kept(file).items()}


def _keep(file: str, tests: dict[str, dict]) -> None:
    """Write down what was seen of the tests of a file: a survey that ends early goes on behind it."""
    called = {call.rsplit(":", 1)[0] for test in tests.values() for call in test["calls"]}
    _survey_of(file).write_text(json.dumps({"called": {name: _digest(name) for name in called}, "tests": tests}))


def _kept(file: str) -> dict[str, dict]:
    """What an earlier run saw of the tests of a file; empty where that is no more so."""
    try:
        kept = json.loads(_survey_of(file).read_text())
    except FileNotFoundError:
        return {}
    return kept["tests"] if all(_digest(name) == digest for name, digest in kept["called"].items()) else {}


def _survey_of(file: str) -> Path:
    skips = "" if (ROOT.parent / "shared").is_dir() else "-alone"  # without it tests skip
    return SURVEYS / f"{file.replace('/', '.')}-{_digest(file)}{skips}.json"


def _digest(file: str) -> str:
    path = ROOT / file
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def order(mutant: Mutant, tests: dict[str, dict]) -> list[str]:
    """Tests that call the function of a mutant; all where that cannot be seen (a kernel, a constant that a test reads),
    those first whose file imports the mutant's, which have least to compile. Quick ones first, the others file by file,
    so that what a file makes for its tests is made once."""
    mine = {n for n in tests if f"{mutant.file}:{mutant.function}" in tests[n]["calls"]}
    pattern = _importing({Path(mutant.file)})
    files = {name.split("::")[0] for name in tests}
    near = {file for file in files if pattern.search((ROOT / file).read_text())}
    by_import = {name for name in tests if name.split("::")[0] in near}
    groups = [mine] if mutant.function and not mutant.compiled else [by_import, mine, set(tests)]
    result: list[str] = []
    for group in groups:
        result += _ranked(group.difference(result), tests)
    return result or _ranked(set(tests), tests)


def _ranked(names: set[str], tests: dict[str, dict]) -> list[str]:
    seconds = {name: tests[name]["seconds"] for name in names}
    files: dict[str, float] = {}
    for name in names:
        file = name.split("::")[0]
        files[file] = max(files.get(file, 0.0), seconds[name])

    def key(name: str) -> tuple[bool, float, str, float]:
        slow = seconds[name] > QUICK
        file = name.split("::")[0]
        return slow, files[file] * slow, file * slow, seconds[name]

    return sorted(names, key=key)


def users(tree: Path, file: str) -> set[Path]:
    """`file` and every file that imports it, directly or not: kernels of theirs may have it compiled in."""
    sources = {
        path: path.read_text() for room in ("service", "drivers", "replay") for path in (tree / room).rglob("*.py")
    }
    found, grown = {tree / file}, True
    while grown:
        pattern = _importing({path.relative_to(tree) for path in found})
        more = {path for path, text in sources.items() if path not in found and pattern.search(text)}
        found, grown = found | more, bool(more)
    return found


def _importing(files: set[Path]) -> re.Pattern[str]:
    names = (".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in files)
    return re.compile(rf"(?:from|import) (?:{'|'.join(map(re.escape, names))})\b")


def carry_over(kernels: Path, tree: Path) -> None:
    """The kernels of this checkout into `kernels`, under the names and stamps by which Numba finds them for the copy:
    here they are known by all sources, of which a mutant is not one."""
    own = Path(os.environ["NUMBA_CACHE_DIR"])
    kernels.mkdir()
    for kept in own.rglob("*.nb?"):
        folder = kept.parent.relative_to(own)
        source = (tree / folder / kept.name.split(".")[0]).with_suffix(".py")
        if not source.exists():  # a kernel of a test's own
            continue
        target = kernels / _CacheLocator.get_suitable_cache_subpath(str(tree / folder / "_.py")) / kept.name
        target.parent.mkdir(parents=True, exist_ok=True)
        if kept.suffix == ".nbi":
            with kept.open("rb") as file:
                version, (_, overloads) = pickle.load(file), pickle.load(file)
            located: Any = types.SimpleNamespace(_py_file=str(source))
            stamp = _SourceFileBackedLocatorMixin.get_source_stamp(located)
            target.write_bytes(pickle.dumps(version, -1) + dumps((stamp, overloads)))
        else:
            shutil.copy(kept, target)


@contextlib.contextmanager
def written(mutant: Mutant, tree: Path, kernels: Path) -> Iterator[Path]:
    """The mutant in the file of the tree; a folder of compiled kernels without those of the file and its users."""
    file = tree / mutant.file
    source, stamp = file.read_text(), file.stat()
    stale = {(path.parent.name, path.stem) for path in users(tree, mutant.file)}
    with tempfile.TemporaryDirectory(dir=kernels.parent) as place:
        kept = Path(place) / "kernels"
        shutil.copytree(kernels, kept, copy_function=os.link)  # Numba replaces files, it does not write into them
        for kernel in kept.rglob("*.nb?"):
            if (kernel.parent.name.rsplit("_", 1)[0], kernel.name.split(".")[0]) in stale:
                kernel.unlink()
        file.write_text(mutant.of(source))
        try:
            yield kept
        finally:
            file.write_text(source)
            os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))  # Numba goes by it


def room_of(room: str, count: int, seed: int, only: set[int]) -> tuple[int, int]:
    """Killed and tried of a room, told one by one."""
    known = {line.rsplit(" # ", 1)[0].strip() for line in EQUIVALENT.read_text().splitlines() if " # " in line}
    every = sites(room)
    chosen = random.Random(f"{room} {seed}").sample(every, min(count, len(every)))
    picked = [(n, m) for n, m in enumerate(chosen, 1) if n in only or not only]
    tests = survey(room)
    print(f"{room}: {len(every)} mutants, {len(picked)} tried", flush=True)
    killed = tried = 0
    passing: set[tuple[str, bool]] = set()  # tests seen to pass without a change: name, whether in the copy
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree, kernels = Path(folder) / "tree", Path(folder) / "kernels"
        if any(mutant.compiled or not mutant.outer for _, mutant in picked):
            copy(tree)
            carry_over(kernels, tree)
        for number, mutant in picked:
            place = f"{mutant.file}:{mutant.line} {mutant.what}"
            if mutant.key in known:
                print(f"{number:4d} equivalent {place}", flush=True)
                continue
            names = order(mutant, tests)
            limit = LEAST_TIME + TIMES * sum(tests[name]["seconds"] for name in names)
            wait = max(WAIT, TIMES * max(tests[name]["seconds"] for name in names))
            started = time.monotonic()
            in_copy = mutant.compiled or not mutant.outer
            if in_copy:
                with written(mutant, tree, kernels) as compiled:
                    word, said = apart(tree, compiled, names, limit, wait)
            else:
                word, said = here(functools.partial(changed, mutant, names, wait), limit)
            if word == BROKEN:
                sys.exit(f"{place}: the tests could not be run:\n{said[-3000:]}")
            by = [
                name
                for name in names
                if re.search(rf"^(?:FAILED|ERROR) {re.escape(name)}(?: - |$)", said, re.MULTILINE)
            ]
            for name in by:
                if (name, in_copy) not in passing:
                    as_is = (
                        apart(tree, kernels, [name], limit) if in_copy else here(functools.partial(alone, name), limit)
                    )
                    if as_is[0] != PASSED:
                        sys.exit(f"{name} fails as it is:\n{as_is[1][-3000:]}")
                    passing.add((name, in_copy))
            tried += 1
            killed += word in (FAILED, LATE)
            print(f"{number:4d} {word:10s} {time.monotonic() - started:5.0f} s  {place}", *by[:1], flush=True)
    return killed, tried


def main() -> None:
    """The rooms asked for, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", choices=TESTS, action="append", help="default: all")
    parser.add_argument("--count", type=int, default=60, help="mutants a room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="+", default=[], metavar="NUMBER", help="these of them")
    asked = parser.parse_args()
    result = {room: room_of(room, asked.count, asked.seed, set(asked.only)) for room in asked.room or TESTS}
    for room, (killed, tried) in result.items():
        print(f"{room}: {killed} of {tried} killed, {100 * killed / max(tried, 1):.0f} %")


if __name__ == "__main__":
    main()
