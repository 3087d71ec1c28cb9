"""The document that `diagnose` writes, `diagnosis.json`."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Verdict = Literal["within_noise", "explained", "partly_explained", "unexplained"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Estimate(_Section):
    """One parameter with its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]


class NamedEffect(_Section):
    """An effect that the data support. joints count from 1, empty where the effect sits on no single joint.

    probability: share of block-bootstrap draws of the data in which it, and no rival or nothing, predicts best.
    gap_share: of the gap's energy above the noise that it removes on data left out.
    """

    name: str
    joints: list[int]
    probability: float
    parameters: dict[str, Estimate]
    gap_share: float
    confusable_with: list[str]
    settles: str
    online: str


class Ranked(_Section):
    """A candidate, named or not."""

    name: str
    joints: list[int]
    probability: float
    after_nm: float


class Gap(_Section):
    """Rms a joint on runs left out of fitting and selection, in the analysis band. unit: N m, N for linear axes."""

    unit: str
    before_nm: list[float]
    after_nm: list[float]
    noise_floor_nm: list[float]
    reversal_nm: list[float]
    shrink: float
    shrink_ci95: tuple[float, float]
    shrink_of_explainable: float | None
    band_hz: float


class Burst(_Section):
    """A stretch in which the gap of a joint (from 1) stands far above the rest: an event, not a property.

    over_noise: its rms, slow parts taken out, over the noise floor.
    """

    run: str
    joint: int
    from_s: float
    to_s: float
    over_noise: float


class Shrunk(_Section):
    """Rms a joint by the model before and after, in the analysis band."""

    before_nm: list[float]
    after_nm: list[float]
    shrink: float
    shrink_ci95: tuple[float, float]


class Unseen(_Section):
    """A log kept out of everything. bursts: of the corrected model's gap there, and the period in s that most keep.

    outside: without the bursts, where there are any. outside_share: of the moving time that is left then.
    """

    trace: str
    whole: Shrunk
    bursts: list[Burst]
    rhythm_s: float | None
    outside: Shrunk | None
    outside_share: float


class Diagnosis(_Section):
    """Where the gap lies, which effect causes it, how far it shrinks.

    plain: parameters of the base model fitted without effects. base: refitted together with the effects. tests: the
    correction on logs given for that alone.
    """

    schema_: Literal["deltatwin.diagnosis/1"] = Field("deltatwin.diagnosis/1", alias="schema")
    robot: str
    traces: list[str]
    verdict: Verdict
    effects: list[NamedEffect]
    cannot_tell: list[str]
    ranking: list[Ranked]
    probability_none: float
    probability_unknown: float
    plain: dict[str, float]
    base: dict[str, Estimate]
    where: dict[str, Any]
    gap: Gap
    tests: list[Unseen] = []
    notes: list[str]
