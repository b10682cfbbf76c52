"""The model's file holds numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from twin.errors import BadInput
from twin.model.fitted_model import Model, dumps, loads
from twin.model.stepper import Structure

STRUCTURE = Structure.of(("inertia", "viscous_friction"))
MODEL = Model(STRUCTURE, {"input_gain": 0.4, "viscous_friction": 2.0}, ("input_gain",), np.array([[1e-4]]))


@pytest.mark.parametrize(
    "spoilt",
    [
        replace(MODEL, values={**MODEL.values, "input_gain": math.nan}),
        replace(MODEL, values={**MODEL.values, "input_gain": math.inf}),
        replace(MODEL, reading_std=math.nan),
        replace(MODEL, torque_density=math.inf),
        replace(MODEL, covariance=np.array([[math.nan]])),
    ],
)
def test_what_is_no_number_is_not_written(spoilt: Model) -> None:
    with pytest.raises(BadInput, match="not a number"):
        dumps(spoilt)


def test_what_was_held_and_has_a_note_is_not_determined() -> None:
    notes = {"input_gain": "it ends at its bound", "viscous_friction": "no coast-down; add one"}
    model = replace(MODEL, notes=notes)
    assert model.undetermined == ("viscous_friction",)


def test_a_variance_without_end_is_written_and_read() -> None:
    text = dumps(replace(MODEL, covariance=np.array([[math.inf]])))
    assert math.isinf(loads(text).std("input_gain")) and dumps(loads(text)) == text
