"""The simulated robot: a closed-chain Delta in MuJoCo with drives, friction, noise and payloads."""

import os

# Nothing is drawn here. MuJoCo would load its window library, which asks for its version in a process of its own: that
# one outlives a command that is ended meanwhile.
os.environ.setdefault("MUJOCO_GL", "disable")
