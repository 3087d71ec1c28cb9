"""The FMU's library for Windows, run by a Windows program under Wine. For the bench: neither is on every machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from schemas.robot import Robot
from service.codegen.fmu import TARGETS, write_fmu
from tests.known import PERIOD
from tests.service.codegen.test_fmu import joints

MINGW, FOLDERS, _, _ = TARGETS[1]
WINE = shutil.which("wine")
HAS_WINE = WINE is not None and shutil.which(MINGW) is not None
HOST = """
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <fcntl.h>
#include <io.h>
#include <windows.h>

typedef void *(*make_2)(const char *, int, const char *, const char *, const void *, int, int);
typedef void *(*make_3)(const char *, const char *, const char *, int, int, int, int, const uint32_t *, size_t, void *,
                        void *, void *);
typedef int (*setup_2)(void *, int, double, double, int, double);
typedef int (*of_one)(void *);
typedef int (*reals_2)(void *, const uint32_t *, size_t, double *);
typedef int (*reals_3)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*wholes_2)(void *, const uint32_t *, size_t, int32_t *);
typedef int (*wholes_3)(void *, const uint32_t *, size_t, int32_t *, size_t);
typedef int (*step_2)(void *, double, double, int);
typedef int (*step_3)(void *, double, double, int, int *, int *, int *, double *);

static HMODULE library;

static void *found(const char *name)
{
    void *place = (void *)GetProcAddress(library, name);
    if (place == 0) { exit(3); }
    return place;
}

static void well(int status)
{
    if (status != 0) { exit(4); }
}

/* host.exe LIBRARY PERIOD, then of its inputs and outputs the references */
int main(int count, char **given)
{
    const int inputs = 10, wholes = 2, outputs = 4;
    const double period = atof(given[2]);
    uint32_t references[16];
    double values[10], answers[4];
    int32_t whole[2];
    void *unit;
    for (int n = 0; n < inputs + wholes + outputs; n++) { references[n] = (uint32_t)atoi(given[3 + n]); }
    library = LoadLibraryA(given[1]);
    if (library == 0 || count != 19) { return 2; }
    (void)_setmode(_fileno(stdin), _O_BINARY);
    (void)_setmode(_fileno(stdout), _O_BINARY);
#if FMI == 3
    unit = ((make_3)found("fmi3InstantiateCoSimulation"))("twin", "TOKEN", "", 0, 0, 0, 0, 0, 0, 0, 0, 0);
    if (unit == 0) { return 5; }
    well(((setup_2)found("fmi3EnterInitializationMode"))(unit, 0, 0.0, 0.0, 0, 0.0));
    well(((of_one)found("fmi3ExitInitializationMode"))(unit));
#else
    unit = ((make_2)found("fmi2Instantiate"))("twin", 1, "TOKEN", "", 0, 0, 0);
    if (unit == 0) { return 5; }
    well(((setup_2)found("fmi2SetupExperiment"))(unit, 0, 0.0, 0.0, 0, 0.0));
    well(((of_one)found("fmi2EnterInitializationMode"))(unit));
    well(((of_one)found("fmi2ExitInitializationMode"))(unit));
#endif
    for (int64_t k = 0; fread(values, sizeof values, 1, stdin) == 1 && fread(whole, sizeof whole, 1, stdin) == 1; k++) {
#if FMI == 3
        int event, ends, early;
        double last;
        well(((reals_3)found("fmi3SetFloat64"))(unit, references, 10, values, 10));
        well(((wholes_3)found("fmi3SetInt32"))(unit, references + inputs, 2, whole, 2));
        well(((step_3)found("fmi3DoStep"))(unit, (double)k * period, period, 1, &event, &ends, &early, &last));
        well(((reals_3)found("fmi3GetFloat64"))(unit, references + inputs + wholes, 4, answers, 4));
#else
        well(((reals_2)found("fmi2SetReal"))(unit, references, 10, values));
        well(((wholes_2)found("fmi2SetInteger"))(unit, references + inputs, 2, whole));
        well(((step_2)found("fmi2DoStep"))(unit, (double)k * period, period, 1));
        well(((reals_2)found("fmi2GetReal"))(unit, references + inputs + wholes, 4, answers));
#endif
        (void)fwrite(answers, sizeof answers, 1, stdout);
    }
    return 0;
}
"""


def under_wine(robot: Robot, samples: np.ndarray, fmi: Any, folder: Path, prefix: Path) -> np.ndarray:
    """(N, 4): feed-forward torques N m and mass kg. prefix: of Wine, made where it is not there."""
    write_fmu(robot, PERIOD, fmi, folder / "t.fmu", "deltatwin")
    with zipfile.ZipFile(folder / "t.fmu") as archive:
        (folder / "deltatwin.dll").write_bytes(archive.read(f"binaries/{FOLDERS[fmi]}/deltatwin.dll"))
    read: Any = fmpy.read_model_description(str(folder / "t.fmu"))
    places = {one.name: one.valueReference for one in read.modelVariables}
    (folder / "host.c").write_text(HOST.replace("TOKEN", read.guid))
    subprocess.run([MINGW, "-O1", f"-DFMI={fmi}", "host.c", "-o", "host.exe"], check=True, cwd=folder)
    reals, wholes = ("position", "torque", "position_command"), ("gripper", "flags")
    fields = [*((name, "f8", 3) for name in reals), ("fourth_position", "f8"), *((name, "i4") for name in wholes)]
    given = np.zeros(len(samples), fields)
    for name in given.dtype.names or ():
        given[name] = samples[name]
    inputs = [*(one for name in reals for one in joints(name)), "fourth_position", *wholes]
    references = [str(places[name]) for name in (*inputs, *joints("feedforward"), "mass")]
    told = subprocess.run(
        [WINE or "", "host.exe", "deltatwin.dll", repr(PERIOD), *references],
        input=given.tobytes(), capture_output=True, check=True, cwd=folder,
        env=os.environ | {"WINEPREFIX": str(prefix), "WINEDEBUG": "-all"},
    ).stdout  # fmt: skip
    return np.frombuffer(told).reshape(len(samples), 4)
