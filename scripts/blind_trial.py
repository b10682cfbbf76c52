"""Does the tool name what it is not told? Effects concealed in simulated rigs, labels sealed until it has answered.

    python scripts/blind_trial.py --trials 20 --seed 1 --json trials.jsonl
    python scripts/blind_trial.py --simulator circuit --trials 20 --seed 1
    python scripts/blind_trial.py --summarise trials.jsonl

One trial: rig, excitation, effects and their sizes are drawn; SHA-256 of label and salt is printed; the tool gets
the recording alone, in a process that never held the label, and answers; label and salt are printed. At the end the
answers are held against the labels. The same seed draws the same trials, whatever the number of processes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

from concealed import Concealed, Trip, visibility
from excitations import EXCITATIONS, FREE
from simulators import SIMULATORS
from worn_rig import DEPARTS

from twin.diagnosis import diagnose
from twin.effects.catalogue import BASE, CANDIDATES
from twin.estimation.estimate import compile_kernel
from twin.io.recording import Recording
from twin.model.stepper import Structure

Array = NDArray[np.float64]

KINDS = {"single": 0.5, "pair": 0.2, "none": 0.15, "outside": 0.15}  # how often each is drawn
SMALLEST, LARGEST = 0.001, 0.3  # sizes as `draw_effect` has them; the largest is plain to see on every rig
FLOOR = 1.0  # an effect that changes less than noise does is not there
VISIBLE = 3.0  # it at least triples what noise alone leaves
REDRAWS = 8
VISIBILITIES = (FLOOR, 2.0, VISIBLE, 5.0, 10.0, 30.0, math.inf)
NOTHING, UNKNOWN, FAILED = "nothing", "unknown", "failed"
START = Structure.of(BASE)
VOCABULARY = SIMULATORS["mujoco"].VOCABULARY  # of each


@dataclass(frozen=True)
class Planted:
    """One concealed effect; `visibility` is what it changes by itself over what noise changes."""

    id: str
    size: float
    visibility: float
    parameters: dict[str, float]


@dataclass(frozen=True)
class Label:
    """All that is true about one trial."""

    seed: int
    trial: int
    simulator: str
    kind: str
    excitation: str
    duration: float
    rig: dict[str, float]
    effects: tuple[Planted, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Ids that a right answer consists of: effects that another one brings along are not named beside it."""
        return () if self.kind == "outside" else Structure.of((*BASE, *(e.id for e in self.effects))).named

    @property
    def departures(self) -> set[str]:
        """Ids of what the rig has beside the concealed effects: to name one is right, and so is not to name it."""
        return {name.removeprefix(DEPARTS) for name in self.rig if name.startswith(DEPARTS)} - set(self.names)

    @property
    def visibility(self) -> float:
        """That of the faintest effect; infinite where there is none."""
        return min((e.visibility for e in self.effects), default=math.inf)

    def text(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)


def seal(label: Label, salt: str) -> str:
    """What is printed before the tool runs: it binds the label and does not tell it."""
    return hashlib.sha256((label.text() + salt).encode()).hexdigest()


@dataclass(frozen=True)
class Answer:
    """What the tool said. Hold-out errors (rad) are of the free run through the FMU; NaN when it failed."""

    verdict: str
    findings: tuple[tuple[str, float], ...]  # id and probability, the likeliest first
    before: float
    after: float
    seconds: float
    says: str = ""  # of a failure
    undecided: tuple[tuple[str, str], ...] = ()  # pairs that it says the recording cannot tell apart

    @property
    def names(self) -> set[str]:
        return {i for i, _ in self.findings}

    @property
    def first(self) -> str:
        if self.findings:
            return self.findings[0][0]
        return {"nothing_missing": NOTHING, FAILED: FAILED}.get(self.verdict, UNKNOWN)


@dataclass(frozen=True)
class Outcome:
    """An opened trial. `possible` is the hold-out error (rad) of the truth as the tool fits it; NaN unknown."""

    label: Label
    salt: str
    seal: str
    answer: Answer
    possible: float

    @property
    def visible(self) -> bool:
        return self.label.visibility >= VISIBLE

    @property
    def first_right(self) -> bool:
        first = next((i for i, _ in self.answer.findings if i not in self.label.departures), "")
        if not first and not self.label.names and self.label.kind != "outside":
            return self.answer.verdict != FAILED and (bool(self.label.departures) or self.answer.first == NOTHING)
        wanted = self.label.names or (UNKNOWN if self.label.kind == "outside" else NOTHING,)
        return (first or self.answer.first) in wanted

    @property
    def exact(self) -> bool:
        return self.first_right and self.answer.names - self.label.departures == set(self.label.names)

    @property
    def doubted(self) -> bool:
        """Whether all that is there is either named or in a pair that the tool says it cannot tell apart."""
        said = self.answer.names.union(*self.answer.undecided)
        return set(self.label.names) <= said

    @property
    def achieved(self) -> float:
        """Share of the possible hold-out improvement; NaN where none was possible or it is unknown."""
        gain = self.answer.before - self.possible
        return (self.answer.before - self.answer.after) / gain if gain > 0.0 else math.nan


