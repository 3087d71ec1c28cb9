"""EtherCAT slave controller (ESC) in software: registers, SII access, FMMUs, sync managers, AL states, watchdog, clock.

Register addresses and bits: Beckhoff ESC data sheet section II, ETG.1000.4 and ETG.1000.6. Process data only: no
mailbox, byte-wise FMMUs, sync manager 0 for outputs and 1 for inputs.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass

from drivers.ethercat.frames import AL_CONTROL, AL_STATUS, DC_SYSTEM_TIME, FMMU, AlState
from drivers.simulated.segment.sii import INPUT_ADDRESS, OUTPUT_ADDRESS

STATION_ADDRESS = 0x0010
DL_STATUS = 0x0110
AL_STATUS_CODE = 0x0134
WATCHDOG_DIVIDER = 0x0400
WATCHDOG_TIME = 0x0420  # process data
WATCHDOG_STATUS = 0x0440
EEPROM_CONTROL = 0x0502
EEPROM_ADDRESS = 0x0504
EEPROM_DATA = 0x0508
SYNC_MANAGER = 0x0800
DC_RECEIVE_TIME = 0x0900
DC_RECEIVE_TIME_UNIT = 0x0918
DC_OFFSET = 0x0920

MEMORY_BYTES = 0x3000
FMMUS, SYNC_MANAGERS = 4, 4

_DESCRIPTION = bytes((0x11, 0x00, 0x02, 0x00, FMMUS, SYNC_MANAGERS, 8, 0x0F, 0x0C, 0x00))  # 8 KiB, DC with 64 bits
_READ_ONLY = ((0x0000, 0x0010), (DL_STATUS, 0x0112), (AL_STATUS, 0x0138), (WATCHDOG_STATUS, 0x0442))
_EEPROM_READS_8, _EEPROM_ERROR = 0x0040, 0x2000


_STATES = frozenset(AlState)
ERROR = 0x10  # error indication in AL status, acknowledgement in AL control


class Code(enum.IntEnum):
    """AL status codes."""

    OK = 0x0000
    INVALID_STATE_CHANGE = 0x0011
    UNKNOWN_STATE = 0x0012
    BOOT_NOT_SUPPORTED = 0x0013
    NO_VALID_OUTPUTS = 0x0019
    WATCHDOG = 0x001B
    INVALID_OUTPUT_CONFIGURATION = 0x001D
    INVALID_INPUT_CONFIGURATION = 0x001E


@dataclass(frozen=True)
class Mapping:
    """One active FMMU: logical bytes [start, end) are the slave's memory from `physical` on."""

    start: int
    end: int
    physical: int


