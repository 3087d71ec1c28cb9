"""The plain model of a diagnosis is what `identify` writes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.errors import DataError
from service.diagnosis.pipeline import diagnose
from service.identification.from_traces import identify
from service.identification.regression import summarise
from service.model.nominal import pack
from tests.service.diagnosis.logs import ROBOT, record, swing


@pytest.fixture(scope="module")
def traces(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    paths = [record(folder / f"run_{seed}.csv", ROBOT, swing(seed), 4.0, seed, 2.0) for seed in range(3)]
    return [read_trace(path, ROBOT) for path in paths]


def test_it_is_the_same_model(traces):
    written = identify(ROBOT, [summarise(pack(ROBOT), trace) for trace in traces]).robot.identified
    found = diagnose(ROBOT, traces, ())
    assert written is not None
    base = found.plain.hypothesis.base
    identified = [
        written.rho_1.value, written.rho_2.value, written.forearm_inertia_kg.value,
        *written.viscous_friction_nms.value, *written.coulomb_friction_nm.value,
        written.friction_transition_radps, written.torque_timing_s,
    ]  # fmt: skip
    plain = [*base.rigid, *base.viscous, *base.coulomb, base.transition, base.timing]
    np.testing.assert_allclose(identified, plain, rtol=1e-6)
    assert written.torque_noise_nm is not None
    np.testing.assert_allclose(written.torque_noise_nm.value, found.noise, rtol=1e-3)


def test_logs_of_two_rates_are_refused(traces):
    half = {name: getattr(traces[1], name)[::2] for name in ("time", "position", "torque", "flags")}
    with pytest.raises(DataError, match=r"run_1: 2 ms between samples, run_0 has 1 ms"):
        diagnose(ROBOT, [traces[0], replace(traces[1], **half)], ())
