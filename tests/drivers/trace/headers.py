"""What KUKA and CODESYS write round their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np


def kuka_header(signals: Sequence[str], time: str, file: str, rows: int) -> str:
    """Of `file`, which holds one block of `rows` of `signals`; `time`, its name, is implied, 2 ms a row."""
    header = ["DIAEXTENDED  {@:ENGLISH}", "#BEGINGLOBALHEADER", "1,WINDOWS", "#ENDGLOBALHEADER"]
    header += ["#BEGINCHANNELHEADER", f"200,{time}", "202,s", "210,IMPLIZIT", f"220,{rows}", "240,0", "241,0.002"]
    header += ["#ENDCHANNELHEADER"]
    for k, name in enumerate(signals, 1):
        header += ["#BEGINCHANNELHEADER", f"200,{name}", "202,°", "210,EXPLIZIT", f"211,{file}", "213,BLOCK"]
        header += ["214,REAL64", f"220,{rows}", f"221,{k}", "240,0", "241,1", "#ENDCHANNELHEADER"]
    return "\r\n".join(header)


def codesys_trace(signals: Mapping[str, Sequence[float]], time: np.ndarray) -> tuple[str, str]:
    """The CSV and the XML of a trace. time: (N,) s, which is written in us."""
    lines = ["[key]; [value]", "Version; 0x03050000", "Name; Application.Trace", "Flags; 32"]
    xml = '<Trace><C><Single Name="MicroSeconds" Type="bool">True</Single></C><TraceData><TraceRecord>'
    stamps = [round(t * 1e6) for t in time.tolist()]
    for k, (name, values) in enumerate(signals.items()):
        lines += [f"{k}.Variable; {name}", f"{k}.GraphColor; 4278190080", f"{k}.Data; "]
        lines += [f"; {stamp}; {value!r}" for stamp, value in zip(stamps, values, strict=True)]
        xml += f'<TraceVariable VarName="{name}" Type="System.Double"><Values>{",".join(map(repr, values))}</Values>'
        xml += f"<Timestamps>{','.join(map(str, stamps))}</Timestamps></TraceVariable>"
    return "\n".join(lines), xml + "</TraceRecord></TraceData></Trace>"
