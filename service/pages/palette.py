"""What does a colour mean? One meaning each, on every page, picture and plot.

Each stands out from white and from dark paper by 3 to 1 or more (WCAG 2.2, graphical objects).
"""

from __future__ import annotations

from enum import StrEnum


class Colour(StrEnum):
    """A meaning, and the colour that it has."""

    MEASURED = "#000000"  # what was recorded, or is true of a simulated robot; the page's ink on dark paper
    AFTER = "#1f6feb"  # the model at hand: corrected, with everything in it
    BEFORE = "#c2690b"  # the identified model, which the correction starts from
    WITHOUT_FRICTION = "#8a6d3b"  # the identified model as far as its masses go
    TEXTBOOK = "#1b8a9e"  # the model as drawn up, before anything is identified
    FEEDBACK = "#8250df"  # a controller without feed-forward
    FAULT = "#d1242f"  # what nothing explains, was rejected, or has failed
    NOISE = "#868e97"  # what noise alone would make
    REVERSAL = "#c9509c"  # friction that turns over between two samples
    REFITTED = "#7a7f00"  # what refitting the base model changes
    PAYLOAD = "#a65e2e"  # the mass that the robot carries
    PICK = "#1a8f4c"
    RELEASE = "#b83280"
    EFFECT_1 = "#0f857a"
    EFFECT_2 = "#5b6bc0"
    EFFECT_3 = "#c2255c"
    EFFECT_4 = "#96569f"
    JOINT_1 = "#2b8a3e"
    JOINT_2 = "#9a6700"
    JOINT_3 = "#9c4fd6"


EFFECTS = (Colour.EFFECT_1, Colour.EFFECT_2, Colour.EFFECT_3, Colour.EFFECT_4)  # of one robot, in their order
JOINTS = (Colour.JOINT_1, Colour.JOINT_2, Colour.JOINT_3)


def faint(colour: Colour) -> str:
    """The colour of a band around a line of `colour`."""
    red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, 0.22)"
