"""What may be claimed: a function of the figures of `twin.diagnosis.adequacy` and the findings, and of nothing else.

The table of conditions is in docs/evidence.md, section "Verdicts".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun, TorqueFigures
from twin.diagnosis.result import Estimate, Finding, NotBorneOut
from twin.effects.catalogue import EFFECTS
from twin.model.stepper import Structure

#: An error is not noise if it passes three limits. Noise makes it less often than the first. It is the second times the
#: expected one. It is more than the third as a share of the recorded range. A free run nearer than that leaves nothing
#: visible.
CHANCE, SEVERAL, SHOWS = 1e-3, 3.0, 0.01
#: By this share an error is larger than another.
LARGER = 1.05
#: Share of the missing torque that is large, if it is also the second share of the drive's torque. The third is the
#: share of the drive's torque from which on something is missing by itself, whatever noise the fit takes it for.
MUCH_LEFT, OF_DRIVE, TOO_MUCH = 0.5, 0.05, 0.3
#: Standard errors by which a size has to differ from nothing.
SURE = 2.0


@dataclass(frozen=True)
class Claims:
    """The verdict (an id of the contract), its sentence, and what speaks against more being claimed."""

    verdict: str
    says: str
    objections: tuple[str, ...]


def is_off(run: FreeRun, span: float) -> bool:
    """Whether a free run errs by what the model's own noise does not make, and visibly."""
    return bool(
        run.p_value < CHANCE and run.rmse > SEVERAL * run.expected and run.rmse > SHOWS * span and math.isfinite(span)
    )


def is_worse(compared: Comparison) -> bool:
    """Whether the last model errs more than the first, and more than the noise of either makes: within that, chance
    rules. A model whose parameters nothing fixes expects any error.
    """
    before, after = compared.before, compared.after
    return after.rmse > LARGER * before.rmse and not after.rmse <= min(before.largest, after.largest)


def vetoed(figures: Adequacy) -> bool:
    """Whether the data that no fit has seen contradict the last model: then the first is handed out."""
    return is_worse(_judge(figures)[1])


def _judge(figures: Adequacy) -> tuple[str, Comparison]:
    """The free runs through held-out data; through fitted ones where none was held out."""
    where = "holdout" if "holdout" in figures.free_run else "train"
    return where, figures.free_run[where]


def vetoed_names(figures: Adequacy, last: Structure, first: Structure) -> list[NotBorneOut]:
    """The names of a last model that is not handed out, with how many times the first model's error it makes."""
    where, compared = _judge(figures)
    ratio = compared.after.rmse / compared.before.rmse
    data = "held-out" if where == "holdout" else "fitted"
    reason = f"with it the free run on {data} data errs {ratio:.2f} times as much as the first model's"
    return [NotBorneOut(i, reason, ratio) for i in last.named if i not in first]


def veto_sentence(figures: Adequacy, last: Structure, first: Structure) -> str:
    """Why the last model is not handed out."""
    titles = ", ".join(EFFECTS[i].title for i in last.named if i not in first)
    where, compared = _judge(figures)
    data = "held-out" if where == "holdout" else "fitted"
    return (
        f"Tried, not confirmed: {titles}. With it the free run on {data} data errs {compared.after.rmse:.3g} where the "
        f"first model errs {compared.before.rmse:.3g}, so the first model is kept."
    )


def size_of(finding: Finding) -> Estimate | None:
    """The estimate of the effect's size; None where it has none, or it was held."""
    screen = EFFECTS[finding.id].screen if finding.id in EFFECTS else None
    found = finding.parameters.get(screen.gain) if screen else None
    return found if found is not None and math.isfinite(found.std) else None


def includes_nothing(finding: Finding) -> bool:
    """Whether the effect's size may as well be nothing."""
    size = size_of(finding)
    if size is None:
        return False
    (neutral,) = [p.neutral for p in EFFECTS[finding.id].parameters if p.name in finding.parameters][:1] or [0.0]
    return abs(size.value - (neutral if neutral is not None and math.isfinite(neutral) else 0.0)) < SURE * size.std


def _times(ratio: float) -> str:
    if f"{ratio:.2g}" == "1":
        return "as much"
    return f"{ratio:.2g} times as much" if ratio < 100.0 else f"{ratio:.0f} times as much"


