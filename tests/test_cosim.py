"""The closed loop: model in process and FMU in FMPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from test_control import axis
from twin.control import design
from twin.cosim import make_reference, run, simulate
from twin.errors import BadInput
from twin.package import export


def test_fmu_and_model_give_the_same_loop(tmp_path: Path) -> None:
    model = axis(
        "gravity", "coulomb_friction", "input_delay", gravity_gain=3.0, coulomb_friction=1.0, delay=0.005
    )
    made = design(model)
    reference = make_reference("minimum-jerk", made)
    fmu = export(model, tmp_path / "axis.fmu")
    in_process, in_fmpy = simulate(model, made, reference), run(fmu, made, reference)
    np.testing.assert_allclose(in_fmpy.position, in_process.position, atol=1e-9)
    assert in_fmpy.rms < 0.002


def test_fast_reference_is_refused() -> None:
    model = axis()
    made = design(model)
    slow = make_reference("sine", made)
    fast = make_reference("sine", made, amplitude=50.0, duration=3.0)
    simulate(model, made, slow)
    with pytest.raises(BadInput, match="asks at t ="):
        run(Path("none.fmu"), made, fast)
