"""The loops that the page on controllers shows compile or parse, and are no more lines than it promises."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
import tree_sitter
import tree_sitter_iec61131_3_st

from service.codegen.plc import to_st
from service.codegen.twin import to_c
from tests.conftest import REPOSITORY
from tests.known import PERIOD, robot
from tests.service.codegen.built import COMPILER, FLAGS, needs_compiler

__all__ = ["robot"]
PAGE = REPOSITORY / "docs" / "how-to" / "controller.md"
# As SOEM's and the IgH master's headers declare what is called.
ROUND_IT = """
#include "deltatwin.h"
#define EC_TIMEOUTRET 2000
int ec_send_processdata(void);
int ec_receive_processdata(int timeout);
typedef struct ec_master ec_master_t;
typedef struct ec_domain ec_domain_t;
void ecrt_master_receive(ec_master_t *master);
void ecrt_master_send(ec_master_t *master);
void ecrt_domain_process(ec_domain_t *domain);
void ecrt_domain_queue(ec_domain_t *domain);
extern int expected_wkc;
extern ec_master_t *master;
extern ec_domain_t *domain;
int wait_for_cycle(void);
void read_drives(deltatwin_sample *sample);
void write_torque_offset(const double *torque);
int main(void)
{{
{loop}
return 0;
}}
"""


def block(heading: str, language: str, number: int = 0) -> str:
    """A block of code below a heading."""
    part = PAGE.read_text(encoding="utf-8").split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    return re.findall(rf"```{language}\n(.*?)```", part, re.DOTALL)[number]


CYCLES = 50
CALLED = f"""
int wait_for_cycle(void) {{ static int count = 0; return count++ < {CYCLES}; }}
void read_drives(deltatwin_sample *sample)
{{
    sample->stamp_nanosec = (uint32_t)sample->sequence * 1000000U;
    for (int i = 0; i < 3; i++) {{
        sample->position[i] = sample->position_command[i] = 0.5;
        sample->torque[i] = 10.0;
    }}
}}
void write_torque_offset(const double *torque) {{ printf("%g\\n", torque[0]); }}
"""
GIVEN = """static deltatwin_sample sample;
static deltatwin_feedforward answer;
static deltatwin_payload payload;
static deltatwin_error error;
(void)payload;
(void)error;
"""
LOOPS = {
    "plain": ("In a C loop", 0, ""),
    "SOEM": ("SOEM and the IgH EtherCAT master", 0, GIVEN),
    "IgH": ("SOEM and the IgH EtherCAT master", 1, GIVEN),
}  # fmt: skip


@needs_compiler
@pytest.mark.parametrize("name", LOOPS)
def test_the_loop_compiles_without_a_warning(robot, tmp_path: Path, name: str) -> None:
    heading, number, before = LOOPS[name]
    loop = block(heading, "c", number)
    lines = [line for line in loop.splitlines() if line.strip(" }")]
    assert len(lines) <= 10
    twin = to_c(robot, PERIOD)
    (tmp_path / "deltatwin.h").write_text(twin.header)
    (tmp_path / "loop.c").write_text(ROUND_IT.format(loop=f"{before}\n{loop}"))
    command = [COMPILER or "gcc", *FLAGS, "-c", str(tmp_path / "loop.c"), "-o", str(tmp_path / "loop.o")]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr


@needs_compiler
def test_the_command_of_the_page_makes_a_program_that_answers(robot, tmp_path: Path) -> None:
    twin, loop = to_c(robot, PERIOD), block("In a C loop", "c")
    (tmp_path / "twin").mkdir()
    (tmp_path / "twin" / "deltatwin.h").write_text(twin.header)
    (tmp_path / "twin" / "deltatwin.c").write_text(twin.source)
    (tmp_path / "loop.c").write_text("#include <stdio.h>\n" + ROUND_IT.format(loop=loop) + CALLED)
    part = PAGE.read_text(encoding="utf-8").split("## In a C loop\n", 1)[1]
    command = re.search(r"^    (gcc .*)$", part, re.MULTILINE)
    assert command is not None
    made = subprocess.run(shlex.split(command[1]), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    told = subprocess.run(["./loop"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split()
    assert len(told) == CYCLES
    assert float(told[-1]) != 0.0


def test_the_call_in_structured_text_is_one_and_names_what_the_block_has(robot) -> None:
    text = block("Structured Text", "text")
    tree = tree_sitter.Parser(tree_sitter.Language(tree_sitter_iec61131_3_st.language())).parse(text.encode())
    assert not tree.root_node.has_error
    made = to_st(robot, PERIOD)
    members = {member.name for one in made.types for member in one.members}
    given = {one.name for _, variables in made.pous[-1].sections for one in variables}
    assert set(re.findall(r"twin\.([a-z_]+)", text)) <= given
    assert set(re.findall(r"([a-z_]+) :=", text.split("twin(", 1)[1].split(")", 1)[0])) <= given
    assert set(re.findall(r"twin\.[a-z_]+\.([a-z_]+)", text)) <= members


def test_every_code_is_in_the_page(robot) -> None:
    page, header = PAGE.read_text(encoding="utf-8"), to_c(robot, PERIOD).header
    codes = set(re.findall(r"#define DELTATWIN_(\w+) \(-\d\)", header))
    assert codes == set(re.findall(r"^\| `([A-Z_]+)` \|", page, re.MULTILINE))
