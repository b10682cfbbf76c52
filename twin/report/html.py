"""One page that says what was wrong with the first model: self-contained, for the screen and for paper."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from twin.codegen import latex
from twin.control.controller import Controller
from twin.control.cosimulation import Tracking
from twin.diagnosis import localization
from twin.diagnosis.result import Diagnosis, Finding, Fitness
from twin.display.numbers import capital, listed, measure, number, percent, pretty, unit_text
from twin.effects.catalogue import BASE, EFFECTS, UNKNOWN
from twin.estimation.two_stage import NAMES, TwoStage
from twin.io.recording import Rig
from twin.model.fitted_model import Model
from twin.report import figures, wording
from twin.report.explorer import explorer
from twin.report.origin import Origin
from twin.report.style import CSS

_MOST_ROWS = 20


@dataclass(frozen=True)
class Check:
    """An FMU checked in FMPy: how it replays a recording, what the validator says, and what it runs on."""

    fmu: str
    recording: str
    rmse: float
    nrmse_percent: float
    seconds: float | None  # None: not said, so that the same input gives the same page
    problems: tuple[str, ...]
    platforms: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Story:
    """What a report can show; what was not done is None or empty."""

    diagnosis: Diagnosis
    rig: Rig | None = None
    two_stage: TwoStage | None = None
    checks: tuple[Check, ...] = ()
    controller: Controller | None = None
    tracking: Tracking | None = None
    experiment_file: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    failures: Mapping[str, str] = field(default_factory=dict)  # the stages that failed, and why
    origin: Origin | None = None


# ---- small pieces of HTML ----


def _tag(name: str, content: str, kind: str = "") -> str:
    return f'<{name} class="{kind}">{content}</{name}>' if kind else f"<{name}>{content}</{name}>"


def _said(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return _tag("p", escape(pretty(text)), kind)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], kinds: Sequence[str] = (), caption: str = "") -> str:
    """Cells are HTML already. `kinds` are the classes of the columns."""
    kinds = [*kinds, *[""] * (len(head) - len(kinds))]
    top = "".join(_tag("th", h, k) for h, k in zip(head, kinds, strict=True))
    body = "".join(_tag("tr", "".join(_tag("td", c, k) for c, k in zip(row, kinds, strict=True))) for row in rows)
    said = _tag("caption", caption) if caption else ""
    return f'<div class="scroll"><table>{said}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _section(key: str, title: str, *content: str) -> str:
    inside = "".join(content)
    return f'<section id="{key}"><h2>{escape(title)}</h2>{inside}</section>' if inside else ""


def _figure(drawing: str, says: str, kind: str = "") -> str:
    return _tag("figure", f"{drawing}<figcaption>{says}</figcaption>", kind)


def _key(kind: str, text: str) -> str:
    return f'<span class="key {kind}"></span>{text}'


# ---- the parts of the page ----


def _masthead(story: Story) -> str:
    d = story.diagnosis
    return (
        '<header><p class="kicker">Digital twin of one axis '
        f'<span class="verdict {d.verdict}">{d.verdict.replace("_", " ")}</span></p>'
        f"<h1>{escape(wording.headline(d))}</h1>"
        f"{_said(wording.recordings_sentence(d.recordings), 'source')}</header>"
    )


def _figure_of_merit(value: str, before: str, says: str) -> str:
    was = f'<span class="was">{before}</span><span class="to">→</span>' if before else ""
    return f'<div class="merit"><p class="value">{was}{value}</p><p class="label">{says}</p></div>'


def _merits(story: Story) -> str:
    """The few numbers that matter, at a glance."""
    d, shown = story.diagnosis, []
    role = "holdout" if math.isfinite(_fit(d, "holdout", "before").rmse) else "train"
    before, after = _fit(d, role, "before"), _fit(d, role, "after")
    where = "on data held out" if role == "holdout" else "on the training data"
    if math.isfinite(after.nrmse_percent):
        now, was = (f"{number(f.nrmse_percent)}\u202f%" for f in (after, before))
        shown.append(_figure_of_merit(now, was, f"free-running error, of the recorded range, {where}"))
    if d.findings:
        best = d.findings[0]
        says = f"probability of {escape(wording.title(best.id))}"
        shown.append(_figure_of_merit(percent(best.probability), "", says))
    left, lacked = (_size(m.torque) for m in (d.missing_after, d.missing_before))
    if math.isfinite(left):
        unit = unit_text(f"{d.after.axis_unit}/s^2")
        says = "missing torque, RMS, over inertia"
        shown.append(_figure_of_merit(f"{number(left, 2)} {unit}", number(lacked, 2), says))
    if story.tracking is not None:
        unit = unit_text(d.after.axis_unit)
        says = "RMS tracking error in closed loop"
        shown.append(_figure_of_merit(f"{number(story.tracking.rms, 2)} {unit}", "", says))
    return f'<div class="merits">{"".join(shown)}</div>'


def _size(values: np.ndarray) -> float:
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else math.nan


def _fit(d: Diagnosis, role: str, when: str) -> Fitness:
    return d.fit.get(role, {}).get(when, Fitness(math.nan, math.nan, math.nan))


def _lead(story: Story) -> str:
    d = story.diagnosis
    said = [*d.since, *filter(None, (d.adequacy.says, wording.fit_sentence(d))), *d.remarks, *story.remarks]
    said += story.failures.values()
    return "".join(_said(s, "lead" if i == 0 else "remark") for i, s in enumerate(said))


def _equation(shown: latex.Equation, says: str, new: Sequence[str]) -> str:
    """An equation, term by term, so that what is new stands out and long ones wrap."""
    parts = [f'<span class="term">{figures.math_svg(shown.left)}</span>']
    for i, term in enumerate(shown.terms):
        sign, text = term.text[0], term.text[2:]
        text = f"{sign}\\;{text}" if i else f"-{text}" if sign == "-" else text
        equals = '<span class="term equals">=</span>' if i == 0 else ""
        kind = "term new" if term.effect in new else "term"
        parts.append(f'{equals}<span class="{kind}">{figures.math_svg(text)}</span>')
    return f'<div class="equation"><span class="about">{escape(says)}</span><span>{"".join(parts)}</span></div>'


def _finding(found: Finding, model: Model) -> str:
    rows = [
        (
            figures.math_svg(latex.symbol(n, model.axis_unit)),
            escape(model.parameter(n).meaning if n in model.values else n.replace("_", " ")),
            escape(measure(e.value, e.std, e.unit)),
        )
        for n, e in found.parameters.items()
    ]
    where = f"acts at the {escape(found.station)} · probability {percent(found.probability)}"
    equation = f'<div class="equation large"><span class="term new">{figures.math_svg(found.equation)}</span></div>'
    table = _table(("", "parameter", "value"), rows, ("symbol", "", "number")) if rows else ""
    title = escape(capital(wording.title(found.id)))
    return (
        f'<article class="finding"><h3>{title}<span class="where">{where}</span></h3>'
        f"{_said(found.says)}{equation}{table}</article>"
    )


def _found(story: Story) -> str:
    d = story.diagnosis
    new = [i for i in d.after.structure.ids if i not in (*d.before.structure.ids, "tooth_compliance")]
    parts = [_finding(f, d.after) for f in d.findings]
    if not d.findings:
        parts.append(_said(_nothing_found(d)))
    parts += map(_said, wording.nameless(d))
    equations = latex.equations(d.after.structure, d.after.axis_unit)
    parts.append(_tag("h3", "The whole model" + (", what is new marked" if new else "")))
    above = ""
    for e in equations:
        parts.append(_equation(e, "" if e.says == above else e.says, new))
        above = e.says
    bracket = "A square bracket is one where its condition holds, else zero. "
    parts.append(
        _said(
            "Torques stand over the inertia of the axis, so every term is an acceleration. "
            f"{bracket if any(latex.BRACKET in e.text for e in equations) else ''}"
            "The equations are written by the program from the laws that it ran.",
            "note",
        )
    )
    return _section("found", "What was found", *parts)


def _still_missing(story: Story) -> str:
    d = story.diagnosis
    stretches = localization.segments(localization.without_base(d.missing_after))
    says = wording.still_missing(d, stretches)
    if not says:
        return ""
    drawn = figures.left_over(d, stretches)
    where = f" along {escape(d.telling)}" if len(d.recordings) > 1 else ""
    caption = f"The torque that the last model lacks{where}; shaded, {_key('misfit', 'where most of it acts')}."
    return _section("still-missing", "What is still missing", _said(says), _figure(drawn, caption))


def _nothing_found(d: Diagnosis) -> str:
    if d.verdict == "nothing_missing":
        return (
            "None of the known effects improves the fit significantly on this recording. What the first model leaves "
            "over does not depend on where the axis is, how fast it moves or what drives it."
        )
    if d.verdict in ("inconclusive", "stopped"):
        return "No effect is claimed to be missing."
    where = wording.variables(d) or "nothing that was looked at"
    return f"What is left over goes with {where}, but none of the known effects has that form."


def _where(story: Story) -> str:
    d = story.diagnosis
    places: dict[str, list[str]] = {}
    for i in (*(f.id for f in d.findings), *(i for i in d.after.structure.ids if i in UNKNOWN)):
        places.setdefault(EFFECTS[i].station, []).append(wording.title(i))
    if places:
        says = "what was left out is marked."
    elif d.verdict == "nothing_missing":
        says = "nothing is missing in it."
    else:
        says = "in which part something is missing cannot be said."
    parts = [_figure(figures.chain(places), f"The machine as the model sees it; {says}")]
    if d.depends_on:
        parts.append(_said(f"What the first model lacks depends on {wording.variables(d)}."))
    return _section("where", "Where in the machine", *parts)


def _legend(d: Diagnosis) -> str:
    return listed([_key(which, name) for which, _, name in figures.models(d)])


def _comparison(story: Story) -> str:
    d = story.diagnosis
    unit = unit_text(d.recordings[0].output_unit)
    drawn = figures.models(d)
    says = (
        f"Above: {_key('recorded', 'recorded')}, {_legend(d)}, running free from the initial state. "
        "Below: the error of that."
    )
    if len(d.recordings) == 1 and any(t.role == "holdout" for t in d.traces):
        says += " A part was held out: no fit and no choice has seen it, and the simulation starts there anew."
    rows = []
    for role, name in (("train", "fitted"), ("holdout", "held out")):
        fits = [_fit(d, role, which) for which, _, _ in drawn]
        if any(math.isfinite(f.rmse) for f in fits):
            cells = [f"{number(f.rmse)} {unit}" for f in fits]
            cells += [f"{number(f.nrmse_percent)}\u202f%" for f in fits]
            rows.append((name, *cells, *(_p_value(f.whiteness_p) for f in fits)))
    head = ["data"]
    for quantity in ("RMSE", "of the range", "whiteness p"):
        head += [f"{quantity}<br>{name}" if i == 0 else f"<br>{name}" for i, (_, _, name) in enumerate(drawn)]
    still = _figure(figures.overlay(d), says, "still")
    parts = [explorer(d), still, _table(head, rows, ("", *["number"] * (len(head) - 1)))]
    parts.append(
        _said(
            "Whiteness p: how likely a residual like this one would be if it were noise alone; a small value means "
            "that something, however little, is left in it.",
            "note",
        )
    )
    if len(d.recordings) > 1:
        parts.append(_recordings_table(d))
    return _section("comparison", "Recording against simulation", *parts)


def _p_value(p: float) -> str:
    if not math.isfinite(p):
        return "–"
    return "&lt; 0.001" if p < 0.001 else number(p, 2)


def _recordings_table(d: Diagnosis) -> str:
    """Per recording, the worst first; of many, only these."""
    rows = []
    for t in d.traces:
        span = float(np.nanmax(t.recorded) - np.nanmin(t.recorded))
        if span > 0.0:
            before, after = (100.0 * _size(v - t.recorded) / span for v in (t.before, t.after))
            rows.append((after, t.name, t.role, before))
    rows.sort(reverse=True)
    data = {"holdout": "held out", "train": "fitted"}
    shown = [
        (escape(name), data[role], f"{number(before)}\u202f%", f"{number(after)}\u202f%")
        for after, name, role, before in rows[:_MOST_ROWS]
    ]
    more = f"; the {_MOST_ROWS} worst of {len(rows)}" if len(rows) > _MOST_ROWS else ""
    head = ("recording", "data", "before", "after")
    return _table(head, shown, ("", "", "number", "number"), f"Error per recording, of its own range{more}")


def _residual(story: Story) -> str:
    d = story.diagnosis
    where = escape(d.telling) if len(d.recordings) > 1 else "the recording"
    changed = len(figures.models(d)) > 1
    parts = [
        _said(
            "A position error shows a missing torque late and smeared. This is the torque itself: what a filter must "
            "add to the model at every moment to stay on the recording."
        ),
        _figure(
            figures.missing_over_time(d),
            f"The missing torque along {where}, {_legend(d)}; shaded, "
            f"{_key('misfit', 'where most of the misfit is')}; on the right the worst such stretch, from nearby.",
        ),
    ]
    if d.shapes_before:
        parts.append(
            _figure(
                figures.shapes(d),
                "The same over the state: means with a band of two standard errors. The percentage is the share of the "
                "first model's missing torque that this variable alone predicts, on stretches kept aside.",
            )
        )
    if d.segments:
        worst = sorted(d.segments, key=lambda s: -s.share)[:5]
        said = ", ".join(
            f'<a href="#explorer" data-from="{s.start:.6g}" data-to="{s.end:.6g}">{number(s.start)} to '
            f"{number(s.end)} s</a> ({percent(s.share)})"
            for s in worst
        )
        parts.append(_tag("p", f"Stretches with most of the misfit: {said}."))
    if where := wording.where(d):
        parts.append(_said(where))
    return _section("residual", "What the first model gets wrong" if changed else "What is left over", *parts)


def _ranking(story: Story) -> str:
    d = story.diagnosis
    found = {f.id for f in d.findings}
    bars = "".join(
        f'<li class="{"chosen" if i in found else ""}"><span class="name">{escape(wording.title(i))}</span>'
        f'<span class="bar"><span style="width:{100 * min(max(p, 0.004), 1.0):.1f}%"></span></span>'
        f'<span class="p">{percent(p)}</span></li>'
        for i, p in d.ranking[:8]
    )
    parts = [f'<ol class="ranking">{bars}</ol>'] if bars else []
    parts += [_said(wording.doubt(u)) for u in d.undecided]
    return _section("rivals", "Rival explanations", *parts)


def _value_cell(model: Model, parameter: str, rig: Rig | None) -> str:
    """The value with its standard error, and the same in the rig's own unit below it."""
    own = wording.in_rig_unit(model, parameter, rig)
    value = measure(model.values[parameter], model.std(parameter), model.unit(parameter))
    return escape(value) + (f'<span class="note">{escape(own)}</span>' if own else "")


