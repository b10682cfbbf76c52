"""`twin effects`: the vocabulary, and all that is known of one effect."""

from __future__ import annotations

import argparse
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from twin.cli.command import Command, check_outputs
from twin.cli.output import answer_user
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.effects.effect import Effect


def _effects(args: argparse.Namespace) -> int:
    check_outputs(args)
    from twin.effects.catalogue import EFFECTS, UNKNOWN

    named = {i: e for i, e in EFFECTS.items() if i not in UNKNOWN}
    if args.id is None:
        width = max(map(len, named))
        said = [f"{i:<{width}}  {e.station:<12}  {e.title}" for i, e in named.items()]
        answer: dict[str, Any] = {
            "format": "twin-effects/1",
            "effects": [{"id": i, "station": e.station, "title": e.title} for i, e in named.items()],
        }
    elif args.id in named:
        said, answer = _lines(named[args.id]), {"format": "twin-effects/1", "effects": [_to_json(named[args.id])]}
    else:
        close = get_close_matches(args.id.replace("-", "_").lower(), named, 1)
        meant = f"did you mean {close[0]}? " if close else ""
        raise BadInput(f"there is no effect {args.id!r}; {meant}there are {', '.join(named)}")
    answer_user(args, said, answer)
    return 0


def _lines(effect: Effect) -> list[str]:
    from twin.effects.catalogue import EFFECTS
    from twin.model.equations import trace

    said = [str(effect).split("\nnot ")[0]]
    if effect.law is not None:
        said.append(f"law: {str(trace(effect.id).expression).replace('p.', '')}")
    said.append(f"what a recording shows: a torque or reading that goes with {', '.join(effect.depends_on)}")
    for other, experiment in effect.confused_with.items():
        title = EFFECTS[other].title if other in EFFECTS else other
        said.append(f"confused with {title} ({other}); to tell them apart: {experiment}")
    return [*said, f"source: {effect.reference}"]


def _to_json(effect: Effect) -> dict[str, Any]:
    from twin.codegen import latex

    return {
        "id": effect.id,
        "title": effect.title,
        "station": effect.station,
        "equation": latex.equation(effect.id),
        "depends_on": list(effect.depends_on),
        "parameters": [
            {"name": p.name, "unit": p.unit_for("rad", "%"), "meaning": p.meaning} for p in effect.parameters
        ],
        "confused_with": dict(effect.confused_with),
        "reference": effect.reference,
    }


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("id", nargs="?", metavar="ID", help="one effect: its law, and what it is confused with")


COMMAND = Command("effects", "the effects that twin knows, or one of them in full", _add_arguments, _effects)
