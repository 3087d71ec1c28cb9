"""Offline prediction: the reference plant at its noise floor, every row predicted, faults bridged and told."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.messages import SampleFlag
from schemas.robot import Robot, load_robot, save_robot
from schemas.trace import Trace
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.model.nominal import pack
from service.model.prediction import MODELS, error_in_band, motion, predict_along

Record = Callable[..., Trace]


@pytest.fixture(scope="module")
def identified(robot: Robot, record: Record) -> Robot:
    return identify(robot, [summarise(pack(robot), record(seed)) for seed in range(3)]).robot


def test_reference_plant_is_left_at_its_noise(data: Path) -> None:
    folder = data / "plant_logs" / "case_000"
    robot = load_robot(folder / "robot.toml")
    fits = [read_trace(path, robot) for path in sorted(folder.glob("fit_*.csv"))]
    robot = identify(robot, [summarise(pack(robot), trace) for trace in fits]).robot
    square, count = 0.0, 0
    for path in sorted(folder.glob("test_*.csv")):
        trace = read_trace(path, robot)
        error = error_in_band(trace, motion(trace), predict_along(robot, trace, motion(trace))["full"])
        square, count = square + np.nansum(error**2), count + np.isfinite(error).sum()
    floor = 0.48900295 * np.sqrt(2 * 40 / 1000)  # white noise of the plant's torque, key.json
    assert np.sqrt(square / count) <= 1.1 * floor


def test_each_model_is_closer(identified: Robot, record: Record) -> None:
    trace = record(9)
    torque = predict_along(identified, trace, motion(trace))
    along = motion(trace)
    spread = [np.nanstd(error_in_band(trace, along, torque[name])) for name in MODELS]
    assert all(more < less for less, more in pairwise(spread))
    assert spread[-1] < 0.11  # 0.3 N m of white noise seen below 40 Hz are 0.08


def test_plain_description_predicts_the_textbook_model_only(robot: Robot, record: Record) -> None:
    trace = record(9)
    assert list(predict_along(robot, trace, motion(trace))) == ["M_KH"]


def test_faulty_rows_are_bridged_and_not_counted(identified: Robot, record: Record) -> None:
    whole, broken = record(9), record(9)
    clean = predict_along(identified, whole, motion(whole))["full"]
    broken.flags[4000:4003] |= np.uint32(SampleFlag.NOT_A_NUMBER)
    broken.position[4000:4003] = np.nan
    along = motion(broken)
    torque = predict_along(identified, broken, along)["full"]
    assert torque.shape == clean.shape
    assert np.isfinite(torque).all()
    assert not along.measured[4000:4003].any()
    assert along.measured.sum() == len(broken) - 3
    assert np.isnan(error_in_band(broken, along, torque)[3900:4100]).all()
    assert np.abs(torque - clean)[4000:4003].max() < 0.05 * np.abs(clean).max()


def test_written_description_predicts_the_same(identified: Robot, record: Record, tmp_path: Path) -> None:
    save_robot(identified, tmp_path / "identified.toml")
    trace = record(9)
    read, written = (
        predict_along(robot, trace, motion(trace))["full"]
        for robot in (load_robot(tmp_path / "identified.toml"), identified)
    )
    assert np.array_equal(read, written)
