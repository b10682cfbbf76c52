"""An outside torque for a stretch of time: someone leans on the link, a hose catches, wind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.effects.effect import Effect, Recorded, Screen, Seen
from twin.effects.math_ops import maximum, minimum
from twin.effects.parameter import Parameter

#: Shares of the recording that trial pulses last, and how many of each length are laid end to end and overlap by half.
_LENGTHS = (0.02, 0.05, 0.1, 0.2)


def law(q: Any, p: Any) -> Any:
    rising = (q.time - p.pulse_start) / p.pulse_edge
    falling = (p.pulse_start + p.pulse_length - q.time) / p.pulse_edge
    return p.pulse_torque * maximum(0.0, minimum(1.0, minimum(rising, falling)))


def trials(seen: Seen) -> list[dict[str, float]]:
    """Pulses of four lengths, at every half of their length."""
    return [
        {"pulse_start": begin * seen.end, "pulse_length": max(length * seen.end, 0.1)}
        for length in _LENGTHS
        for begin in (0.5 * length * i for i in range(int(2.0 * (1.0 - length) / length) + 1))
    ]


def plausible(values: Mapping[str, float], recorded: Recorded) -> bool:
    """It begins within the recording, and is over before most of it is."""
    begin, length = values["pulse_start"], values["pulse_length"]
    return -length < begin < recorded.end and length < 0.7 * recorded.end


EFFECT = Effect(
    id="disturbance_pulse",
    title="outside torque for a stretch of time",
    station="disturbance",
    slot="load",
    parameters=(
        Parameter("pulse_torque", "{x}/s^2", "size of the outside torque over inertia", 0.0),
        Parameter("pulse_start", "s", "time at which it begins", None),
        Parameter("pulse_length", "s", "how long it lasts", None, 0.05, start=1.0),
        Parameter("pulse_edge", "s", "time in which it rises and falls", None, 1e-3, start=0.02, estimated=False),
    ),
    law=law,
    depends_on=("time",),
    promises=frozenset({"memoryless"}),
    sentence="An outside torque of {pulse_torque} acts on the link from {pulse_start} on for {pulse_length}.",
    reference="Basseville, Nikiforov, Detection of Abrupt Changes, 1993, ch. 2 (additive changes)",
    confused_with={
        "detent": "pass the same angle at another time: a detent is there again",
        "load_change": "rest: a changed load shows only while accelerating",
        "periodic_disturbance": "record for longer: a periodic torque returns",
    },
    screen=Screen("pulse_torque", trials=trials, local=True, moment="pulse_start"),
    plausible=plausible,
)
