"""A real servo axis: the EMPS benchmark's published parameters and its direction-dependent friction."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.trace import find_columns, read_trace
from schemas.axes import load_axes
from service.cli.main import app
from service.diagnosis.diagnose import diagnose
from service.diagnosis.document import document
from service.diagnosis.effects import CATALOGUE

# Janot, Gautier, Brunot 2019: M kg, F_v N s/m, F_c N, offset N; with friction by direction F_v+ and F_v-
PUBLISHED = {"inertia_1": 95.1089, "f_v_1": 203.5034, "f_c_1": 20.3935, "offset_1": -3.1648}
FORWARD, BACKWARD = 166.7, 239.9


@pytest.fixture
def description(tmp_path):
    path = tmp_path / "emps.toml"
    path.write_text('name = "emps"\nkind = "axes"\ncolumns = "emps"\n[[axis]]\nunit = "m"\n')
    return path


def test_published_parameters_and_asymmetric_friction(shared, description, tmp_path):
    log = shared / "real" / "emps" / "emps.csv"
    arguments = ["diagnose", str(log), "--robot", str(description), "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(app, arguments, catch_exceptions=False).exit_code == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    for name, value in PUBLISHED.items():
        assert found["plain"][name] == pytest.approx(value, rel=0.01)
    effect = found["effects"][0]
    assert effect["name"] == "asymmetric_friction"
    delta = effect["parameters"]["delta_v"]
    assert delta["unit"] == "N s/m"
    viscous = found["base"]["f_v_1"]["value"]
    assert viscous + delta["value"] == pytest.approx(FORWARD, rel=0.02)
    assert viscous - delta["value"] == pytest.approx(BACKWARD, rel=0.02)
    assert load_axes(tmp_path / "out" / "corrected.toml").effect[0].name == "asymmetric_friction"


def test_force_pulses_are_events_outside_the_catalogue(shared, description):
    path = shared / "real" / "emps" / "emps_pulses.csv"
    trace = read_trace(path, columns=find_columns("emps"))
    pulses = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 4))
    found = document(diagnose(load_axes(description), [trace], CATALOGUE))
    assert found.verdict in ("unexplained", "partly_explained")
    events = found.where["bursts"][:4]
    active = pulses[np.abs(pulses[:, 1]) > 0, 0]
    for event in events:
        assert np.min(np.abs(active - 0.5 * (event["from_s"] + event["to_s"]))) < 0.3
