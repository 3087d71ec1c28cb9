"""What is remembered from frame to frame, as one record that the kernels read and write in place."""

from __future__ import annotations

import numpy as np

from drivers.ethercat.process_data.object_layout import INPUT_SHAPE, OUTPUT_SHAPE

INTERVALS = 64  # cycles whose median step is the cycle time
NEVER = -(1 << 62)

# What has been counted since the state was made.
COUNTS = np.dtype(
    [
        ("samples", "i8"),
        ("sent", "i8"),  # frames with process data on their way out
        ("returned", "i8"),
        ("counter_faults", "i8"),  # cycles whose working counter was too low
        ("unanswered", "i8"),  # of these: nobody answered
        ("not_enabled", "i8"),  # cycles in which a drive was not in operation
        ("drive_faults", "i8"),  # of these: in fault
        ("gaps", "i8"),  # samples that came later than the next cycle
        ("lost", "i8"),  # cycles missing in the gaps, without those that only were late
        ("incomplete", "i8"),  # cycles of which a part never came
        ("damaged", "i8"),  # frames left out: marked by the analyzer, snapped, or not as long as they say
        ("backwards", "i8"),
        ("repeated", "i8"),
        ("pauses", "i8"),  # gaps in which the master sent nothing
        ("missing", "i8"),  # cycles since the last sample that were sent and did not come back
    ],
    align=True,
)

UNDECIDED, CAPTURE_CLOCK, DISTRIBUTED_CLOCK = range(3)

CLOCK = np.dtype(
    [
        ("last", "i8"),  # ns, stamp of the last sample
        ("period", "i8"),  # ns, 0 while unknown
        ("mode", "i8"),  # whose clock the stamps are of
        ("dc_last", "i8"),  # distributed clock, ns, as last read
        ("dc_offset", "i8"),  # and what it was ahead of the capture's
        ("dc_now", "i8"),  # of the cycle in the making, 0 while it has none
        ("owed", "i8"),  # cycles counted as lost that may only be late
        ("slip", "i8"),  # ns that the cycles behind a gap are late
        ("since", "i8"),  # sample with which they began
        ("steps", "i8"),  # intervals taken
    ],
    align=True,
)

_PASSES = np.dtype(
    [
        ("plain_seen", "i8"),  # a source address without the first slave's bit was seen
        ("highest", "i8"),  # working counter of any port
        ("fault", "i8"),  # of the cycle in the making
        ("sent", "i8"),  # cycles on their way since the last sample
        ("sent_index", "i8"),  # datagram index of the newest, and when, ns
        ("sent_ns", "i8"),
        ("back_index", "i8"),  # the same of the last frame that came back
        ("back_ns", "i8"),
    ],
    align=True,
)
_SEEN = np.dtype([(name, "i8") for name in ("command", "address", "expected", "higher", "run")], align=True)
_PORT = np.dtype([(name, "i8") for name in ("answered", "silent", "highest")], align=True)

STATE = np.dtype(
    [
        ("counts", COUNTS),
        ("clock", CLOCK),
        ("passes", _PASSES),
        ("intervals", "i8", INTERVALS),  # ns
        ("raw_inputs", "i8", INPUT_SHAPE),  # of the cycle in the making
        ("have_inputs", "i8", INPUT_SHAPE),
        ("last_inputs", "i8", INPUT_SHAPE),  # of the cycle before
        ("raw_outputs", "i8", OUTPUT_SHAPE),
        ("have_outputs", "i8", OUTPUT_SHAPE),
        ("sent_outputs", "i8", (256, *OUTPUT_SHAPE)),  # by datagram index
        ("outputs_at", "i8", (256, *OUTPUT_SHAPE)),  # ns, when they were sent, NEVER once they came back
        ("sent_at", "i8", 256),  # ns, by datagram index: when a frame was sent, NEVER once it came back
        ("counters", _SEEN, 16),  # highest working counter seen; a higher one, how often in a row
        ("ports", _PORT, 256),  # answered frames, silent frames, highest working counter
    ],
    align=True,
)


def new_state() -> np.ndarray:
    """(1,) record of STATE that has seen nothing."""
    state = np.zeros(1, STATE)
    state["outputs_at"] = state["sent_at"] = NEVER
    return state


def counts_of(state: np.ndarray) -> np.ndarray:
    """(len(COUNTS),) int64 view of what `state` has counted."""
    return state["counts"].view(np.int64)
