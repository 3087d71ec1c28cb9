"""The online step as code for a controller, made from the kernels that the service itself runs.

A compiler of the language that kernels are written in, which is small: numbers, records, arrays of known shapes, loops
over ranges, calls. It reads their Python text and types it as Numba does, so there is one definition of the step, and a
construct that it does not know stops the export with file and line. (Numba's own typed form has lost its loops and
names by then; what a plant's engineer is to read, and Structured Text can hold, has both.)

`source` a kernel's text, `types` and `tree` what it becomes, `expressions`, `statements`, `program` how, `c` C99 of it,
`layout` which records and how much of them, `parameters` what may be loaded, `twin` the whole of it for one robot.
`st`, `st_functions` Structured Text of it, `pou` its text, `plcopen` its XML, `plc` the whole; `folder` on disk.
"""
