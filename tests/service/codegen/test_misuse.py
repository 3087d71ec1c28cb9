"""What a controller and a user may do wrong with a generated twin: a code and zeros, or one clear line."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.messages import FeedforwardSource, HealthFlag, SampleFlag
from schemas.robot import save_robot
from service.cli.main import app
from service.codegen import tunable
from service.codegen.folder import read_twin
from service.codegen.twin import to_c
from service.estimator import state
from service.estimator.estimator import Estimator
from tests.known import PERIOD, make, robot
from tests.service.codegen.built import COMPILER, Built, converted, differences, needs_compiler, pointer
from tests.service.codegen.test_twin import with_effects

__all__ = ["make", "robot"]
OK, NOTHING, NOT_READY, WRONG_PERIOD, NO_ARGUMENT, OUT_OF_RANGE = 0, 1, -1, -2, -3, -4


@pytest.fixture(scope="module")
def built(robot, tmp_path_factory) -> Built:
    return Built(robot, PERIOD, tmp_path_factory.mktemp("twin"), "-O0")


def parameters_of(built: Built) -> np.ndarray:
    """(1,) record of the figures that may be loaded, as they are now."""
    fields = [(one.name, "f8", tunable.shape(one)) for one in tunable.LOADABLE]
    record = np.zeros(1, np.dtype(fields, align=True))
    built.library[f"{built.name}_parameters_now"](pointer(record))
    return record


def ones(built: Built, topic: str) -> np.ndarray:
    """(1,) record full of what nobody answered."""
    return np.ones(1, built.dtypes[topic])


def is_zero(answer: np.ndarray) -> bool:
    return not answer["torque"].any() and answer["source"][0] == FeedforwardSource.NONE


@needs_compiler
def test_before_init_and_at_another_rate_every_answer_is_zero(built, make) -> None:
    samples = built.samples(make(0.1).samples)
    answer: np.ndarray = np.ones(1, built.dtypes["feedforward"])
    others: list[np.ndarray] = [np.ones(1, built.dtypes[topic]) for topic in ("payload", "error")]
    for period in (2e-3, 0.9e-3, 0.0, -PERIOD, math.nan, math.inf):
        assert built.init(period) == WRONG_PERIOD
        for n in range(3):
            answer["torque"] = 1.0
            assert built.call("step", samples[n : n + 1], answer) == NOT_READY
            assert is_zero(answer)
        assert built.call("look_back", *others) == NOT_READY
        assert others[0]["mass"][0] == others[1]["full"][0, 0] == 0.0
        assert built.findings()[0] == NOT_READY
        assert built.call("plan", np.zeros(1, built.dtypes["reference"])) == NOT_READY
        assert built.call("load", parameters_of(built)) == NOT_READY
    assert built.init(PERIOD * (1 + 5e-4)) == OK, "a clock is no more exact"
    assert built.call("look_back", *others) == NOTHING


@needs_compiler
def test_no_pointer_is_followed_that_is_none(built) -> None:
    assert built.init() == OK
    answer = ones(built, "feedforward")
    for function, count in (("step", 2), ("look_back", 2), ("plan", 1), ("load", 1), ("findings", 1)):
        assert built.library[f"{built.name}_{function}"](*[None] * count) == NO_ARGUMENT
    assert (
        built.library[f"{built.name}_step"](None, answer.ctypes.data_as(__import__("ctypes").c_void_p)) == NO_ARGUMENT
    )
    assert is_zero(answer)


@needs_compiler
@pytest.mark.parametrize("one", tunable.LOADABLE, ids=lambda one: one.name)
def test_figures_that_no_robot_has_are_refused_and_those_of_before_stay(built, make, one) -> None:
    samples = make(0.2).samples
    assert built.init() == OK
    before, plain = parameters_of(built), built.run(samples)
    for value in (np.nan, np.inf, -np.inf, one.low - abs(one.low) - 1.0, one.high * 2.0):
        wrong = before.copy()
        wrong[one.name].reshape(-1)[-1] = value
        assert built.init() == OK
        assert built.call("load", wrong) == OUT_OF_RANGE
        assert parameters_of(built).tobytes() == before.tobytes()
        assert differences(built.run(samples), plain) == []


@needs_compiler
def test_figures_that_are_loaded_are_those_of_the_service(built, robot, make) -> None:
    other = robot.model_copy(deep=True)
    figures = other.identified.model_copy(
        update={"rho_1": robot.identified.rho_1.model_copy(update={"value": 2.6}),
                "rho_2": robot.identified.rho_2.model_copy(update={"value": 1.3})}
    )  # fmt: skip
    limits = other.limits.model_copy(update={"peak_torque_nm": 60.0, "torque_slope_nmps": 9000.0, "torque_fade_s": 0.1})
    other = other.model_copy(update={"identified": figures, "limits": limits})
    settings = state.settings(other, PERIOD, 1)
    samples = make(1.0, noise=0.25).samples
    samples["position"][600:] = samples["position_command"][600:] = np.nan  # fades
    assert built.init() == OK
    built.run(samples)
    loaded = parameters_of(built)
    for one in tunable.LOADABLE:
        loaded[one.name] = settings[one.name]
    assert built.call("load", loaded) == OK
    # that of the peak, by which a jump is told, is a constant of the twin
    wanted = Estimator(other, PERIOD)
    wanted._steps["settings"]["acceleration"] = state.settings(robot, PERIOD, 1)["acceleration"]
    answers = converted(wanted.run(samples).feedforward, built.dtypes["feedforward"])
    assert differences({"feedforward": built.run(samples)["feedforward"]}, {"feedforward": answers}) == []
    assert answers["flags"][-1] & SampleFlag.NOT_A_NUMBER


@needs_compiler
def test_no_sample_and_time_that_goes_back_make_no_torque_of_their_own(built, make) -> None:
    samples = make(0.6).samples
    empty, answer = ones(built, "sample"), ones(built, "feedforward")
    assert built.init() == OK
    built.run(samples)
    built.library[f"{built.name}_clear"](pointer(empty))
    assert np.isnan(empty["position_command"]).all()
    last = built.samples(samples[-1:])
    for back in range(200):
        last["sequence"] -= 1
        assert built.call("step", last, answer) == OK
        assert answer["flags"][0] & SampleFlag.TIME_BACKWARDS or back > 3, "the source starts over"
    assert np.isfinite(answer["torque"]).all()


@needs_compiler
def test_health_says_what_the_model_does_without(robot, make, tmp_path) -> None:
    late = with_effects(robot, ["torque_delay"])
    late.effect[0].parameters["delay"] = late.effect[0].parameters["delay"].model_copy(update={"value": 0.5})
    told = Built(late, 0.125e-3, tmp_path, "-O0")
    assert list(told.twin.left_out) == ["torque_delay"]
    assert told.init() == OK
    assert told.findings()[0] == HealthFlag.EFFECT_LEFT_OUT


def export(*arguments: str):
    return CliRunner().invoke(app, ["export", *arguments])


def test_a_folder_holds_code_description_and_what_ties_them(robot, tmp_path: Path) -> None:
    save_robot(robot.model_copy(update={"name": "r-1"}), tmp_path / "r.toml")
    told = export(
        str(tmp_path / "r.toml"), "--to", "c", "--rate", "2000", "--name", "cell_3", "--out", str(tmp_path / "t")
    )
    assert told.exit_code == 0, told.output
    assert {path.name for path in (tmp_path / "t").iterdir()} == {
        "cell_3.h",
        "cell_3.c",
        "twin.json",
        "description.toml",
    }
    manifest, described = read_twin(tmp_path / "t")
    assert (manifest.name, manifest.period_s, described.name) == ("cell_3", 0.0005, "r-1")
    assert described.identified == robot.identified
    (tmp_path / "t" / "cell_3.c").write_text((tmp_path / "t" / "cell_3.c").read_text().replace("2.3", "2.4"))
    with pytest.raises(Exception, match=r"cell_3\.h or cell_3\.c was changed after the export"):
        read_twin(tmp_path / "t")


def test_what_was_never_identified_is_refused_unless_it_is_asked_for(robot, tmp_path: Path) -> None:
    save_robot(robot.model_copy(update={"identified": None}), tmp_path / "r.toml")
    arguments = [str(tmp_path / "r.toml"), "--to", "c", "--out", str(tmp_path / "t")]
    told = export(*arguments)
    assert told.exit_code == 1 or told.exception is not None
    assert "r.toml: identified: missing" in str(told.exception)
    assert not (tmp_path / "t").exists()
    assert export(*arguments, "--nominal").exit_code == 0


@pytest.mark.parametrize("to", ["c", "st", "fmu"])
def test_an_effect_that_the_code_does_without_is_named(robot, tmp_path: Path, to: str) -> None:
    late = with_effects(robot, ["torque_delay"])
    late.effect[0].parameters["delay"] = late.effect[0].parameters["delay"].model_copy(update={"value": 0.5})
    save_robot(late, tmp_path / "r.toml")
    told = export(str(tmp_path / "r.toml"), "--to", to, "--rate", "8000", "--out", str(tmp_path / "t"))
    if to == "fmu" and COMPILER is None:
        assert "gcc is not installed" in str(told.exception)
        return
    assert told.exit_code == 0, told.output
    assert re.search(r"^torque_delay is left out: .+", told.output, re.MULTILINE)


def test_a_cycle_that_no_controller_has_is_refused(robot) -> None:
    for period in (0.0, 1.0, 1e-6, math.nan):
        with pytest.raises(Exception, match=r"a cycle of .* s: must be .* to .* s"):
            to_c(robot, period)


@pytest.mark.parametrize("name", ["3d", "a b", "double", "a-b", "", "x" * 32, "é", "*/ int x; /*"])
def test_a_name_that_is_none_in_c_is_refused(robot, tmp_path: Path, name: str) -> None:
    with pytest.raises(Exception, match="--name"):
        to_c(robot, PERIOD, name)


def test_no_text_of_a_description_gets_out_of_its_comment(robot) -> None:
    made = to_c(robot.model_copy(update={"name": "x */ int broken; /*"}), PERIOD)
    assert "int broken" not in made.header.replace("x ?? int broken? ??", "")
    assert "int broken" not in made.source.replace("x ?? int broken? ??", "")
