"""fleet.html: each parameter over the axes, who stands apart, what is missing where. Self-contained."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from urllib.parse import quote

from twin.batch.overview import Fleet, named, sentences, spread_text
from twin.display.numbers import capital, measure, number, pretty, unit_text
from twin.effects.catalogue import EFFECTS
from twin.estimation.population import Population
from twin.report.style import CSS

#: What the page needs beside the common style sheet. A strip is drawn by the page itself, so that it fits any width.
_CSS = """
.strip { display: block; width: 100%; height: 2.6rem; overflow: visible; }
.strip line { vector-effect: non-scaling-stroke; stroke: var(--after); stroke-width: 2; }
.strip .own { stroke-width: 6; opacity: 0.22; }
.strip .apart { stroke: var(--before); }
.strip .axis { stroke: var(--rule); stroke-width: 1; }
.strip rect { fill: var(--band-held); }
.ends { display: flex; justify-content: space-between; font-family: var(--sans); font-size: 0.74rem;
  color: var(--muted); margin: 0.1rem 0 0.4rem; max-width: none; }
.apart { color: var(--before); }
.lead, td.axes, td .note { overflow-wrap: anywhere; }
a { color: var(--after); }
table { min-width: 0; }
"""
#: Verdicts that need no sentence in the table: the axis' own report has it.
_PLAIN = ("explained", "nothing_missing")


def _strip(population: Population, name: str) -> str:
    """A line for each axis at its value, its own 95 % interval behind it, and the band that 95 % of the axes share."""
    low, high = (population.quantile(side * 1.96) for side in (-1.0, 1.0))
    first, last = float(min([*population.values, low, high])), float(max([*population.values, low, high]))
    margin = 0.03 * (last - first) or 1e-3 * max(abs(last), 1.0)
    first, last = first - margin, last + margin

    def place(value: float) -> float:
        return min(max(1000.0 * (value - first) / (last - first), 0.0), 1000.0)

    marks = []
    for axis, value, std in zip(population.axes, population.values, population.stds, strict=True):
        kind = ' class="apart"' if axis in population.outliers else ""
        at, ends = place(value), (place(value - 1.96 * std), place(value + 1.96 * std))
        title = f"<title>{escape(axis)}: {number(float(value), 4)} ± {number(float(std), 2)}</title>"
        own = f'<line class="own" x1="{ends[0]:.1f}" x2="{ends[1]:.1f}" y1="20" y2="20"/>'
        marks.append(f'<g{kind}>{title}{own}<line{kind} x1="{at:.1f}" x2="{at:.1f}" y1="8" y2="32"/></g>')
    left, right = place(min(low, high)), place(max(low, high))
    return (
        f'<svg class="strip" viewBox="0 0 1000 40" preserveAspectRatio="none" role="img" '
        f'aria-label="{escape(name)} of {len(population.axes)} axes">'
        f'<rect x="{left:.1f}" y="2" width="{max(right - left, 1.0):.1f}" height="36"/>'
        f'<line class="axis" x1="0" x2="1000" y1="20" y2="20"/>{"".join(marks)}</svg>'
        f'<p class="ends"><span>{number(first)}</span><span>{number(last)}</span></p>'
    )


def _parameter(fleet: Fleet, name: str) -> str:
    p, unit = fleet.populations[name], fleet.unit(name)
    shown = name.replace("_", " ")
    tail = f" {unit_text(unit)}" if unit_text(unit) else ""
    said = f"{len(p.axes)} axes; centre {number(p.centre)}{tail}; they differ by {spread_text(p, unit_text(unit))}."
    apart = ""
    if p.outliers:
        told = []
        for axis in p.outliers:
            i = p.axes.index(axis)
            told.append(f"{escape(axis)}, {escape(measure(float(p.values[i]), float(p.stds[i]), unit))}")
        apart = f'<p class="apart">Stands apart: {"; ".join(told)}.</p>'
    return f'<h3>{escape(capital(shown))}</h3>{_strip(p, shown)}<p class="note">{escape(pretty(said))}</p>{apart}'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], last: str = "") -> str:
    """Cells are HTML already; `last` is the class of the last column."""
    kind = [""] * (len(head) - 1) + [f' class="{last}"' if last else ""]
    top = "".join(f"<th>{h}</th>" for h in head)
    body = "".join(f"<tr>{''.join(f'<td{k}>{c}</td>' for c, k in zip(row, kind, strict=True))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _axes(fleet: Fleet) -> str:
    apart = fleet.outliers
    rows = []
    for r in fleet.results:
        name = escape(r.axis)
        if not r.failed:
            name = f'<a href="{quote(r.axis)}/report.html">{name}</a>'
        effects = ", ".join(EFFECTS[e].title for e in r.effects)
        verdict = escape(r.verdict.replace("_", " "))
        if r.axis in apart:
            stands = ", ".join(n.replace("_", " ") for n in apart[r.axis])
            verdict += f'<br><span class="apart">stands apart: {escape(stands)}</span>'
        if r.verdict not in _PLAIN:
            verdict += f'<span class="note">{escape(pretty(r.says))}</span>'
        rows.append((name, verdict, escape(effects) or "–"))
    return _table(("Axis", "Verdict", "Left out by the first model"), rows, "axes")


def _missing(fleet: Fleet) -> str:
    count = len(fleet.results) - len(fleet.failed)
    rows = [
        (escape(capital(EFFECTS[e].title)), f"{len(axes)} of {count}", escape(named(axes)))
        for e, axes in fleet.missing.items()
    ]
    return _table(("Effect", "Axes", "Which"), rows, "axes") if rows else "<p>No axis lacks an effect.</p>"


def _headline(fleet: Fleet) -> str:
    parts = []
    if fleet.failed:
        parts.append(f"{len(fleet.failed)} failed")
    if fleet.outliers:
        parts.append(f"{len(fleet.outliers)} stand{'s' if len(fleet.outliers) == 1 else ''} apart")
    state = ", ".join(parts) or "none stands apart"
    return f"{len(fleet.results)} axes: {state}"


def fleet_page(fleet: Fleet) -> str:
    """The page (HTML, self-contained).

    Parameters
    ----------
    fleet : Fleet
        Its axes' reports lie in folders of their names beside the page.
    """
    title = _headline(fleet)
    lead = "".join(f'<p class="lead">{escape(pretty(s))}</p>' for s in sentences(fleet))
    parameters = "".join(
        _parameter(fleet, n) for n in sorted(fleet.populations, key=lambda n: not fleet.populations[n].outliers)
    )
    key = (
        '<p class="note">A line is one axis, the pale bar its own 95\u202f% interval. '
        "95\u202f% of the axes that do not stand apart lie within the band.</p>"
    )
    spread = parameters or "<p>No parameter is fixed by more than one axis.</p>"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}{_CSS}</style>\n</head>\n<body>\n<main>"
        f'<header><p class="kicker">Fleet</p><h1>{escape(title)}</h1></header>{lead}'
        f"<section><h2>The axes</h2>{_axes(fleet)}</section>"
        f"<section><h2>Missing effects by axis</h2>{_missing(fleet)}</section>"
        f"<section><h2>Each parameter over the fleet</h2>{key}{spread}</section>"
        "</main>\n</body>\n</html>\n"
    )
