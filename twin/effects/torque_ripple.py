"""Torque periodic in angle, several times a turn: cogging, gear mesh."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter
from twin.effects.phases import polar


def law(q: Any, p: Any) -> Any:
    return p.ripple_torque * sin(p.ripple_order * q.position - p.ripple_phase)


EFFECT = Effect(
    id="torque_ripple",
    title="torque ripple (cogging, gear mesh)",
    station="load",
    slot="shaft",
    parameters=(
        Parameter("ripple_torque", "{x}/s^2", "amplitude of the ripple over inertia", 0.0, 0.0),
        Parameter("ripple_order", "rad/{x}", "periods per turn of the link", None, 1.5, 400.0, 12.0),
        Parameter("ripple_phase", "rad", "phase at position zero", None),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="A torque ripple of {ripple_torque} repeats {ripple_order} times a turn.",
    reference="Holtz, Springob, Identification and compensation of torque ripple, IEEE TIE 43, 1996",
    confused_with={
        "encoder_eccentricity": "two constant speeds: a torque's trace falls with speed, a sensor's does not"
    },
    substeps=2,
    screen=Screen("ripple_torque", "ripple_phase", polar, rate="ripple_order"),
)
