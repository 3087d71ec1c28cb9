"""All pages and drawings that are made from the code, by their path under docs/."""

from __future__ import annotations

from docs.making import commands, drawings, effects, figures, messages, models, python
from drivers.simulated.plant.truth import PlantTruth
from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.columns import Columns
from schemas.diagnosis import Diagnosis
from schemas.messages import TOPICS
from schemas.robot import Robot
from service.model.effects import CATALOGUE

FILES = {
    "robot": (Robot, "Delta robot description", "The TOML file of `--robot` for a Delta robot."),
    "axes": (Axes, "Description of axes", 'The TOML file of `--robot` for separate axes, `kind = "axes"`.'),
    "arm": (Chain, "Arm description", 'The TOML file of `--robot` for a serial arm with a URDF, `kind = "chain"`.'),
    "columns": (
        Columns, "Column mapping",
        "How the columns of a foreign table are read: `[columns]` in a robot description, or a separate file for "
        "`--columns`. `deltatwin import` writes one.",
    ),
    "truth": (
        PlantTruth, "Simulated robot",
        "True parameters of the simulated robot, for `deltatwin simulate --truth FILE`. Missing keys are as in the "
        "robot description.",
    ),
    "diagnosis": (Diagnosis, "diagnosis.json", "What `deltatwin diagnose` writes for other programs."),
}  # fmt: skip


def made() -> dict[str, str]:
    """Path -> text, of the whole reference, the tables of figures and the drawings; takes some seconds."""
    found = {
        "reference/commands/index.md": commands.index(),
        "reference/exit-codes.md": commands.exit_codes(),
        "reference/flags.md": messages.flags(),
        "reference/messages/index.md": messages.index(),
        "reference/effects/index.md": effects.index(),
        "explanation/joint-zero.svg": drawings.joint_zero(),
    }
    for names in commands.groups().values():
        found |= {f"reference/commands/{name}.md": commands.page(name) for name in names}
    found |= {f"reference/messages/{topic}.md": messages.page(topic) for topic in TOPICS}
    for name, (model, title, introduction) in FILES.items():
        found[f"reference/files/{name}.md"] = models.page(model, title, introduction)
    if python.is_there():
        found["reference/python.md"] = python.page()
    found["measured/index.md"] = figures.index()
    found |= {f"measured/{name}.md": figures.page(name) for name in figures.benches()}
    for effect in CATALOGUE:
        found[f"reference/effects/{effect.name}.md"] = effects.page(effect)
        found[f"reference/effects/{effect.name}.svg"] = effects.picture(effect)
    return found
