"""The report's figures: SVG text that takes its fonts and its width from the page around it."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from html import escape
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from latex2mathml.converter import convert
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextToPath
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from twin.control.cosimulation import Tracking
from twin.diagnosis.localization import Segment
from twin.diagnosis.residual_torque import TorqueShape
from twin.diagnosis.result import Diagnosis, Experiment, Trace
from twin.display.numbers import unit_text
from twin.estimation.two_stage import TwoStage
from twin.report.style import AFTER, BEFORE, GRID, HELD, INK, MISFIT, MUTED, RECORDED

Values = NDArray[np.floating[Any]]

WIDTH = 9.2  # inches, of a full figure
_POINTS = 1400  # columns that a line is drawn with

_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "twin",
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "lines.linewidth": 1.1,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}  # fmt: skip


# ---- from matplotlib to the page ----


def draw_svg(draw: Callable[[Figure], None], width: float, height: float, says: str) -> str:
    """Draw, and make the SVG fit to stand inside HTML: no addresses, no fonts and no names of its own."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height))
        draw(figure)
        out = io.StringIO()
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r"<g id=\"[a-zA-Z0-9_.]+\">", "<g>", text)
    text = re.sub(r"font: (?:(?:normal|bold|[0-9]+) )?([0-9.]+)px [^;\"]*", r"font-size: \1px", text)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)
    text = re.sub(r"\n\s*", "\n", text)
    size = re.search(r'viewBox="([^"]*)"', text)
    box = size.group(1) if size else "0 0 1 1"
    head = f'<svg class="figure" viewBox="{box}" role="img" aria-label="{escape(says, quote=True)}">'
    return head + text[text.index(">") + 1 :]


_TEXT = TextToPath()
_LETTERS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}


def _mathml(latex: str) -> str:
    """The same as MathML, without the address of its name space, which HTML knows."""
    return re.sub(r' xmlns="[^"]*"', "", convert(latex))


@cache
def math_svg(latex: str) -> str:
    """LaTeX mathematics as inline SVG on the text's baseline, and as MathML for a screen reader; the source itself
    where it cannot be set."""
    label = escape(latex, quote=True)
    size = float(_TEXT.FONT_SCALE)  # then widths and outlines are in the same unit
    with matplotlib.rc_context({"mathtext.fontset": "stix"}):
        font = FontProperties(size=size)
        try:
            width, height, descent = _TEXT.get_text_width_height_descent(f"${latex}$", font, ismath=True)
            points, codes = _TEXT.get_text_path(font, f"${latex}$", ismath=True)
        except ValueError:
            return f"<code>{label}</code>"
    outline = []
    for ends, code in Path(points, codes).iter_segments(simplify=False):
        places = [] if code == Path.CLOSEPOLY else [f"{x:.0f} {-y:.0f}" for x, y in ends.reshape(-1, 2)]
        outline.append(_LETTERS[code] + " ".join(places))
    em, pad = 1.06 / size, 4.0
    style = (
        f"width:{(width + 2 * pad) * em:.3f}em;height:{(height + 2 * pad) * em:.3f}em;"
        f"vertical-align:{-(descent + pad) * em:.3f}em"
    )
    box = f"{-pad:.0f} {-(height - descent + pad):.0f} {width + 2 * pad:.0f} {height + 2 * pad:.0f}"
    return (
        f'<svg class="math" style="{style}" viewBox="{box}" aria-hidden="true">'
        f'<title>{label}</title><path d="{"".join(outline)}"/></svg><span class="spoken">{_mathml(latex)}</span>'
    )


# ---- drawing ----


def thinned(x: Values, y: Values, points: int = _POINTS) -> tuple[Values, Values]:
    """Smallest and largest value of each of `points` columns, so that no peak is lost; (n,) each."""
    if len(x) <= 2 * points:
        return x, y
    edges = np.linspace(0, len(x), points + 1).astype(int)
    index: list[int] = []
    for a, b in pairwise(edges):
        part = y[a:b]
        if not np.isfinite(part).any():
            index.append(a)
            continue
        index += sorted({a + int(np.nanargmin(part)), a + int(np.nanargmax(part))})
    kept = np.array(index)
    return x[kept], y[kept]


