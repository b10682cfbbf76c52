"""A search whose only candidates the recording cannot show ends with the first model."""

from __future__ import annotations

import numpy as np

from twin import extend, kernel, likelihood
from twin.axis import Structure
from twin.recording import Recording


def test_candidates_that_a_linear_axis_has_not_are_not_tried() -> None:
    structure = Structure.of(["inertia", "viscous_friction"])
    time = 0.002 * np.arange(3000)
    duty = 40.0 * np.sign(np.sin(3.0 * time))
    blank = Recording("sled", time, duty, np.zeros(3000), "%", "m", 1e-5)
    p = kernel.vector(structure, {"input_gain": 0.02, "viscous_friction": 2.0})
    read = kernel.predict(likelihood.prepare(blank, structure).drive, p, kernel.start_state(0.0, 0.0, 0.0)).reading
    sled = Recording("sled", time, duty, 1e-5 * np.round(read / 1e-5), "%", "m", 1e-5)
    found = extend.search([sled], structure, {}, ("gravity", "encoder_eccentricity"))
    assert found.rounds == () and found.last.structure == structure
    assert abs(found.last.values["input_gain"] - 0.02) < 1e-4
