"""How numbers and verdicts are put into words; the command line and the report say the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from twin.display.numbers import listed, measure, number, percent, unit_text
from twin.effects.catalogue import EFFECTS, UNKNOWN

if TYPE_CHECKING:
    from twin.control.cosimulation import Tracking
    from twin.diagnosis.localization import Segment
    from twin.diagnosis.result import Diagnosis, Fitness, Undecided
    from twin.io.recording import Recording, Rig
    from twin.model.fitted_model import Model

#: The variables that a misfit may go with, in plain words.
VARIABLES = {
    "position": "position", "velocity": "speed", "acceleration": "acceleration", "input": "the command",
    "time": "time", "direction": "the direction of motion", "load": "the load",
}  # fmt: skip

#: The least share of the missing torque that a variable has to predict to be named.
LEAST_SHARE = 0.05
#: An input gain that is off by less is not worth a sentence.
LEAST_BIAS = 0.01
#: So many ranges of a variable are put into words; more say that it acts all over.
MOST_REGIMES = 3


def undetermined_sentence(model: Model) -> str:
    """The parameters that a recording cannot fix, and what would fix them, in one line; "" where all are fixed."""
    if not model.undetermined:
        return ""
    names = listed([n.replace("_", " ") for n in model.undetermined])
    remedies = dict.fromkeys(model.notes[n].rsplit(";", 1)[-1].strip() for n in model.undetermined)
    return f"Not determined by this recording: {names}. What would help: {'; '.join(remedies)}."


def in_rig_unit(model: Model, parameter: str, rig: Rig | None) -> str:
    """A parameter in the unit in which its rig logs, with its standard error; "" where that is the model's own,
    and for nothing.
    """
    own = None if rig is None else rig.own_unit(model.unit(parameter))
    if own is None or model.values[parameter] == 0.0:
        return ""
    unit, factor = own
    return measure(factor * model.values[parameter], factor * model.std(parameter), unit)


def title(effect: str) -> str:
    return EFFECTS[effect].title if effect in EFFECTS else effect.replace("_", " ")


def variables(diagnosis: Diagnosis) -> str:
    """What the misfit goes with."""
    return listed([VARIABLES.get(v, v) for v in diagnosis.depends_on])


def doubt(pair: Undecided) -> str:
    """Two effects that could be each other, how likely either is, and what would tell."""
    one, two = (f"{title(i)} ({percent(p)})" for i, p in zip(pair.ids, pair.probabilities, strict=True))
    return f"This recording cannot tell {one} from {two}; this would: {pair.experiment}."


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    found = listed([_or_else(f.id, diagnosis) for f in diagnosis.findings])
    if diagnosis.verdict == "explained":
        pronoun = "it" if len(diagnosis.findings) == 1 else "them"
        return f"The first model left out {found}; with {pronoun}, the model explains the recording."
    if diagnosis.verdict == "nothing_missing":
        return "Nothing is missing: the first model already explains this recording."
    if diagnosis.verdict == "partly_explained":
        return f"The first model left out {found}, and something else that has no name here yet."
    if diagnosis.verdict == "stopped":
        return "The search was stopped; this is its best model so far."
    if diagnosis.verdict == "inconclusive":
        return "This recording allows no claim about what the model lacks."
    where = variables(diagnosis)
    tail = f", and it goes with {where}" if where else ""
    drawn = listed([title(i) for i in diagnosis.after.structure.ids if i in UNKNOWN])
    curve = f". Fitted in its place: {drawn}" if drawn else ""
    return f"Something is missing that none of the known effects describes{tail}{curve}."


def nameless(diagnosis: Diagnosis) -> list[str]:
    """What is fitted in the place of what has no name, with its numbers."""
    return [diagnosis.after.says(i) for i in diagnosis.after.structure.ids if i in UNKNOWN]


def _or_else(effect: str, diagnosis: Diagnosis) -> str:
    """An effect and whatever could as well stand in its place."""
    rivals = [title(u.ids[1]) for u in diagnosis.undecided if u.ids[0] == effect]
    return " or ".join([title(effect), *rivals]) + (" (this recording cannot tell which)" if rivals else "")


def _fit_change(before: Fitness, after: Fitness, unit: str, where: str) -> str:
    """How the free-running error changed, if it did."""
    if before.rmse == after.rmse:
        share = f"{number(after.nrmse_percent)}\u202f% of the recorded range"
        return f"{where} the free-running simulation errs by {share} ({number(after.rmse)} {unit_text(unit)})."
    change = (
        f"from {number(before.nrmse_percent)}\u202f% to {number(after.nrmse_percent)}\u202f% of the recorded range "
        f"({number(before.rmse)} to {number(after.rmse)} {unit_text(unit)})"
    )
    moved = "falls" if after.rmse < 0.98 * before.rmse else "goes" if after.rmse < 1.02 * before.rmse else "rises"
    return f"{where} the free-running simulation's error {moved} {change}."


def _held_out_part(diagnosis: Diagnosis) -> str:
    """What the hold-out is, to begin a sentence with."""
    held = [t for t in diagnosis.traces if t.role == "holdout"]
    span = sum(float(t.time[-1] - t.time[0]) for t in held)
    of = f" in {len(held)} recordings" if len(held) > 1 else ""
    return f"On {number(span)} s{of} that no fit has seen"


def fit_sentence(diagnosis: Diagnosis) -> str:
    """The change of the error on what was held out, or on the training data where nothing was."""
    unit = diagnosis.recordings[0].output_unit
    for role in ("holdout", "train"):
        both = diagnosis.fit.get(role, {})
        if "before" in both and math.isfinite(both["before"].rmse):
            where = _held_out_part(diagnosis) if role == "holdout" else "On the training data"
            return _fit_change(both["before"], both["after"], unit, where)
    return "There were no readings to compare a simulation with."


def where(diagnosis: Diagnosis) -> str:
    """At which values the first model lacks most, and how that bent its gain; "" where neither can be said."""
    share = diagnosis.gain_bias
    size = "large" if share > 0.0 else "small"
    bent = f"It made the first model's input gain {percent(abs(share))} too {size}." if abs(share) > LEAST_BIAS else ""
    return " ".join(s for s in (_at_values(diagnosis), bent) if s)


def _at_values(diagnosis: Diagnosis) -> str:
    """The values at which the first model lacks most; "" where it lacks something everywhere."""
    regimes = diagnosis.regimes
    if not 0 < len(regimes) <= MOST_REGIMES:
        return ""
    if regimes[0].variable == "direction":
        return f"It acts in {'forward' if regimes[0].high > 0.0 else 'backward'} motion."
    axis = diagnosis.after.axis_unit
    units = {"position": axis, "velocity": f"{axis}/s", "acceleration": f"{axis}/s^2"}
    unit = unit_text(units.get(regimes[0].variable, diagnosis.recordings[0].input_unit))
    ranges = listed([f"from {number(r.low, 2)} to {number(r.high, 2)} {unit}" for r in regimes])
    turns = " within each turn" if regimes[0].period else ""
    return f"It acts where the {VARIABLES[regimes[0].variable].removeprefix('the ')} is {ranges}{turns}."


def still_missing(diagnosis: Diagnosis, stretches: Sequence[Segment]) -> str:
    """How large the torque is that the last model lacks, what it goes with, and the stretches in which most of it acts;
    "" where nothing is missing."""
    if diagnosis.verdict in ("explained", "nothing_missing"):
        return ""
    figures = diagnosis.adequacy.missing_torque
    if not math.isfinite(figures.after):
        return ""
    said = [f"{number(figures.after, 2)} {unit_text(figures.unit)} RMS of torque over inertia is still missing"]
    if math.isfinite(figures.of_drive):
        said.append(f"{percent(figures.of_drive)} of what the drive makes")
    telling = [
        f"{VARIABLES[s.variable]} ({percent(s.share)})" for s in diagnosis.shapes_after[:3] if s.share >= LEAST_SHARE
    ]
    goes = f"It goes with {listed(telling)}" if telling else "It goes with no state of motion that was looked at"
    worst = sorted(stretches, key=lambda s: -s.share)[:3]
    when = [f"{number(s.start)} to {number(s.end)} s" for s in sorted(worst, key=lambda s: s.start)]
    return f"{', '.join(said)}. {goes}. Most of it acts from {listed(when)}." if when else f"{', '.join(said)}. {goes}."


def sentences(diagnosis: Diagnosis, tracking: Tracking | None = None) -> tuple[str, ...]:
    """What somebody who reads only three sentences should know."""
    found = [*(f.says for f in diagnosis.findings), *nameless(diagnosis)]
    said = [*diagnosis.since, " ".join([headline(diagnosis), *found]), fit_sentence(diagnosis)]
    if diagnosis.adequacy.says:
        said.append(diagnosis.adequacy.says)
    if tracking is not None:
        said.append(f"The controller made from the model was tried against the FMU: {_lower(tracking.says[0])}")
    return tuple(said)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def recordings_sentence(recordings: Sequence[Recording]) -> str:
    """What was recorded."""
    first = recordings[0]
    if len(recordings) == 1:
        return f"{first.name}: {first!r}."
    span = sum(float(r.time[-1]) for r in recordings)
    held = sum(r.role == "holdout" for r in recordings)
    return f"{len(recordings)} recordings of {number(span)} s in all, {held} of them held out; the first: {first!r}."
