"""The trend chart of `twin track`: each parameter over the recordings, with its errors and the changes seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure

from twin.diagnosis.tracking import Track
from twin.display.numbers import pretty, unit_text
from twin.report.figures import WIDTH, draw_svg
from twin.report.style import AFTER, BEFORE, CSS, MISFIT


def _chart(history: Track, name: str) -> str:
    """One parameter (values and 95 % intervals) over the recordings."""
    place = np.arange(1, len(history.fits) + 1)
    values = np.array([f.values[name] for f in history.fits])
    spread = np.array([1.96 * f.std(name) for f in history.fits])
    value, std = history.model.values[name], history.model.std(name)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for a in history.alarms:
            if any(c.parameter in (name, "inertia_ratio") for c in a.changes):
                axes.axvspan(a.since + 0.5, len(place) + 0.5, color=MISFIT, linewidth=0.0, zorder=0)
        if math.isfinite(std):
            axes.axhspan(value - 1.96 * std, value + 1.96 * std, color=BEFORE, alpha=0.18, linewidth=0.0)
        axes.axhline(value, color=BEFORE, linewidth=1.0)
        axes.errorbar(place, values, spread, fmt="o", color=AFTER, markersize=3.5, linewidth=1.0)
        axes.set_xlabel("recording")
        axes.set_ylabel(unit_text(history.model.unit(name)) or "1")
        axes.set_xlim(0.5, len(place) + 0.5)

    return draw_svg(draw, WIDTH, 1.9, f"{name.replace('_', ' ')} over the recordings")


def trend_page(history: Track, said: Sequence[str]) -> str:
    """The page (HTML, self-contained).

    Parameters
    ----------
    history : Track
    said : sequence of str
        What is said above the charts.
    """
    names = [n for n in history.model.fitted if all(math.isfinite(f.std(n)) for f in history.fits)]
    moved = {n: max((abs(s.get(n, 0.0)) for s in history.standardised), default=0.0) for n in names}
    charts = "".join(
        f"<section><h2>{escape(n.replace('_', ' ').capitalize())}</h2><figure>{_chart(history, n)}"
        "<figcaption>The line and its band: the model. Points: one recording each, with 95\u202f% intervals. "
        "Shaded: since a change.</figcaption></figure></section>"
        for n in sorted(names, key=lambda n: -moved[n])
    )
    lead = "".join(f'<p class="lead">{escape(pretty(s))}</p>' for s in said)
    changed = f"{len(history.alarms)} changes" if len(history.alarms) != 1 else "One change"
    title = f"{changed} in {len(history.fits)} recordings" if history.alarms else "Nothing has changed"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}</style>\n</head>\n<body>\n<main>"
        f'<header><p class="kicker">History of one axis</p><h1>{escape(title)}</h1></header>{lead}{charts}'
        "</main>\n</body>\n</html>\n"
    )
