"""The exported C beside the service's compiled step: time, instructions, bytes, loops; random robots bit for bit; ten
million hostile samples under the sanitizers; single precision; Structured Text by a compiler, where there is one.

uv run python -m tests.bench.bench_export [--robots 100] [--hostile 10000000] [--steps 10000000] [--seed 1]
    [--strucpp FOLDER, of STruC++, built] --store
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.validation import validate_fmu

from docs.making.figures import store
from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD
from schemas.robot import Robot, load_robot
from service.codegen.fmu import write_fmu
from service.codegen.tree import For
from service.codegen.twin import lowered, to_c
from service.estimator import state
from service.estimator.estimator import Estimator
from service.estimator.step import run_kernel
from service.model.effects import CATALOGUE
from tests.bench.need import need
from tests.conftest import DATA
from tests.service.codegen.built import COMPILER, FLAGS, Built, differences, expected
from tests.service.codegen.disturbed import disturbed
from tests.service.codegen.on_windows import HAS_WINE, under_wine
from tests.service.codegen.sanitized import Sanitized
from tests.service.codegen.strucpp import Strucpp
from tests.service.codegen.test_fmu import in_fmpy, recorded
from tests.service.codegen.test_hostile import FOURTH_AXIS, streams, turned
from tests.service.codegen.test_memory import AXES, PERIODS, ROBOTS, bytes_of, laden
from tests.service.codegen.test_twin import GROUPS, stored, with_effects
from tests.service.estimator.test_named_effects import FOUND, effect

PERIOD = 1e-3
BLOCK, TURNS = 1000, 40  # steps of the one, then of the other
COUNTED = 2000  # steps
PART = 250_000  # hostile samples in memory at once
# Time of each step over a log again and again, in a histogram of ns.
TIMED = """
#include <stdio.h>
#include <stdlib.h>
#include <sched.h>
#include <sys/mman.h>
#include <time.h>
#include "deltatwin.c"

#define MOST 1000000
#define PAUSE 100000
#define WARMING 2000

