"""A CiA 402 servo drive in software: power state machine, cyclic position and torque modes, faults, a brake."""

from __future__ import annotations

from drivers.ethercat.cia402 import Control, DriveState, Mode, Scale, joint_angle

VOLTAGE_ENABLED, REMOTE, FOLLOWS_COMMAND = 0x0010, 0x0200, 0x1000

_TRANSITIONS = {
    (DriveState.SWITCH_ON_DISABLED, Control.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.READY_TO_SWITCH_ON, Control.SWITCH_ON): DriveState.SWITCHED_ON,
    (DriveState.READY_TO_SWITCH_ON, Control.ENABLE_OPERATION): DriveState.SWITCHED_ON,
    (DriveState.SWITCHED_ON, Control.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.SWITCHED_ON, Control.ENABLE_OPERATION): DriveState.OPERATION_ENABLED,
    (DriveState.OPERATION_ENABLED, Control.SWITCH_ON): DriveState.SWITCHED_ON,
    (DriveState.OPERATION_ENABLED, Control.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.OPERATION_ENABLED, Control.QUICK_STOP): DriveState.QUICK_STOP_ACTIVE,
    (DriveState.QUICK_STOP_ACTIVE, Control.ENABLE_OPERATION): DriveState.OPERATION_ENABLED,
    (DriveState.READY_TO_SWITCH_ON, Control.QUICK_STOP): DriveState.SWITCH_ON_DISABLED,
    (DriveState.SWITCHED_ON, Control.QUICK_STOP): DriveState.SWITCH_ON_DISABLED,
}
_FAULTED = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)


class SimulatedDrive:
    """State of one drive: what it is told on the bus, in the drive's units, turned into what its loops are told, in SI.

    The loops themselves run in the plant. While the drive is not enabled its brake holds the joint at `target`.

    Attributes: state; mode; target, velocity: where the cycle under way ends, rad and rad/s; start, start_velocity:
    where it began; torque: N m that the motor is to add to the loops, or, when not `stiff`, to give alone.
    """

    def __init__(self, scale: Scale, following_error: float, position: float) -> None:
        """`following_error`: rad; a target further off than that trips the drive (0x6065)."""
        self._scale, self._following_error = scale, following_error
        self.state = DriveState.SWITCH_ON_DISABLED
        self.mode = Mode.NONE
        self.torque = 0.0
        self._hold(position)
        self._last_control = 0
        joint_angle(0, scale.zero_counts, scale.radians_per_count)  # compiled before a cycle has to wait for it

    @property
    def enabled(self) -> bool:
        """The motor is under current and follows the bus."""
        return self.state is DriveState.OPERATION_ENABLED

    @property
    def stiff(self) -> bool:
        """The position and velocity loops are closed."""
        return not (self.enabled and self.mode is Mode.CST)

    def receive(
        self, control: int, mode: int, counts: int, torque: int, offset: int, position: float, period: float
    ) -> None:
        """Take the outputs of a cycle of `period` s that begins with the joint at `position` rad."""
        self._walk(control, position)
        self.mode = Mode(mode) if mode in (Mode.CSP, Mode.CST) else Mode.NONE
        self.start, self.start_velocity = self.target, self.velocity
        if not self.enabled:
            return
        unit = self._scale.torque_nm_per_mille
        if self.mode is Mode.CST:
            self._hold(position)
            self.torque = (torque + offset) * unit
        elif self.mode is Mode.CSP:
            self.target = joint_angle(counts, self._scale.zero_counts, self._scale.radians_per_count)
            self.velocity = (self.target - self.start) / period
            self.torque = offset * unit
            if abs(self.target - position) > self._following_error:
                self.trip(position)
        else:
            self._hold(self.target)
            self.torque = 0.0

    def trip(self, position: float) -> None:
        """Fault: the motor is without current, the brake takes the joint where it is."""
        if self.state not in _FAULTED:
            self.state = DriveState.FAULT_REACTION_ACTIVE
            self._brake(position)

    def release(self, position: float) -> None:
        """The bus is out of operation: no motor torque, the brake holds. A fault stays."""
        if self.state not in _FAULTED:
            if self.state in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE):
                self._brake(position)
            self.state = DriveState.SWITCH_ON_DISABLED

    def statusword(self) -> int:
        """0x6041."""
        word = self.state | REMOTE
        if self.state not in (DriveState.SWITCH_ON_DISABLED, *_FAULTED):
            word |= VOLTAGE_ENABLED
        if self.enabled and self.mode is not Mode.NONE:
            word |= FOLLOWS_COMMAND
        return word

    def _walk(self, control: int, position: float) -> None:
        if self.state is DriveState.FAULT_REACTION_ACTIVE:
            self.state = DriveState.FAULT
        reset = control & Control.FAULT_RESET and not self._last_control & Control.FAULT_RESET
        self._last_control = control
        if self.state is DriveState.FAULT:
            if reset:
                self.state = DriveState.SWITCH_ON_DISABLED
            return
        was_enabled = self.enabled
        if not control & 0x02:
            self.state = DriveState.SWITCH_ON_DISABLED
        else:
            self.state = _TRANSITIONS.get((self.state, _command(control)), self.state)
        if was_enabled and not self.enabled:
            self._brake(position)

    def _brake(self, position: float) -> None:
        self._hold(position)
        self.torque = 0.0

    def _hold(self, position: float) -> None:
        self.target = self.start = position
        self.velocity = self.start_velocity = 0.0


def _command(control: int) -> Control:
    """The state machine's command in a control word (CiA 402, table of commands)."""
    if not control & 0x04:
        return Control.QUICK_STOP
    if not control & 0x01:
        return Control.SHUTDOWN
    return Control.ENABLE_OPERATION if control & 0x08 else Control.SWITCH_ON
