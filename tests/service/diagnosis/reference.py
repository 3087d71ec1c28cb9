"""The stored diagnosis of three logs: how they are made, what is kept, and how it is written anew.

After a change that is meant to move the results: `uv run python -m tests.service.diagnosis.reference`, and say why in
the commit.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from schemas.trace import Trace
from tests.service.injected import reports
from tests.service.subject import CATALOGUE, diagnose, document
from tests.service.world import ROBOT, course

STORED = Path(__file__).with_name("reference.json")
SECONDS, NOISE, COUNT = 4.0, 0.3, 2 * np.pi / (25 * 2**17)  # s, N m a sample, rad
RELATIVE, ABSOLUTE = 1e-3, 2e-3  # of a value, and of shares and probabilities, whose draws another machine may turn


def run() -> diagnose.Findings:
    """Three logs through the whole diagnosis."""
    traces = []
    for seed in (1, 2, 3):
        made, random = course(seed, SECONDS), np.random.default_rng([seed, 9])
        torque = reports("stribeck_friction", seed, SECONDS) + reports("cogging", seed, SECONDS) - made.torque
        position = np.round((made.motion[0] + 1e-7 * random.standard_normal(torque.shape)) / COUNT) * COUNT
        traces.append(
            Trace(Path(f"run_{seed}"), made.time, position, torque + NOISE * random.standard_normal(torque.shape))
        )
    return diagnose.diagnose(ROBOT, traces, CATALOGUE)


def kept(findings: diagnose.Findings) -> dict[str, Any]:
    """`place in the document` to value, for everything the document says."""
    return dict(_flat("", document.document(findings).model_dump(mode="json", by_alias=True)))


def _flat(place: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [item for key, part in value.items() for item in _flat(f"{place}.{key}" if place else key, part)]
    if isinstance(value, list):
        return [item for key, part in enumerate(value) for item in _flat(f"{place}[{key}]", part)]
    return [(place, value)]


def difference(stored: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """One line a value that moved: where in the document, from what to what."""
    lines = [f"{place}: gone, was {stored[place]}" for place in stored.keys() - now.keys()]
    lines += [f"{place}: new, {now[place]}" for place in now.keys() - stored.keys()]
    for place in stored.keys() & now.keys():
        old, new = stored[place], now[place]
        if isinstance(old, float | int) and isinstance(new, float | int):
            if not np.isclose(old, new, rtol=RELATIVE, atol=ABSOLUTE):
                lines.append(f"{place}: {old:g} stored, {new:g} now, moved by {new - old:+.3g}")
        elif old != new:
            lines.append(f"{place}: {old!r} stored, {new!r} now")
    return sorted(lines)


if __name__ == "__main__":
    found = kept(run())
    for line in difference(json.loads(STORED.read_text()), found) if STORED.exists() else []:
        print(line)
    STORED.write_text(json.dumps(found, indent=1) + "\n")
    print(f"wrote {STORED.name}")
