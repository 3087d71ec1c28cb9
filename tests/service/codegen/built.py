"""A generated twin as a controller has it: compiled by gcc with every warning an error, called through ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from schemas.messages import TOPICS
from schemas.robot import Robot
from service.codegen.layout import layout_of
from service.codegen.twin import Twin, in_c, to_c
from service.estimator import state
from service.estimator.estimator import Estimator

COMPILER = shutil.which("gcc")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wcast-qual", "-pedantic", "-Werror", "-ffp-contract=off"]
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no gcc on this machine")
TOPICS_OUT = ("feedforward", "payload", "error")
LOOP = """
#include "{name}.h"
/* What a controller's cycles do, for logs; answers where a look back was due are counted. */
int64_t run(int64_t count, const {name}_sample *samples, {name}_feedforward *answers, {name}_payload *payloads,
            {name}_error *errors);
int64_t run(int64_t count, const {name}_sample *samples, {name}_feedforward *answers, {name}_payload *payloads,
            {name}_error *errors)
{{
    int64_t behind = 0;
    for (int64_t n = 0; n < count; n++) {{
        (void){name}_step(&samples[n], &answers[n]);
        if ({name}_look_back(&payloads[behind], &errors[behind]) == 0) {{
            behind++;
        }}
    }}
    return behind;
}}
"""


class Built:
    """A twin of `robot`, compiled in `folder`. library: of ctypes. dtypes: topic -> record as C has it."""

    def __init__(
        self,
        robot: Robot,
        period: float,
        folder: Path,
        optimised: str = "-O2",
        name: str = "deltatwin",
        single: bool = False,
    ) -> None:
        self.twin: Twin = to_c(robot, period, name, nominal=True, single=single)
        self.robot, self.period, self.name = robot, period, name
        self._real = ctypes.c_float if single else ctypes.c_double
        (folder / f"{name}.h").write_text(self.twin.header)
        (folder / f"{name}.c").write_text(self.twin.source)
        (folder / "loop.c").write_text(LOOP.format(name=name))
        path = folder / f"lib{name}.so"
        sources = [str(folder / f"{name}.c"), str(folder / "loop.c")]
        made = subprocess.run(
            [COMPILER or "gcc", optimised, *FLAGS, "-fPIC", "-shared", *sources, "-o", str(path), "-lm"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr[:3000]
        self.library = ctypes.CDLL(str(path))
        self.library.run.restype = ctypes.c_int64
        layout = layout_of(robot, state.settings(robot, period, 1))
        self.dtypes = {topic: in_c(layout, message.dtype, single) for topic, message in TOPICS.items()}

    def init(self, period: float | None = None) -> int:
        function = getattr(self.library, f"{self.name}_init")
        return function(self._real(self.period if period is None else period))

    def call(self, function: str, *records: np.ndarray) -> int:
        """A function of the twin with pointers to (1,) records."""
        return getattr(self.library, f"{self.name}_{function}")(*map(pointer, records))

    def samples(self, samples: np.ndarray) -> np.ndarray:
        """(N,) records of SAMPLE as C has them."""
        return converted(samples, self.dtypes["sample"])

    def run(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        """What it answers, topic -> (N,) and (M,) records."""
        answers, behind = self.loop(self.samples(samples))
        found = {topic: records if topic == "feedforward" else records[:behind] for topic, records in answers.items()}
        return found | {"friction": self.findings()[1]}

    def loop(self, given: np.ndarray) -> tuple[dict[str, np.ndarray], int]:
        """Answers to (N,) samples as C has them, topic -> (N,) records, and how many payloads and errors there are."""
        answers = {topic: np.zeros(len(given), self.dtypes[topic]) for topic in TOPICS_OUT}
        return answers, self.library.run(ctypes.c_int64(len(given)), *map(pointer, (given, *answers.values())))

    def findings(self) -> tuple[int, np.ndarray]:
        """Bits of health, or a code, and (1,) record of friction."""
        friction = np.zeros(1, self.dtypes["friction"])
        return self.call("findings", friction), friction


def converted(records: np.ndarray, dtype: np.dtype) -> np.ndarray:
    found = np.zeros(len(records), dtype)
    for name in dtype.names or ():
        found[name] = records[name]
    return found


def expected(built: Built, samples: np.ndarray) -> dict[str, np.ndarray]:
    """What the service answers, as C has it."""
    estimator = Estimator(built.robot, built.period)
    result = estimator.run(samples)._asdict()
    estimator.findings()
    result["friction"] = estimator.friction
    return {topic: converted(records, built.dtypes[topic]) for topic, records in result.items()}


def differences(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> list[str]:
    """What differs in a bit, in words: topic, field, first row, both values. NaN is like any NaN."""
    said = []
    for topic, records in wanted.items():
        if len(found[topic]) != len(records):
            said.append(f"{topic}: {len(found[topic])} records, not {len(records)}")
            continue
        for name in records.dtype.names or ():
            one, other = found[topic][name], records[name]
            wrong = (one != other) & ~((one != one) & (other != other))
            if wrong.any():
                row = int(np.argwhere(wrong)[0][0])
                said.append(
                    f"{topic}.{name}: {int(wrong.sum())} differ, first in row {row}: {one[row]}, not {other[row]}"
                )
    return said


def pointer(records: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(records.ctypes.data)
