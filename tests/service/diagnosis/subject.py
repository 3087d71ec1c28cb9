"""What these tests are about, imported in one place: where it lives is said here and nowhere else."""

from service.diagnosis import cautions, diagnose, document, events, evidence, noise, selection, statistics, where
from service.diagnosis.description import described, torque_along
from service.diagnosis.description import term as term_of
from service.diagnosis.effects import CATALOGUE, by_name
from service.diagnosis.effects.base import Amplitude, Effect, Shape, on_joint
from service.diagnosis.effects.signal import delayed
from service.diagnosis.hypothesis import (
    Fit,
    Hypothesis,
    Problem,
    Term,
    added,
    evaluate,
    fit,
    limits,
    predict,
    reported,
    solve,
    tangent,
    unreported,
)
from service.diagnosis.mechanism import DecoupledAxes, Delta
from service.diagnosis.scene import Band, Base, Recording, Scene
from service.diagnosis.selection import Candidate, Dictionary, Scored, Selection, Split
from service.identification.regression import thin
from service.identification.signals import Segment, lowpass, segments

EFFECTS = by_name(CATALOGUE)

__all__ = [
    "CATALOGUE",
    "EFFECTS",
    "Amplitude",
    "Band",
    "Base",
    "Candidate",
    "DecoupledAxes",
    "Delta",
    "Dictionary",
    "Effect",
    "Fit",
    "Hypothesis",
    "Problem",
    "Recording",
    "Scene",
    "Scored",
    "Segment",
    "Selection",
    "Shape",
    "Split",
    "Term",
    "added",
    "cautions",
    "delayed",
    "described",
    "diagnose",
    "document",
    "evaluate",
    "events",
    "evidence",
    "fit",
    "limits",
    "lowpass",
    "noise",
    "on_joint",
    "predict",
    "reported",
    "segments",
    "selection",
    "solve",
    "statistics",
    "tangent",
    "term_of",
    "thin",
    "torque_along",
    "unreported",
    "where",
]
