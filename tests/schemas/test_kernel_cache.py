"""A kernel must not outlive the sources it was compiled from."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.kernel_cache import KERNEL_ROOMS

PROJECT = Path(__file__).resolve().parents[2]
HEADER = "from numba import njit\nimport schemas.kernels\n"
ROOMS = ("drivers", "replay", "schemas", "service")


def run(folder: Path, **environment: str) -> tuple[str, str]:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | environment
    code = "from service.model.caller import ask; print(ask())"
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True)
    return done.stdout.strip(), done.stderr.strip()


@pytest.fixture
def room(tmp_path):
    """A package of one kernel that calls another."""
    (tmp_path / "schemas").mkdir()
    for name in ("__init__.py", "kernel_cache.py", "kernels.py"):
        shutil.copy(PROJECT / "schemas" / name, tmp_path / "schemas")
    room = tmp_path / "service" / "model"
    room.mkdir(parents=True)
    (tmp_path / "service" / "__init__.py").touch()
    (room / "__init__.py").touch()
    (room / "caller.py").write_text(
        f"{HEADER}from service.model.called import answer\n\n@njit(cache=True)\ndef ask():\n    return answer()\n"
    )
    (room / "called.py").write_text(f"{HEADER}\n@njit(cache=True)\ndef answer():\n    return 1\n")
    return room


def test_a_change_in_a_called_file_recompiles_its_callers(tmp_path, room):
    assert run(tmp_path) == ("1", "")
    # Another length: Python takes a source of the same length and second for the one that it has compiled.
    (room / "called.py").write_text(f"{HEADER}\n@njit(cache=True)\ndef answer():\n    return 22\n")
    assert run(tmp_path) == ("22", "")


@pytest.fixture
def homeless(tmp_path, room):
    """Environment in which neither the package's folder nor the home can keep anything."""
    (tmp_path / "schemas" / "__pycache__").touch()
    (tmp_path / "t").mkdir()
    return {"HOME": os.devnull, "TMPDIR": str(tmp_path / "t"), "PYTHONDONTWRITEBYTECODE": "1"}


def test_without_a_place_kernels_are_kept_in_a_temporary_folder_of_this_users_alone(tmp_path, homeless):
    own = tmp_path / "t" / f"deltatwin-{os.getuid()}"
    answer, said = run(tmp_path, **homeless)
    assert (answer, len(said.splitlines())) == ("1", 1)
    assert str(own) in said
    assert own.stat().st_mode & 0o777 == 0o700
    assert list(own.rglob("*.nbc"))
    assert run(tmp_path, **homeless) == ("1", "")


@pytest.mark.parametrize("planted", ["link", "open to others"])
def test_a_temporary_folder_that_others_could_write_is_not_used(tmp_path, homeless, planted):
    own, foreign = tmp_path / "t" / f"deltatwin-{os.getuid()}", tmp_path / "foreign"
    foreign.mkdir()
    if planted == "link":
        own.symlink_to(foreign)
    else:
        own.mkdir()
        own.chmod(0o777)
    answer, said = run(tmp_path, **homeless)
    assert (answer, len(said.splitlines())) == ("1", 1)
    assert "this run only" in said
    assert not list(tmp_path.rglob("*.nbc"))
    assert [path.name for path in (tmp_path / "t").iterdir()] == [own.name]


def test_with_no_folder_at_all_it_is_one_line(tmp_path, homeless):
    nowhere = "/dev/null"
    code = f"import tempfile; tempfile._candidate_tempdir_list = lambda: [{nowhere!r}]; import schemas.kernels"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | homeless
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


@pytest.fixture
def ours(tmp_path, room):
    """The same room with kernels of our own making."""
    shutil.copy(PROJECT / "schemas" / "kernels.py", tmp_path / "schemas")
    for path in room.glob("call*.py"):
        text = path.read_text().replace("from numba import njit\n", "from schemas.kernels import kernel\n")
        path.write_text(text.replace("@njit(cache=True)", "@kernel"))
    return tmp_path