def _line(axes: Axes, x: Values, y: Values, color: str, **more: Any) -> None:
    axes.plot(*thinned(np.asarray(x), np.asarray(y)), color=color, **more)


def _within(axes: Axes, *values: Values, share: float = 0.002) -> None:
    """Limits that show all but the rarest spikes."""
    seen = np.concatenate([v[np.isfinite(v)] for v in values]) if values else np.zeros(0)
    if len(seen) == 0:
        return
    low, high = np.quantile(seen, [share, 1.0 - share])
    room = 0.12 * max(high - low, 1e-12)
    axes.set_ylim(low - room, high + room)


def _marked(axes: Axes, segments: Sequence[Segment]) -> None:
    for s in segments:
        axes.axvspan(s.start, s.end, color=MISFIT, linewidth=0.0, zorder=0)


def _label(unit: str) -> str:
    return unit_text(unit) or "1"


def _stretches(diagnosis: Diagnosis) -> list[list[Trace]]:
    """What to show beside one another: the parts of one recording together, or up to four recordings."""
    if len(diagnosis.recordings) == 1:
        return [list(diagnosis.traces)]
    chosen: list[Trace] = []
    for role in ("train", "holdout"):
        mine = [t for t in diagnosis.traces if t.role == role]
        worst = sorted(mine, key=lambda t: -float(np.nanmean((t.recorded - t.before) ** 2)))
        chosen += worst[:2]
    return [[t] for t in chosen]


def _covered(trace: Trace, traces: Sequence[Trace]) -> NDArray[np.bool_]:
    """The stamps (N,) of a trace that lie in a held-out one beside it."""
    covered = np.zeros(len(trace.time), dtype=bool)
    for t in traces:
        if t is not trace and t.role == "holdout":
            covered |= (trace.time >= t.time[0]) & (trace.time <= t.time[-1])
    return covered


def models(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """What to draw: before or after, its colour, its name; one model where nothing was added."""
    if diagnosis.before.structure.ids == diagnosis.after.structure.ids:
        return [("after", AFTER, "model")]
    return [("before", BEFORE, "first model"), ("after", AFTER, "improved model")]


def overlay(diagnosis: Diagnosis) -> str:
    """Recording and both free-running simulations, and their errors below."""
    columns, drawn = _stretches(diagnosis), models(diagnosis)
    unit = diagnosis.recordings[0].output_unit
    lone = len(diagnosis.recordings) == 1

    def draw(figure: Figure) -> None:
        grid = figure.subplots(2, len(columns), squeeze=False, sharex="col", height_ratios=(1.25, 1.0))
        for column, traces in enumerate(columns):
            top, bottom = grid[0, column], grid[1, column]
            for t in traces:
                if t.role == "holdout" and lone:
                    for axes in (top, bottom):
                        axes.axvspan(t.time[0], t.time[-1], color=HELD, linewidth=0.0, zorder=-1)
                    place = {"transform": bottom.get_xaxis_transform(), "va": "top"}
                    bottom.text(t.time[0], 0.97, "  held out", fontsize=8, color=MUTED, **place)
                _line(top, t.time, t.recorded, RECORDED, linewidth=3.2, label="recorded")
                # What a simulation does where another begins anew belongs to no comparison.
                elsewhere = _covered(t, traces)
                for which, color, name in drawn:
                    simulated = np.where(elsewhere, np.nan, getattr(t, which))
                    _line(top, t.time, simulated, color, label=name)
                    _line(bottom, t.time, simulated - t.recorded, color)
            _within(bottom, *(getattr(t, which) - t.recorded for t in traces for which, _, _ in drawn), share=0.0)
            if not lone:
                data = "held out" if traces[0].role == "holdout" else "fitted"
                top.set_title(f"{traces[0].name[-34:]}\n{data}", fontsize=8, parse_math=False)
            bottom.axhline(0.0, color=MUTED, linewidth=0.6)
            bottom.set_xlabel("time, s")
            top.margins(x=0.0)
        if lone:
            _marked(grid[1, 0], diagnosis.segments)
        quantity = "speed" if unit.endswith("/s") else "position"
        grid[0, 0].set_ylabel(f"{quantity}, {_label(unit)}")
        grid[1, 0].set_ylabel(f"simulated − recorded, {_label(unit)}")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        unique = dict(zip(labels, handles, strict=True))
        figure.legend(unique.values(), unique.keys(), loc="outside upper left", ncols=3, borderpad=0.0)

    return draw_svg(
        draw, WIDTH, 4.6, "Recording against the free-running simulations before and after, and their errors"
    )


def missing_over_time(diagnosis: Diagnosis) -> str:
    """The torque that each model lacks, along the recording; on the right, its worst stretch from nearby."""
    lacking = {"before": diagnosis.missing_before, "after": diagnosis.missing_after}
    drawn = [(lacking[which], color, name) for which, color, name in models(diagnosis)]
    unit = unit_text(f"{diagnosis.after.axis_unit}/s^2")
    worst = max(diagnosis.segments, key=lambda s: s.share, default=None)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, 2 if worst else 1, squeeze=False, width_ratios=(2.6, 1.0) if worst else None)[0]
        for axes in panels:
            _marked(axes, diagnosis.segments)
            axes.axhline(0.0, color=MUTED, linewidth=0.6)
            for missing, color, name in drawn:
                near = slice(None)
                if worst and axes is panels[-1]:
                    near = slice(*np.searchsorted(missing.time, _around(worst)))
                _line(axes, missing.time[near], missing.torque[near], color, linewidth=0.9, label=name)
            axes.margins(x=0.0)
            axes.set_xlabel("time, s")
        if worst:
            panels[1].set_xlim(_around(worst))
        panels[0].set_xlim(float(drawn[0][0].time[0]), float(drawn[0][0].time[-1]))
        _within(panels[0], *(m.torque for m, _, _ in drawn), share=0.0003)
        panels[0].set_ylabel(f"missing torque, {unit}")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2, borderpad=0.0)

    return draw_svg(draw, WIDTH, 2.6, "Missing torque over time, before and after; the stretches of misfit are shaded")


