"""A function block compiled by STruC++ (github.com/Autonomy-Logic/STruCpp), for the bench: it has no package."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from schemas.messages import TOPICS
from schemas.robot import Robot
from service.codegen.layout import layout_of
from service.codegen.plc import to_st
from service.codegen.pou import Names
from service.codegen.twin import OUT, in_c
from service.estimator import state
from tests.service.codegen.built import converted
from tests.service.codegen.structured import fields_of


class Strucpp:
    """A program that reads samples and writes answers. compiler: folder of STruC++, built (`npm ci`, `npx tsc`)."""

    def __init__(self, robot: Robot, period: float, folder: Path, compiler: Path) -> None:
        layout = layout_of(robot, state.settings(robot, period, 1))
        self._dtypes = {topic: in_c(layout, message.dtype) for topic, message in TOPICS.items()}
        (folder / "block.st").write_text(to_st(robot, period, nominal=True).text)
        command = ["node", str(compiler / "dist" / "node" / "cli.js"), "block.st", "-o", "block.cpp"]
        subprocess.run([*command, "--no-line-mapping"], check=True, cwd=folder, capture_output=True)
        (folder / "main.cpp").write_text(self._main(period))
        sources = sorted(path.name for path in folder.glob("*.cpp"))
        flags = ["-O1", "-std=c++17", "-w", "-ffp-contract=off", "-I", str(compiler / "src" / "runtime" / "include")]
        subprocess.run(["g++", *flags, *sources, "-o", "main"], check=True, cwd=folder)
        self._program = folder / "main"

    def run(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        """What it answers: topic -> (N,) records, `code` and `has_payload` (N,)."""
        given = converted(samples, self._dtypes["sample"])
        ran = subprocess.run([self._program], input=given.tobytes(), capture_output=True, check=True)
        whole = np.dtype([("code", "i4"), ("has_payload", "i4"), *((topic, self._dtypes[topic]) for topic in OUT)])
        records = np.frombuffer(ran.stdout, whole)
        assert not records["code"].any()
        return {name: records[name] for name in records.dtype.names or ()}

    def _main(self, period: float) -> str:
        structs = [f"struct of_{topic} {{ {fields_of(self._dtypes[topic])} }};" for topic in ("sample", *OUT)]
        lines = [
            '#include "block.hpp"', "#include <cstdio>", "#include <cstdint>", "using namespace strucpp;", *structs,
            "int main() { static DELTATWIN it; of_sample sample; bool first = true;",
            "while (fread(&sample, sizeof sample, 1, stdin) == 1) {",
            f"it.INIT = first; first = false; it.PERIOD_S = {period!r};",
            "it.HAS_POSITION_COMMAND = true; it.HAS_TORQUE_COMMAND = true; it.ASK_FINDINGS = true;",
            *_copied(self._dtypes["sample"], "it.SAMPLE.{0} = sample.{1};"), "it();",
            "int32_t code = it.CODE, has = it.HAS_PAYLOAD; fwrite(&code, 4, 1, stdout); fwrite(&has, 4, 1, stdout);",
        ]  # fmt: skip
        for topic in OUT:
            lines += [f"{{ static of_{topic} made;"]
            lines += _copied(self._dtypes[topic], f"made.{{1}} = it.{Names()(topic).upper()}.{{0}};")
            lines += ["fwrite(&made, sizeof made, 1, stdout); }"]
        return "\n".join([*lines, "} return 0; }", ""])


def _copied(dtype: np.dtype, line: str) -> list[str]:
    lines, names = [], Names()
    for name in dtype.names or ():
        own, shape = names(name).upper(), dtype[name].shape
        if shape:
            lines.append(f"for (int k = 0; k < {shape[0]}; k++) {{ {line.format(f'{own}.at(k)', f'{name}[k]')} }}")
        else:
            lines.append(line.format(own, name))
    return lines
