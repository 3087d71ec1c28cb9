"""Column mapping: how a foreign table's columns and units become joint-side SI."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Columns(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
