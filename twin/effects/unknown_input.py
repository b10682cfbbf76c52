"""Correction of the command, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.knots import line, parameters


def law(q: Any, p: Any) -> Any:
    return q.command + line(q.command, "unknown_input", p)


EFFECT = Effect(
    id="unknown_input",
    title="drive curve of unknown shape",
    station="drive",
    slot="drive",
    parameters=parameters("unknown_input", "{u}", "command", "{u}", -100.0, 200.0),
    law=law,
    depends_on=("input",),
    promises=frozenset({"memoryless"}),
    sentence="The drive alters the command by a curve of no known shape, drawn from {unknown_input_from} on.",
    reference="de Boor, A Practical Guide to Splines, 1978",
    confused_with={
        "drive_saturation": "steps at four or more duties: saturation has a corner",
        "supply_sag": "the same duty at several speeds",
        "unknown_velocity": "coast-downs: a resistance acts without command",
    },
)