def left_over(diagnosis: Diagnosis, stretches: Sequence[Segment]) -> str:
    """The torque that the last model lacks: over time, and its mean over the variable that tells most of it."""
    unit = unit_text(f"{diagnosis.after.axis_unit}/s^2")
    missing, shape = diagnosis.missing_after, diagnosis.shapes_after[0]

    def draw(figure: Figure) -> None:
        over_time, over_state = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
        _marked(over_time, stretches)
        _line(over_time, missing.time, missing.torque, AFTER, linewidth=0.9)
        over_time.set_xlim(float(missing.time[0]), float(missing.time[-1]))
        _within(over_time, missing.torque, share=0.0003)
        over_time.set_xlabel("time, s")
        over_time.set_ylabel(f"missing torque, {unit}")
        _shape(over_state, shape, AFTER, True)
        over_state.set_xlabel(f"mean over the {_NAMES_OF[shape.variable]}")
        for axes in (over_time, over_state):
            axes.axhline(0.0, color=MUTED, linewidth=0.6)

    return draw_svg(draw, WIDTH, 2.6, "The torque that the improved model still lacks, over time and over the state")


def _around(segment: Segment) -> tuple[float, float]:
    """The stretch with some of what lies on either side."""
    room = max(0.5 * (segment.end - segment.start), 0.25)
    return segment.start - room, segment.end + room


_NAMES_OF = {
    "position": "position", "velocity": "velocity", "acceleration": "acceleration", "input": "command",
    "time": "time", "direction": "direction of motion", "load": "acceleration",
}  # fmt: skip


def _variable_unit(variable: str, axis_unit: str, input_unit: str) -> str:
    units = {
        "position": axis_unit, "velocity": f"{axis_unit}/s", "acceleration": f"{axis_unit}/s^2", "input": input_unit,
        "time": "s",
    }  # fmt: skip
    return units.get(variable, "")


def _shape(axes: Axes, shape: TorqueShape, color: str, marker: bool) -> None:
    band = 2.0 * shape.error
    if shape.variable == "direction":
        axes.errorbar(shape.centre, shape.mean, band, color=color, fmt="o", markersize=4, linewidth=1.2)
        axes.set_xticks([-1, 0, 1], ["backwards", "rest", "forwards"])
        axes.set_xlim(-1.4, 1.4)
        return
    axes.fill_between(shape.centre, shape.mean - band, shape.mean + band, color=color, alpha=0.18, linewidth=0.0)
    axes.plot(shape.centre, shape.mean, color=color, marker="o" if marker else "", markersize=2.4)


