"""A model's parameters on sliders: their ranges, and the free run with what the user sets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from twin.diagnosis.result import Diagnosis
from twin.display.numbers import unit_text
from twin.errors import BadInput
from twin.report.explorer import tell_free_run
from twin.report.wording import title


def sliders(d: Diagnosis) -> list[dict[str, Any]]:
    """One slider a parameter that the recording determines, the effects that were found first.

    Each goes from nothing to twice the value, within the law's bounds; a value near zero by ten standard errors.
    """
    model, out = d.after, []
    for effect in sorted(model.structure.effects, key=lambda e: e.id in d.before.structure):
        for p in effect.parameters:
            value = model.values.get(p.name, math.nan)
            std = model.std(p.name) if p.name in model.fitted else math.nan
            reach = max(abs(value), 10.0 * std if math.isfinite(std) else 0.0)
            if p.name not in model.fitted or p.name in model.undetermined or not reach > 0.0:
                continue
            low, high = max(p.lower, value - reach), min(p.upper, value + reach)
            out.append(
                {
                    "name": p.name, "effect": title(effect.id), "meaning": p.meaning, "value": value,
                    "unit": unit_text(model.unit(p.name)), "low": low, "high": high,
                }
            )  # fmt: skip
    return out


def free_run(d: Diagnosis, values: Mapping[str, Any]) -> dict[str, Any]:
    """The free run of the last model with some parameters changed, as the explorer's event `overlay` takes it.

    Raises
    ------
    BadInput
        A parameter that is not on a slider, or no number within its range.
    """
    ranges = {s["name"]: (s["low"], s["high"]) for s in sliders(d)}
    for name, value in values.items():
        if name not in ranges or isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInput(f"{str(name)[:60]} is no parameter on a slider, or its value no number: reload the page")
        low, high = ranges[name]
        if not low - 1e-9 * abs(low) <= value <= high + 1e-9 * abs(high):
            raise BadInput(f"{name} = {value:g} is outside [{low:g}, {high:g}]: move the slider")
    clipped = {name: min(max(float(v), ranges[name][0]), ranges[name][1]) for name, v in values.items()}
    return tell_free_run(d, d.after.with_values(clipped))