def _parameters(story: Story) -> str:
    before, after = story.diagnosis.before, story.diagnosis.after
    rows: list[tuple[str, ...]] = []
    for p in after.structure.parameters:
        if p.name in after.undetermined:
            continue
        known = p.name in before.values and p.name not in before.undetermined
        old = _value_cell(before, p.name, story.rig) if known else "–"
        new = _value_cell(after, p.name, story.rig)
        more = [escape(after.notes[p.name])] if p.name in after.notes else []
        if p.name in after.intervals:
            low, high = after.intervals[p.name]
            more.insert(0, f"95\u202f% interval {number(low)} to {number(high)}")
        if not math.isfinite(after.std(p.name)):
            more.append("held fixed")
        meaning = escape(p.meaning) + (f'<span class="note">{"; ".join(more)}</span>' if more else "")
        symbol = figures.math_svg(latex.symbol(p.name, after.axis_unit))
        rows.append((symbol, f"<code>{p.name}</code>", meaning, old, new))
    head = ["", "parameter", "meaning", "first model", "improved model"]
    kinds = ["symbol", "", "", "number", "number"]
    if len(figures.models(story.diagnosis)) == 1:
        head, kinds, rows = [*head[:3], "value"], kinds[:4], [(*row[:3], row[4]) for row in rows]
    says = _said("Value ± standard error. A note says where this recording cannot fix a number, and what would.")
    lost = wording.undetermined_sentence(after)
    return _section("parameters", "Parameters", says, _table(head, rows, kinds), _said(lost, "lost") if lost else "")


