"""The compiled step against a plain NumPy one written from the equations: the whole demo log, every number."""

import numpy as np

from drivers.trace import read_trace
from replay.demo import LOG, ROBOT
from replay.process import process
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD
from schemas.robot import load_robot
from tests.bench.numpy_step import NumpyEstimator


def test_the_compiled_step_is_the_numpy_step():
    robot = load_robot(ROBOT)
    samples = read_trace(LOG, robot).samples()[:2500]  # two picks and their releases
    reference = NumpyEstimator(robot, 1e-3)
    answers = [reference.step(samples[n : n + 1].tobytes()) for n in range(len(samples))]
    result = process(robot, samples)
    for place, (message, name) in enumerate(
        ((FEEDFORWARD, "feedforward"), (PAYLOAD, "payload"), (MODEL_ERROR, "error"))
    ):
        expected = np.frombuffer(b"".join(answer[place] for answer in answers), message.dtype)
        found = getattr(result, name)
        assert len(found) == len(expected)
        for field in message.dtype.names or ():
            if field not in ("cdr_header", "flags"):
                np.testing.assert_allclose(
                    found[field], expected[field], rtol=1e-7, atol=1e-7, err_msg=f"{name}.{field}"
                )
