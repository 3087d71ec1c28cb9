"""What the generator knows of Python, construct by construct: the C against the same kernel as Numba compiles it, and
what it does not know refused with file and line."""

# ruff: noqa: RET503  # what has a way through it without a value is refused

from __future__ import annotations

import ctypes
import importlib.util
import linecache
import math
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from schemas.kernels import kernel
from schemas.messages import PayloadEvent
from service.codegen.c import Writer, nested
from service.codegen.program import Layout, Program
from service.codegen.source import CodegenError
from service.codegen.types import Array, Record
from tests.service.codegen.built import COMPILER, FLAGS, needs_compiler

INNER = np.dtype([("values", "f8", (2, 3)), ("many", "i8")], align=True)
DATA = np.dtype(
    [
        ("x", "f8", 8), ("n", "i8", 8), ("u", "u8", 2), ("small", "u4", 2), ("signed", "i4", 2), ("inner", INNER, 3),
        ("real", "f8", 24), ("whole", "i8", 24), ("single", "f4", 4),
    ],
    align=True,
)  # fmt: skip
LAYOUT = Layout({INNER: "inner", DATA: "data"})
SHARE, THREE = 0.2, 3


class Pair(NamedTuple):
    row: np.ndarray
    factor: float


@kernel
def _rests(d):
    for i in range(8):
        by = 3 if i % 2 == 0 else -3
        d.whole[i] = d.n[i] % by
        d.whole[i + 8] = d.n[i] // by
    d.whole[16] = -7 % 3 + -7 // 3


@kernel
def _from_the_end(d):
    d.real[0] = d.x[-1]
    for i in range(3):
        d.real[1 + i] = d.x[d.n[0] - i]  # n[0] is 1
    d.inner[-1].values[1, 2] = d.x[1]
    head = 0
    d.real[5] = d.x[head - 1]


@kernel
def _extremes(d):
    d.real[0], d.real[1] = max(d.x[0], d.x[1]), max(d.x[1], d.x[0])  # one is no number
    d.real[2], d.real[3] = min(d.x[0], d.x[1]), min(d.x[1], d.x[0])
    d.real[4], d.real[5] = max(d.x[2], d.x[3]), min(d.x[2], d.x[3])  # 0.0 and -0.0
    d.real[6], d.real[7] = max(d.x[4], d.x[5], d.x[6]), min(d.n[0], d.x[4])
    d.whole[0] = max(d.n[0], d.n[1], 2)


@kernel
def _rounded(d):
    for i in range(8):
        d.whole[i] = round(d.x[i])
        d.whole[8 + i] = np.int64(d.x[i])
        d.whole[16 + i] = math.ceil(d.x[i]) if abs(d.x[i]) < 1e9 else -1


@kernel
def _powers(d):
    for i in range(8):
        d.real[i] = d.x[i] ** 2 + (d.x[i] * 1.1) ** 3
    d.real[8], d.real[9], d.real[10] = SHARE**-2, (SHARE + 1.0) ** 5, abs(d.x[4]) ** d.x[5]


@kernel
def _serial_numbers(d):
    d.whole[0] = np.int64(d.u[0] - d.u[1])
    d.whole[1] = np.int64(d.u[1] - d.u[0])
    d.u[0] = d.u[1]


@kernel
def _narrow(d):
    d.small[0] = d.n[7]  # a large one is cut
    d.whole[0] = d.small[1] - d.small[0]  # below zero
    d.whole[1] = d.signed[0] + d.signed[1]  # beyond 32 bits
    d.real[0] = d.signed[0] + d.small[1] * 1e-9
    d.small[1] |= 5
    d.whole[2] = ~d.small[1] & 0xFF ^ 3


