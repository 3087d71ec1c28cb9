"""The generator types every variable of every kernel as Numba does."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numba
from numba.core import compiler, types
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.ssa import reconstruct_ssa
from numba.core.typed_passes import type_inference_stage

from service.codegen.layout import layout_of
from service.codegen.program import Program
from service.codegen.tree import Function
from service.codegen.twin import ROOTS
from service.codegen.types import Array, Record, Scalar
from service.estimator import state
from tests.known import PERIOD, robot

__all__ = ["robot"]


def as_numba_has_it(
    kernel: CPUDispatcher, arguments: tuple[types.Type, ...]
) -> tuple[dict[str, list[types.Type]], set[Any]]:
    """Types of the variables of a kernel, and the kernels that it calls with the types of their arguments."""
    text = reconstruct_ssa(compiler.run_frontend(kernel.py_func))
    contexts = cpu_target.typing_context, cpu_target.target_context
    contexts[0].refresh()  # pyright: ignore[reportAttributeAccessIssue]
    found = type_inference_stage(*contexts, text, arguments, None)
    called = set()
    for block in text.blocks.values():
        for expression in block.find_exprs(op="call"):
            function = found.typemap[expression.func.name]
            if isinstance(function, types.Dispatcher):
                called.add((function.dispatcher, found.calltypes[expression].args))
    versions = defaultdict(list)  # of a variable, for each time that it is set
    for name, kind in found.typemap.items():
        if name.partition(".")[0].isidentifier():
            versions[name.partition(".")[0]].append(kind)
    return versions, called


def kind_of(one: types.Type) -> str:
    if isinstance(one, types.Boolean | types.BooleanLiteral):
        return "bool"
    if isinstance(one, types.IntegerLiteral):
        return "int64"
    if isinstance(one, types.Integer):
        return "uint64" if one is types.uint64 else "int64"
    if isinstance(one, types.Float):
        return "float64" if one.bitwidth == 64 else "float32"
    return "record" if isinstance(one, types.Record) else "array" if isinstance(one, types.Array) else "other"


def kinds(function: Function) -> dict[str, str]:
    found = {}
    for name, one in {**dict(function.parameters), **function.variables}.items():
        if isinstance(one, Scalar):
            found[name] = one.value
        else:
            found[name] = "record" if isinstance(one, Record) else "array" if isinstance(one, Array) else "other"
    return found


def is_alike(mine: str, theirs: list[types.Type]) -> bool:
    """A whole constant may begin what is a real later."""
    begins = mine == "float64" and any(isinstance(one, types.Float) for one in theirs)
    return all(kind_of(one) == mine or (begins and isinstance(one, types.IntegerLiteral)) for one in theirs)


def test_every_variable_has_the_type_that_numba_infers(robot) -> None:
    settings = state.settings(robot, PERIOD, 1)
    program = Program(layout_of(robot, settings))
    step = numba.typeof(state.fresh(settings))
    for root in ROOTS.values():
        program.function(root, (Array(Record(state.STEP), (1,)),))
    mine = defaultdict(list)
    for function in program.functions:
        mine[program.sources[function.name][0]].append(kinds(function))
    waiting, seen, compared, wrong = [(root, (step,)) for root in ROOTS.values()], set(), 0, []
    while waiting:
        kernel, arguments = waiting.pop()
        if (kernel, arguments) in seen:
            continue
        seen.add((kernel, arguments))
        theirs, called = as_numba_has_it(kernel, arguments)
        waiting += called
        misses = [
            [
                f"{name}: {one[name]}, not {theirs[name]}"
                for name in one
                if not is_alike(one[name], theirs.get(name, []))
            ]
            for one in mine[kernel]
        ]
        compared += len(theirs)
        if not any(miss == [] for miss in misses):
            wrong.append(f"{kernel.py_func.__module__}.{kernel.py_func.__name__}: {misses}")
    assert wrong == []
    assert {kernel for kernel, _ in seen} == set(mine), "the same kernels are reached"
    assert compared > 1000
