"""The estimator of an arm or of axes as an object, with the methods of a Delta's."""

from __future__ import annotations

import numpy as np

from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.messages import JOINT_ERROR, JOINT_FEEDFORWARD, LOAD, HealthFlag, PayloadEvent
from service.estimator.estimator import Result
from service.estimator.joints import joints_state
from service.estimator.joints.joints_step import begin_kernel, end_kernel, look_kernel, plan_kernel
from service.estimator.joints.running_load import Found, LoadMemory
from service.model.description import base_of


class JointEstimator:
    """Consumes JOINT_SAMPLE in the order they come; the same samples give the same bits, one by one or in any batches.

    feedforward, payload, error: (1,) records of JOINT_FEEDFORWARD, LOAD and JOINT_ERROR, what the last `step` and
    `look_back` said, overwritten by the next. payload: None of axes.
    """

    friction = None  # none is learnt

    def __init__(self, description: Axes | Chain, period: float, stride: int = 1) -> None:
        """description: identified. period, stride: of its samples.

        Raises:
            RobotError, DataError: see `joints_state.check`.
        """
        self.period, self.stride = period, stride
        machine = joints_state.check(description)
        direct, self._tree = machine.mechanism.direct, machine.mechanism.tree
        assert direct is not None
        self._rows, self._base = machine.mechanism.rows, base_of(description)
        self._steps = joints_state.fresh(joints_state.settings(description, period, stride))
        self._given = self._steps["given"].view(np.uint8).data
        self.feedforward, self.error = self._steps["feedforward"], self._steps["error"]
        self.payload = None if self._tree is None else self._steps["load"]
        count, one = description.count, self._steps["state"][0]
        self._motion, self._looked = one["motion"][:, :count], one["looked"][:, :count]
        self._rigid, self._reported = one["rigid"][:count], one["reported"][:count]
        self._rubbed, self._state = one["rubbed"][:count], one
        self._coulomb = self._base.coulomb
        self._transition = self._steps["settings"][0]["transition"][: len(self._coulomb)]
        self._count, self._lagged = count, False
        self._bare = self._torque = direct.instant(self._base.rigid)
        self._load: LoadMemory | None = None
        self._fed: Found | None = None
        if self._tree is not None:
            self._load = LoadMemory(machine, self._tree, period, machine.limits().speed)
            self._onto = machine.load(None)[1]
        self._found = HealthFlag.EFFECT_LEFT_OUT if joints_state.left_out(description) else HealthFlag(0)
        self._say(None)

    def step(self, message: bytes) -> int:
        """Fill `feedforward` for one JOINT_SAMPLE as it came off the wire. Returns its flags."""
        if self._lagged:
            self.look_back()
        self._given[:] = message
        answers = begin_kernel(self._steps)
        if answers:
            self._rigid[:] = self._torque(self._motion)
        flags, self._lagged = end_kernel(self._steps, answers)
        return flags

    def look_back(self) -> int:
        """Fill `payload` and `error` after a `step`. Returns the payload event, or -1 where there is nothing."""
        if not self._lagged:
            return -1
        self._lagged = False
        usable, error = look_kernel(self._steps), self.error[0]
        if self._state["unseen"]:
            self._state["unseen"] = 0
            if self._load is not None:
                self._load.forget()
        if not usable:
            for name in ("rigid", "friction", "full"):
                error[name][: self._count] = np.nan
            if self._load is not None:
                self._load.add(np.zeros(0), np.zeros(0), False)
        elif self._load is None:
            self._tell(self._reported - self._bare(self._looked), 0.0)
        else:
            self._weigh(self._load)
        found = None if self._load is None else self._load.found
        if found is not self._fed:
            self._feed(found)
        if self._load is None:
            return int(PayloadEvent.NONE)
        self._steps["load"]["event"] = event = self._load.event()
        return int(event)

    def _weigh(self, load: LoadMemory) -> None:
        """Errors at the sample looked back on, which goes into the estimate of the load."""
        motion = self._looked
        dry = np.tanh(self._rows @ motion[1] / self._transition)
        row = load.residual(motion, self._reported, self._rubbed, dry)
        left = row[:, -1] + self._rubbed
        carried = row[:, :10] @ self._fed.feed if self._fed is not None and self._fed.trusted else 0.0
        self._tell(left, carried)
        load.grip(int(self._state["gripper"]))
        load.add(row, motion[1], bool(self._state["votes"]))

    def _tell(self, left: np.ndarray, carried: np.ndarray | float) -> None:
        """The errors. left: (n,) without friction and load."""
        error, count = self.error[0], self._count
        error["rigid"][:count] = left
        error["friction"][:count] = left - self._rubbed
        error["full"][:count] = left - self._rubbed - carried

    def _feed(self, found: Found | None) -> None:
        """The load that is known now, in what is fed forward and said."""
        self._fed, self._torque = found, self._bare
        if found is not None and found.trusted:
            assert self._tree is not None
            self._torque = self._tree.instant(self._base.rigid, self._onto @ found.feed)
        self._say(found)

    def _say(self, found: Found | None) -> None:
        said = self._steps["load"][0]
        for name in ("trusted", "centre_trusted", "inertia_trusted", "motion"):
            said[name] = 0
        for name in ("mass", "centre", "inertia"):
            for part in ("", "_random", "_common"):
                said[f"{name}{part}"] = np.nan
        if found is None:
            return
        body, rows = found.body, {"mass": 0, "centre": slice(1, 4), "inertia": slice(4, 10)}
        for name, place in rows.items():
            said[name] = getattr(body, name)
            said[f"{name}_random"], said[f"{name}_common"] = found.random[place], body.common[place]
        said["trusted"], said["motion"] = found.trusted, found.motion
        said["centre_trusted"], said["inertia_trusted"] = body.centre_told, body.inertia_told

    def run(self, samples: np.ndarray) -> Result:
        """Take (N,) records of JOINT_SAMPLE."""
        self.look_back()
        size, data = samples.dtype.itemsize, samples.tobytes()
        answers, loads, errors = [], [], []
        for n in range(len(samples)):
            self.step(data[n * size : (n + 1) * size])
            answers.append(self.feedforward.tobytes())
            if self.look_back() >= 0:
                loads += [] if self.payload is None else [self.payload.tobytes()]
                errors.append(self.error.tobytes())
        return Result(
            *(
                np.frombuffer(bytearray().join(parts), message.dtype)
                for parts, message in ((answers, JOINT_FEEDFORWARD), (loads, LOAD), (errors, JOINT_ERROR))
            )
        )

    def plan(self, reference: np.void) -> None:
        """Take one JOINT_REFERENCE record: while it lies ahead, the feed-forward torque is for its motion."""
        self._steps["planned"] = reference
        plan_kernel(self._steps)

    def findings(self) -> HealthFlag:
        """What there is to say in health."""
        return self._found

    def warm_up(self) -> None:
        """Compile, without touching the state."""
        fresh = joints_state.fresh(self._steps["settings"])
        plan_kernel(fresh)
        end_kernel(fresh, begin_kernel(fresh))
        look_kernel(fresh)
