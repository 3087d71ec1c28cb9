"""Reference pages of the effect catalogue: what the source says of each, its signature and its nearest aliases.

The signature is the torque that the effect adds to one joint of the robot d3-1200 on two planned motions, a fast
multisine and a slow sweep, computed by the model that diagnoses. The aliases are the effects whose torque on the same
motions is most alike, once the base parameters have explained what they can.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from docs.making.drawings import as_svg, figure
from docs.making.markdown import cell, code, prose, table
from drivers.motion import Planner
from schemas.robot import load_robot
from service.model.effects import CATALOGUE
from service.model.effects.base import Effect
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import mechanism_of
from service.model.scene import Base, Recording, Scene
from service.model.signals import Segment, lowpass
from service.model.torque import added, reported

PERIOD = 0.002  # s; four times the analysis band and more
FAST_S, SLOW_S = 6.0, 10.0  # s of the two motions
SHOWN_S = 3.0  # s of the fast motion in the picture, around the peak
JOINT = 1  # that effects on single joints are put on; from 0
ALIKE = 0.4  # cosine from which another effect is listed
MOST = 6  # listed
SMALL = 1e-3  # amplitude at which an effect is taken as proportional to it: m, rad or a share
HEADINGS = {
    "delta": "Delta robots", "axes": "single axes", "chain": "arms described by a URDF",
}  # fmt: skip


@dataclass(frozen=True)
class Signature:
    """Torque (N, n) N m per unit of each amplitude, one entry a motion. scenes: what it was computed on."""

    scenes: tuple[Scene, ...]
    torque: tuple[tuple[np.ndarray, ...], ...]


@cache
def _scenes() -> tuple[Scene, ...]:
    robot = load_robot("d3-1200")
    mechanism = mechanism_of(robot)
    planner, rng = Planner(robot, PERIOD), np.random.default_rng(1)
    base = Base(np.array([1.0, 1.0, robot.mass.passive_link]), np.full(3, 2.0), np.full(3, 4.0))
    found = []
    for number, motion in enumerate((planner.multisine(rng, FAST_S), planner.slow(rng, SLOW_S))):
        time = PERIOD * np.arange(len(motion.position))
        moving = np.abs(motion.velocity) > 0.01
        segment = Segment(
            np.arange(len(time)), time, PERIOD, motion.position, motion.velocity, motion.acceleration,
            np.zeros_like(motion.position), moving,
        )  # fmt: skip
        found.append(Scene(Recording(segment, mechanism, number, "motion"), base))
    return tuple(found)


@cache
def signature(effect: Effect) -> Signature:
    """What the effect adds on each motion, by amplitude; the searched quantities in the middle of their grid."""
    scenes = _scenes()
    return Signature(scenes, tuple(tuple(_columns(effect, scene)) for scene in scenes))


def _columns(effect: Effect, scene: Scene) -> list[np.ndarray]:
    middle = tuple(one.tried[len(one.tried) // 2] for one in effect.nonlinear.values())
    joints = (JOINT,) if effect.per_joint else ()
    amplitudes = SMALL * np.eye(len(effect.amplitudes)) if effect.amplitudes else np.zeros((1, 0))
    found = []
    for amplitude in amplitudes:
        term = Term(effect, joints, amplitude[None], middle)
        if effect.measured:
            found.append(reported(scene, Hypothesis(scene.base, (term,)), scene.total) - scene.total)
        else:
            found.append(added(scene, term))
    return found


@cache
def _projected() -> dict[str, np.ndarray]:
    """Orthonormal basis (N, k) of each effect's torque in the analysis band, base parameters projected out."""
    scenes = _scenes()
    base = []
    for j in range(3):
        for column in (lambda s, j=j: s.segment.theta_dot[:, j], lambda s, j=j: s.direction[:, j]):
            base.append(_stacked([_on(column(scene), j) for scene in scenes]))
    rigid = [scene.recording.rigid.columns for scene in scenes]
    base += [_stacked([columns[..., k] for columns in rigid]) for k in range(rigid[0].shape[-1])]
    basis = _orthonormal(np.stack(base, axis=1))
    found = {}
    for effect in CATALOGUE:
        columns = np.stack([_stacked(parts) for parts in zip(*signature(effect).torque, strict=True)], axis=1)
        found[effect.name] = _orthonormal(columns - basis @ (basis.T @ columns), of=columns)
    return found


