"""Feed-forward and load of three arms of 4, 6 and 7 joints at 1 kHz, simulated by MuJoCo, the load picked up and
released in motion: how far mass and centre are off, how many errors cover the truth, when a change is seen.

uv run python -m tests.bench.bench_arm_online --robots 4 --loads 4 --store
uv run python -m tests.bench.bench_arm_online --bus --store
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from docs.making import figures
from drivers.bus import open_bus
from drivers.trace import read_trace
from schemas.axes_description import load_description, save_description
from schemas.chain_description import Chain
from schemas.messages import JOINT_SAMPLE, NANOSECONDS, OF_JOINTS, PayloadEvent, Role, set_stamp, stamp_ns
from service.estimator.joints.joints_estimator import JointEstimator
from service.identification.joint_machines import identify_axes
from service.monitor.readback import read_recording
from service.supervisor import Supervisor
from tests.bench.bench_arm_load import CERTAIN, HEAVY_URDF, drawn
from tests.service.arms import FOUR, SEVEN, SIX, Kind, Load

PERIOD = 1e-3  # s
PICK, RELEASE, END = 8.0, 22.0, 28.0  # s
ENCODER = 1e-5  # rad rms
KINDS = (FOUR, SIX, SEVEN)


class Row(NamedTuple):
    """A load. off, errors: (4,) kg and m of mass and centre as known at the release. seen: (2,) s from pick and release
    to their event, infinite without. false: other events. idle: kg and its error at the end. feed: (n,) share of the
    torque's rms that the feed-forward is off, once the load is known."""

    kg: float
    off: np.ndarray
    errors: np.ndarray
    seen: np.ndarray
    false: int
    idle: np.ndarray
    feed: float
    seconds: np.ndarray


def identified(kind: Kind, folder: Path, seed: int) -> Chain:
    """The arm without a load, from a URDF that is too heavy."""
    (folder / "arm.urdf").write_text(kind.urdf(scale=HEAVY_URDF))
    (folder / "arm.toml").write_text(kind.description())
    plain = load_description(folder / "arm.toml")
    empty = [kind.record(folder / f"empty_{k}.csv", 1000 * seed + k) for k in range(2)]
    assert isinstance(plain, Chain)
    robot = identify_axes(plain, [read_trace(path, plain) for path in empty]).robot
    assert isinstance(robot, Chain)
    return robot


def samples(kind: Kind, seed: int, load: Load) -> np.ndarray:
    """JOINT_SAMPLE records of a motion in which `load` is carried from `PICK` to `RELEASE`."""
    times = np.arange(round(END / PERIOD)) * PERIOD
    signals, draw = kind.motion(seed, times), np.random.default_rng(1000 + seed)
    carries = ((times >= PICK) & (times < RELEASE))[:, None]
    needed = np.where(carries, kind.needed(signals, load), kind.needed(signals))
    records = JOINT_SAMPLE.empty(len(times))
    set_stamp(records, np.rint(times * NANOSECONDS).astype(np.int64))
    records["sequence"], records["joints"] = np.arange(len(times)), kind.count
    records["torque_command"] = np.nan
    own = slice(kind.count)
    records["position_command"][:, own] = signals[0]
    records["position"][:, own] = signals[0] + draw.normal(0, 1, signals[0].shape) * ENCODER
    records["torque"][:, own] = needed + draw.normal(0, 1, needed.shape) * kind.noise
    return records


def measured(kind: Kind, robot: Chain, seed: int, load: Load) -> Row:
    """One load on one robot."""
    given, estimator = samples(kind, seed, load), JointEstimator(robot, PERIOD)
    size, data = given.dtype.itemsize, given.tobytes()
    answers, said, seconds = [], [], np.empty(len(given))
    for n in range(len(given)):
        begin = time.perf_counter()
        estimator.step(data[n * size : (n + 1) * size])
        answers.append(estimator.feedforward["torque"][0, : kind.count].copy())
        event = estimator.look_back()
        seconds[n] = time.perf_counter() - begin
        if event >= 0:
            assert estimator.payload is not None
            said.append(estimator.payload.copy())
    loads = np.concatenate(said)
    at = stamp_ns(loads) / NANOSECONDS
    known = loads[np.searchsorted(at, RELEASE) - 1]
    error = np.hypot(np.r_[known["mass_random"], known["centre_random"]],
                     np.r_[known["mass_common"], known["centre_common"]])  # fmt: skip
    events = [(at[n], loads["event"][n]) for n in np.flatnonzero(loads["event"])]
    seen = np.array([
        min((t - since for t, what in events if what == kind_of and since <= t < until), default=np.inf)
        for kind_of, since, until in ((PayloadEvent.PICK, PICK, RELEASE), (PayloadEvent.RELEASE, RELEASE, END))
    ])  # fmt: skip
    last, carried = loads[-1], slice(round((RELEASE - 4.0) / PERIOD), round(RELEASE / PERIOD))
    needed = given["torque"][carried, : kind.count]
    off = np.array(answers)[carried] - needed
    return Row(
        load.mass, np.r_[known["mass"] - load.mass, known["centre"] - load.centre], error, seen,
        len(events) - int(np.isfinite(seen).sum()),
        np.array([last["mass"], np.hypot(last["mass_random"], last["mass_common"])]),
        float(np.sqrt(np.mean(off**2, axis=0) / np.mean(needed**2, axis=0)).max()), seconds,
    )  # fmt: skip


