"""`deltatwin demo` as a user runs it: three processes over Zenoh, a recording that other tools read, a picture."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
from mcap_ros2.reader import read_ros2_messages

from replay.demo import PAYLOADS
from schemas.messages import PayloadEvent
from service.monitor.readback import read_recording
from tests.service.pages.test_pages import plots_of

PROGRAM = Path(sys.executable).with_name("deltatwin")


def test_the_demo_weighs_every_pick_and_leaves_a_whole_recording(bus_folder, tmp_path):
    run = subprocess.run(
        [PROGRAM, "demo", "--out", tmp_path], capture_output=True, text=True, env=environment(), check=False
    )
    assert run.returncode == 0, run.stderr
    recorded = read_recording(tmp_path / "demo.mcap")
    samples, feedforward, payload, error = (
        recorded[topic].records for topic in ("sample", "feedforward", "payload", "error")
    )
    assert (np.diff(samples["sequence"].astype(int)) == 1).all()
    assert (samples["sequence"] == feedforward["sequence"]).all()
    picks = list(csv.DictReader(PAYLOADS.open()))
    events = payload["event"][payload["event"] != 0].tolist()
    assert events == [PayloadEvent.PICK, PayloadEvent.RELEASE] * len(picks)
    assert np.nanstd(error["full"]) < 0.5 * np.nanstd(error["id_friction"]) < 0.25 * np.nanstd(error["kh"])
    assert len(list(read_ros2_messages(tmp_path / "demo.mcap", topics=["/deltatwin/demo/payload"]))) == len(payload)
    page = (tmp_path / "demo.html").read_text()
    assert "full model with payload" in [trace["name"] for plot in plots_of(page) for trace in plot["data"]]
    assert "<script src=" not in page, "the page needs nothing from elsewhere"
    for text in ("M_KH", "3.80", f"{len(samples)}", "demo.mcap"):
        assert text in run.stdout


def test_a_folder_that_cannot_be_made_is_one_line(bus_folder, tmp_path):
    (tmp_path / "file").write_text("")
    run = subprocess.run(
        [PROGRAM, "demo", "--out", tmp_path / "file" / "x"],
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
    )
    assert run.returncode == 1
    assert run.stderr.strip().splitlines()[-1].startswith("deltatwin: ")
    assert "Traceback" not in run.stderr


def environment():
    import os

    return os.environ | {"COLUMNS": "160"}
