"""The planner: torque as the simulated robot needs it, and no simulator to plan with."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from drivers.motion import Planner, peak_torque
from drivers.simulated.plant.mujoco_delta import Design, build, required_torque
from drivers.simulated.plant.truth import PlantTruth
from schemas.robot import load_robot


def test_planned_torque_is_what_the_simulated_robot_needs() -> None:
    robot = load_robot("rl5-1450-6kg")
    planner = Planner(robot, 2e-3)
    motion = planner.multisine(np.random.default_rng(4), 2.0)
    nominal = build(Design(PlantTruth.nominal(robot)), 1e-3)
    rows = slice(None, None, 25)
    theta, theta_dot, theta_ddot = motion.position[rows], motion.velocity[rows], motion.acceleration[rows]
    needed = required_torque(nominal, theta, theta_dot, theta_ddot)  # MuJoCo's inverse dynamics, virtual work
    limit = 0.6 * peak_torque(robot)
    np.testing.assert_allclose(planner.torque(theta, theta_dot, theta_ddot), needed, atol=2e-5 * limit)
    assert np.abs(needed).max() > 0.2 * limit  # it moved


PLANS = """
import sys
import numpy as np
sys.argv = ["deltatwin", "master", *{arguments}]
from service.cli.main import main
try:
    main()
except SystemExit as end:
    assert end.code == {code}, end.code
import drivers.ethercat.setpoints, drivers.ethercat.soem_master, replay.realtime, service.cli.progress
from drivers.motion import Planner
from schemas.robot import load_robot
from service.estimator.estimator import Estimator
robot = load_robot("d3-1200")
Planner(robot, 4e-3).pick_and_place(np.random.default_rng(0), 3.0, masses=(1.0,), speed=0.5)
Estimator(robot, 4e-3)
assert "mujoco" not in sys.modules and not any(name.startswith("drivers.simulated.plant") for name in sys.modules)
"""


def test_a_master_does_not_load_the_simulator() -> None:
    for arguments, code in ((["--help"], 0), (["nosuch0", "--robot", "d3-1200"], 1)):
        script = PLANS.format(arguments=arguments, code=code)
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=280, check=False)
        assert done.returncode == 0, done.stderr