def _on(values: np.ndarray, joint: int) -> np.ndarray:
    torque = np.zeros((len(values), 3))
    torque[:, joint] = values
    return torque


def _stacked(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([lowpass(part, PERIOD)[:: math.ceil(0.01 / PERIOD)].ravel() for part in parts])


def _orthonormal(columns: np.ndarray, of: np.ndarray | None = None) -> np.ndarray:
    size = np.linalg.norm(columns if of is None else of, axis=0)
    left, value, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return left[:, value > 0.02]


def aliases(effect: Effect) -> list[tuple[str, float]]:
    """Effects of the catalogue whose torque is like this one's, with the cosine of the angle between them, strongest
    first: 1 means that these motions cannot separate the two."""
    own, found = _projected()[effect.name], []
    for name, other in _projected().items():
        if name != effect.name and own.size and other.size:
            cosine = float(np.linalg.svd(own.T @ other, compute_uv=False)[0])
            if cosine >= ALIKE:
                found.append((name, cosine))
    return sorted(found, key=lambda pair: -pair[1])[:MOST]


def _drawn(effect: Effect) -> list[np.ndarray]:
    """Torque on the joint, an array a motion, of the amplitude that gives the most."""
    sign = signature(effect)
    columns = [np.concatenate([part[k][:, JOINT] for part in sign.torque]) for k in range(len(sign.torque[0]))]
    column = int(np.argmax([np.abs(values).max() for values in columns]))
    return [part[column][:, JOINT] for part in sign.torque]


def shown(effect: Effect) -> tuple[np.ndarray, np.ndarray]:
    """Time (N,) s and torque (N,) N m of the fast motion, where the effect is largest in it."""
    time, torque = _scenes()[0].segment.time, _drawn(effect)[0]
    peak_s = time[int(np.argmax(np.abs(torque)))]
    begin = np.clip(peak_s - SHOWN_S / 2, 0.0, time[-1] - SHOWN_S)
    rows = (time >= begin) & (time < begin + SHOWN_S)
    return time[rows], torque[rows]


def picture(effect: Effect) -> str:
    """The signature as SVG: over time, over joint speed, over joint angle."""
    joint, torque = JOINT, _drawn(effect)
    peak = max(np.abs(values).max() for values in torque) or 1.0
    motion = [scene.segment for scene in _scenes()]
    with figure(width=7.6, height=2.5, columns=3) as (drawing, (over_time, over_speed, over_angle)):
        time, fast = shown(effect)
        over_time.plot(time, fast / peak, lw=1.0)
        over_time.set(xlabel="time, s", ylabel="torque, share of its peak", title="fast motion")
        for part, values, label in zip(motion, torque, ("fast", "slow"), strict=True):
            over_speed.plot(part.theta_dot[:, joint], values / peak, ".", ms=1.4, label=label, rasterized=True)
            over_angle.plot(part.theta[:, joint], values / peak, ".", ms=1.4, label=label, rasterized=True)
        over_speed.set(xlabel="speed of the joint, rad/s", title="against speed")
        over_angle.set(xlabel="angle of the joint, rad", title="against angle")
        for axes in (over_time, over_speed, over_angle):
            axes.set_ylim(-1.1, 1.1)
        over_angle.legend(loc="lower center", bbox_to_anchor=(0.5, 1.1), ncols=2, markerscale=6, fontsize=7)
        return as_svg(drawing)


def page(effect: Effect) -> str:
    """What it is, its torque, its quantities, aliases, and what to check on the machine."""
    parts = _parts(inspect.getmodule(type(effect)).__doc__ or "")
    text = [f"# {effect.name}\n", f"**{effect.in_words}.**\n"]
    text.append(f"![Torque of {effect.name} over time, speed and angle]({effect.name}.svg)\n")
    text.append(
        "*Torque that the effect adds on one joint of the robot d3-1200, computed by the model, as a share of its "
        "peak.*\n"
    )
    for title, said in (("Physics and equation", _physics(effect, parts)), ("In the model", parts["Implementation"])):
        text.append(f"## {title}\n\n{said}\n")
    text.append("## Check on the machine\n\n" + (effect.means or "No advice is stored for this effect.") + "\n")
    text.append(f"The motion that shows it best: {effect.settles}.\n")
    text.append("## Parameters\n\n" + _quantities(effect))
    text.append("\n## What it is confused with\n\n" + parts.get("Limitations", "") + "\n" + _confused(effect))
    where = ", ".join(HEADINGS[kind] for kind in sorted(effect.kinds, key=list(HEADINGS).index))
    text.append("\n## Where it applies\n\n" + f"Machines: {where}. " + _place(effect) + "\n")
    return "\n".join(text)


def _physics(effect: Effect, parts: dict[str, str]) -> str:
    """Its summary, unless that only repeats the title, and its physics; an equation completes the summary."""
    summary, physics = parts[""].strip(), parts["Physics"]
    if summary.lower() == f"{effect.in_words}.".lower():
        return physics
    return (f"{summary[:-1]}: " if physics.startswith("<span>") else f"{summary} ") + physics


def _parts(docstring: str) -> dict[str, str]:
    """The paragraphs of an effect's docstring by their heading; the first has none."""
    pieces = re.split(r"^(Physics|Implementation|Limitations): ", inspect.cleandoc(docstring), flags=re.MULTILINE)
    named = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    return {key: _sentence(prose(value).strip()) + "\n" for key, value in {"": pieces[0], **named}.items()}


def _sentence(text: str) -> str:
    """With a capital, unless an equation begins it."""
    return text[:1].upper() + text[1:]


def _quantities(effect: Effect) -> str:
    rows = []
    for name, amplitude in effect.amplitudes.items():
        rows.append([code(name), amplitude.unit or "1", cell(amplitude.meaning), _range(amplitude.low, amplitude.high)])
    for name, searched in effect.nonlinear.items():
        how = "fixed" if searched.fixed else _range(searched.low, searched.high)
        rows.append([code(name), searched.unit or "1", cell(searched.meaning), how])
    return table(["Name", "Unit", "Meaning", "Range"], rows)


def _range(low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "any"
    if math.isinf(high):
        return f"{low:g} or more"
    return f"up to {high:g}" if math.isinf(low) else f"{low:g} to {high:g}"


def _confused(effect: Effect) -> str:
    text = ""
    if effect.same:
        links = ", ".join(f"[{name}]({name}.md)" for name in sorted(effect.same))
        text += f"No motion separates it from {links}; only their sum is identifiable.\n\n"
    found = aliases(effect)
    if not found:
        return text + (
            "On a fast multisine and a slow sweep together, no other effect of the catalogue has a similar torque.\n"
        )
    text += (
        "On a fast multisine and a slow sweep together, after projection onto the base parameters, these "
        "effects have the most similar torque (cosine of the angle between the two torques; at 1 the motions "
        "cannot separate them):\n\n"
    )
    return text + table(["Effect", "Cosine"], ([f"[{name}]({name}.md)", f"{cosine:.2f}"] for name, cosine in found))


def _place(effect: Effect) -> str:
    said = []
    if effect.per_joint:
        elsewhere = "Each joint has its own value; its torque appears in other joints, too."
        said.append("It acts on single joints." if effect.own_joint else elsewhere)
    else:
        said.append("It acts on the robot as a whole.")
    if effect.measured:
        said.append("It changes the reported torque, not the true torque.")
    if effect.dissipates:
        said.append("It is friction: together with the base model it always takes energy out of the motion.")
    if effect.directional:
        said.append("A joint that moves in one direction only does not show it.")
    if effect.own_nonlinear:
        said.append("Each joint may have its own shape.")
    return " ".join(said)


def index() -> str:
    """The catalogue."""
    head = (
        "# Effects\n\nThe catalogue of unmodelled effects that `diagnose` and `watch` search. Each page says what the "
        "effect is, what it is confused with and what to check on the machine. How the search works is explained in "
        "[The diagnosis](../../explanation/diagnosis.md); how to add one in "
        "[Add an effect of your own](../../how-to/add-an-effect.md).\n\n"
    )
    rows = [[f"[`{effect.name}`]({effect.name}.md)", cell(effect.in_words)] for effect in CATALOGUE]
    return head + table(["Effect", "Meaning"], rows)
