"""What a diagnosis says, line by line."""

from __future__ import annotations

from schemas.diagnosis import Diagnosis
from service.diagnosis.documents.text import paragraphs


def sentences(document: Diagnosis) -> list[str]:
    """The lines of its paragraphs."""
    return [line for group in paragraphs(document) for line in group]
