"""The loop that the page on controllers shows is C that compiles, and no more lines than it promises."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from service.codegen.twin import to_c
from tests.conftest import REPOSITORY
from tests.known import PERIOD, robot
from tests.service.codegen.built import COMPILER, FLAGS, needs_compiler

__all__ = ["robot"]
PAGE = REPOSITORY / "docs" / "how-to" / "controller.md"
ROUND_IT = """
#include "deltatwin.h"
int wait_for_cycle(void);
void read_drives(deltatwin_sample *sample);
void write_torque_offset(const double *torque);
int main(void)
{{
{loop}
return 0;
}}
"""


@needs_compiler
def test_the_loop_compiles_without_a_warning(robot, tmp_path: Path) -> None:
    loop = re.search(r"## In a C loop\n\n```c\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert loop is not None
    lines = [line for line in loop[1].splitlines() if line.strip(" }")]
    assert len(lines) <= 10
    twin = to_c(robot, PERIOD)
    (tmp_path / "deltatwin.h").write_text(twin.header)
    (tmp_path / "loop.c").write_text(ROUND_IT.format(loop=loop[1]))
    command = [COMPILER or "gcc", *FLAGS, "-c", str(tmp_path / "loop.c"), "-o", str(tmp_path / "loop.o")]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr


def test_every_code_is_in_the_page(robot) -> None:
    page, header = PAGE.read_text(encoding="utf-8"), to_c(robot, PERIOD).header
    codes = set(re.findall(r"#define DELTATWIN_(\w+) \(-\d\)", header))
    assert codes == set(re.findall(r"^\| `([A-Z_]+)` \|", page, re.MULTILINE))