def test_kernels_hold_for_any_copy_of_the_same_sources(ours, tmp_path_factory):
    """Wherever it lies and whenever its files were written; and for no copy of other sources."""
    assert run(ours) == ("1", "")
    copy = tmp_path_factory.mktemp("elsewhere") / "copy"
    shutil.copytree(ours, copy, copy_function=shutil.copy)  # with times of their own
    kept = {path: path.stat().st_mtime_ns for path in copy.rglob("*.nb[ic]")}
    assert len(kept) == 4
    assert run(copy) == ("1", "")
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*.nb[ic]")} == kept
    called = copy / "service" / "model" / "called.py"
    called.write_text(called.read_text().replace("return 1", "return 22"))
    assert run(copy) == ("22", "")


def test_in_a_folder_of_somebody_elses_they_go_by_their_file(ours, tmp_path_factory):
    """There may be those of other sources, under the same names."""
    place = str(tmp_path_factory.mktemp("place"))
    assert run(ours, NUMBA_CACHE_DIR=place) == ("1", "")
    copy = tmp_path_factory.mktemp("elsewhere") / "copy"
    shutil.copytree(ours, copy)
    called = copy / "service" / "model" / "called.py"
    called.write_text(called.read_text().replace("return 1", "return 22"))
    assert run(copy, NUMBA_CACHE_DIR=place) == ("22", "")
    assert run(ours, NUMBA_CACHE_DIR=place) == ("1", "")
    assert len(list(Path(place).rglob("*.nbi"))) == 4


def test_a_file_of_the_users_own_goes_by_that_file(ours):
    own = ours / "own.py"
    for answer in ("7", "88"):
        own.write_text(f"from schemas.kernels import kernel\n\n@kernel\ndef ask():\n    return {answer}\n")
        (ours / "service" / "model" / "caller.py").write_text("from own import ask\n")
        assert run(ours) == (answer, "")


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def turned(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


@pytest.mark.parametrize("damage", [cut, turned, lambda path: path.write_bytes(b"")], ids=["cut", "turned", "empty"])
@pytest.mark.parametrize("kind", ["*.nbc", "*.nbi"])
def test_what_is_damaged_is_made_anew_and_said_once(ours, kind, damage):
    assert run(ours) == ("1", "")
    files = list(ours.rglob(kind))
    assert len(files) == 2
    for path in files:
        damage(path)
    answer, said = run(ours)
    assert answer == "1"
    if damage is not turned or kind == "*.nbc":  # a bit of an index may only say that there is nothing
        assert len(said.splitlines()) == 1
        assert "compiled kernels are damaged" in said
        assert said.endswith("compiled again")
    assert run(ours) == ("1", "")


def test_where_the_disk_is_full_kernels_are_made_for_this_run_alone(ours):
    """Files of more than 4 kB cannot be written, as by `ulimit -f`."""
    code = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "from service.model.caller import ask; print(ask())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # Python itself leaves its own files cut there
    done = subprocess.run([sys.executable, "-c", code], cwd=ours, env=environment, capture_output=True, text=True)
    assert done.stdout.strip() == "1", done.stderr
    said = [line for line in done.stderr.splitlines() if "compiled kernels" in line]  # a library may warn beside it
    assert len(said) == 1, done.stderr
    assert "compiled kernels cannot be stored (File too large): they are compiled for this run only" in said[0]
    assert run(ours) == ("1", "")


def imported(path: Path) -> set[Path]:
    """Our own files that `path` imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            if name.split(".")[0] in ROOMS:
                stem = PROJECT / Path(*name.split("."))
                found |= {p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.exists()}
    return found


def test_all_that_kernels_are_made_of_is_in_the_digest():
    sources = [path for room in ROOMS for path in (PROJECT / room).rglob("*.py")]
    makes = re.compile("^from (numba import njit|schemas.kernels import)", re.MULTILINE)
    reached, ahead = set(), {path for path in sources if makes.search(path.read_text())}
    while ahead:
        path = ahead.pop()
        reached.add(path)
        ahead |= imported(path) - reached
    strangers = [
        str(path.relative_to(PROJECT))
        for path in sorted(reached)
        if not any(path.is_relative_to(PROJECT / room) for room in KERNEL_ROOMS)
        and path != PROJECT / "service" / "__init__.py"
    ]
    assert not strangers