@kernel
def _in_single_precision(d):
    d.single[0] = d.x[5] * 1e-3  # rounded as it is stored
    d.single[1] += d.x[5]
    d.single[1] *= 0.1
    d.real[0] = np.float64(d.single[0]) * d.x[5] + np.float64(d.single[1])
    d.single[2:] = 1.0
    d.single[3] = np.float64(d.single[3]) / 3.0 if d.n[0] == 1 else 0.0


@kernel
def _decided_beforehand(d):
    if THREE == 3 and d.n[0] > 0 and not THREE < 1:
        d.whole[0] = 1 if THREE > 2 else 7
    if THREE == 2 or d.n[1] == 0:
        d.whole[1] = 1
    if THREE == 2:
        d.whole[2] = 1
    elif THREE == 3 or d.n[1] == 0:
        d.whole[3] = 1
    d.real[0] = 1.0 if THREE >= 3 else d.n[1]


@kernel
def _both(d):
    return d.x[4], d.x[5]


@kernel
def _chosen(d):
    for k in range(2):
        x, y = (d.x[4], d.x[5]) if k == 0 else (-d.x[5], d.x[4])
        d.real[2 * k], d.real[2 * k + 1] = x, y
    a, b = d.x[4], d.x[5]
    a, b = b, a + b
    one, other = _both(d) if d.n[0] > 0 else (0.0, 1.0)
    d.real[6], d.real[7] = one, other
    d.real[4], d.real[5] = a, b
    event = (PayloadEvent.PICK if a > b else PayloadEvent.RELEASE).value
    d.whole[0] = event
    d.whole[1] = 1 if 0 < d.n[0] <= 1 and not d.n[1] == d.n[0] else 0  # noqa: SIM201
    d.whole[2] |= d.x[4] != d.x[5]
    found = False
    for i in range(8):
        found |= d.n[i] > 100
    d.whole[3] = found
    d.whole[4] = len(d.x) + len(d.inner)


@kernel
def _loops(d):
    total = 0
    for i in range(7, -1, -2):
        if d.n[i] > 1000:
            continue
        total = total * 3 + i
    d.whole[0] = total
    count = d.n[0]
    for k in range(count, count + 3):
        count += 10  # the loop's end is not moved
        d.whole[k] += k
    for k in range(8):
        if d.x[k] > 1.0:
            break
        d.whole[8] = k
    mixed = 0
    for k in range(3):
        mixed += 0.5 * k
    d.real[0] = mixed


@kernel
def _inside(pair, inner):
    for i in range(3):
        inner.values[1, i] = pair.factor * pair.row[i]
    return pair.factor, inner.many


@kernel
def _views(d):
    row, block = d.inner[1].values[0], d.inner[2]
    row[1] = 4.0
    if d.n[0] > 0:
        row = d.inner[0].values[1]
    row[2] = 5.0
    block.values[:, 1:] = 7.0
    block.values[0] = 2.0
    pair = Pair(row=block.values[0], factor=d.x[4])
    factor, many = _inside(pair, d.inner[1])
    d.real[0], d.whole[0] = factor, many
    other = Pair(row, 2.0)
    d.real[1] = _inside(other, block)[0]
    passed = (1.0, d.x[4], d.x[4] * d.x[5])
    for i in range(3):
        d.real[2 + i] = passed[i]
    d.real[8] = d.real[9] = d.x[4] * d.x[5]


@kernel
def _functions(d):
    x = d.x[4]
    d.real[0], d.real[1], d.real[2] = math.sin(x), math.cos(x), math.tanh(x)
    d.real[3], d.real[4], d.real[5] = math.exp(-x), math.hypot(x, d.x[5]), math.sqrt(abs(x))
    d.real[6], d.real[7] = np.sqrt(abs(x)), np.copysign(x, -1.0)
    d.whole[0] = math.isfinite(d.x[0])
    d.whole[1] = math.isnan(d.x[0])
    d.real[8] = -math.inf if d.n[0] == 1 else math.nan


