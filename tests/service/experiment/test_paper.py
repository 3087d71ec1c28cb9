"""The paper's experiment, shortened: the models improve as they should, and the report holds what it promises."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drivers.motion import Planner
from drivers.plant.effects import make_effects
from drivers.plant.plant import Plant
from drivers.plant.truth import TRUTHS, load_truth
from schemas.robot import load_robot
from service.experiment.logs import excitations, record
from service.experiment.paper import PUBLISHED, Findings, comparison, page, run
from service.experiment.pictures import Figure, Table, write_page, write_pictures
from service.identification.evaluation import WITH_PAYLOAD


@pytest.fixture(scope="module")
def found() -> Findings:
    robot = load_robot("d3-1200")
    truth = load_truth(TRUTHS / "d3-1200-paper.toml", robot)
    plant = Plant(robot, truth, make_effects(truth.effect, "truth"), seed=2)
    planner = Planner(robot, 1e-3)
    rng = np.random.default_rng(2)
    picking = planner.pick_and_place(rng, 5.0, (3.8,), speed=0.4)
    logs = record(plant, excitations(planner, rng, 4, 4.0), "identification")
    (stress,) = record(plant, iter([planner.multisine(rng, 6.0)]), "upsilon_F")
    (picks,) = record(plant, iter([picking]), "upsilon_P")
    return run(robot, logs, stress, picks, picking.payloads)


def test_every_model_improves_on_the_one_before_as_in_the_paper(found: Findings) -> None:
    errors = found.stress.errors
    for joint in range(3):
        spread = [errors[model].std[joint] for model in PUBLISHED]
        assert spread[0] > spread[1] > 2 * spread[2]
        # about as far off as the real robot: that is how the plant was chosen
        assert 0.5 < spread[0] / PUBLISHED["M_KH"][joint][1] < 1.6
        assert abs(errors["M_KH"].mean[joint] - PUBLISHED["M_KH"][joint][0]) < 5.0


def test_payload_takes_error_away(found: Findings) -> None:
    without, aware = found.picks.errors["full"].rms, found.picks.errors[WITH_PAYLOAD].rms
    assert np.sqrt((aware**2).mean()) < 0.8 * np.sqrt((without**2).mean())
    assert all(score.seen < 0.2 for score in found.scores)


def test_report_holds_tables_and_figures(found: Findings, tmp_path: Path) -> None:
    report = page(found, "truth of this test")
    titles = [part.title for part in report.parts]
    assert [title.split(":")[0] for title in titles if title.startswith(("Table", "Figure"))] == [
        "Table 1", "Table 2", *(f"Figure {number}" for number in range(3, 9)),
    ]  # fmt: skip
    table = comparison(found)
    assert [row[4:] for row in table.rows if row[1] == "M_KH"] == [
        ("14.32", "23.97"), ("7.98", "20.30"), ("6.62", "20.23"),
    ]  # fmt: skip
    write_page(report, tmp_path / "experiment.html")
    text = (tmp_path / "experiment.html").read_text(encoding="utf-8")
    assert "Every measurement here is simulated" in text
    assert text.count("Plotly.newPlot") >= 6
    assert 'src="http' not in text
    for part in report.parts:
        if isinstance(part, Table):
            assert all(cell in text for row in part.rows for cell in row if "'" not in cell)
    figures = [part for part in report.parts if isinstance(part, Figure)]
    write_pictures(figures, tmp_path, "experiment")
    pages = re.findall(rb"/Type /Page\b", (tmp_path / "experiment.pdf").read_bytes())
    assert len(pages) == len(figures) == 6
    for figure in figures:
        with Image.open(tmp_path / f"{figure.name}.png") as picture:
            levels = np.asarray(picture.convert("L"))
        assert min(levels.shape) > 300
        assert (levels < 128).mean() > 0.002  # something is drawn
