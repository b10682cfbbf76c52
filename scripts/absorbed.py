"""What of that which a blind study hid is left once the first model's own numbers are chosen anew?

    python scripts/blind_trial.py --trials 20 --seed 1 --json trials.jsonl
    python scripts/absorbed.py trials.jsonl --json absorbed.jsonl

The study calls an effect visible that changes how an axis travels by three times what noise does. But a supply that
gives way may be a smaller gain, and a constant torque dead-bands that differ: what a first model takes over leaves no
error, and nobody can find it in one. So for each visible effect the simulator itself is asked for the gain, friction,
dead-bands, gap and shares with which the rig, without the effect, comes nearest to what it does with it
(`concealed.unabsorbed`); what is then left, over what noise leaves, is printed, and the study's tables with it. The
tool has no part in this. Trials that the second file has already are not computed again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from blind_trial import KINDS, UNKNOWN, VISIBLE, Label, Outcome, draw, read, share
from concealed import unabsorbed
from simulators import SIMULATORS


def left(label: Label) -> tuple[float, ...]:
    """What each effect of a trial leaves. Raises ValueError where the trial was drawn among other kinds or rigs."""
    drawn = draw(label.seed, label.trial, tuple(KINDS), label.duration, label.simulator)
    if drawn.label != label:
        raise ValueError(f"trial {label.trial} of seed {label.seed} is drawn otherwise here")
    simulate = SIMULATORS[label.simulator].simulate
    return tuple(unabsorbed(simulate, drawn.rig, [e], drawn.time, drawn.duty, drawn.noise_seed) for e in drawn.effects)


def known(path: Path) -> dict[str, tuple[float, ...]]:
    """What was computed before, by seal."""
    if not path.exists():
        return {}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {row["seal"]: tuple(row["left"]) for row in rows}


def summary(outcomes: Sequence[Outcome], remains: Mapping[str, tuple[float, ...]]) -> str:
    """The study's shares among trials in which every effect leaves enough, and among those in which one does not."""
    lines = [f"visible: every effect changes at least {VISIBLE:g} times what noise does; and of that"]
    for what, enough in ((f"at least {VISIBLE:g} is left", True), ("less is left", False)):
        own = [o for o in outcomes if o.seal in remains and (min(remains[o.seal]) >= VISIBLE) is enough]
        for kind in ("single", "pair"):
            these = [o for o in own if o.label.kind == kind]
            lines.append(f"{f'{kind}, {what}, first name right':48} {share([o.first_right for o in these])}")
            lines.append(f"{f'{kind}, {what}, exact set':48} {share([o.exact for o in these])}")
        unknown = [o.answer.first == UNKNOWN for o in own if o.label.kind == "outside"]
        lines.append(f"{f'outside, {what}, recognised as unknown':48} {share(unknown)}")
    lines += ["", "visible and not exact: visibility, what is left"]
    for o in outcomes:
        if o.seal in remains and not (o.exact or (o.label.kind == "outside" and o.answer.first == UNKNOWN)):
            pairs = zip(o.label.effects, remains[o.seal], strict=True)
            told = ", ".join(f"{e.id} {e.visibility:.3g} {rest:.2g}" for e, rest in pairs)
            said = " + ".join(i for i, _ in o.answer.findings) or o.answer.first
            lines.append(f"{o.label.simulator} {o.label.trial}: {told}; said {said}")
    return "\n".join(lines)


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
    with ProcessPoolExecutor(given.processes, multiprocessing.get_context("spawn")) as pool:
        try:
            for o, found in zip(open_, pool.map(left, [o.label for o in open_]), strict=True):
                remains[o.seal] = found
                with given.json.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"seal": o.seal, "left": found}) + "\n")
        except ValueError as error:
            pool.shutdown(cancel_futures=True)
            parser.error(str(error))
    print(summary(outcomes, remains))


if __name__ == "__main__":
    main()