def objections(figures: Adequacy, findings: Sequence[Finding]) -> list[str]:
    """Objections to the claim that the model explains the recording, each as a part of a sentence."""
    said = []
    train, held_out = figures.free_run.get("train"), figures.free_run.get("holdout")
    if train is not None and is_off(train.after, train.span):
        said.append(
            f"the free run through the fitted data errs {_times(train.after.rmse / train.after.expected)} as "
            "the model's own noise makes"
        )
    if held_out is not None and is_off(held_out.after, held_out.span):
        said.append(
            f"on data that no fit has seen it errs {_times(held_out.after.rmse / held_out.after.expected)} as "
            "the model's own noise makes"
        )
    for where, compared in (("fitted", train), ("held-out", held_out)):
        if compared is not None and is_worse(compared):
            ratio = compared.after.rmse / compared.before.rmse
            said.append(f"on {where} data it errs {ratio:.2f} times as much as the first model")
    torque = figures.missing_torque
    if findings and torque.share_left > MUCH_LEFT and torque.of_drive > OF_DRIVE:
        said.append(f"{100.0 * torque.share_left:.0f} % of the missing torque is left")
    if torque.of_drive > TOO_MUCH:
        said.append(f"the torque that it lacks is {100.0 * torque.of_drive:.0f} % of the drive's")
    said += [f"the size of {EFFECTS[f.id].title} may be nothing" for f in findings if includes_nothing(f)]
    return said


def decide(figures: Adequacy, findings: Sequence[Finding], left: bool, drawn: bool) -> Claims:
    """The verdict, and what the figures allow to be claimed in one sentence.

    Parameters
    ----------
    figures : Adequacy
        Of the first and the last model.
    findings : sequence of Finding
        The effects that the last model names beyond the first.
    left : bool
        Whether the torque that the last model lacks still goes with something, beyond chance.
    drawn : bool
        Whether a curve without a name is part of the last model.
    """
    against = objections(figures, findings)
    held_out = figures.free_run.get("holdout")
    beyond_only = bool(figures.beyond_training) and held_out is not None and is_off(held_out.after, held_out.span)
    if not (left or against or drawn):
        verdict = "explained" if findings else "nothing_missing"
    elif findings and not vetoed(figures):
        verdict = "partly_explained"
    elif not (findings or left or drawn) and beyond_only and len(against) == 1:
        verdict = "inconclusive"
    else:
        verdict = "unexplained"
    return Claims(verdict, sentence(verdict, figures, against), tuple(against))


_OPENINGS: Mapping[str, str] = {
    "explained": "The figures support the model",
    "nothing_missing": "The figures support the first model",
    "partly_explained": "The figures support what is named, but not that it is all that is missing",
    "unexplained": "The figures do not support the model",
    "inconclusive": "The figures allow no claim",
}


#: Where the fitted data themselves are not followed: names may help by standing for something else.
_NOT_THE_CAUSE = "The figures do not show that what is named is the cause"
_ALTHOUGH = ", although with it the free run through the fitted data errs {} as much"


#: The same where no figure speaks against the model, but something in it, or left by it, has no name.
_WITHOUT_NAME: Mapping[str, str] = {
    "partly_explained": "The figures support what is named, and something without a name beside it",
    "unexplained": "The figures are good, but something in the model, or left by it, has no name",
}


def _on_held_out(run: FreeRun) -> str:
    """The held-out error against noise."""
    if not math.isfinite(run.rmse):
        return ""
    if not run.expected > 0.0:
        return "its own noise makes no error that the held-out one could be held against"
    rare = "which chance makes less often than once in 1000" if run.p_value < CHANCE else f"p = {run.p_value:.2g}"
    return f"its free run on held-out data errs {_times(run.rmse / run.expected)} as its own noise makes, {rare}"


def sentence(verdict: str, figures: Adequacy, against: Sequence[str]) -> str:
    """What the figures allow to be claimed, in one sentence."""
    held_out, torque = figures.free_run.get("holdout"), figures.missing_torque
    facts = list(against[:2]) or ([_on_held_out(held_out.after)] if held_out is not None else [])
    if not against and math.isfinite(torque.of_drive):
        facts.append(_lacking(torque))
    # Later times are untested wherever the end is held out: that is worth a word where something is off.
    beyond = [b for b in figures.beyond_training if against or b.variable != "time"]
    if beyond:
        names = ", ".join(f"{b.variable} beyond {b.train[0]:.3g} to {b.train[1]:.3g} {b.unit}".rstrip() for b in beyond)
        facts.append(f"nothing was fitted at {names}")
    train = figures.free_run.get("train")
    opening = _OPENINGS[verdict] if against or verdict not in _WITHOUT_NAME else _WITHOUT_NAME[verdict]
    if verdict == "partly_explained" and train is not None and is_off(train.after, train.span):
        ratio = train.after.rmse / train.before.rmse
        opening = _NOT_THE_CAUSE + (_ALTHOUGH.format(_percent(ratio)) if LARGER * ratio < 1.0 else "")
    return f"{opening}: {'; '.join(f for f in facts if f)}." if any(facts) else f"{opening}."


def _lacking(torque: TorqueFigures) -> str:
    """The torque that the last model lacks, against the drive's."""
    if torque.is_hidden and torque.drive > 0.0:
        noise = _percent(torque.by_reading / torque.drive)
        return f"the torque that it lacks is hidden by the noise of the readings, which makes {noise} of the drive's"
    return f"the torque that it lacks is {_percent(torque.of_drive)} of the drive's"


def _percent(share: float) -> str:
    if share < 1e-3:
        return "under 0.1 %"
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"