def _two_stage(story: Story) -> str:
    found = story.two_stage
    if found is None:
        return ""
    d = story.diagnosis
    parts = [
        _said(
            "The same axis by the classical method, as a cross-check: dead-band and q = b/c from steady speeds, then b "
            "from the transients in which the gears are in mesh."
        )
    ]
    if any(p.used for p in found.pieces):
        says = "Grey: what was recorded in mesh after each change of the input. Right: one b per piece, and from all."
        parts.append(_figure(figures.pieces(found, d.recordings[0].output_unit), says))
    if found.ok:
        drive, x = d.after.input_unit, d.after.axis_unit
        units = {"q": f"{drive}/({x}/s)", "b": "1/s", "c": f"{x}/s^2/{drive}"}
        joint = {"b": "viscous_friction", "c": "input_gain"}
        rows = []
        for n in NAMES:
            other = joint.get(n, n)
            mine = measure(getattr(found, n), found.std(n), units.get(n, drive))
            theirs = measure(d.after.values[other], d.after.std(other)) if other in d.after.values else "–"
            rows.append((escape(n.replace("_", " ")), escape(mine), escape(theirs)))
        parts.append(_table(("", "two-stage", "improved model"), rows, ("", "number", "number")))
    if found.says:
        parts.append(_said(found.says, "note"))
    return _section("two-stage", "The two-stage estimate", *parts)