# ---- making trials; this knows the truth ----


def _ids(rng: np.random.Generator, kind: str, outside: Sequence[str]) -> tuple[str, ...]:
    if kind == "none":
        return ()
    if kind == "outside":
        return (str(rng.choice(outside)),)
    while True:
        ids = tuple(rng.choice(VOCABULARY, 2 if kind == "pair" else 1, replace=False).tolist())
        if len(Structure.of((*BASE, *ids)).named) == len(ids):  # neither of a pair brings the other along
            return ids


def _plant(
    rng: np.random.Generator, effect: str, source: Any, rig: Any, trip: Trip, duration: float
) -> tuple[Concealed, Planted] | None:
    """The effect at a size drawn log-uniformly from its noise floor up; None where it cannot show at all."""
    least = SMALLEST
    for _ in range(REDRAWS):
        size = least * (LARGEST / least) ** float(rng.uniform())
        drawn = source.draw_effect(rng, effect, rig, size, duration)
        seen = visibility(trip, rig, [drawn])
        if seen >= FLOOR:
            return drawn, Planted(effect, size, seen, drawn.parameters)
        least = size  # visibility grows with size: what is below need not be tried again
    return None


@dataclass(frozen=True)
class Study:
    """What the trials of a study have in common; with it, a trial's number draws all of that trial."""

    seed: int
    kinds: Sequence[str]
    duration: float  # of a recording, s
    simulator: str


@dataclass(frozen=True, eq=False)
class Draw:
    """All that a trial is made of: the label, its salt, and what the simulator is given."""

    label: Label
    salt: str
    rig: Any
    effects: tuple[Concealed, ...]
    time: Array
    duty: Array
    noise_seed: int


def draw(seed: int, trial: int, kinds: Sequence[str], duration: float, simulator: str = "mujoco") -> Draw:
    """A trial, all by simulator, seed and number."""
    source = SIMULATORS[simulator]
    rng = np.random.default_rng([seed, trial])
    salt = rng.bytes(16).hex()
    shares = np.array([KINDS[k] for k in kinds])
    kind = str(rng.choice(kinds, p=shares / shares.sum()))
    while True:
        rig, excitation = source.draw_rig(rng), str(rng.choice(list(EXCITATIONS)))
        ids = _ids(rng, kind, source.OUTSIDE)
        stamps, duty = EXCITATIONS[excitation](duration, rng, FREE)
        trip = Trip(source.simulate, stamps, duty, int(rng.integers(2**31)))
        found = []
        for effect in ids:
            one = _plant(rng, effect, source, rig, trip, duration)
            if one is None:
                break
            found.append(one)
        else:
            break
    planted = tuple(p for _, p in found)
    label = Label(seed, trial, simulator, kind, excitation, duration, rig.truths(), planted)
    return Draw(label, salt, rig, tuple(e for e, _ in found), stamps, duty, trip.seed)


def make(
    seed: int, trial: int, kinds: Sequence[str], duration: float, simulator: str = "mujoco"
) -> tuple[Label, str, Recording]:
    """A trial's label, its salt and the recording."""
    drawn = draw(seed, trial, kinds, duration, simulator)
    planted = [Concealed(p.id, p.parameters) for p in drawn.label.effects]
    run = SIMULATORS[simulator].simulate(drawn.rig, planted, drawn.time, drawn.duty, drawn.noise_seed)
    count = 2.0 * math.pi / run.counts_per_revolution
    recording = Recording(f"trial {trial}", run.time, run.duty, run.counts * count, "%", "rad", count)
    return drawn.label, drawn.salt, recording


# ---- the tool, in a process that is given the arguments below and nothing else ----


