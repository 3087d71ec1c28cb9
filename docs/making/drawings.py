"""Drawings of the documentation as SVG: legible on a light and on a dark page, the same bytes from the same code."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

INK = "#6b7280"  # grey that has contrast on white and on near-black
COLOURS = ("#0b7fc0", "#d9480f", "#2b8a3e", "#9c36b5")
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "deltatwin", "svg.fonttype": "path", "font.size": 8, "axes.titlesize": 8,
    "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.spines.top": False, "axes.spines.right": False, "figure.facecolor": "none", "axes.facecolor": "none",
    "savefig.facecolor": "none", "legend.frameon": False,
}  # fmt: skip


@contextmanager
def figure(width: float, height: float, columns: int = 1) -> Iterator[tuple[Any, Any]]:
    """A Matplotlib figure of a size in inches and its axes, closed at the end."""
    import matplotlib

    matplotlib.use("svg")
    from cycler import cycler
    from matplotlib import pyplot

    with matplotlib.rc_context({**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}):
        drawing, axes = pyplot.subplots(1, columns, figsize=(width, height), layout="constrained")
        try:
            yield drawing, axes
        finally:
            pyplot.close(drawing)


def as_svg(drawing: Any) -> str:
    """The figure as text."""
    text = io.StringIO()
    drawing.savefig(text, format="svg", dpi=140, metadata={"Date": None})
    return text.getvalue()


def joint_zero() -> str:
    """One arm from the side: where the joint angle is zero, which way is positive, the frame, the lengths."""
    base, platform, active, passive, angle = 0.20, 0.05, 0.40, 0.95, 0.45
    elbow = np.array([base + active * np.cos(angle), -active * np.sin(angle)])
    x = 0.10  # of the platform's centre
    wrist = np.array([x + platform, elbow[1] - np.sqrt(passive**2 - (x + platform - elbow[0]) ** 2)])
    with figure(width=6.2, height=5.4) as (drawing, axes):
        axes.plot([-0.24, base], [0, 0], color=INK, lw=5, solid_capstyle="round")
        axes.plot([base, base + active + 0.08], [0, 0], color=INK, lw=1, ls="--")
        axes.plot([base, elbow[0]], [0, elbow[1]], color=COLOURS[0], lw=4, solid_capstyle="round")
        axes.plot([elbow[0], wrist[0]], [elbow[1], wrist[1]], color=COLOURS[1], lw=2.4, solid_capstyle="round")
        axes.plot([x - 0.07, wrist[0]], [wrist[1]] * 2, color=COLOURS[2], lw=5, solid_capstyle="round")
        for point in ([base, 0], elbow, wrist):
            axes.plot(*point, "o", color=INK, ms=7, mfc="white")
        turn = np.linspace(0, angle, 40)
        axes.plot(base + 0.24 * np.cos(turn), -0.24 * np.sin(turn), color=COLOURS[0], lw=1.4)
        _arrow(axes, (base + 0.24 * np.cos(angle - 0.06), -0.24 * np.sin(angle - 0.06)),
               (base + 0.24 * np.cos(angle), -0.24 * np.sin(angle)), COLOURS[0])  # fmt: skip
        _arrow(axes, (0, 0), (0, 0.22), INK)
        _arrow(axes, (0, 0), (0.17, 0.0), INK)
        _arrow(axes, (-0.19, -0.25), (-0.19, -0.45), INK)
        _arrow(axes, (x, wrist[1]), (x, wrist[1] - 0.15), COLOURS[2])
        words = [
            (0.015, 0.20, "z", INK), (0.12, 0.035, "towards arm $i$", INK), (-0.075, 0.03, "O", INK),
            (base + 0.26, -0.085, r"$\theta_i > 0$", COLOURS[0]),
            (base + active + 0.09, -0.012, r"$\theta_i = 0$: link horizontal", INK),
            (0.22, -0.19, "active link $l_1$", COLOURS[0]), (0.47, -0.62, "forearm $l_2$ (two rods)", COLOURS[1]),
            (-0.215, wrist[1] + 0.03, "platform, $p$", COLOURS[2]), (-0.17, -0.37, "gravity", INK),
            (x + 0.015, wrist[1] - 0.15, "payload", COLOURS[2]), (-0.02, -0.06, "base radius $r_a$", INK),
            (-0.24, 0.03, "base", INK),
        ]  # fmt: skip
        for left, low, text, colour in words:
            axes.text(left, low, text, color=colour, fontsize=9)
        axes.set(xlim=(-0.28, 1.02), ylim=(wrist[1] - 0.2, 0.26), aspect="equal")
        axes.axis("off")
        return as_svg(drawing)


def _arrow(axes: Any, start: Any, end: Any, colour: str) -> None:
    axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4})