def shapes(diagnosis: Diagnosis) -> str:
    """The mean missing torque over each variable, before and after; the most telling variable first and large."""
    found = {"before": diagnosis.shapes_before, "after": diagnosis.shapes_after}
    drawn = [({s.variable: s for s in found[which]}, color) for which, color, _ in models(diagnosis)]
    first = diagnosis.shapes_before
    unit, drive = diagnosis.after.axis_unit, diagnosis.after.input_unit

    def fill(axes: Axes, shape: TorqueShape, large: bool) -> None:
        axes.axhline(0.0, color=MUTED, linewidth=0.6)
        for of_model, color in drawn:
            if shape.variable in of_model:
                _shape(axes, of_model[shape.variable], color, large)
        name, of = _NAMES_OF[shape.variable], _variable_unit(shape.variable, unit, drive)
        axes.set_xlabel(f"{name}, {_label(of)}" if of else name)
        tells = f"{100.0 * shape.share:.0f} %" if shape.share >= 0.005 else "nothing"
        axes.set_title(f"over {name}: explains {tells}" if large else f"{name}: {tells}", fontsize=9 if large else 8.5)

    def draw(figure: Figure) -> None:
        grid = figure.add_gridspec(2, 4)
        large = figure.add_subplot(grid[:, :2])
        fill(large, first[0], True)
        large.set_ylabel(f"missing torque, {_label(unit + '/s^2')}")
        for i, shape in enumerate(first[1:5]):
            small = figure.add_subplot(grid[i // 2, 2 + i % 2], sharey=large)
            fill(small, shape, False)
            small.tick_params(labelsize=7.5, labelleft=False)
            small.xaxis.label.set_fontsize(8)

    return draw_svg(
        draw, WIDTH, 3.7, "Missing torque over the state in which it lives, with bands of two standard errors"
    )


def pieces(found: TwoStage, output_unit: str) -> str:
    """The two-stage estimate: transients in mesh with their fits, and the b that each gives."""
    used = [p for p in found.pieces if p.used]
    speed = output_unit.endswith("/s") or found.form == "speeds"

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
        for p in used[:12]:
            since = p.time - p.time[0]
            level = 0.0 if speed else p.measured[0]
            _line(left, since, p.measured - level, RECORDED, linewidth=3.0)
            _line(left, since, p.fitted - level, AFTER, linewidth=1.0)
        left.set_xlabel("time since the gears are in mesh, s")
        left.set_ylabel(f"speed, {_label(output_unit)}" if speed else f"travel, {_label(output_unit)}")
        left.set_title(f"{len(used)} pieces in mesh (grey) and their fits")
        place = np.arange(1, len(used) + 1)
        values, errors = [p.b for p in used], [p.b_std for p in used]
        right.errorbar(place, values, errors, fmt="o", color=INK, markersize=3, linewidth=0.9)
        if found.ok:
            std = found.std("b")
            right.axhspan(found.b - std, found.b + std, color=AFTER, alpha=0.18, linewidth=0.0)
            right.axhline(found.b, color=AFTER)
        right.set_xlabel("piece")
        right.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        right.set_ylabel("b, 1/s")
        right.set_title("b of each piece and of all together")

    return draw_svg(draw, WIDTH, 2.9, "Two-stage estimate: transients in mesh and the b of each")


def tracking(ran: Tracking, axis_unit: str, input_unit: str) -> str:
    """The closed loop: reference and link, error, command."""

    def draw(figure: Figure) -> None:
        top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(1.5, 1.0, 1.0))
        _line(top, ran.time, ran.reference, RECORDED, linewidth=3.2, label="reference")
        _line(top, ran.time, ran.position, AFTER, label="link")
        _line(middle, ran.time, ran.error, BEFORE)
        _line(bottom, ran.time, ran.input, INK, linewidth=0.8)
        top.set_ylabel(f"position, {_label(axis_unit)}")
        middle.set_ylabel(f"error, {_label(axis_unit)}")
        bottom.set_ylabel(f"command, {_label(input_unit)}")
        bottom.set_xlabel("time, s")
        for axes in (top, middle, bottom):
            axes.margins(x=0.0)
            axes.yaxis.set_major_locator(MaxNLocator(4))
        figure.align_ylabels()
        figure.legend(loc="outside upper left", ncols=2, borderpad=0.0)

    return draw_svg(draw, WIDTH, 4.0, "Closed loop: reference and link, error and command")


def experiment(found: Experiment, input_unit: str) -> str:
    """The input to record next."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.step(found.time, found.input, where="post", color=INK, linewidth=0.9)
        axes.margins(x=0.0)
        axes.set_xlabel("time, s")
        axes.set_ylabel(f"command, {_label(input_unit)}")

    return draw_svg(draw, WIDTH, 2.0, "The input to record next")


# ---- the chain of stations ----

_BOXES = {
    "drive": (84, 88), "motor": (210, 88), "transmission": (336, 88), "inertia": (470, 88), "sensor": (604, 88),
    "friction": (350, 8), "load": (470, 8), "disturbance": (590, 8),
}  # fmt: skip
_NAMES = {"inertia": "link"}
_BOX = (96, 38)


def chain(found: Mapping[str, Sequence[str]]) -> str:
    """The machine as a chain of stations; `found` names for each station what was left out there."""
    w, h = _BOX
    row = ("drive", "motor", "transmission", "inertia", "sensor")
    below = max([len(found.get(name, ())) for name in (*row, "load")], default=0)
    parts = [
        f'<svg class="figure chain" viewBox="0 0 800 {134 + 19 * below + (8 if below else 0)}" role="img" '
        'aria-label="The chain of stations"><defs><marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" '
        'markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0.6 8 4 0 7.4z" fill="{MUTED}"/></marker></defs>'
    ]

    def arrow(x1: float, y1: float, x2: float, y2: float) -> None:
        parts.append(f'<path class="arrow" d="M{x1:g} {y1:g}L{x2:g} {y2:g}" marker-end="url(#arrow)"/>')

    middle = _BOXES["drive"][1] + h / 2
    arrow(38, middle, _BOXES["drive"][0] - 3, middle)
    for a, b in pairwise(row):
        arrow(_BOXES[a][0] + w, middle, _BOXES[b][0] - 3, middle)
    arrow(_BOXES["sensor"][0] + w, middle, 742, middle)
    x, y = _BOXES["inertia"]
    for name, end in (("friction", x + 26), ("load", x + w / 2), ("disturbance", x + w - 26)):
        arrow(_BOXES[name][0] + w / 2, _BOXES[name][1] + h, end, y - 3)
    parts.append(f'<text class="end" x="0" y="{middle + 4}">input</text>')
    parts.append(f'<text class="end" x="800" y="{middle + 4}" text-anchor="end">reading</text>')
    for name, (left, top) in _BOXES.items():
        kind = "station found" if found.get(name) else "station"
        parts.append(
            f'<g class="{kind}"><rect x="{left}" y="{top}" width="{w}" height="{h}" rx="5"/>'
            f'<text x="{left + w / 2}" y="{top + h / 2 + 4}" text-anchor="middle">{_NAMES.get(name, name)}</text></g>'
        )
        for i, what in enumerate(found.get(name, ())):
            at, line, anchor = _beside(name, i)
            parts.append(f'<text class="what" x="{at:g}" y="{line:g}" text-anchor="{anchor}">{escape(what)}</text>')
    return "".join(parts) + "</svg>"


def _beside(name: str, number: int) -> tuple[float, float, str]:
    """Where what was found at a station is written: x, y and the text's anchor."""
    (left, top), (w, h) = _BOXES[name], _BOX
    if name == "friction":
        return left - 10, top + h / 2 + 4 + 17 * number, "end"
    if name == "disturbance":
        return left, top + h + 17 + 17 * number, "start"
    x, y = _BOXES["inertia"] if name == "load" else (left, top)
    anchor = {"drive": "start", "sensor": "end"}.get(name, "middle")
    at = {"drive": left, "sensor": left + w}.get(name, x + w / 2)
    return at, y + h + 19 + 17 * number, anchor
