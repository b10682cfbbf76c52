"""What of that which a blind study hid is left once numbers are chosen anew: the first model's, or those of an answer?

    python scripts/blind_trial.py --trials 20 --seed 1 --json trials.jsonl
    python scripts/absorbed.py trials.jsonl --json absorbed.jsonl

The study calls an effect visible that changes how an axis travels by three times what noise does. But a supply that
gives way may be a smaller gain, and a constant torque dead-bands that differ. What a first model takes over leaves no
error, and nobody can find it in one. And of two effects one may keep the axis from where the other would show.

So for each visible effect the simulator runs its rig without that effect. All other numbers are chosen anew: gain,
friction, dead-bands, gap, shares, and those of the other effect. They are those with which the rig comes nearest to
what it does with the effect (`concealed.unabsorbed`). What is then left is printed, over what noise leaves, and the
study's tables with it.

Where the answer was not what is there, the simulator is asked, too, how near the rig comes with what was named in its
place, at any size (`concealed.unanswered`). How an axis travels does not tell the truth from an answer that leaves as
little as noise does. The tool has no part in this. Trials that the second file has already are not computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from blind_trial import KINDS, UNKNOWN, VISIBLE, Outcome, draw, read, share
from concealed import Concealed, Trip, unabsorbed, unanswered
from simulators import SIMULATORS

#: So often is what was named and is not there drawn, at sizes between these shares of the concealed one.
DRAWS, LEAST, LARGEST = 40, 0.03, 3.0


@dataclass(frozen=True)
class Left:
    """Of one trial, over what noise leaves: what each effect leaves beside a first model, and what the answer leaves.

    NaN for an answer that is right, or names what the simulator does not know.
    """

    each: tuple[float, ...]
    answer: float


def right(o: Outcome) -> bool:
    """Whether the answer is what is there."""
    return o.first_right if o.label.kind == "outside" else o.exact


def left(o: Outcome) -> Left:
    """What is left in a trial. Raises ValueError where it was drawn among other kinds or rigs."""
    label, source = o.label, SIMULATORS[o.label.simulator]
    drawn = draw(label.seed, label.trial, tuple(KINDS), label.duration, label.simulator)
    if drawn.label != label:
        raise ValueError(f"trial {label.trial} of seed {label.seed} is drawn otherwise here")
    trip, rig = Trip(source.simulate, drawn.time, drawn.duty, drawn.noise_seed), drawn.rig
    answer = math.nan
    if not right(o) and o.answer.names <= set(source.VOCABULARY):
        rng, size = np.random.default_rng(label.trial), max(e.size for e in label.effects)
        there = {e.id: e for e in drawn.effects}

        def begin(name: str) -> Concealed:
            """What is there as it is there, anything else as it may be."""
            share = LEAST * (LARGEST / LEAST) ** rng.uniform()
            return there.get(name) or source.draw_effect(rng, name, rig, share * size, label.duration)

        draws = 1 if o.answer.names <= there.keys() else DRAWS
        begun = [[begin(name) for name in sorted(o.answer.names)] for _ in range(draws)]
        answer = unanswered(trip, rig, drawn.effects, begun)
    others = ([o for o in drawn.effects if o is not e] for e in drawn.effects)
    each = (unabsorbed(trip, rig, [e], beside) for e, beside in zip(drawn.effects, others, strict=True))
    return Left(tuple(each), answer)


def known(path: Path) -> dict[str, Left]:
    """What was computed before, by seal."""
    if not path.exists():
        return {}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {row["seal"]: Left(tuple(row["left"]), float(row["answer"])) for row in rows}


def summary(outcomes: Sequence[Outcome], remains: Mapping[str, Left]) -> str:
    """The study's shares among trials in which every effect leaves enough, and among those in which one does not; and
    what the answers leave that are not what is there.
    """
    lines = [f"visible: every effect changes at least {VISIBLE:g} times what noise does; and of that"]
    for what, enough in ((f"at least {VISIBLE:g} is left", True), ("less is left", False)):
        own = [o for o in outcomes if o.seal in remains and (min(remains[o.seal].each) >= VISIBLE) is enough]
        for kind in ("single", "pair"):
            these = [o for o in own if o.label.kind == kind]
            lines.append(f"{f'{kind}, {what}, first name right':48} {share([o.first_right for o in these])}")
            lines.append(f"{f'{kind}, {what}, exact set':48} {share([o.exact for o in these])}")
        unknown = [o.answer.first == UNKNOWN for o in own if o.label.kind == "outside"]
        lines.append(f"{f'outside, {what}, recognised as unknown':48} {share(unknown)}")
    wrong = [remains[o.seal].answer < VISIBLE for o in outcomes if o.seal in remains and not right(o)]
    lines.append(f"{'not exact, the answer leaves less than that':48} {share(wrong)}")
    lines += ["", "visible and not exact: visibility, what is left; answer, what it leaves"]
    for o in outcomes:
        if o.seal in remains and not right(o):
            rest = remains[o.seal]
            pairs = zip(o.label.effects, rest.each, strict=True)
            told = ", ".join(f"{e.id} {e.visibility:.3g} {r:.2g}" for e, r in pairs)
            said = " + ".join(i for i, _ in o.answer.findings) or o.answer.first
            lines.append(f"{o.label.simulator} {o.label.trial}: {told}; said {said} {rest.answer:.2g}")
    return "\n".join(lines)


def computed(outcomes: Sequence[Outcome], processes: int) -> Iterator[Left]:
    """What is left of each, in their order; by this process alone where one is asked for. Raises as `left` does."""
    if processes == 1:
        yield from map(left, outcomes)
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        try:
            yield from pool.map(left, outcomes)
        finally:
            pool.shutdown(cancel_futures=True)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trials", type=Path, nargs="+", metavar="FILE", help="of blind_trial.py --json")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help="what is left, a line per trial")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args(arguments)
    try:
        outcomes = [o for path in given.trials for o in read(path)]
        remains = known(given.json)
    except (OSError, ValueError, KeyError, TypeError) as error:
        parser.error(f"what was read is no study and what is left of it: {error}")
    open_ = [o for o in outcomes if o.visible and o.label.effects and o.seal not in remains]
    try:
        for o, found in zip(open_, computed(open_, given.processes), strict=True):
            remains[o.seal] = found
            with given.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"seal": o.seal, "left": found.each, "answer": found.answer}) + "\n")
    except ValueError as error:
        parser.error(str(error))
    print(summary(outcomes, remains))


if __name__ == "__main__":
    main()
