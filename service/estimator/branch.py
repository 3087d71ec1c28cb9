"""What effects carry from sample to sample along one motion: the measured one, or the one that is answered for.

It survives a hole as long as the filters coast over it, for what happened in there is known well enough; beyond that it
starts over, at rest under the load of then, and the sample says so.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.estimator.named_effects import MEMORY
from service.model.gears import TWIST, release_kernel

BRANCH = np.dtype(
    [
        ("idle", "i8"),  # cycles since it was moved on
        ("started", "i8"),
        ("memory", "f8", MEMORY),
        ("twist", TWIST),
        ("link", "f8", (3, 3)),  # position, velocity of the links, acceleration of the motors
        ("doubt", "f8", 3),  # (N m)^2, of the torque, for what is not known of the state
        ("wanted", "f8", 3),  # N m, last torque asked of the drives
    ],
    align=True,
)
MEASURED, ANSWERED = range(2)


@kernel
def forget_kernel(branch):
    """Start over with the next sample."""
    branch.idle = branch.started = 0
    branch.memory[:] = 0.0
    release_kernel(branch.twist)


@kernel
def wake_kernel(branch, cycles, longest):
    """Before the branch is moved on by `cycles`, no more than `longest` of which it survives. Returns how many it is
    moved on by since it last was, 0 where it starts over."""
    branch.idle += cycles
    if branch.started == 0 or branch.idle > longest:
        forget_kernel(branch)
    passed = branch.idle if branch.started != 0 else np.int64(0)
    branch.started, branch.idle = 1, 0
    return passed