static int64_t now(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static int64_t cycles(void)
{
#ifdef __x86_64__
    return (int64_t)__builtin_ia32_rdtsc();
#else
    return now();
#endif
}

/* Whether nothing of this system that is no interrupt takes the processor: by a real-time priority, on one of them. */
static bool alone(void)
{
    const struct sched_param first = {.sched_priority = 80};
    cpu_set_t last;
    CPU_ZERO(&last);
    CPU_SET(sched_getcpu(), &last);
    return (sched_setaffinity(0, sizeof last, &last) == 0) && (mlockall(MCL_CURRENT) == 0) &&
           (sched_setscheduler(0, SCHED_FIFO, &first) == 0);
}

int main(int argc, char **argv)
{
    static deltatwin_sample samples[20000];
    static int64_t taken[MOST + 1];
    int64_t worst = 0, begun = now(), ticks = cycles();
    deltatwin_feedforward answer;
    deltatwin_payload payload;
    deltatwin_error error;
    int64_t steps = (argc > 1) ? atoll(argv[1]) : 0, count = (int64_t)fread(samples, sizeof samples[0], 20000, stdin);
    uint64_t sequence = 0;
    const bool is_alone = (argc > 2) && alone();
    (void)deltatwin_init(DELTATWIN_PERIOD);
    for (int64_t n = 0; n < steps; n++) {
        deltatwin_sample sample = samples[n % count];
        sample.sequence = sequence++;
        sample.stamp_sec = (int32_t)(n / 1000);
        sample.stamp_nanosec = (uint32_t)(n % 1000) * 1000000U;
        const int64_t begin = cycles();
        (void)deltatwin_step(&sample, &answer);
        (void)deltatwin_look_back(&payload, &error);
        const int64_t took = cycles() - begin;
        if (is_alone && (n % PAUSE == 0)) { /* the system stops what never rests; the next steps warm the cache */
            const struct timespec rest = {.tv_nsec = 30000000};
            (void)nanosleep(&rest, 0);
        }
        worst = ((n >= count) && (n % PAUSE > WARMING) && (took > worst)) ? took : worst;
        taken[(took < MOST) ? took : MOST]++;
    }
    const double rate = (double)(cycles() - ticks) / (double)(now() - begun);
    int64_t seen = 0, median = -1, rare = -1, rarer = -1, rarest = -1;
    for (int64_t n = 0; n <= MOST; n++) {
        seen += taken[n];
        median = ((median < 0) && (2 * seen >= steps)) ? n : median;
        rare = ((rare < 0) && (100 * (steps - seen) <= steps)) ? n : rare;
        rarer = ((rarer < 0) && (1000 * (steps - seen) <= steps)) ? n : rarer;
        rarest = ((rarest < 0) && (100000 * (steps - seen) <= steps)) ? n : rarest;
    }
    (void)printf("%lld %lld %lld %lld %lld %d %f\\n", (long long)median, (long long)rare, (long long)rarer,
                 (long long)rarest, (long long)worst, (int)is_alone, rate);
    return 0;
}
"""


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--robots", type=int, default=100)
    arguments.add_argument("--hostile", type=int, default=10_000_000)
    arguments.add_argument("--steps", type=int, default=10_000_000)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--strucpp", type=Path, help="folder of STruC++, built: Structured Text is compiled by it")
    arguments.add_argument("--store", action="store_true", help="put the figures into results/export.json")
    given = arguments.parse_args()
    need("gcc", "valgrind")
    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        built = Built(robot, PERIOD, folder)
        result: dict[str, Any] = {}
        (fast := folder / "fast").mkdir()
        sides = {"-O2": side_by_side(built, samples), "-O3": side_by_side(Built(robot, PERIOD, fast, "-O3"), samples)}
        result |= {"kernel": sides}
        result |= timed(built, samples, folder, given.steps) | sizes(folder)
        result |= {
            "fourth_axis_bytes": fourth_axis(robot),
            "most_bytes": most_bytes(),
            "loops": loops(robot),
            "single": single(robot, samples, folder),
        }
        result["clang_tidy"] = tidied(folder)
        tell(result, given.store)
        if given.strucpp:
            result["structured_text"] = structured_text(robot, samples, given.strucpp, folder)
            tell(result, given.store)
        result["fmu"] = units(robot, folder)
        if HAS_WINE:
            result["windows"] = windows(robot, folder)
        result["stored"] = stored_logs(folder)
        tell(result, given.store)
        if given.hostile:
            result["hostile"] = hostile(robot, folder, given.hostile, given.seed)
            tell(result, given.store)
        if given.robots:
            result["random_robots"] = drawn(folder, given.robots, given.seed)
            tell(result, given.store)


def tell(result: dict[str, Any], stored: bool) -> None:
    """What there is by now, and whether it is stored."""
    told: dict[str, tuple[float, int | str, str | None]] = {}
    for key, level in (("over_service", "-O2"), ("over_service_o3", "-O3")):
        side = result["kernel"][level]
        spread = f"10 to 90 % of the blocks: {side['p10']} to {side['p90']}"
        told[key] = side["c_over_service"], side["blocks"] * side["steps_a_block"], spread
    step, most = result["step_cycles"], result["most_instructions_a_step"]
    spread = f"p99 {step['p99']}, p99.9 {step['p99_9']}, p99.999 {step['p99_999']}, most {step['worst']}"
    told["cycles"] = step["median"], step["steps"], f"{spread}; {step['cycles_a_ns']} a ns"
    how = f"load {os.getloadavg()[0]:.0f}, "
    how += "SCHED_FIFO 80 on one processor, memory locked" if step["alone"] else "other processes within it"
    told["cycles_worst"] = step["worst"], step["steps"], f"{how}; interrupts and the hypervisor within it"
    told["step"] = round(step["median"] / step["cycles_a_ns"] / 1000, 2), step["steps"], None
    told["instructions"] = result["mean_instructions_a_step"], most["steps"], None
    told["instructions_most"] = most["most"], most["steps"], None
    for name, (value, note) in processors(most["most"]).items():
        told[name] = value, most["steps"], note
    loop = result["loops"]
    told["loops"] = (
        loop["loops"],
        loop["functions"],
        f"{loop['constant']} of constant bounds, at most {loop['longest']}",
    )
    told["static_fourth_axis"] = result["fourth_axis_bytes"], 1, None
    largest = result["most_bytes"]
    told["static_most"] = largest["most"], largest["combinations"], "robots, rates of 250 Hz to 8 kHz, axes, effects"
    off = result["single"]
    told["single_rms"] = off["rms"], off["samples"], f"99.9 % within {off['most']} N m; trusted masses {off['mass']} kg"
    told["single_static"] = off["static_bytes"], 1, None
    for key, name in (("static", "static_bytes"), ("stack", "stack_bytes"), ("code", "code_and_constant_bytes")):
        told[key] = result[name], 1, None
    if result.get("clang_tidy"):
        told["clang_tidy"] = result["clang_tidy"]["findings"], f"{result['clang_tidy']['lines']} lines", None
    if "fmu" in result:
        told["fmu"] = result["fmu"]["differ"], result["fmu"]["samples"], "FMI 2.0 and 3.0 in FMPy, with faults"
    if "windows" in result:
        found = result["windows"]
        told["windows"] = found["largest"], found["samples"], f"by Wine and MinGW; {found['alike']} bit for bit"
    if "stored" in result:
        told["stored_logs"] = result["stored"]["differ"], result["stored"]["samples"], result["stored"]["which"]
    if "hostile" in result:
        found = result["hostile"]
        largest = f"largest torque {found['largest_torque_nm']:.0f} N m"
        told["hostile_findings"] = found["findings"], found["samples"], largest
    if "random_robots" in result:
        found = result["random_robots"]
        told["random_robots"] = found["differ"], found["robots"], f"{found['samples_each']} samples each, with faults"
    if "structured_text" in result:
        found = result["structured_text"]
        told["structured_text"] = (
            found["largest"],
            found["samples"],
            f"by {found['compiler']}; {found['alike']} bit for bit",
        )
    print(json.dumps(result, indent=1))
    if stored:
        print(f"kept in {store('export', told)}", flush=True)


def side_by_side(built: Built, samples: np.ndarray) -> dict[str, Any]:
    """Processor time of a step in blocks of both, in turns, so that both see the same machine."""
    steps = state.fresh(state.settings(built.robot, PERIOD, 1))
    out = FEEDFORWARD.empty(BLOCK), PAYLOAD.empty(BLOCK), MODEL_ERROR.empty(BLOCK)
    assert built.init() == 0
    built.run(samples[:BLOCK])
    run_kernel(steps, samples[:BLOCK], *out)
    taken: dict[str, list[float]] = {"c": [], "service": []}
    for turn in range(TURNS):
        part = samples[turn % (len(samples) // BLOCK) * BLOCK :][:BLOCK].copy()
        part["sequence"] = np.arange(BLOCK) + turn * BLOCK
        part["stamp_sec"], part["stamp_nanosec"] = np.divmod((np.arange(BLOCK) + turn * BLOCK) * 1_000_000, 10**9)
        given = built.samples(part)
        begin = time.process_time_ns()
        built.loop(given)
        taken["c"].append((time.process_time_ns() - begin) / BLOCK)
        begin = time.process_time_ns()
        run_kernel(steps, part, *out)
        taken["service"].append((time.process_time_ns() - begin) / BLOCK)
    medians = {f"{name}_ns": round(float(np.median(values)), 1) for name, values in taken.items()}
    ratios = np.array(taken["c"]) / np.array(taken["service"])
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    ratio = {"c_over_service": round(float(middle), 3), "p10": round(float(low), 3), "p90": round(float(high), 3)}
    return medians | ratio | {"blocks": TURNS, "steps_a_block": BLOCK}


def timed(built: Built, samples: np.ndarray, folder: Path, steps: int) -> dict[str, Any]:
    """Median of single steps, with the clock's own 20 to 40 ns; and instructions, which no other process can delay."""
    (folder / "timed.c").write_text("#define _GNU_SOURCE\n" + TIMED)
    program = folder / "timed"
    flags = [flag for flag in FLAGS if not flag.startswith("-W")]
    subprocess.run(
        [COMPILER or "gcc", "-O2", *flags, str(folder / "timed.c"), "-o", str(program), "-lm"], check=True, cwd=folder
    )
    data = built.samples(samples).tobytes()
    ran = subprocess.run([program, str(steps), "alone"], input=data, capture_output=True, check=True)
    *spread, rate = ran.stdout.split()
    median, rare, rarer, rarest, worst, is_alone = map(int, spread)
    counts = [_instructions(program, data, count) for count in (4000, 8000)]
    return {
        "step_cycles": {
            "median": median,
            "p99": rare,
            "p99_9": rarer,
            "alone": bool(is_alone),
            "p99_999": rarest,
            "worst": worst,
            "steps": steps,
            "cycles_a_ns": round(float(rate), 3),
        },
        "mean_instructions_a_step": round((counts[1] - counts[0]) / 4000),
        "most_instructions_a_step": _most_instructions(program, data, folder),
    }


def _instructions(program: Path, data: bytes, steps: int) -> int:
    ran = subprocess.run(
        ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", str(program), str(steps)],
        input=data, capture_output=True, check=True,
    )  # fmt: skip
    found = re.search(rb"Collected : (\d+)", ran.stderr)
    assert found is not None, ran.stderr[-500:]
    return int(found[1])


def _most_instructions(program: Path, data: bytes, folder: Path) -> dict[str, int]:
    """Of single steps round the first pick of the log."""
    ran = subprocess.run(
        ["valgrind", "--tool=callgrind", "--dump-after=deltatwin_look_back", "--callgrind-out-file=steps", str(program),
         str(COUNTED)],
        input=data, capture_output=True, check=False, cwd=folder,
    )  # fmt: skip
    found = []
    for path in folder.glob("steps.*"):
        told = re.search(r"^(?:summary|totals): (\d+)", path.read_text(), re.MULTILINE)
        found.append(int(told[1]) if told else 0)
        path.unlink()
    assert len(found) >= COUNTED, ran.stderr[-500:]
    found.sort()
    return {"steps": COUNTED, "most": found[-3]}  # two of them have the program's own start and end


def sizes(folder: Path) -> dict[str, Any]:
    """Bytes of what it remembers, of code and constants, and of the deepest stack, at -O2."""
    flags = ["-O2", *FLAGS, "-fcallgraph-info=su", "-c", "deltatwin.c", "-o", "deltatwin.o"]
    subprocess.run([COMPILER or "gcc", *flags], check=True, cwd=folder)
    text, data, bss = map(
        int, subprocess.run(["size", "deltatwin.o"], check=True, cwd=folder, capture_output=True).stdout.split()[6:9]
    )
    stack = _deepest((folder / "deltatwin.ci").read_text())
    return {"static_bytes": data + bss, "code_and_constant_bytes": text, "stack_bytes": stack}


def _deepest(graph: str) -> int:
    """Bytes on the longest way through gcc's call graph; a library function's own are not in it."""
    own = {name: int(size) for name, size in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes', graph)}
    calls: dict[str, set[str]] = {}
    for one, other in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', graph):
        calls.setdefault(one, set()).add(other)

    def deep(name: str) -> int:
        return own.get(name, 0) + 8 + max((deep(other) for other in calls.get(name, ())), default=0)

    return max(deep(name) for name in own)


def tidied(folder: Path) -> dict[str, int] | None:
    """What clang-tidy says of the code in `folder`, where it is installed. Not asked: parameters of one type in a row,
    unused ones that are marked as such, and branches that are alike, which are what the kernels say."""
    if shutil.which("clang-tidy") is None:
        return None
    checks = "-*,clang-analyzer-*,clang-diagnostic-*,bugprone-*,cert-*,misc-*,performance-*,portability-*,"
    checks += "readability-non-const-parameter"
    left_out = "-bugprone-easily-swappable-parameters,-misc-unused-parameters,-bugprone-branch-clone"
    command = ["clang-tidy", f"--checks={checks},{left_out}", "deltatwin.c", "--", "-std=c99", "-Wall", "-Wextra"]
    ran = subprocess.run([*command, "-Wconversion"], check=False, cwd=folder, capture_output=True, text=True)
    said = set(re.findall(r"^.*(?:warning|error): .*$", ran.stdout, re.MULTILINE))
    print("\n".join(sorted(said)))
    return {"findings": len(said), "lines": len((folder / "deltatwin.c").read_text().splitlines())}


def processors(instructions: int) -> dict[str, tuple[float, str]]:
    """Share of a task of 250 us that the longest step takes, by instructions alone: what others count for such code."""
    kinds = {"atom": (1.3e9, 1.0, "Atom E3930, 1.3 GHz, 1"), "a53": (1.2e9, 0.7, "Cortex-A53, 1.2 GHz, 0.7")}
    return {
        f"task_{name}": (round(instructions / rate / clock * 1e6), f"computed: {said} instructions a clock")
        for name, (clock, rate, said) in kinds.items()
    }


def fourth_axis(robot: Robot) -> int:
    """Static bytes with one."""
    return to_c(robot.model_copy(update={"fourth_axis": FOURTH_AXIS}), PERIOD).static_bytes


def most_bytes() -> dict[str, int]:
    """Static bytes, the most: robots that come along, several rates, with and without a fourth axis and effects."""
    robots = [load_robot(path).model_copy(update={"fourth_axis": axis}) for path in ROBOTS for axis in AXES.values()]
    found = [bytes_of(one, period) for robot in robots for one in (robot, laden(robot)) for period in PERIODS]
    return {"most": max(found), "combinations": len(found)}


def loops(robot: Robot) -> dict[str, int]:
    """Of the tree: how many, how many between constants, the longest of those."""
    _, program, _ = lowered(robot, PERIOD, nominal=True)
    found = [loop for one in program.functions for loop in _loops(one.body)]
    fixed = [loop for loop in found if loop.start.is_constant and loop.stop.is_constant]
    longest = max(len(range(loop.start.value, loop.stop.value, loop.step)) for loop in fixed)
    return {"functions": len(program.functions), "loops": len(found), "constant": len(fixed), "longest": longest}


def _loops(statements: list[Any]) -> list[For]:
    found = []
    for one in statements:
        found += [one] if isinstance(one, For) else []
        for part in ("body", "otherwise"):
            found += _loops(getattr(one, part, []))
    return found


def single(robot: Robot, samples: np.ndarray, folder: Path) -> dict[str, Any]:
    """What single precision costs along the demo log, plain and with faults."""
    (own := folder / "single").mkdir()
    built, off, masses = Built(robot, PERIOD, own, "-O1", single=True), [], []
    for each in (samples, disturbed(samples)):
        assert built.init() == 0
        found, wanted = built.run(each), expected(built, each)
        off.append(np.abs(found["feedforward"]["torque"].astype(float) - wanted["feedforward"]["torque"]))
        _, one, other = np.intersect1d(found["payload"]["sequence"], wanted["payload"]["sequence"], return_indices=True)
        a, b = found["payload"][one], wanted["payload"][other]
        both = (a["trusted"] != 0) & (b["trusted"] != 0)
        masses.append(np.abs(a["mass"] - b["mass"])[both].max())
    torque = np.concatenate(off)
    return {
        "rms": round(float(np.sqrt(np.mean(torque**2))), 2), "most": round(float(np.quantile(torque, 0.999)), 1),
        "mass": round(float(max(masses)), 3), "samples": len(torque), "static_bytes": built.twin.static_bytes,
    }  # fmt: skip


def structured_text(robot: Robot, samples: np.ndarray, strucpp: Path, folder: Path) -> dict[str, Any]:
    """The function block, compiled by STruC++ and run along the demo log, plain and with faults: largest difference."""
    (own := folder / "st").mkdir()
    block, largest, alike, count = Strucpp(robot, PERIOD, own, strucpp), 0.0, 0, 0
    for each in (samples, disturbed(samples)):
        found, wanted = block.run(each), Estimator(robot, PERIOD).run(each)._asdict()
        found["payload"], found["error"] = (found[one][found["has_payload"] != 0] for one in ("payload", "error"))
        for topic, records in wanted.items():
            assert len(found[topic]) == len(records)
            for name in found[topic].dtype.names or ():
                a, b = found[topic][name].astype(float), records[name].astype(float)
                off = np.where((a == b) | ((a != a) & (b != b)), 0.0, np.abs(a - b))
                largest = max(largest, float(off.max()))
                alike, count = alike + int((off == 0.0).sum()), count + off.size
        del found
    return {"largest": float(f"{largest:.1e}"), "alike": f"{alike} of {count} numbers", "samples": 2 * len(samples),
            "compiler": "STruC++"}  # fmt: skip


def units(robot: Robot, folder: Path) -> dict[str, int]:
    """FMUs in FMPy along the whole demo log with faults: samples whose torque or mass differs in a bit from the
    service's; and what FMPy's checker finds, which must be nothing."""
    described, differ, count = robot.model_copy(update={"fourth_axis": FOURTH_AXIS}), 0, 0
    samples = recorded(described)
    wanted = Estimator(described, PERIOD).run(samples)
    told = wanted.payload["sequence"].astype(int) + int(state.settings(described, PERIOD, 1)["motion"]["lag"][0])
    for fmi in (2, 3):
        write_fmu(described, PERIOD, fmi, path := folder / f"{fmi}.fmu", "deltatwin")
        assert validate_fmu(str(path)) == []
        torque, mass, _ = in_fmpy(path, fmi, samples, folder / f"fmu_{fmi}")
        wrong = (torque != wanted.feedforward["torque"]).any(axis=1)
        wrong[told] |= mass[told] != wanted.payload["mass"]
        differ, count = differ + int(wrong.sum()), count + len(samples)
    return {"differ": differ, "samples": count}


def windows(robot: Robot, folder: Path) -> dict[str, Any]:
    """The FMU's library for Windows along the demo log with faults, by FMI 2.0 and 3.0: largest difference, N m."""
    described, largest, alike, count = robot.model_copy(update={"fourth_axis": FOURTH_AXIS}), 0.0, 0, 0
    samples = recorded(described)
    wanted = Estimator(described, PERIOD).run(samples).feedforward["torque"]
    for fmi in (2, 3):
        (own := folder / f"windows_{fmi}").mkdir()
        off = np.abs(under_wine(described, samples, fmi, own, folder / "wine")[:, :3] - wanted)
        largest, alike, count = max(largest, float(off.max())), alike + int((off == 0.0).sum()), count + off.size
    return {"largest": float(f"{largest:.1e}"), "alike": f"{alike} of {count} torques", "samples": 2 * len(samples)}


def hostile(robot: Robot, folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Samples under address, undefined, float-cast-overflow and the code's own checks of every index: of the robot, of
    one with a fourth axis and of ones with effects that remember."""
    good, made, largest, programs = read_trace(LOG, robot).samples()[1200:1600], 0, 0.0, []
    turning = robot.model_copy(update={"fourth_axis": FOURTH_AXIS})
    for group in ("none", "turning", "gears", "loose", "friction"):
        (own := folder / f"hostile_{group}").mkdir()
        described = with_effects(turning if group == "turning" else robot, GROUPS.get(group, ()))
        programs.append(Sanitized(described, PERIOD, own, "-O1"))
    while made < count:
        samples = turned(streams(good, min(count // len(programs), PART), seed + made), seed + made)
        for program in programs:
            largest, made = max(largest, float(np.abs(program.run(samples)).max())), made + len(samples)
            print(f"\r{made} hostile samples, largest torque {largest:.0f} N m", end="", flush=True)
    print()
    return {"samples": made, "findings": 0, "largest_torque_nm": largest}


def stored_logs(folder: Path) -> dict[str, Any]:
    """Logs of other robots that the tests have, each plain and with faults, bit for bit."""
    differ, samples, logs, cases = 0, 0, 0, 0
    for packed in sorted([*(DATA / "plant_logs").glob("case_*"), *(DATA / "payload_logs").glob("case_*")]):
        (own := folder / f"{packed.parent.name}_{packed.name}").mkdir()
        shutil.copy(packed / "robot.toml", own)
        for path in packed.glob("*.csv.xz"):
            (own / path.stem).write_bytes(lzma.decompress(path.read_bytes()))
        found = sorted(own.glob("*.csv"))
        if found:
            wrong, count = stored(own / "robot.toml", found, own)
            differ, samples, logs, cases = differ + len(wrong), samples + count, logs + len(found), cases + 1
    return {"differ": differ, "samples": samples, "which": f"{logs} logs of {cases} robots, plain and with faults"}


def drawn(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Robots drawn at random, each with up to four effects and one in four with a fourth axis, along the demo log with
    faults, bit for bit."""
    random, wrong = np.random.default_rng(seed), []
    base = load_robot(ROBOT)
    plain = disturbed(read_trace(LOG, base).samples()[:4000])
    for number in range(count):
        robot = _draw(base, random)
        samples = plain if robot.fourth_axis is None else turned(plain, number)
        built = Built(robot, PERIOD, folder, "-O0", f"robot_{number}")
        assert built.init() == 0
        found = differences(built.run(samples), expected(built, samples))
        if found:
            wrong.append({"effects": [one.name for one in robot.effect], "differences": found[:3]})
        print(f"\r{number + 1} robots, {len(wrong)} differ", end="", flush=True)
    print()
    return {"robots": count, "samples_each": len(plain), "differ": len(wrong), "which": wrong}


def _draw(base: Robot, random: np.random.Generator) -> Robot:
    def near(value: float) -> float:
        return float(value * random.uniform(0.85, 1.15))

    geometry = base.geometry.model_copy(
        update={n: near(getattr(base.geometry, n)) for n in ("active_link_length", "passive_link_length")}
    )
    mass = base.mass.model_copy(
        update={n: near(getattr(base.mass, n)) for n in ("active_link", "passive_link", "platform")}
    )
    names = random.choice(sorted(FOUND), int(random.integers(0, 5)), replace=False)
    reports = {"torque_delay", "torque_filter", "drive_lag"}
    whole = {entry.name for entry in CATALOGUE if not entry.per_joint}
    joints = [[int(random.integers(1, 4))] for _ in names]
    effects = [
        effect(str(name), [1, 2, 3] if name in whole or name in reports else own)
        for name, own in zip(names, joints, strict=True)
    ]
    axis = FOURTH_AXIS if random.random() < 0.25 else None
    return base.model_copy(update={"geometry": geometry, "mass": mass, "effect": effects, "fourth_axis": axis})


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
