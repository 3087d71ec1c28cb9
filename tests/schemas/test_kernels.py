"""A kernel has two compiled forms: one for Python, and one without what lets Python call it for other kernels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

# Numba counts here what it compiles. In a file, since kernels of a text are not kept.
ROOM = """
import gc
import sys

from numba.core import event

from schemas.kernels import kernel

compiled = []
if "frozen" in sys.argv:
    gc.freeze()


class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
        if "freezing" in sys.argv:
            compiled.append(gc.get_freeze_count() > 10_000)

    def on_end(self, event):
        pass


event.register("numba:compile", Listener())


@kernel
def power(base, exponent):
    result = 1.0
    for _ in range(exponent):
        result *= base
    return result


@kernel
def cubic(x):
    return power(x, 3) - 2.0 * power(x, 2) + power(x, 1)


if __name__ == "__main__":
    print([globals()[name](*numbers) for name, numbers in eval(sys.argv[1])], compiled)
    if "freezing" in sys.argv:
        print(gc.get_freeze_count() > 0)
"""


@pytest.fixture
def asked(tmp_path: Path):
    """Calls kernels of ROOM in a process of its own, all with the same cache: answers, and what it compiled."""
    file = tmp_path / "room.py"
    file.write_text(ROOM)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": os.getcwd()}

    def ask(*calls: tuple[str, tuple[float, ...]], also: tuple[str, ...] = ()) -> str:
        command = [sys.executable, file, str(calls), *also]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return ask


def test_a_kernel_that_another_calls_is_compiled_once_for_any_number_in_the_call(asked):
    assert asked(("cubic", (3.0,))) == "[12.0] ['cubic', 'power']"


def test_what_was_compiled_for_a_kernel_is_compiled_once_more_for_python(asked):
    assert asked(("cubic", (3.0,)), ("power", (2.0, 10))) == "[12.0, 1024.0] ['cubic', 'power', 'power']"


def test_both_forms_are_kept(asked):
    asked(("cubic", (3.0,)), ("power", (2.0, 10)))
    assert asked(("power", (2.0, 10)), ("cubic", (3.0,))) == "[1024.0, 12.0] []"


def test_what_is_kept_for_kernels_is_nothing_for_python_to_call(asked):
    asked(("cubic", (3.0,)))
    assert asked(("power", (2.0, 10))) == "[1024.0] ['power']"


def test_while_one_is_compiled_the_collector_leaves_alone_what_was_there_before(asked):
    told = asked(("cubic", (3.0,)), ("power", (2.0, 10)), also=("freezing",))
    assert told == "[12.0, 1024.0] ['cubic', True, 'power', True, 'power', True]\nFalse"


def test_what_a_program_has_frozen_stays_frozen(asked):
    assert asked(("cubic", (3.0,)), also=("freezing", "frozen")).endswith("\nTrue")