def result(rows: list[Row]) -> dict[str, tuple[float, int, str | None]]:
    """What all loads come to."""
    mass, off, errors = (
        np.array([r.kg for r in rows]),
        np.array([r.off for r in rows]),
        np.array([r.errors for r in rows]),
    )
    kg, mm = np.abs(off[:, 0]), 1e3 * np.linalg.norm(off[:, 1:], axis=1)
    covered = np.abs(off) < CERTAIN * errors
    seen, idle = np.array([r.seen for r in rows]), np.array([r.idle for r in rows])
    step = 1e6 * np.concatenate([r.seconds for r in rows])
    return {
        "mass": (round(float(np.median(100 * kg / mass)), 3), len(rows), f"most {(100 * kg / mass).max():.2g} %"),
        "mass_good": (round(float(np.mean(kg <= np.maximum(0.02, 0.02 * mass))), 3), len(rows), None),
        "centre": (round(float(np.median(mm)), 3), len(rows), f"most {mm.max():.2g} mm"),
        "centre_good": (round(float(np.mean(mm <= 10)), 3), len(rows), None),
        "covered": (round(float(covered.mean()), 3), covered.size, f"mass alone {covered[:, 0].mean():.3g}"),
        "seen": (round(float(np.isfinite(seen).mean()), 3), seen.size, None),
        "seen_after": (round(float(np.median(seen)), 2), seen.size, f"p90 {np.quantile(seen, 0.9):.2f} s"),
        "false": (int(sum(r.false for r in rows)), len(rows), None),
        "idle": (round(1e3 * float(np.abs(idle[:, 0]).max()), 1), len(rows), None),
        "feedforward": (round(100 * float(np.median([r.feed for r in rows])), 2), len(rows), None),
        "step": (round(float(np.median(step))), len(step), f"p99 {np.quantile(step, 0.99):.0f} us"),
    }


def on_the_bus(kind: Kind, seconds: float) -> dict[str, tuple[float, int, str | None]]:
    """A log at 1 kHz through player, estimator and monitor: what was lost, and how long an answer took."""
    with tempfile.TemporaryDirectory(prefix="dt-") as runtime:
        folder = Path(runtime)
        os.environ["XDG_RUNTIME_DIR"] = runtime
        robot, run = folder / "identified.toml", folder / "run.mcap"
        save_description(identified(kind, folder, 20), robot)
        log = kind.record(folder / "log.csv", 77, drawn(kind, np.random.default_rng(7)), PERIOD, seconds, ENCODER)
        with open_bus(kind.name, Role.OBSERVER) as bus, Supervisor(folder) as crew:
            for role, words in ((Role.MONITOR, ("monitor", "--out", run)), (Role.ESTIMATOR, ("estimate",))):
                crew.start(lambda role=role: role in bus.alive, *words, "--robot", robot).wait_ready()
            crew.run("replay", log, "--robot", robot, "--wait", 20)
            time.sleep(1.5)
            crew.check()
        recorded = read_recording(run)
    health = recorded["health"].records
    told = health[(health["role"] == Role.ESTIMATOR) & (health["latency_max"] > 0)]
    sent, answered = (len(recorded[topic].records) for topic in (OF_JOINTS.sample, OF_JOINTS.feedforward))
    expected = round(seconds / PERIOD)
    median, slowest = 1e6 * np.median(told["latency_median"]), 1e6 * np.median(told["latency_p99"])
    return {
        "lost": (2 * expected - sent - answered, 2 * expected, None),
        "latency": (round(float(median)), len(told), f"p99 {slowest:.0f} us"),
    }


def main() -> None:
    """Print each arm, and store what all come to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=4, help="of each arm, with noise and motion of their own")
    parser.add_argument("--loads", type=int, default=4, help="of each robot")
    parser.add_argument("--store", action="store_true", help="put the figures into results/arm_online.json")
    parser.add_argument("--bus", action="store_true", help="only the arm of six joints over Zenoh, for 30 s")
    given = parser.parse_args()
    if given.bus:
        show(on_the_bus(SIX, 30.0), given.store)
        return
    every: list[Row] = []
    for kind in KINDS:
        rows = []
        for seed in range(20, 20 + given.robots):
            with tempfile.TemporaryDirectory() as folder:
                robot = identified(kind, Path(folder), seed)
                for number in range(given.loads):
                    load = drawn(kind, np.random.default_rng([seed, number]))
                    rows.append(measured(kind, robot, 1000 * seed + 100 + number, load))
                    row = rows[-1]
                    print(
                        f"{kind.name} {seed} {number}: {row.kg:.3f} kg off {1e3 * row.off[0]:.1f} g "
                        f"± {1e3 * row.errors[0]:.1f}, centre {1e3 * np.linalg.norm(row.off[1:]):.2f} mm, "
                        f"seen {row.seen.round(2)} s, false {row.false}, idle {row.idle.round(4)} kg",
                        flush=True,
                    )
        every += rows
    show(result(every), given.store)


def show(found: dict[str, tuple[float, int, str | None]], kept: bool) -> None:
    """Print, and store, figures."""
    for key, (value, count, interval) in found.items():
        print(f"{key}: {value} of {count} ({interval})")
    if kept:
        print(f"stored in {figures.store('arm_online', found)}")


if __name__ == "__main__":
    main()