def _faults(story: Story) -> str:
    d = story.diagnosis
    several = len(d.recordings) > 1
    faults = [(r.name, f) for r in d.recordings for f in r.faults]
    rows = [
        (escape(f.kind), number(f.start), number(f.end), escape(f"{name}: {f.says}" if several else f.says))
        for name, f in faults[:_MOST_ROWS]
    ]
    said = _said(f"{len(faults)} faults; the first {_MOST_ROWS}:") if len(faults) > _MOST_ROWS else ""
    assumed = "".join(_said(f"Assumed, for want of a rig file: {a}") for a in (story.rig.assumed if story.rig else ()))
    assumed += "".join(_said(f"{f.about or r.name}: {f.says}.") for r in d.recordings for f in r.preflight)
    if not rows:
        return _section("recording", "The recording", assumed, _said("No faults were found in it."))
    table = _table(("fault", "from, s", "to, s", ""), rows, ("", "number", "number", ""))
    end = _said("Faulty readings are left out of every fit and every comparison.", "note")
    return _section("recording", "The recording", assumed, said, table, end)


def _control(story: Story) -> str:
    made, ran, model = story.controller, story.tracking, story.diagnosis.after
    if made is None:
        return ""
    x = model.axis_unit
    margins = made.margins
    rows = [
        ("bandwidth", f"{number(made.bandwidth)} Hz"),
        ("phase margin", f"{number(math.degrees(margins.phase))}°"),
        ("gain margin", number(margins.gain)),
        ("delay margin", f"{number(1e3 * margins.delay)} ms"),
        ("largest sensitivity", number(margins.sensitivity)),
    ]
    parts = []
    if ran is not None:
        rows += [
            ("tracking error, RMS", f"{number(ran.rms)} {x}"),
            ("tracking error, largest", f"{number(ran.peak)} {x}"),
            ("command, RMS", escape(measure(ran.effort, unit=model.input_unit))),
            ("settled", f"{number(ran.settled)} s after the last move" if ran.settled is not None else "–"),
        ]
        says = "The controller and the improved model's FMU in FMPy co-simulation; the command leaves a sample late."
        parts.append(_figure(figures.tracking(ran, x, model.input_unit), says))
    parts.append(_table(("feedback-linearising controller", ""), rows, ("", "number")))
    notes = [*(ran.says if ran is not None else ()), *made.remarks]
    items = "".join(_tag("li", escape(capital(pretty(s)))) for s in notes)
    parts.append(f'<ul class="notes">{items}</ul>')
    return _section("control", "What the model can control", *parts)


