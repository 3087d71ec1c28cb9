"""Every command, key of a file, message, flag and effect has its reference page, and the page says all of it.

What is to be there comes from another side than the page: the text of `--help`, the JSON schema, the dtype.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from docs.making import commands, effects, messages, models
from docs.making.markdown import prose
from docs.making.pages import FILES
from schemas.messages import TOPICS, HealthFlag, SampleFlag
from service.cli.main import app, summaries
from service.model.effects import CATALOGUE, NAMES
from service.model.effects.base import Effect


@pytest.mark.parametrize("name", sorted(summaries()))
def test_every_option_of_a_command(name: str) -> None:
    shown = CliRunner().invoke(app, [name, "--help"]).stdout
    page = commands.page(name)
    options = set(re.findall(r"^  (--[a-z-]+)", shown, re.MULTILINE))
    assert "--help" in options
    assert [option for option in options if f"`{option}" not in page] == []
    assert all(f"$ {line.strip()}"[:40] in page for line in re.findall(r"Example: (deltatwin .*)", shown))
    assert f"[`{name}`]({name}.md)" in commands.index()


@pytest.mark.parametrize("name", FILES)
def test_every_key_of_a_file(name: str) -> None:
    model, title, introduction = FILES[name]
    page = models.page(model, title, introduction)
    schema = model.model_json_schema()
    for table in [schema, *schema.get("$defs", {}).values()]:
        for key in table.get("properties", {}):
            assert re.search(rf"\| `(?:[\w.<>\[\]]+\.)?{key}` \|", page), f"{table['title']}.{key}"


@pytest.mark.parametrize("name", [name for name in FILES if name != "diagnosis"])
def test_every_key_that_a_user_writes_says_what_it_is(name: str) -> None:
    unsaid = [key.path for key in models.keys(FILES[name][0]) if not key.meaning and not key.inner]
    assert unsaid == [], "a comment beside the field, in the model"


def test_bounds_and_defaults_of_keys() -> None:
    page = models.page(*FILES["robot"])
    assert "| `active_link_length` | number, > 0 | `required` | m, from the joint's axis to the elbow |" in page
    assert "| `arm_angles_deg` | list of number, 3 entries | `[0.0, 120.0, 240.0]` |" in page
    assert "| `drive` | table |  | The conversion between bus and joint |" in page
    assert "`[drive.joint[]]`" in page
    assert "| `sign` | `1` or `-1` | `required` |" in page


@pytest.mark.parametrize("topic", TOPICS)
def test_every_field_of_a_message(topic: str) -> None:
    page = messages.page(topic)
    dtype = TOPICS[topic].dtype
    fields: Any = dtype.fields
    for name in set(dtype.names or ()) - {"cdr_header", "stamp_sec", "stamp_nanosec", "frame_id"}:
        offset = fields[name][1]
        assert re.search(rf"\| `{name}` \| `\w+(\[\d+\])?` \| {offset} \|", page), name
    assert f"[`{topic}`]({topic}.md)" in messages.index()


def test_every_flag_says_what_it_means() -> None:
    page = messages.flags()
    for flag in [*SampleFlag, *HealthFlag]:
        assert re.search(rf"\| `{flag.name}` \| {int(flag)} \| \w", page), flag


def test_every_effect_has_a_page() -> None:
    assert [effect.name for effect in CATALOGUE] == list(NAMES)
    for effect in CATALOGUE:
        page = effects.page(effect)
        assert effect.settles in page
        assert "## Check on the machine\n\nNothing" not in page
        for name in [*effect.amplitudes, *effect.nonlinear]:
            assert f"| `{name}` |" in page
        for heading in ("Physics and equation", "Check on the machine", "Parameters", "What it is confused with"):
            assert f"## {heading}\n" in page, effect.name
        physics = page.partition("## Physics and equation")[2].partition("\n## ")[0]
        assert "<mo>&#x0003D;</mo>" in physics, f"{effect.name}: no equation"
        assert f"[`{effect.name}`]({effect.name}.md)" in effects.index()


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_a_page_of_an_effect_has_equations_and_no_names_of_the_code(effect: Effect) -> None:
    """No equation in letters of a keyboard; between grave accents nothing but effects, parameters and commands."""
    said = inspect.getmodule(type(effect)).__doc__ or ""  # type: ignore[union-attr]
    text = re.sub(r"\$\$?.+?\$\$?", "", said, flags=re.DOTALL)
    ascii_only = r"\w_\w|_dot|\b(?:theta|delta|epsilon|omega|tau|rho|alpha|sigma)\b|\^|\s=\s|sign v"
    plain = re.sub(r"`\w+`", "", text)
    assert not re.search(ascii_only, plain), f"{effect.name}: {re.findall(ascii_only, plain)}"
    named = set(re.findall(r"`(\w+)`", text))
    assert named <= {*NAMES, *effect.amplitudes, *effect.nonlinear}, effect.name
    assert "$" not in effects.page(effect)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_a_page_of_an_effect_opens_with_one_sentence_and_says_where_it_acts(effect: Effect) -> None:
    page = effects.page(effect)
    opening = page.partition("\n![")[0].partition("\n")[2]
    assert opening.split("\n") == ["", f"**{effect.in_words}.**", ""]
    assert page.count(f"{effect.in_words}.") == 1
    reaches_others = effect.per_joint and not effect.own_joint
    assert ("Each joint has its own value; its torque appears in other joints, too." in page) == reaches_others
    assert ("It acts on single joints." in page) == (effect.per_joint and effect.own_joint)


def test_equations_are_part_of_their_sentence() -> None:
    markdown = pytest.importorskip("markdown", reason="needs the dependency group docs: uv sync --group docs")
    page = prose("a $x_1$ of\n$b < *c*$ and $$y = x^2$$ `_code_` $1/2$")
    drawn = markdown.markdown(page)
    assert drawn.count("<p>") == 1
    assert "*" not in drawn.replace("&#x0002A;", "")
    assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block"' in drawn
    assert "<code>_code_</code>" in drawn


def test_aliases_are_those_that_are_known() -> None:
    """A constant offset and friction by direction, a filter and a delay: in the band they are nearly one."""
    found = {effect.name: dict(effects.aliases(effect)) for effect in CATALOGUE}
    assert found["torque_offset"]["asymmetric_friction"] > 0.99
    assert found["torque_filter"]["torque_delay"] > 0.75
    assert "cogging" not in found["tool_mass"]


def test_the_picture_over_time_shows_the_peak() -> None:
    """Backlash is nothing for seconds, and then an impact."""
    for effect in CATALOGUE:
        fast, torque = effects.shown(effect)
        assert np.ptp(fast) > 2.0, effect.name
        assert np.abs(torque).max() > 0.0, effect.name


@pytest.mark.slow
def test_the_picture_of_an_effect_is_the_same_every_time() -> None:
    effect = next(effect for effect in CATALOGUE if effect.name == "stribeck_friction")
    picture = effects.picture(effect)
    assert picture.startswith("<?xml")
    assert picture == effects.picture(effect)