def ask(recording: Recording, candidates: Sequence[str] = CANDIDATES) -> Answer:
    """The tool's answer to a recording alone, from the base structure."""
    begun = time.perf_counter()
    try:
        found = diagnose.diagnose([recording], START, candidates=candidates)
    except Exception as error:  # a trial that the tool does not survive counts against it and ends no study
        return Answer(FAILED, (), math.nan, math.nan, time.perf_counter() - begun, f"{type(error).__name__}: {error}")
    held_out = found.fit["holdout"]
    findings = tuple((f.id, float(f.probability)) for f in found.findings)
    errors = held_out["before"].rmse, held_out["after"].rmse
    pairs = tuple(u.ids for u in found.undecided)
    return Answer(found.verdict, findings, *errors, time.perf_counter() - begun, undecided=pairs)


# ---- running them ----


def _trial(pool: Executor, study: Study, trial: int) -> Outcome:
    label, salt, recording = make(study.seed, trial, study.kinds, study.duration, study.simulator)
    sealed = seal(label, salt)
    print(f"trial {trial}: sealed {sealed}", flush=True)
    answer = pool.submit(ask, recording).result()
    best = answer
    if label.names and answer.names != set(label.names):
        # The seal is broken only now: what would the tool have reached, had it had the truth alone to choose from?
        best = pool.submit(ask, recording, label.names).result()
        if best.verdict == FAILED:
            print(f"trial {trial}: the true structure could not be fitted: {best.says}", flush=True)
    possible = best.after if best.names == set(label.names) else math.nan
    return Outcome(label, salt, sealed, answer, possible)


def _opened(outcome: Outcome) -> str:
    label, answer = outcome.label, outcome.answer
    truth = " + ".join(f"{e.id} (visibility {e.visibility:.3g})" for e in label.effects) or NOTHING
    said = " + ".join(f"{i} ({p:.2f})" for i, p in answer.findings) or answer.first
    said += "".join(f", not told apart: {one} and {other}" for one, other in answer.undecided)
    verdict = f"{answer.verdict} {answer.says}".rstrip()
    mark = "exact" if outcome.exact else "first right" if outcome.first_right else "wrong"
    return (
        f"trial {label.trial}: opened, label {label.text()} salt {outcome.salt}\n"
        f"trial {label.trial}: {mark}; {truth}; said {said}; {verdict} in {answer.seconds:.1f} s"
    )


def run(study: Study, trials: Iterable[int], processes: int, done: Callable[[Outcome], None]) -> list[Outcome]:
    """These trials of a study; `done` is called with each as it is opened."""
    compile_kernel(lambda sentence, share: print(sentence, file=sys.stderr))
    # Fresh processes: they share no memory with this one, and the linear algebra in them starts with one thread each.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    outcomes = []
    with (
        ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool,
        ThreadPoolExecutor(processes) as threads,
    ):
        waiting = [threads.submit(_trial, pool, study, n) for n in trials]
        try:
            for future in as_completed(waiting):
                outcomes.append(future.result())
                print(_opened(outcomes[-1]), flush=True)
                done(outcomes[-1])
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            raise
    return outcomes


