"""A torque that the drive makes anew only every few samples and holds between, where it is taken as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from service.model.signals import Segment, stands


def held_s(parts: Sequence[Segment]) -> float:
    """s for which each torque of a log stands before the next, by its `parts` as they were logged; 0 where it does
    not."""
    samples = stands(parts)
    return samples * parts[0].period if samples > 1 else 0.0


def told_of_held(held: Mapping[str, float]) -> list[str]:
    """What to say of logs. held: `held_s` by name."""
    logs: dict[str, list[str]] = {}
    for name, seconds in held.items():
        if seconds:
            logs.setdefault(f"{1e3 * seconds:.3g}", []).append(name)
    return [
        f"{', '.join(names)}: the torque is updated only every {every} ms and repeated in between. The "
        "repeated samples are late but used: log the torque with every sample; `deltatwin diagnose` does not use them"
        for every, names in logs.items()
    ]
