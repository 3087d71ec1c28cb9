"""Process data to joint samples: which bytes are which object, which pass is believed, what the cycle's time is.

`layout` says where the objects lie, `passes` which sight of a frame is believed, `clock` what the time of a cycle is
and what is missing, `assembly` makes the samples: one kernel serves the capture reader (a block of frames a call) and
the live tap (one frame a call).

Which pass is believed. Every cyclic frame can be seen twice: as the master sent it, working counter 0, its input bytes
left over from the cycle before; and as it came back, with the inputs of this cycle. Only a returned frame gives inputs.
Commands are read from the same returned frame, unless inputs and outputs share logical addresses: there the inputs
have overwritten them, and they come from the sent frame of the same datagram index.

What tells the passes apart, in this order: a working counter above 0 is a returned frame; so is the source address with
the bit that the first slave sets, where the master's own address has it clear; so is a port of the analyzer that has
only ever seen answered frames; so is the second sight of one datagram index. Between two slaves both passes are
answered: there the port with the smaller working counter is the way out.

What a missing pass does. A sample's values depend on the frames of its own cycle alone, so two recordings of one bus
that miss different frames agree on every cycle both saw. Returned pass missing: no sample, GAP_BEFORE on the next one,
counted as lost. Sent pass missing: nothing where addresses are not shared; where they are, the sample has no command
(NaN, NO_COMMAND), never that of another cycle: an index comes again, so a sent frame counts for `_FLIGHT` of a cycle.

Time is the distributed clock's where the frame of the first cycle carries it, else the capture's own, of the returned
frame, for the whole stream. Cycles in which the clock's datagram is missing go on by the capture's clock.
"""
