"""Decoding speed and memory of captures, beside dpkt's bare reading of the same file, in turns in one run.

    python -m tests.bench.bench_capture CAPTURE ROBOT [--megabytes 1000] [--rounds 3] [--store]

CAPTURE (pcap) is repeated with rising stamps until the file is that large; each reading runs in a process of its own.
Example: uv run python -m tests.bench.bench_capture ../shared/captures/own_three_drives_4khz.pcap \\
    tests/drivers/ethercat/robots/own_three_drives.toml
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from docs.making.figures import store


def repeat(source: Path, target: Path, size: int) -> None:
    """Write the records of a little-endian pcap again and again, each time later by its length in whole seconds."""
    data = source.read_bytes()
    head, records = data[:24], np.frombuffer(data[24:], np.uint8).copy()
    starts, at = [], 0
    while at < len(records):
        starts.append(at)
        at += 16 + int.from_bytes(records[at + 8 : at + 12].tobytes(), "little")
    seconds = np.array(starts)[:, None] + np.arange(4)
    first = records[seconds].copy().view("<u4")[:, 0]
    span = int(first.max() - first.min()) + 1
    with target.open("wb") as out:
        out.write(head)
        for turn in range(size // len(records)):
            records[seconds] = (first + turn * span).astype("<u4")[:, None].view(np.uint8)
            out.write(records.tobytes())


def bare(path: Path, robot: Path) -> int:
    """dpkt, nothing done with the frames."""
    import dpkt

    with path.open("rb") as file:
        return sum(1 for _ in dpkt.pcap.Reader(file))


def datagrams(path: Path, robot: Path) -> int:
    """Every datagram of every frame."""
    from drivers.ethercat.capture import Capture
    from drivers.ethercat.frames import decode

    capture = Capture(path)
    for frames in capture.blocks():
        decode(frames)
    return capture.frames


def samples(path: Path, robot: Path) -> int:
    """Joint samples."""
    from drivers.trace.capture_trace import CaptureReader
    from schemas.robot import load_robot

    reader = CaptureReader(path, load_robot(robot))
    for _ in reader.blocks():
        pass
    return reader.capture.frames


def convert(path: Path, robot: Path) -> int:
    """Joint samples into an MCAP file; each sample stands for its two frames."""
    from drivers.trace.capture_trace import convert_capture
    from schemas.robot import load_robot

    with tempfile.TemporaryDirectory() as folder:
        made, _ = convert_capture(path, load_robot(robot), Path(folder) / "out.mcap", lambda done, size: None)
    return 2 * made


READINGS: dict[str, Callable[[Path, Path], int]] = {f.__name__: f for f in (bare, datagrams, samples, convert)}


def measure(name: str, small: Path, path: Path, robot: Path) -> None:
    """Print frames, wall and processor seconds and peak memory in kB, after a first reading of `small` to compile."""
    READINGS[name](small, robot)
    wall, processor = time.perf_counter(), time.process_time()
    frames = READINGS[name](path, robot)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(frames, wall, processor, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("robot", type=Path)
    parser.add_argument("--megabytes", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--store", action="store_true", help="put the figures into results/speed.json")
    parser.add_argument("--reading", nargs=2)
    arguments = parser.parse_args()
    if arguments.reading:
        measure(arguments.reading[0], arguments.capture, Path(arguments.reading[1]), arguments.robot)
        return
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.pcap"
        repeat(arguments.capture, large, arguments.megabytes * 1_000_000)
        print(f"{large.stat().st_size / 1e6:.0f} MB, {arguments.rounds} rounds in turns")
        figures: dict[str, list[np.ndarray]] = {name: [] for name in READINGS}
        for _ in range(arguments.rounds):
            for name, found in figures.items():
                command = [sys.executable, __file__, str(arguments.capture), str(arguments.robot)]
                done = subprocess.run(
                    [*command, "--reading", name, str(large)], check=True, capture_output=True, text=True
                )
                found.append(np.array(done.stdout.split(), float))
        medians = {name: np.median(found, axis=0) for name, found in figures.items()}
        for name, (frames, wall, processor, memory) in medians.items():
            print(
                f"{name:10s} {frames:.0f} frames: {frames / wall:9.0f} frames/s, {frames / processor:9.0f} a processor "
                f"second, peak memory {memory / 1024:.0f} MiB"
            )
    if arguments.store:
        measured = {}
        for key, name in (("capture_samples", "samples"), ("capture_mcap", "convert")):
            frames, wall, _, memory = medians[name]
            measured[key] = (round(float(frames / wall), -3), int(frames), f"peak memory {memory / 1024:.0f} MiB")
        print(f"kept in {store('speed', measured)}")


if __name__ == "__main__":
    main()
