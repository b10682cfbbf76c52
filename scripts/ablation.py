"""Which rules of the search earn their place? Trials asked again with each rule switched off.

    python scripts/ablation.py --trials circuit:59083:4 --trials mujoco:69061:813
    python scripts/ablation.py --rules narrow_restarts,hidden_pairs --json ablation.jsonl
    python scripts/ablation.py --count

A trial is one of scripts/blind_trial.py: simulator, seed and number. By default it is each of a list of trials whose
answer was near another one. A rule that did nothing in a trial changes no answer there, and is not switched off in it.
The table holds, for every rule, the trials in which it acted, those whose answer changed without it, and those that
became right or wrong. A rule whose removal makes no answer worse does not earn its place. `--count` prints the named
constants and the rules of the search.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parent))

from blind_trial import KINDS, Answer, Label, Outcome, ask, make

from twin.diagnosis import (
    acceptance,
    curve_substitution,
    forward_selection,
    free_curves,
    gap_presence,
    name_tests,
    search_result,
    selection_round,
    short_memory,
    thresholds,
    torque_regression,
    verdict,
)
from twin.estimation import maximum_likelihood
from twin.estimation.estimate import compile_kernel

#: Trials that were decided narrowly, or wrongly, at some commit (docs/trials.md and the comments of the thresholds).
NEAR = (
    "circuit:120401:0", "mujoco:69061:813", "mujoco:69061:790", "circuit:71069:961", "circuit:91002:0",
    "mujoco:140901:0", "mujoco:140901:4", "mujoco:140901:5", "mujoco:140901:9", "circuit:140902:0",
    "circuit:140902:1", "circuit:140902:3", "circuit:140902:6", "textbook:140903:0", "textbook:140903:5",
    "gearmotor:140904:1", "gearmotor:140904:4", "gearmotor:140904:5",
)  # fmt: skip


def _same(*given: Any) -> Any:
    """What a rule that changes nothing returns: the round or the search that it was given."""
    return next(g for g in given if isinstance(g, (selection_round.Round, search_result.SearchResult)))


@dataclass(frozen=True)
class Rule:
    """A rule, where it stands, and what stands there without it."""

    says: str
    module: Any
    name: str
    without: Any


def _constantly(value: Any) -> Callable[..., Any]:
    return lambda *given, **named: value


RULES = {
    "narrow_restarts": Rule("begin again from a close rival of the first round", thresholds, "MAX_RESTARTS", 0),
    "leads_elsewhere": Rule(
        "begin again only where a second effect does more", forward_selection, "_leads_elsewhere", _constantly(True)
    ),
    "round_restarts": Rule("repeat a round from a better smaller model", thresholds, "MAX_ROUND_RESTARTS", 1),
    "replacements": Rule("go on after one effect has replaced another", thresholds, "MAX_REPLACEMENTS", 1),
    "hidden_pairs": Rule("win with a second effect beside", thresholds, "MAX_HIDDEN", 0),
    "exchanged_places": Rule("rivals exchange their optima", thresholds, "MAX_EXCHANGED", 0),
    "long_memory": Rule("repeat a lost round with a long memory", selection_round, "retry_with_long_memory", _same),
    "short_memory": Rule("look closer with a short memory", short_memory, "refine_with_short_memory", _same),
    "followers": Rule("start from the missing torque", thresholds, "MAX_FOLLOWERS", 0),
    "free_motion": Rule("start beside free motion", torque_regression, "fit_to_free_motion", _constantly(None)),
    "roughness": Rule("ask more where the likelihood is rough", maximum_likelihood, "roughness", _constantly(0.0)),
    "foreseen_contacts": Rule(
        "confirm at foreseeable contacts", selection_round, "_confirmed_at_foreseeable_contacts", _constantly(True)
    ),
    "short_memories": Rule(
        "confirm with short memories", selection_round, "_confirmed_by_short_memories", _constantly(True)
    ),
    "law_tolerance": Rule("allow for what laws miss", thresholds, "LAW_TOLERANCE", 0.0),
    "idle_gap": Rule("leave a gap out that does not show", gap_presence, "without_idle_gap", _constantly(None)),
    "idle_names": Rule("drop names that do nothing", name_tests, "_idle_names", _constantly([])),
    "acceptance": Rule("test size and blocks of a name", acceptance, "not_borne_out", _constantly(None)),
    "name_chance": Rule("drop names that predict by chance", thresholds, "NAME_MAX_P_VALUE", 1.0),
    "curves": Rule("replace names by curves", free_curves, "replaces_names", _constantly(False)),
    "substitution": Rule("replace names that cancel", curve_substitution, "best_substitution", _constantly(None)),
    "worse_curve": Rule(
        "no curve that helps no free run", free_curves, "without_worse_curve", lambda found, first: (found, [])
    ),
    "veto": Rule("hand out no model that errs more", verdict, "vetoed", _constantly(False)),
    "stiff_joint": Rule("a joint that damps is a lag", thresholds, "MAX_DAMPING_RATIO", 10.0),
    "wave_of_count": Rule("a wave moves the reading", thresholds, "MIN_WAVE_OF_COUNT", 0.0),
    "min_gain": Rule("half the gain that a name must bring", thresholds, "MIN_GAIN", 0.5 * thresholds.MIN_GAIN),
}


@contextmanager
def without(name: str) -> Iterator[None]:
    """The search without a rule; with all of them where it has no name."""
    with ExitStack() as stack:
        if name:
            rule = RULES[name]
            stack.enter_context(patch.object(rule.module, rule.name, rule.without))
        yield


def _noted(name: str, acted: set[str]) -> Callable[..., Any]:
    """A rule that is a function, which notes where it gives anything else than what stands there without it."""
    rule = RULES[name]
    stands = getattr(rule.module, rule.name)

    def asked(*given: Any, **named: Any) -> Any:
        got = stands(*given, **named)
        if got != rule.without(*given, **named):
            acted.add(name)
        return got

    return asked


@contextmanager
def watched() -> Iterator[set[str]]:
    """The rules that have acted while the search ran. Of one that is a number this is not seen: it may have."""
    acted = {name for name, rule in RULES.items() if not callable(rule.without)}
    with ExitStack() as stack:
        for name in set(RULES) - acted:
            stack.enter_context(patch.object(RULES[name].module, RULES[name].name, _noted(name, acted)))
        yield acted


@dataclass(frozen=True)
class Asked:
    """What the search said of a trial without a rule, which had acted in it or not."""

    trial: str
    rule: str
    exact: bool
    names: tuple[str, ...]
    verdict: str
    acted: bool = True


def _asked(trial: str, rule: str, label: Label, answer: Answer) -> Asked:
    outcome = Outcome(label, "", "", answer, float("nan"))
    return Asked(trial, rule, outcome.exact, tuple(sorted(answer.names)), answer.verdict)


def ask_without(trial: str, rules: Sequence[str], duration: float) -> Iterator[Asked]:
    """The answers to a trial: with all rules first, then without each that acted in it."""
    simulator, seed, number = trial.split(":")
    label, _, recording = make(int(seed), int(number), tuple(KINDS), duration, simulator)
    with watched() as acted:
        usual = _asked(trial, "", label, ask(recording))
    yield usual
    for rule in rules:
        if rule not in acted:
            yield replace(usual, rule=rule, acted=False)
            continue
        with without(rule):
            answer = ask(recording)
        yield _asked(trial, rule, label, answer)


def table(asked: Sequence[Asked]) -> str:
    """One line for each rule."""
    usual = {a.trial: a for a in asked if not a.rule}
    lines = [f"{'without the rule that says':52} {'trials':>6} {'acted':>6} {'changed':>8} {'better':>7} {'worse':>6}"]
    for rule in dict.fromkeys(a.rule for a in asked if a.rule):
        pairs = [(usual[a.trial], a) for a in asked if a.rule == rule]
        changed = sum(u.names != a.names or u.verdict != a.verdict for u, a in pairs)
        acted = sum(a.acted for _, a in pairs)
        better, worse = (sum(b.exact > a.exact for a, b in some) for some in (pairs, [p[::-1] for p in pairs]))
        lines.append(f"{RULES[rule].says:52} {len(pairs):6} {acted:6} {changed:8} {better:7} {worse:6}")
    return "\n".join(lines)


def constants() -> int:
    """The named numbers of twin/diagnosis: names in capitals that stand for numbers alone."""
    found = 0
    for path in sorted((Path(__file__).resolve().parents[1] / "twin" / "diagnosis").glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.Assign):
                continue
            values = [v.value for v in ast.walk(node.value) if isinstance(v, ast.Constant)]
            names = [t.id for target in node.targets for t in ast.walk(target) if isinstance(t, ast.Name)]
            if values and all(isinstance(v, int | float) for v in values):
                found += sum(name.isupper() for name in names)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", action="append", metavar="SIMULATOR:SEED:NUMBER")
    parser.add_argument("--rules", default=",".join(RULES), help="some of " + ", ".join(RULES))
    parser.add_argument("--duration", type=float, default=30.0, help="of a recording, s")
    parser.add_argument("--json", type=Path, metavar="FILE", help="append one line per answer")
    parser.add_argument("--count", action="store_true", help="only print the numbers of constants and rules")
    given = parser.parse_args()
    if given.count:
        print(f"{constants()} named constants in twin/diagnosis, {len(RULES)} rules that can be switched off")
        return
    rules = given.rules.split(",")
    if unknown := [r for r in rules if r not in RULES]:
        parser.error(f"there is no rule {unknown[0]!r}: choose from {', '.join(RULES)}")
    compile_kernel(lambda sentence, share: None)
    asked: list[Asked] = []
    for trial in given.trials or NEAR:
        for one in ask_without(trial, rules, given.duration):
            asked.append(one)
            print(
                f"{one.trial} without {one.rule or 'nothing'}: {'exact' if one.exact else 'not exact'}; "
                f"{one.verdict}; {', '.join(one.names) or 'no name'}",
                flush=True,
            )
            if given.json:
                with given.json.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(vars(one)) + "\n")
    print(table(asked))


if __name__ == "__main__":
    main()
