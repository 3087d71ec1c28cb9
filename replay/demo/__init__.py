"""A sample log to try everything on: a withheld simulated Delta robot, seven picks in ten seconds at 1 kHz.

`log.mcap` holds what the bus carried, `robot.toml` the description as `deltatwin identify` wrote it from other logs of
that robot, `payloads.csv` what was really picked (s, s, kg).
"""

from pathlib import Path

_FOLDER = Path(__file__).parent
LOG = _FOLDER / "log.mcap"
ROBOT = _FOLDER / "robot.toml"
PAYLOADS = _FOLDER / "payloads.csv"
