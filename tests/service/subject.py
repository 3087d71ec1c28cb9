"""What these tests are about, imported in one place: where it lives is said here and nowhere else."""

from service.diagnosis import pipeline as diagnose
from service.diagnosis.documents import document
from service.diagnosis.evidence import cautions, statistics, where
from service.diagnosis.evidence import rivals as evidence
from service.diagnosis.fit import candidates, selection
from service.diagnosis.fit.candidates import Candidate, Dictionary, Regressors
from service.diagnosis.fit.selection import Scored, Selection
from service.identification import events, noise
from service.identification.fit import Fit, Problem, evaluate, fit, solve
from service.identification.folds import Split
from service.model.description import described, terms_of, torque_along
from service.model.effects import CATALOGUE, by_name
from service.model.effects.base import Amplitude, Effect, Nonlinear, on_joint
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import DecoupledAxes, Delta
from service.model.parameters import Parameters
from service.model.scene import Base, Recording, Scene
from service.model.signals import Band, Segment, delayed, lowpass, segments, thin
from service.model.torque import added, predict, reported, tangent, unreported

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
    "Nonlinear",
    "Parameters",
    "Problem",
    "Recording",
    "Regressors",
    "Scene",
    "Scored",
    "Segment",
    "Selection",
    "Split",
    "Term",
    "added",
    "candidates",
    "cautions",
    "delayed",
    "described",
    "diagnose",
    "document",
    "evaluate",
    "events",
    "evidence",
    "fit",
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
    "terms_of",
    "thin",
    "torque_along",
    "unreported",
    "where",
]
