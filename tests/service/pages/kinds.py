"""One page of each kind, by the real writers, as large as such a page is."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from schemas.messages import MODEL_ERROR, PAYLOAD, SAMPLE, set_stamp
from schemas.robot import Servo
from schemas.rollout_document import Reached, RegimeReached, RolloutDocument
from service.monitor.readback import Recorded
from service.monitor.recording_picture import picture
from service.pages import Headline
from service.pages import write_page as write_any_page
from service.rollout.gap import REGIMES
from service.rollout.rollout_page import write_rollout
from tests.service.pages.drawn import KINDS
from tests.service.pages.some_joints import write_logs

ROWS = 12_000  # of a recording: 12 s at 1 kHz


def rollout(path: Path) -> None:
    times, regimes = [0.01 * k for k in range(21)], []

    def reached(robot: str, error: float) -> Reached:
        grown: list[float | None] = [error * (0.01 + time**2) for time in times]
        return Reached(
            robot=robot, joint_mrad=[error] * 3, platform_mm=error, growth_mm=grown, ran_away=0, left_out=[],
            torque_nm=[1.0, 2.0, 3.0],
        )  # fmt: skip

    *robots, floor = (reached(name, error) for name, error in (("plain", 9.0), ("corrected", 1.0), ("floor", 0.8)))
    errors = {robot.robot: robot.platform_mm for robot in (*robots, floor)}
    for joint in (1, 2, 3):
        regimes += [RegimeReached(joint=joint, regime=name, windows=9, joint_mrad=errors) for name in REGIMES]
    three = [20.0, 21.0, 22.0]
    document = RolloutDocument(
        schema="deltatwin.rollout/1", traces=["pick", "slow"], horizon_s=0.2, windows=60, payload_kg=[0.0, 1.2],
        untold_s=0.8, interruptions=[], windows_lost=0, seconds=13.0, used_s=12.0, path_mm=60.0,
        over_identified=[4.0, None, 1.0], times_s=times, robots=robots, floor=floor, regimes=regimes,
        servo=Servo(position_gain_ps=three, velocity_gain_nms=three),
    )  # fmt: skip
    write_rollout(document, path, {})
    text = path.read_text(encoding="utf-8")
    assert "driven by the recorded position commands alone" in text
    assert "<td>1, 2, 3</td>" in text
    assert "In 1 of 60 windows every simulated robot carries 1.2 kg" in text
    assert "corrected leaves 4, -, 1 times as much torque unexplained" in text


def recording(path: Path) -> None:
    rng = np.random.default_rng(0)
    records = [dtype.empty(ROWS) for dtype in (SAMPLE, MODEL_ERROR, PAYLOAD)]
    for k, some in enumerate(records):
        set_stamp(some, 1_000_000 * np.arange(ROWS))
        some["sequence"] = np.arange(ROWS)
        for name in (("torque",), ("kh", "full"), ("mass", "std_dev"))[k]:
            wave = 3.0 * np.sin(np.arange(ROWS) / 50) + rng.normal(size=ROWS)
            some[name] = wave.reshape(-1, *[1] * (some[name].ndim - 1))
    recorded = {
        topic: Recorded(some, np.arange(ROWS))
        for topic, some in zip(("sample", "error", "payload"), records, strict=True)
    }
    said = Headline("told", "A log of twelve seconds.", "3 N m", "of torque", "`deltatwin inspect` it.")
    write_any_page("recording", path, said, title="pick.mcap replayed", figure=picture(recorded))


OTHERS = {
    "recording": recording,
    "rollout of commands": rollout,
    "one joint": partial(write_logs, 1),
    "six joints": partial(write_logs, 6),
}
PAGES = (*KINDS, *OTHERS)


def written(kind: str, path: Path) -> None:
    """A page of each kind; the paper's has tests of its own."""
    if kind in KINDS:
        KINDS[kind][0](np.random.default_rng(11), path)
    else:
        OTHERS[kind](path)
