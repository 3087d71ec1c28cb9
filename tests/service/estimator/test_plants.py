"""`trusted` means it on simulated plants: bodies and effects of MuJoCo's, not of the model, picks made at rest."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.motion import Planner
from drivers.plant.effects import make_effects
from drivers.plant.plant import Plant
from drivers.plant.truth import TRUTHS, load_truth
from schemas.robot import load_robot
from service.experiment.logs import excitations, record
from service.identification.identify import identify
from service.identification.payload import payload_history
from service.identification.regression import summarise
from service.model.nominal import pack

PERIOD = 1e-3
SETTLED = 0.15  # s after a pick or release
RARE = 0.3  # share of samples that are trusted at least, so that what is covered says something


@pytest.mark.parametrize(("name", "masses"), [("d3-1200", (0.2, 3.8)), ("rl5-1450-6kg", (0.2, 5.0))])
def test_a_trusted_mass_is_within_its_error(name, masses):
    robot = load_robot(name)
    truth = load_truth(TRUTHS / f"{name}.toml", robot)
    planner, random = Planner(robot, PERIOD), np.random.default_rng(3)
    plant = Plant(robot, truth, make_effects(truth.effect, "test"), seed=2)
    fits = record(plant, excitations(planner, random, 3, 4.0), "fit")
    motion = planner.pick_and_place(random, 4.0, masses, speed=0.8)
    (picks,) = record(plant, iter([motion]), "picks")
    found = identify(robot, [summarise(pack(robot), log) for log in fits]).robot
    weighed = payload_history(found, picks)
    time = weighed.time - picks.time[0]
    hung, fresh = np.zeros(len(time)), np.zeros(len(time), bool)
    for load in motion.payloads:
        hung[(time >= load.pick) & (time < load.release)] = load.mass
        for edge in (load.pick, load.release):
            fresh |= (time >= edge) & (time < edge + SETTLED)
    judged = weighed.trusted.astype(bool) & ~fresh
    inside = np.abs(weighed.mass - hung) <= 2 * weighed.std_dev + 0.02
    assert judged.mean() > RARE
    assert inside[judged].mean() >= 0.95