KNOWN = [
    _rests, _from_the_end, _extremes, _rounded, _powers, _serial_numbers, _narrow, _chosen, _loops, _views, _functions,
    _in_single_precision, _decided_beforehand,
]  # fmt: skip


def data() -> np.ndarray:
    made = np.zeros(1, DATA)
    made["x"] = [np.nan, 1.0, 0.0, -0.0, 2.5, 0.7, -3.5, 1e300]
    made["n"] = [1, 2, -5, 7, -9, 4, 0, 2**40 + 3]
    made["u"], made["small"], made["signed"] = [3, 2**64 - 2], [1, 4_000_000_000], [2**31 - 1, 2**31 - 5]
    made["inner"]["many"] = [[4, 5, 6]]
    return made


@needs_compiler
@pytest.mark.parametrize("function", KNOWN, ids=lambda function: function.py_func.__name__)
def test_c_does_what_numba_does(tmp_path: Path, function) -> None:
    wanted, found = data(), data()
    if function is _rounded:  # beyond int64 neither says what comes
        wanted["x"][0, 7] = found["x"][0, 7] = 1e9
        wanted["x"][0, 0] = found["x"][0, 0] = 0.5
    _in_c(tmp_path, function)(ctypes.c_void_p(found.ctypes.data))
    function(wanted[0])
    for name in DATA.names or ():
        np.testing.assert_array_equal(found[name], wanted[name], name)
    assert found.tobytes() != data().tobytes(), "it does something"