def write(path: Path, outcome: Outcome) -> None:
    """Append one line to the file."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(outcome)) + "\n")


def read(path: Path) -> list[Outcome]:
    """The outcomes in a file. Raises ValueError where a label is not the one that was sealed, or stands twice."""
    outcomes: list[Outcome] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        entry: dict[str, Any] = json.loads(line)
        label = Label(**{**entry["label"], "effects": tuple(Planted(**e) for e in entry["label"]["effects"])})
        findings = tuple((str(i), float(p)) for i, p in entry["answer"]["findings"])
        pairs = tuple((str(one), str(other)) for one, other in entry["answer"]["undecided"])
        answer = Answer(**{**entry["answer"], "findings": findings, "undecided": pairs})
        outcome = Outcome(label, entry["salt"], entry["seal"], answer, entry["possible"])
        if seal(label, outcome.salt) != outcome.seal:
            raise ValueError(f"{path}: trial {label.trial}: label and salt do not give the seal")
        if any(o.seal == outcome.seal for o in outcomes):
            raise ValueError(f"{path}: trial {label.trial} of seed {label.seed} stands twice")
        outcomes.append(outcome)
    return outcomes


# ---- what came out ----


def share(of: Sequence[bool]) -> str:
    """Percent, count and 95 % interval (Wilson)."""
    n, k = len(of), sum(of)
    if n == 0:
        return "- (none drawn)"
    z = 1.96
    centre, spread = (k + z * z / 2.0) / (n + z * z), z / (n + z * z) * math.sqrt(k * (n - k) / n + z * z / 4.0)
    low, high = max(centre - spread, 0.0), centre + spread
    return f"{100.0 * k / n:.1f} % ({k} of {n}; {100.0 * low:.0f} to {100.0 * high:.0f} %)"


def claims(outcomes: Iterable[Outcome]) -> list[tuple[float, bool]]:
    """Every name that the tool gave: its probability, and whether the effect was there."""
    there = ((o, {*o.label.names, *o.label.departures}) for o in outcomes)
    return [(p, i in ids) for o, ids in there for i, p in o.answer.findings]


def reliability(given: Sequence[tuple[float, bool]], bins: int = 10) -> list[tuple[int, float, float]]:
    """For each bin of probability that holds claims: how many, their mean probability, the share that was right."""
    rows = []
    for k in range(bins):
        own = [(p, right) for p, right in given if min(int(p * bins), bins - 1) == k]
        if own:
            rows.append((len(own), float(np.mean([p for p, _ in own])), float(np.mean([r for _, r in own]))))
    return rows


def calibration_error(given: Sequence[tuple[float, bool]]) -> float:
    """Expected calibration error; NaN without claims."""
    rows = reliability(given)
    return sum(n * abs(p - right) for n, p, right in rows) / len(given) if given else math.nan


def chance_error(given: Sequence[tuple[float, bool]], draws: int = 200) -> float:
    """The calibration error that chance alone leaves, in the mean, where each of these probabilities is right."""
    rng, said = np.random.default_rng(0), [p for p, _ in given]
    return float(np.mean([calibration_error([(p, bool(rng.random() < p)) for p in said]) for _ in range(draws)]))


def confusion(outcomes: Iterable[Outcome]) -> str:
    """Truth in the rows, the first name given in the columns."""
    cells = Counter(((o.label.effects[0].id if o.label.effects else NOTHING), o.answer.first) for o in outcomes)
    outside = sorted({i for s in SIMULATORS.values() for i in s.OUTSIDE})
    known = (NOTHING, *VOCABULARY, *outside, UNKNOWN, FAILED)
    ids = [i for i in known if any(i in pair for pair in cells)]
    said = [i for i in ids if any(column == i for _, column in cells)]
    lines = [" " * 33 + "".join(f"{ids.index(i) + 1:4}" for i in said)]
    for number, truth in enumerate(ids, 1):
        row = [cells[truth, column] for column in said]
        lines.append(f"{number:4} {truth:28}" + "".join(f"{n or '.':>4}" for n in row))
    return "\n".join(lines)


def _detection(singles: Sequence[Outcome]) -> list[str]:
    lines = [f"{'visibility':>12} {'trials':>6} {'anything':>9} {'first':>6} {'exact':>6}"]
    for low, high in pairwise(VISIBILITIES):
        own = [o for o in singles if low <= o.label.visibility < high]
        if own:
            found = [o.answer.first not in (NOTHING, FAILED) for o in own]
            rates = [100.0 * float(np.mean(r)) for r in (found, [o.first_right for o in own], [o.exact for o in own])]
            span = f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"
            lines.append(f"{span:>12} {len(own):6} {rates[0]:8.0f}% {rates[1]:5.0f}% {rates[2]:5.0f}%")
    return lines


def _median(values: Iterable[float], scale: float, unit: str) -> str:
    held = [v for v in values if math.isfinite(v)]
    return f"{scale * float(np.median(held)):.1f}{unit} (of {len(held)} trials)" if held else "-"


def summary(outcomes: Sequence[Outcome]) -> str:
    """All tables."""
    of = {kind: [o for o in outcomes if o.label.kind == kind] for kind in KINDS}
    lines = [f"{len(outcomes)} trials; visible: every effect changes at least {VISIBLE:g} times what noise does", ""]
    for kind in ("single", "pair"):
        for what, own in (
            ("visible", [o for o in of[kind] if o.visible]),
            ("near the floor", [o for o in of[kind] if not o.visible]),
        ):
            lines.append(f"{kind + ', ' + what + ', first name right':48} {share([o.first_right for o in own])}")
            lines.append(f"{kind + ', ' + what + ', exact set':48} {share([o.exact for o in own])}")
    null, outside = of["none"], [o for o in of["outside"] if o.visible]
    lines.append(f"{'nothing there, false alarms':48} {share([not o.exact for o in null])}")
    lines.append(f"{'  of these a name':48} {share([bool(o.answer.findings) for o in null])}")
    for what, kept in (("visible", outside), ("near the floor", [o for o in of["outside"] if not o.visible])):
        unknown = [o.answer.first == UNKNOWN for o in kept]
        lines.append(f"{'outside, ' + what + ', recognised as unknown':48} {share(unknown)}")
    partly = [o.answer.first == UNKNOWN or o.answer.verdict == "partly_explained" for o in outside]
    lines.append(f"{'outside, visible, that or partly explained':48} {share(partly)}")
    shown = [o for o in of["single"] if o.visible]
    for what, kept in (("single", shown), ("pair", [o for o in of["pair"] if o.visible])):
        achieved = _median((o.achieved for o in kept), 100.0, " %")
        lines.append(f"{what + ', visible, hold-out improvement, median':48} {achieved}")
        missed = [o for o in kept if not o.exact]
        blind = sum(math.isnan(o.possible) for o in missed)
        lines.append(f"{'  nor exact with the truth alone to choose from':48} {blind} of the {len(missed)} not exact")
        told = sum(o.doubted for o in missed)
        lines.append(f"{'  all named, or said not to be told apart':48} {told} of the {len(missed)} not exact")
    lines.append("  (of what the true structure achieves when the tool fits it; its own fit where its set is exact)")
    lines.append(f"{'seconds a trial, median':48} {_median((o.answer.seconds for o in outcomes), 1.0, ' s')}")
    worn = [o for o in outcomes if o.label.departures]
    if worn:
        wholly = [o.answer.verdict in ("explained", "nothing_missing") for o in worn]
        lines.append(f"{'rigs with departures, said to be explained or whole':48} {share(wholly)}")
        sure = [right for p, right in claims(worn) if p >= 0.9]
        lines.append(f"{'  names given with 0.9 or more that are right':48} {share(sure)}")
    failed = sorted((o for o in outcomes if o.answer.verdict == FAILED), key=lambda o: o.label.trial)
    lines += [f"failed: trial {o.label.trial}: {o.answer.says}" for o in failed]
    for title, rows in (
        ("truth (rows) and first name given (columns): one effect, visible, or nothing", shown + outside + null),
        ("the same near the floor", [o for o in of["single"] + of["outside"] if not o.visible]),
    ):
        lines += ["", title, confusion(rows)] if rows else []
    lines += ["", "detection against size, single effects", *_detection(of["single"])]
    given = claims(outcomes)
    lines += ["", "probabilities of the names given, all trials", f"{'names':>6} {'said':>6} {'right':>6}"]
    lines += [f"{n:6} {p:6.3f} {right:6.3f}" for n, p, right in reliability(given)]
    lines.append(f"expected calibration error {calibration_error(given):.3f}")
    inside = claims(o for o in outcomes if o.label.kind != "outside")
    lines.append(f"without the trials outside the vocabulary {calibration_error(inside):.3f}")
    lines.append(f"calibration error that chance alone would give {chance_error(given):.3f}")
    return "\n".join(lines)


def _kinds(text: str) -> tuple[str, ...]:
    kinds = tuple(text.split(","))
    wrong = [k for k in kinds if k not in KINDS]
    if wrong:
        raise argparse.ArgumentTypeError(f"no kind {wrong[0]!r}; there are {', '.join(KINDS)}")
    return kinds


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial, to go on where one stopped")
    parser.add_argument("--seed", type=int, default=1, help="draws everything")
    parser.add_argument("--simulator", choices=SIMULATORS, default="mujoco", help="what makes the recordings")
    parser.add_argument("--duration", type=float, default=30.0, help="of a recording, s")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--kinds", type=_kinds, default=tuple(KINDS), help=f"some of {','.join(KINDS)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="append one line per trial as it is opened")
    parser.add_argument("--summarise", type=Path, metavar="FILE", help="only print the tables of such a file")
    given = parser.parse_args(arguments)
    if min(given.trials, given.processes, given.duration) <= 0:
        parser.error("trials, duration and processes must be positive")
    if given.summarise:
        try:
            outcomes = read(given.summarise)
        except (OSError, ValueError, KeyError, TypeError) as error:
            parser.error(f"{given.summarise} is not a file of opened trials: {error}")
        print(summary(outcomes))
        return
    numbers = range(given.first, given.first + given.trials)
    save = (lambda outcome: write(given.json, outcome)) if given.json else (lambda outcome: None)
    study = Study(given.seed, given.kinds, given.duration, given.simulator)
    outcomes = run(study, numbers, given.processes, save)
    print("\n" + summary(outcomes))


if __name__ == "__main__":
    main()
