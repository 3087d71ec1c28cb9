"""What a kernel must not do with memory of its own."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("schemas", "drivers", "replay", "service")


def borrowed(source: str) -> list[int]:
    """Lines of kernels that take a record out of an array that nothing keeps."""
    found = []
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef) and any(_is_kernel(one) for one in function.decorator_list):
            found += [
                node.lineno
                for node in ast.walk(function)
                if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Call)
                and isinstance(node.value.func, ast.Attribute) and node.value.func.attr in ("zeros", "empty", "ones")
            ]  # fmt: skip
    return found


def _is_kernel(decorator: ast.expr) -> bool:
    called = decorator.func if isinstance(decorator, ast.Call) else decorator
    return isinstance(called, ast.Name) and called.id in ("kernel", "part")


def test_no_kernel_takes_a_record_out_of_an_array_that_nothing_keeps():
    """Numba frees the array after its last use, and the record is memory of whoever asks for some next."""
    paths = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    assert {str(path): lines for path in paths if (lines := borrowed(path.read_text(encoding="utf-8")))} == {}


def test_such_a_record_is_found():
    assert borrowed("@kernel(nogil=True)\ndef one(n):\n    s = np.zeros(1, STATE)[0]\n") == [3]
    assert borrowed("@kernel\ndef one(n):\n    s = np.zeros(1, STATE)\n    t = s[0]\n") == []