def _in_c(folder: Path, function):
    program, writer = Program(LAYOUT), Writer(LAYOUT, "t")
    root = program.function(function, (Record(DATA),))
    functions = [line for one in program.functions for line in writer.function(one)]
    head = ["#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>", "#define CHECK(x) ((void)0)"]
    head.append("#define UNROLLED")
    call = ["void go(t_data *d);", "void go(t_data *d)", "{", f"    {root.name}(d);", "}", ""]
    lines = [*head, *writer.records(nested(DATA)), *writer.bundles(program), *writer.used_helpers(), *functions, *call]
    (folder / "k.c").write_text("\n".join(lines))
    made = subprocess.run(
        [COMPILER or "gcc", "-O1", *FLAGS, "-fPIC", "-shared", str(folder / "k.c"), "-o", str(folder / "k.so"), "-lm"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return ctypes.CDLL(str(folder / "k.so")).go


@kernel
def _raised(row):
    row[0] += 1.0


@kernel
def _read_alone(row, inner):
    part = inner.values
    first = part[0]
    return row[0] + first[1]


@kernel
def _stored_behind_names(inner, other):
    one = inner.values
    first = one[1]
    _raised(first)
    two = other.values if inner.many > 0 else inner.values
    return two[0, 0]


@kernel
def _many_ways(d):
    d.real[0] = _read_alone(d.x, d.inner[0])
    d.real[1] = _stored_behind_names(d.inner[1], d.inner[2])
    pair = Pair(d.inner[0].values[0], 2.0)
    d.real[2] = _inside(pair, d.inner[1])[0]


@needs_compiler
def test_what_is_read_alone_is_constant_in_c(tmp_path: Path) -> None:
    program = Program(LAYOUT)
    program.function(_many_ways, (Record(DATA),))
    made = {one.name.removeprefix("test_constructs_"): one for one in program.functions}
    assert {name: one.writes & {given for given, _ in one.parameters} for name, one in made.items()} == {
        "read_alone": set(), "raised": {"row"}, "stored_behind_names": {"inner", "other"}, "inside": {"inner"},
        "many_ways": {"d"},
    }  # fmt: skip
    writer = Writer(LAYOUT, "t")
    said = {name: writer.signature(one) for name, one in made.items()}
    assert "(const double *row, const t_inner *inner)" in said["read_alone"]
    assert "(const t_pair *pair, t_inner *inner)" in said["inside"]
    assert "(double *row)" in said["raised"]
    wanted, found = data(), data()
    _in_c(tmp_path, _many_ways)(ctypes.c_void_p(found.ctypes.data))
    _many_ways(wanted[0])
    assert found.tobytes() == wanted.tobytes()


@kernel
def _while(d):
    while d.n[0] > 0:
        d.n[0] -= 1


@kernel
def _list(d):
    values = [1.0, 2.0]
    d.x[0] = values[0]


@kernel
def _unknown_function(d):
    d.x[0] = math.gamma(d.x[1])


@kernel
def _signed_with_unsigned(d):
    d.x[0] = d.u[0] - d.n[0]


@kernel
def _beyond(d):
    d.x[0] = d.x[8]


@kernel
def _no_field(d):
    d.x[0] = d.nothing


@kernel
def _two_types(d):
    a = d.x
    a = 1.0
    d.x[0] = a


@kernel
def _behind_its_loop(d):
    for i in range(3):
        d.x[i] = 0.0
    d.x[i] = 1.0  # pyright: ignore[reportPossiblyUnboundVariable]


@kernel
def _calls_itself(d):
    _calls_itself(d)


@kernel
def _real_into_whole(d):
    d.n[0] = d.x[0]


@kernel
def _slice_to(d):
    d.x[:2] = 0.0


@kernel
def _allocates(d):
    d.x[0] = np.zeros(3)[0]


@kernel
def _rest_of_reals(d):
    d.x[0] = d.x[1] % 2.0


@kernel
def _one_way_without_value(d):
    if d.x[0] > 0.0:
        return 1.0


@kernel
def _single_counted_with(d):
    d.x[0] = d.single[0] * 2.0


@kernel
def _single_with_whole(d):
    d.single[0] += d.n[0]


@kernel
def _single_kept(d):
    x = d.single[0]
    d.x[0] = x


@kernel
def _made_inside_a_call(d):
    d.x[0] = _inside(Pair(d.inner[0].values[0], 2.0), d.inner[1])[0]


REFUSED = [
    _while, _list, _unknown_function, _signed_with_unsigned, _beyond, _no_field, _two_types, _behind_its_loop,
    _calls_itself, _real_into_whole, _slice_to, _allocates, _rest_of_reals, _one_way_without_value, _made_inside_a_call,
    _single_counted_with, _single_with_whole, _single_kept,
]  # fmt: skip


@pytest.mark.parametrize("function", REFUSED, ids=lambda function: function.py_func.__name__)
def test_what_is_not_known_is_refused_with_file_and_line(function) -> None:
    with pytest.raises(CodegenError) as told:
        Program(LAYOUT).function(function, (Record(DATA),))
    first = function.py_func.__code__.co_firstlineno
    if function is _calls_itself:
        assert "calls itself" in str(told.value)
        return
    file, line = str(told.value).split(":")[:2]
    assert Path(file) == Path(__file__)
    assert first <= int(line) <= first + 4
    assert function.py_func.__name__ in str(told.value)


def test_a_kernel_is_made_once_for_each_shape_of_its_arguments() -> None:
    program = Program(LAYOUT)
    one = program.function(_loops, (Record(DATA),))
    assert program.function(_loops, (Record(DATA),)) is one
    assert Array("f8", (2, 3)).item == Array("f8", (3,))


def test_a_file_that_was_changed_since_it_was_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "changing.py"
    path.write_text("from schemas.kernels import kernel\n\n\n@kernel\ndef double(d):\n    d.x[0] = 2.0 * d.x[1]\n")
    spec = importlib.util.spec_from_file_location("changing", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert Program(LAYOUT).function(module.double, (Record(DATA),)).body
    path.write_text(path.read_text().replace("2.0", "3.0"))
    linecache.checkcache(str(path))
    with pytest.raises(CodegenError, match=r"changing\.py:4: double: the file has changed"):
        Program(LAYOUT).function(module.double, (Record(DATA),))