def _next(story: Story) -> str:
    e = story.diagnosis.experiment
    if not e.why:
        return ""
    parts = [_said(e.why)]
    if e.time.size:
        where = f" It is in {story.experiment_file}." if story.experiment_file else ""
        says = escape(f"The input to play and record.{where}")
        parts.append(_figure(figures.experiment(e, story.diagnosis.after.input_unit), says))
    return _section("next", "What to record next", *parts)


def _how(story: Story) -> str:
    d = story.diagnosis
    seconds = story.seconds or d.seconds
    rows = [(escape(k), f"{number(v, 2)} s") for k, v in seconds.items()]
    parts = [_table(("stage", "time"), rows, ("", "number"))] if rows else []
    if story.checks:
        unit = unit_text(d.recordings[0].output_unit)
        checked = [
            (
                f"<code>{escape(c.fmu)}</code><br>{escape(', '.join(c.platforms))}",
                "valid" if not c.problems else escape("; ".join(c.problems)),
                f"{number(c.rmse)} {unit}",
                f"{number(c.nrmse_percent)}\u202f%",
                "" if c.seconds is None else f"{number(c.seconds, 2)} s",
            )
            for c in story.checks
        ]
        head = ("FMU in FMPy", "validation", "RMSE", "of the range", "time")
        caption = f"The exported FMUs, replaying {escape(story.checks[0].recording)} from beginning to end"
        parts.append(_table(head, checked, ("", "", "number", "number", "number"), caption))
    first = listed([wording.title(i) for i in (*BASE, *d.before.structure.named) if i in d.before.structure])
    parts.append(
        _said(
            f"The first model contains {first}. Parameters are those of maximum likelihood over whole recordings, with "
            "a white torque noise as the only freedom; rivals compete by the likelihood and the number of parameters "
            "that they take.",
            "note",
        )
    )
    return _section("how", "How it was computed", *parts)


