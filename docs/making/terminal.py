"""Makes the picture of `deltatwin top` again: `python -m docs.making.terminal`.

Roles run on a bus of their own and play the log of the demo, so it shows what a reader's terminal would.
"""

from __future__ import annotations

import asyncio
import os
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Group

from drivers.bus import open_bus
from replay.demo import LOG, ROBOT
from schemas.messages import Role
from schemas.robot import load_robot
from service.cli.live import Joints, Roles
from service.cli.screen import Screen
from service.supervisor import Supervisor

PICTURE = Path(__file__).resolve().parents[1] / "how-to" / "pictures" / "top.svg"
SIZE = (84, 20)  # columns and rows of the terminal
SHOWN_AFTER_S = 5.1  # of the log: the second pick is under way
REFRESH_S = 0.1


def top(folder: Path) -> str:
    """The screen of `top` as SVG while the demo's log is played. folder: for what the roles write, and their bus."""
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    robot = load_robot(ROBOT)
    with open_bus(robot.name, Role.OBSERVER) as bus, Supervisor(folder) as crew:
        recording = folder / "run.mcap"
        for one in (
            crew.start(lambda: Role.MONITOR in bus.alive, "monitor", "--robot", ROBOT, "--out", recording),
            crew.start(lambda: Role.ESTIMATOR in bus.alive, "estimate", "--robot", ROBOT),
        ):
            one.wait_ready()
        joints, roles = Joints(bus, robot), Roles(bus)
        crew.start(lambda: Role.PLAYER in bus.alive, "replay", LOG, "--robot", ROBOT, "--wait", 20).wait_ready()
        end = time.monotonic() + SHOWN_AFTER_S
        title = f"{robot.name}; q or Ctrl-C ends it"
        return asyncio.run(_drawn(lambda: Group(joints.picture(title), "", roles.table()), end))


async def _drawn(picture: Callable[[], Group], end: float) -> str:
    screen = Screen(picture, lambda: False, REFRESH_S)
    async with screen.run_test(size=SIZE) as pilot:
        await asyncio.sleep(end - time.monotonic())
        await pilot.pause()
        return _offline(screen.export_screenshot(title="deltatwin top", simplify=True))


def _offline(drawing: str) -> str:
    """Without the fonts that it would fetch: the reader's own are as wide."""
    return re.sub(r"@font-face \{.*?\}\s*", "", drawing, flags=re.DOTALL)


def main() -> None:
    """Write the picture."""
    PICTURE.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        PICTURE.write_text(top(Path(folder)), encoding="utf-8")
    print(f"wrote {PICTURE}")


if __name__ == "__main__":
    main()
