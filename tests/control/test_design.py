"""The design: what is cancelled, what is promised, and the file that holds it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from controlled_axis import axis
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.codegen import control_law
from twin.control import controller as files
from twin.control import linearization
from twin.control.controller import LimitCycle
from twin.control.design import design
from twin.effects.catalogue import BASE, EFFECTS
from twin.errors import BadInput
from twin.model.stepper import Structure


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_gets_a_controller_with_margins_and_a_file(effect: str) -> None:
    model = axis(effect)
    pages = EFFECTS[effect].parameters
    present = {p.name: min(p.start or 0.6 / len(pages), p.upper, 0.5) for p in pages if p.neutral == 0.0}
    made = design(model.with_values(present))
    assert made.margins.phase > math.radians(25)
    assert made.margins.delay > 2 * made.sample_time
    again = files.loads(files.dumps(made))
    assert files.dumps(again) == files.dumps(made)
    assert (again.plant, again.values, again.settings) == (made.plant, made.values, made.settings)


def test_drive_is_inverted_whatever_it_holds() -> None:
    made = design(axis("supply_sag", "drive_saturation", "thermal_fade", supply_sag=0.002, fade=0.2))
    law, p = made.laws, made.parameter_list
    for target in np.linspace(-40, 40, 23):
        command = law.answer(target, 3.0, 0.5, 0.0, 100.0, p)
        assert law.drive(command, 3.0, 0.5, 0.0, p) == pytest.approx(target, abs=1e-6)


@given(target=st.floats(-200, 200), emf=st.floats(-50, 50), sag=st.floats(0, 0.02), band=st.floats(0, 30))
@settings(deadline=None)
def test_no_command_comes_closer_than_the_answer(target: float, emf: float, sag: float, band: float) -> None:
    structure = Structure.of([*BASE, "supply_sag", "constant_offset"])
    law = control_law.functions(structure)
    given = {"input_gain": 1.0, "supply_sag": sag, "dead_band_forward": band, "dead_band_reverse": 0.5 * band}
    p = [given.get(q.name, q.start) for q in structure.parameters]
    command = law.answer(target, emf, 0.0, 0.0, 100.0, p)
    assert abs(command) <= 100.0
    # It searches on the side of the target, as a drive never passes on the other sign.
    tried = [abs(law.drive(u, emf, 0.0, 0.0, p) - target) for u in np.linspace(0, math.copysign(100, target), 401)]
    assert abs(law.drive(command, emf, 0.0, 0.0, p) - target) <= min(tried) + 0.02 * abs(target) + 1e-9


def test_blur_is_continuous_over_the_dead_band() -> None:
    made = design(axis())
    law, p, g = made.laws, made.parameter_list, made.settings_list
    blur = made.settings["blur"]
    targets = np.linspace(-2 * blur, 2 * blur, 401)
    commands = np.array([law.invert(t, 0.0, 0.0, 0.0, p, g) for t in targets])
    slope = (10.0 + 2 * blur) / (2 * blur)  # both sides of the band over the blur's width
    assert np.all(np.diff(commands) > 0)
    assert np.max(np.diff(commands)) < 1.01 * slope * (targets[1] - targets[0])


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, math.nan, math.inf, 1e4, 45.0])
def test_absurd_or_unstable_bandwidth_is_refused(bandwidth: float) -> None:
    model = axis("joint_elasticity", joint_frequency=5.0, joint_damping=0.02)
    with pytest.raises(BadInput, match="input_gain is 0"):
        design(axis().with_values({"input_gain": 0.0}))
    with pytest.raises(BadInput, match="bandwidth"):
        design(model, bandwidth)


def test_axis_that_cannot_overcome_its_friction_is_refused() -> None:
    with pytest.raises(BadInput, match="does not move"):
        design(axis("coulomb_friction", coulomb_friction=100.0))


def test_unknown_limit_is_assumed_and_said() -> None:
    made = design(replace(axis("coulomb_friction", coulomb_friction=1.0), input_unit="V"))
    assert "limit" in made.remarks[0] and math.isfinite(made.settings["limit"])
    assert not any(r.startswith("limit:") for r in design(replace(axis(), input_unit="V"), limit=12.0).remarks)


@pytest.mark.parametrize("effects", [{}, {"motor_lag": 0.03}, {"input_delay": 0.009}, {"gravity": 5.0}])
def test_delay_margin_is_where_the_loop_turns_unstable(effects: dict[str, float]) -> None:
    names = {"motor_lag": "lag_time", "input_delay": "delay", "gravity": "gravity_gain"}
    made = design(axis(*effects, **{names[k]: v for k, v in effects.items()}), 2.0)
    samples = made.margins.delay / made.sample_time
    rigid = linearization.linearise(made)
    for extra, holds in ((math.floor(samples) - 1, True), (math.ceil(samples) + 1, False)):
        late = replace(made, settings={**made.settings, "whole": made.settings["whole"] + extra})
        true = linearization.plant_system(rigid, late)
        assert linearization.stable(-linearization.controller_system(rigid, made) * true) is holds


def test_gain_margin_is_where_the_loop_turns_unstable() -> None:
    made = design(axis(), 2.0)
    rigid = linearization.linearise(made)
    for share, holds in ((0.98, True), (1.02, False)):
        louder = replace(rigid, gain=share * made.margins.gain * rigid.gain)
        assert linearization.stable(linearization.loop(made, true=louder)) is holds


def test_command_noise_matches_a_simulated_loop() -> None:
    """An independent oracle: the same linear loop, driven by drawn noise."""
    made = design(axis(), 2.0)
    spread = 1e-4
    predicted = linearization.command_noise(made, spread**2, 0.0)
    rigid = linearization.linearise(made)
    ruler, link = linearization.controller_system(rigid, made), linearization.plant_system(rigid, made)
    rng, x, z, seen = np.random.default_rng(0), np.zeros(ruler.nstates), np.zeros(link.nstates), []
    for noise in spread * rng.standard_normal(60000):
        command, reading = (ruler.C @ x)[0], (link.C @ z)[0] + noise
        z = link.A @ z + link.B[:, 0] * command
        x = ruler.A @ x + ruler.B[:, 0] * reading
        seen.append(command)
    assert np.std(seen) == pytest.approx(predicted, rel=0.05)


def test_gap_element_is_whole_for_large_swings_and_nothing_for_small_ones() -> None:
    gap = linearization.Gap(0.02)
    assert gap.describing_function(1e4) == pytest.approx(1.0, abs=1e-3)
    assert gap.describing_function(0.006) == 0.0


@pytest.mark.parametrize("flight", [0.01, 0.02, 0.1])
def test_gap_element_matches_two_bodies_thrown_back_and_forth(flight: float) -> None:
    """An independent oracle: motor and link under a sine of torque, integrated blow by blow."""
    share, gap, rate = 0.3, 0.02, 10.0
    size = flight * share * rate**2
    h, motor, link, fast, slow, given, phase = 1e-5, 0.0, 0.0, 0.0, 0.0, [], []
    period = 2 * math.pi / rate
    motor = link + 0.5 * gap
    fast = slow = -size / rate
    before = slow
    for i in range(round(6 * period / h)):
        torque = size * math.sin(rate * i * h)
        if abs(motor - link) >= 0.5 * gap and (fast - slow) * (motor - link) >= 0.0 and torque * (motor - link) >= 0:
            slow = fast = share * fast + (1 - share) * slow + torque * h
            motor = link + math.copysign(0.5 * gap, motor - link)
        else:
            fast += torque / share * h
        motor, link = motor + fast * h, link + slow * h
        if i * h > 4 * period:
            given.append((slow - before) / h)
            phase.append(rate * i * h)
        before = slow
    fundamental = 2 * np.mean(np.array(given) * np.exp(-1j * (np.array(phase) - math.pi / 2))) / size
    assert linearization.Gap(gap).describing_function(flight) == pytest.approx(fundamental, abs=0.03)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: "x = [", "not valid TOML"),
        (lambda t: t.replace("twin-controller/1", "twin-model/1"), "format"),
        (lambda t: t.replace('"backlash"', '"slack"'), "unknown effect"),
        (lambda t: t.replace('"backlash"', '["backlash"]'), r"unknown effect \['backlash'\]"),
        (lambda t: t.replace('input_unit = "%"', 'input_unit = ["%"]'), r"input_unit is \['%'\]"),
        (lambda t: t.replace('unit = "rad"', 'unit = ["rad"]'), r"unit is \['rad'\]"),
        (lambda t: f"a = {'[' * 5000}\n{t}", "not valid TOML"),
        (lambda t: t.replace("limit = 100.0", f"limit = 1{'0' * 400}"), "too large"),
        (lambda t: t.replace('"constant_offset"', '"gravity"'), "constant_offset"),
        (lambda t: t.replace("input_gain = 0.3", 'input_gain = "much"'), "not a number"),
        (lambda t: t.replace("input_gain = 0.3", "input_gain = nan"), "not a finite number"),
        (lambda t: t.replace("input_gain = 0.3", "input_gain = -0.3"), "outside"),
        (lambda t: t.replace("input_gain = 0.3", ""), "no input_gain"),
        (lambda t: t.replace("sample_time = 0.002", "sample_time = 0.0"), "sample_time"),
        (lambda t: t.replace("whole = 0.0", "whole = 0.5"), "whole"),
        (lambda t: t.replace("whole = 0.0", "whole = 1e9"), "whole"),
        (lambda t: t.replace("[settings]", "[settings]\nspeed = 1.0"), "unknown"),
        (lambda t: t.replace("[margins]", "[margin]"), "did you mean 'margins'"),
        (lambda t: t.replace("position_gain = ", "position_gain = -"), "position_gain is -.*give 0 or more"),
        (lambda t: t.replace("bandwidth = ", "bandwidth = -"), "bandwidth is -.*above 0"),
        (lambda t: t.replace("phase = ", "phases = "), r"\[margins\]: unknown key 'phases'; did you mean 'phase'"),
        (lambda t: t[: t.index("[margins]")], ""),
    ],
)
def test_damaged_controller_files_are_refused_in_a_line(change, says: str) -> None:  # type: ignore[no-untyped-def]
    text = files.dumps(design(axis(), 2.0))
    assert change(text) != text
    if not says:
        assert math.isnan(files.loads(change(text)).margins.phase)
        return
    with pytest.raises(BadInput, match=says) as caught:
        files.loads(change(text), "CONTROLLER.toml")
    assert str(caught.value).startswith("CONTROLLER.toml") and "\n" not in str(caught.value)


@given(text=st.text(max_size=200))
def test_any_text_is_a_controller_or_bad_input(text: str) -> None:
    with pytest.raises(BadInput):
        files.loads(text)


def test_missing_folder_and_binary_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for path, says in (("none.toml", "no such"), (".", "folder"), ("binary.toml", "UTF-8")):
        with pytest.raises(BadInput, match=says):
            files.read(tmp_path / path)


def test_predicted_cycle_survives_the_file() -> None:
    made = design(axis(backlash_gap=0.02))
    assert isinstance(made.limit_cycle, LimitCycle)
    assert files.loads(files.dumps(made)).limit_cycle == made.limit_cycle


def test_a_model_that_does_not_know_its_gain_gets_no_controller() -> None:
    """Feedback of the wrong sign runs away; a gain that was held is taken at its word."""
    model = axis()
    known = replace(model, fitted=("input_gain",), covariance=np.array([[(0.1 * model.values["input_gain"]) ** 2]]))
    assert design(known).bandwidth == pytest.approx(design(model).bandwidth)
    for size in (0.6 * model.values["input_gain"], 1e6, math.inf):
        with pytest.raises(BadInput, match="input_gain is not known"):
            design(replace(known, covariance=np.array([[size**2]])))


@given(bandwidth=st.floats(1e-300, 1e300))
@settings(deadline=None, max_examples=40)
def test_any_bandwidth_is_designed_or_refused(bandwidth: float) -> None:
    model = axis()
    try:
        made = design(model, bandwidth)
    except BadInput:
        assert not 0.05 < bandwidth < 3.0
        return
    assert made.bandwidth == bandwidth and all(map(math.isfinite, made.settings.values()))


def test_a_noise_that_allows_no_control_is_said() -> None:
    with pytest.raises(BadInput, match="no control at a sample time"):
        design(replace(axis(), reading_std=1e6, torque_density=1e9))