def _origin(story: Story) -> str:
    """What another person needs to make this page again, and what to do with the result."""
    origin = story.origin
    if origin is None:
        return ""
    rows = [
        ("twin", escape(origin.version)),
        ("date", escape(origin.date)),
        ("command", f"<code>{escape(origin.command)}</code>"),
    ]
    rows += [(escape(name), f'<code class="digest">sha256 {digest}</code>') for name, digest in origin.inputs]
    rows += [("files written", escape(", ".join(origin.outputs)))] if origin.outputs else []
    parts = [_table(("", ""), [row for row in rows if row[1] != "<code></code>"])]
    if origin.next_commands:
        parts += [_tag("h3", "To go on"), _tag("pre", escape("\n".join(origin.next_commands)), "commands")]
    return _section("origin", "Where this page comes from", *parts)


_PARTS = (
    _still_missing,
    _where,
    _comparison,
    _residual,
    _ranking,
    _parameters,
    _two_stage,
    _faults,
    _control,
    _next,
    _how,
    _origin,
)


def html(story: Story) -> str:
    """The report as one self-contained page."""
    body = "".join([_masthead(story), _merits(story), _lead(story), _found(story), *(part(story) for part in _PARTS)])
    title = escape(wording.headline(story.diagnosis))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{CSS}</style>\n</head>\n<body>\n<main>{body}</main>\n</body>\n</html>\n"
    )
