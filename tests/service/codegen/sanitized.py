"""A generated twin under the sanitizers of gcc, as a program that reads samples from its standard input."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from schemas.messages import TOPICS
from schemas.robot import Robot
from service.codegen.layout import layout_of
from service.codegen.twin import in_c, to_c
from service.estimator import state
from tests.service.codegen.built import COMPILER, FLAGS

SANITIZERS = "-fsanitize=address,undefined,float-cast-overflow"
# A plan after every 97th sample: what the sample says, whatever that is.
PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#define CHECK(condition) do { if (!(condition)) { abort(); } } while (0)
#include "deltatwin.c"

int main(void)
{
    deltatwin_sample sample;
    deltatwin_feedforward answer;
    deltatwin_payload payload;
    deltatwin_error error;
    int64_t count = 0, wrong = 0;
    if (deltatwin_init(DELTATWIN_PERIOD) != DELTATWIN_OK) {
        return 2;
    }
    while (fread(&sample, sizeof sample, 1, stdin) == 1) {
        if (deltatwin_step(&sample, &answer) != DELTATWIN_OK) {
            wrong++;
            (void)deltatwin_init(DELTATWIN_PERIOD);
        }
        (void)deltatwin_look_back(&payload, &error);
        (void)fwrite(answer.torque, sizeof answer.torque, 1, stdout);
        count++;
        if (count % 97 == 0) {
            deltatwin_reference planned;
            memset(&planned, 0, sizeof planned);
            planned.sequence = sample.sequence + 1U;
            memcpy(planned.position, sample.torque, sizeof planned.position);
            memcpy(planned.velocity, sample.position_command, sizeof planned.velocity);
            (void)deltatwin_plan(&planned);
        }
    }
    (void)fprintf(stderr, "%lld answers no number\\n", (long long)wrong);
    return 0;
}
"""


class Sanitized:
    """A twin of `robot`, compiled in `folder`. optimised: for many samples."""

    def __init__(self, robot: Robot, period: float, folder: Path, optimised: str = "-O0") -> None:
        twin = to_c(robot, period, nominal=True)
        for name, text in (("deltatwin.h", twin.header), ("deltatwin.c", twin.source), ("main.c", PROGRAM)):
            (folder / name).write_text(text)
        self._program = folder / "main"
        sanitize = [SANITIZERS, "-fno-sanitize-recover=all", optimised]
        made = subprocess.run(
            [COMPILER or "gcc", *FLAGS, *sanitize, str(folder / "main.c"), "-o", str(self._program), "-lm"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr[:3000]
        self._dtype = in_c(layout_of(robot, state.settings(robot, period, 1)), TOPICS["sample"].dtype)

    def run(self, samples: np.ndarray) -> np.ndarray:
        """Torques (N, 3) N m of (N,) records of SAMPLE.

        Raises:
            AssertionError: a sanitizer found something, or an answer was no number.
        """
        given = np.zeros(len(samples), self._dtype)
        for name in self._dtype.names or ():
            given[name] = samples[name]
        ran = subprocess.run([self._program], input=given.tobytes(), capture_output=True, check=False)
        assert ran.returncode == 0, ran.stderr.decode()[-3000:]
        assert ran.stderr == b"0 answers no number\n", ran.stderr.decode()[-3000:]
        return np.frombuffer(ran.stdout).reshape(-1, 3)
