"""A generated twin, compiled as a shared library, in the place of the estimator, with what that does in a cycle."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import DataError, RobotError, StorageError
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, SAMPLE, TOPICS
from schemas.robot import Robot
from service.codegen.folder import read_twin
from service.codegen.layout import layout_of
from service.codegen.twin import in_c
from service.estimator import state

_OK = 0


class Library:
    """feedforward, payload, error: (1,) records, what the last `step` and `look_back` said, overwritten by the next."""

    def __init__(self, path: Path, robot: Robot, period: float) -> None:
        """path: beside what `deltatwin export --to c` wrote. robot, period: that it runs for.

        Raises:
            StorageError: it is no library, none of that code, or that is not there. RobotError: made of another
            description. DataError: made for another cycle.
        """
        manifest, described = read_twin(path.parent)
        if described.model_dump() != robot.model_dump():
            raise RobotError(f"{path.parent}: exported from another description than {robot.origin}: export it again")
        if not manifest.id:
            raise StorageError(f"{path.parent}: contains Structured Text: export --to c into a separate folder")
        try:
            self._library = ctypes.CDLL(str(path.resolve()))
        except OSError as error:
            raise StorageError(f"{path}: not a library that this machine can load: {error}") from None
        self._name, self._path = manifest.name, path
        said = self._function("id", ctypes.c_uint64)()
        if f"{said:016x}" != manifest.id:
            raise StorageError(
                f"{path}: compiled from other code than {path.parent / manifest.name}.c: compile it again"
            )
        layout = layout_of(robot, state.settings(robot, manifest.period_s, 1))
        self._records = {
            topic: np.zeros(1, in_c(layout, message.dtype, manifest.single)) for topic, message in TOPICS.items()
        }
        self._real = ctypes.c_float if manifest.single else ctypes.c_double
        self.period, self._made_for = period, manifest.period_s
        self.feedforward, self.payload, self.error = FEEDFORWARD.empty(1), PAYLOAD.empty(1), MODEL_ERROR.empty(1)
        self._step, self._look_back, self._plan = (self._function(one) for one in ("step", "look_back", "plan"))
        self._init()

    def _function(self, name: str, returns: Any = ctypes.c_int) -> Any:
        try:
            found = getattr(self._library, f"{self._name}_{name}")
        except AttributeError:
            raise StorageError(
                f"{self._path}: has no function {self._name}_{name}: not compiled from the code in its folder"
            ) from None
        found.restype = returns
        return found

    def _init(self) -> None:
        if self._function("init")(self._real(self.period)) != _OK:
            raise DataError(
                f"{self._path}: made for a sample every {self._made_for * 1e6:g} us, not {self.period * 1e6:g} us: "
                f"export it with --rate {1 / self.period:g}"
            )

    def warm_up(self) -> None:
        """Nothing has to be compiled."""

    def plan(self, reference: np.void) -> None:
        """As of the estimator."""
        self._plan(self._given("reference", reference))

    def step(self, message: bytes) -> int:
        """As of the estimator; torque is zero, of no source, where the library refuses."""
        (sample,) = np.frombuffer(message, SAMPLE.dtype)
        self._step(self._given("sample", sample), self._place("feedforward"))
        return int(self._taken("feedforward", self.feedforward)["flags"])

    def look_back(self) -> int:
        """As of the estimator."""
        if self._look_back(self._place("payload"), self._place("error")) != _OK:
            return -1
        self._taken("error", self.error)
        return int(self._taken("payload", self.payload)["event"])

    def _given(self, topic: str, record: np.void) -> ctypes.c_void_p:
        own = self._records[topic]
        for name in own.dtype.names or ():
            own[name] = record[name]
        return self._place(topic)

    def _taken(self, topic: str, to: np.ndarray) -> np.void:
        own = self._records[topic]
        for name in own.dtype.names or ():
            to[name] = own[name]
        return to[0]

    def _place(self, topic: str) -> ctypes.c_void_p:
        return ctypes.c_void_p(self._records[topic].ctypes.data)