class SlaveController:
    """One slave's memory and what happens when it is read or written.

    `local_time` gives the slave's free-running clock in ns.
    """

    def __init__(
        self, sii: bytes, output_bytes: int, input_bytes: int, local_time: Callable[[], int], port_open: bool
    ) -> None:
        self._sii = sii + b"\xff" * 8
        self._output_bytes, self._input_bytes = output_bytes, input_bytes
        self._local_time = local_time
        self._received_time = 0
        self.memory = bytearray(MEMORY_BYTES)
        self.memory[: len(_DESCRIPTION)] = _DESCRIPTION
        self.outputs = memoryview(self.memory)[OUTPUT_ADDRESS : OUTPUT_ADDRESS + output_bytes]
        self.inputs = memoryview(self.memory)[INPUT_ADDRESS : INPUT_ADDRESS + input_bytes]
        self.output_mappings: tuple[Mapping, ...] = ()
        self.input_mappings: tuple[Mapping, ...] = ()
        self.station_address = 0
        self.state = AlState.INIT
        self.outputs_written_ns = 0  # local time; 0: not since SAFEOP was entered
        self._put(AL_STATUS, "<H", AlState.INIT)
        self._put(WATCHDOG_DIVIDER, "<H", 2498)  # 100 us
        self._put(WATCHDOG_TIME, "<H", 1000)  # 100 ms
        self._put(WATCHDOG_STATUS, "<H", 1)
        self._put(EEPROM_CONTROL, "<H", _EEPROM_READS_8)
        self.set_port(port_open)

    def set_port(self, downstream: bool) -> None:
        """Port 0 leads to the master; port 1 is open when `downstream`, else its loop is closed."""
        self._put(DL_STATUS, "<H", 0x5A31 if downstream else 0x5611)

    def read(self, address: int, length: int) -> memoryview | None:
        """What the slave puts into a read datagram; None when the range is not all memory."""
        if address + length > MEMORY_BYTES:
            return None
        if address <= DC_SYSTEM_TIME < address + length:
            self._put(DC_SYSTEM_TIME, "<Q", self.system_time & 0xFFFFFFFFFFFFFFFF)
        return memoryview(self.memory)[address : address + length]

    def write(self, address: int, data: memoryview) -> bool:
        """Take a write datagram's data; False when the range is not writable memory."""
        end = address + len(data)
        if end > MEMORY_BYTES or any(address < stop and start < end for start, stop in _READ_ONLY):
            return False
        if address == DC_RECEIVE_TIME:  # a write latches the receive times instead of storing
            self._received_time = self._local_time()
            self._put(DC_RECEIVE_TIME, "<I", self._received_time & 0xFFFFFFFF)
            self._put(DC_RECEIVE_TIME_UNIT, "<Q", self._received_time)
            return True
        if DC_SYSTEM_TIME <= address < DC_RECEIVE_TIME_UNIT:  # drift compensation has nothing to compensate here
            return True
        self.memory[address:end] = data
        if AL_CONTROL <= address < AL_CONTROL + 2:
            self._request(self._get(AL_CONTROL, "<H"))
        elif address <= EEPROM_CONTROL + 1 and end > EEPROM_CONTROL:
            self._eeprom()
        elif address <= STATION_ADDRESS + 1 and end > STATION_ADDRESS:
            self.station_address = self._get(STATION_ADDRESS, "<H")
        elif FMMU <= address < FMMU + 16 * FMMUS:
            self._map()
        return True

    @property
    def system_time(self) -> int:
        """Distributed clock, ns: local time plus the offset the master wrote."""
        return self._local_time() + self._get(DC_OFFSET, "<q")

    def outputs_written(self) -> None:
        """The output sync manager's last byte was written: feed the watchdog."""
        self.outputs_written_ns = self._local_time()
        self.memory[WATCHDOG_STATUS] = 1

    def watchdog_expired(self) -> bool:
        """In OP without outputs for longer than the watchdog time: SAFEOP with an error."""
        timeout = self._get(WATCHDOG_TIME, "<H") * (self._get(WATCHDOG_DIVIDER, "<H") + 2) * 40
        expired = self.state is AlState.OP and 0 < timeout < self._local_time() - self.outputs_written_ns
        if expired:
            self.memory[WATCHDOG_STATUS] = 0
            self._enter(AlState.SAFEOP, Code.WATCHDOG)
        return expired

    def _request(self, control: int) -> None:
        wanted = control & 0x0F
        failed = bool(self.memory[AL_STATUS] & ERROR)
        if failed and not control & ERROR:
            return  # an error has to be acknowledged before anything else
        if wanted not in _STATES:
            self._enter(self.state, Code.UNKNOWN_STATE)
        elif wanted == AlState.BOOT:
            self._enter(self.state, Code.BOOT_NOT_SUPPORTED)
        elif wanted <= self.state:
            self._enter(AlState(wanted), Code.OK)
        else:
            self._climb(AlState(wanted))

    def _climb(self, wanted: AlState) -> None:
        if (self.state, wanted) == (AlState.INIT, AlState.PREOP):
            self._enter(wanted, Code.OK)
        elif (self.state, wanted) == (AlState.PREOP, AlState.SAFEOP):
            outputs = self._sync_manager(0) == (OUTPUT_ADDRESS, self._output_bytes)
            inputs = self._sync_manager(1) == (INPUT_ADDRESS, self._input_bytes)
            if not outputs:
                self._enter(self.state, Code.INVALID_OUTPUT_CONFIGURATION)
            elif not inputs:
                self._enter(self.state, Code.INVALID_INPUT_CONFIGURATION)
            else:
                self.outputs_written_ns = 0
                self._enter(wanted, Code.OK)
        elif (self.state, wanted) == (AlState.SAFEOP, AlState.OP):
            self._enter(wanted, Code.OK) if self.outputs_written_ns else self._enter(self.state, Code.NO_VALID_OUTPUTS)
        else:
            self._enter(self.state, Code.INVALID_STATE_CHANGE)

    def _enter(self, state: AlState, code: Code) -> None:
        self.state = state
        self._put(AL_STATUS, "<H", state | (ERROR if code else 0))
        self._put(AL_STATUS_CODE, "<H", code)

    def _sync_manager(self, number: int) -> tuple[int, int]:
        start, length, _control, _status, activate = struct.unpack_from(
            "<HHBBB", self.memory, SYNC_MANAGER + 8 * number
        )
        return (start, length) if activate & 1 else (0, 0)

    def _map(self) -> None:
        outputs, inputs = [], []
        for number in range(FMMUS):
            start, length, first_bit, last_bit, physical, physical_bit, kind, active = struct.unpack_from(
                "<IHBBHBBB", self.memory, FMMU + 16 * number
            )
            fits = physical + length <= MEMORY_BYTES and (first_bit, last_bit, physical_bit) == (0, 7, 0)
            if active & 1 and length and fits:
                (outputs if kind & 2 else inputs).append(Mapping(start, start + length, physical))
        self.output_mappings, self.input_mappings = tuple(outputs), tuple(inputs)

    def _eeprom(self) -> None:
        command = self._get(EEPROM_CONTROL, "<H") >> 8 & 0x07
        status = _EEPROM_READS_8
        if command == 1:
            start = 2 * self._get(EEPROM_ADDRESS, "<I")
            self.memory[EEPROM_DATA : EEPROM_DATA + 8] = self._sii[start : start + 8].ljust(8, b"\xff")
        elif command:
            status |= _EEPROM_ERROR  # writing or reloading: this EEPROM is read-only
        self._put(EEPROM_CONTROL, "<H", status)

    def _get(self, address: int, layout: str) -> int:
        return struct.unpack_from(layout, self.memory, address)[0]

    def _put(self, address: int, layout: str, value: int) -> None:
        struct.pack_into(layout, self.memory, address, value)
