"""The paper's method on axes whose motion is known in closed form: no integrator, none of the model's code."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from twin.effects.catalogue import BASE
from twin.estimation.two_stage import NAMES, cramer_rao_bound, steady_gains, to_model, two_stage
from twin.io.recording import Recording
from twin.model.fitted_model import dumps, loads

COUNT = 2.0 * math.pi / 10000
STEP = 0.002


@dataclass(frozen=True)
class Axis:
    """The paper's link: sizes as it reports them, but for the speed, which a count in 2 ms must not drown."""

    b: float = 0.52
    q: float = 40.0
    forward: float = 5.0
    reverse: float = 7.0
    dead_time: float = 0.0  # after a reversal: the link coasts, then it is hit

    def settles(self, duty: float) -> float:
        acting = max(duty - self.forward, 0.0) + min(duty + self.reverse, 0.0)
        return acting / self.q


def play(axis: Axis, pieces: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, duty, position and speed under duties held for so many seconds each."""
    position, speed, last = 0.3, 0.0, 0.0
    rows = []
    for length, duty in pieces:
        n = round(length / STEP)
        t = np.arange(n + 1) * STEP
        gap = axis.dead_time if duty * last < 0.0 else 0.0
        coast = 0.4 * axis.b  # only the link's friction brakes it while the gears are apart
        w, x = speed * np.exp(-coast * t), position + speed * (1 - np.exp(-coast * t)) / coast
        if gap == 0.0:
            meet, at = speed, position
        else:
            meet, at = 0.4 * speed * math.exp(-coast * gap), position + speed * (1 - math.exp(-coast * gap)) / coast
        steady, since = axis.settles(duty), t - gap
        decay = np.exp(-axis.b * since)
        in_mesh = t >= gap
        w = np.where(in_mesh, steady + (meet - steady) * decay, w)
        x = np.where(in_mesh, at + steady * since + (meet - steady) / axis.b * (1 - decay), x)
        rows.append((np.full(n, duty), x[:n], w[:n]))
        position, speed, last = float(x[n]), float(w[n]), duty
    duty, x, w = (np.concatenate([r[i] for r in rows]) for i in range(3))
    return np.arange(len(duty)) * STEP, duty, x, w


def wave(level: float, half: float, count: int) -> list[tuple[float, float]]:
    return [(half, level * (-1.0) ** k) for k in range(count)]


PAPER = [(12.0, 25.0), (12.0, -25.0), (12.0, 35.0), (12.0, -35.0), *wave(30.0, 1.5, 12)]


def record(
    axis: Axis, pieces: list[tuple[float, float]] = PAPER, count: float = COUNT, phase: float = 0.0, speed: bool = False
) -> Recording:
    time, duty, x, w = play(axis, pieces)
    value = w if speed else np.floor(x / count + phase) * count if count else x
    return Recording("test", time, duty, value, "%", "rad/s" if speed else "rad", 0.0 if speed else count)


@pytest.mark.parametrize("form", ["speeds", "positions"])
@pytest.mark.parametrize("dead_time", [0.0, 0.08, 0.3])
def test_without_quantisation_the_truth_comes_back_exactly(form: str, dead_time: float) -> None:
    axis = Axis(dead_time=dead_time)
    found = two_stage([record(axis, count=0.0)], form)
    assert found.ok and found.form == form
    # Differences of positions are mean speeds, not speeds: (b T)^2 / 24 off, far below this tolerance.
    assert found.b == pytest.approx(axis.b, rel=1e-4)
    assert found.c == pytest.approx(axis.b / axis.q, rel=1e-4)
    assert found.q == pytest.approx(axis.q, rel=1e-4)
    assert found.dead_band_forward == pytest.approx(5.0, abs=2e-3)
    assert found.dead_band_reverse == pytest.approx(7.0, abs=2e-3)


@pytest.mark.parametrize(("form", "tolerance"), [("speeds", 0.02), ("positions", 0.003)])
@pytest.mark.parametrize("b", [0.52, 3.0])
def test_quantised_positions_give_the_truth_within_their_error(form: str, tolerance: float, b: float) -> None:
    axis = Axis(b=b, dead_time=0.15)
    found = two_stage([record(axis)], form)
    assert found.b == pytest.approx(b, rel=tolerance)
    for name, truth in zip(NAMES, (axis.q, axis.forward, axis.reverse, b, b / axis.q), strict=True):
        assert abs(getattr(found, name) - truth) < 5.0 * found.std(name) + 1e-4 * truth


def test_positions_are_worth_more_than_speeds() -> None:
    axis, errors = Axis(q=150.0, dead_time=0.1), {}
    for form in ("speeds", "positions"):
        runs = [two_stage([record(axis, phase=k / 5.0)], form).b - axis.b for k in range(5)]
        errors[form] = float(np.sqrt(np.mean(np.square(runs))))
    assert errors["positions"] < 0.5 * errors["speeds"]
    assert errors["positions"] < 0.02 * axis.b


def test_the_shift_that_the_printed_projection_forgets_is_taken_off() -> None:
    """The corrected projection finds 0.52 from ten pieces of 0.28 s, with x in place of s it cannot."""
    axis = Axis(q=40.0)
    found = two_stage([record(axis, [*PAPER[:4], *wave(30.0, 0.28, 10)])], "positions")
    short = [p for p in found.pieces if p.end - p.held_since < 0.5 and p.used]
    assert len(short) >= 8
    assert np.mean([p.b for p in short]) == pytest.approx(0.52, rel=0.02)


def test_delta_is_negative_forwards_and_positive_backwards() -> None:
    axis = Axis(forward=4.0, reverse=8.0)
    found = two_stage([record(axis)])
    delta = {duty: found.q * speed - duty for duty, speed, _ in found.steady}  # eq. (6)
    assert [delta[v] for v in (25.0, 35.0)] == pytest.approx([-4.0, -4.0], abs=0.03)
    assert [delta[v] for v in (-25.0, -35.0)] == pytest.approx([8.0, 8.0], abs=0.03)
    # Eq. (7): minus the whole width of the dead-band, not its asymmetry.
    assert delta[25.0] - delta[-25.0] == pytest.approx(-(found.dead_band_forward + found.dead_band_reverse), abs=0.03)


def test_four_duties_give_equation_11_solved_by_hand() -> None:
    duties, speeds = (25.0, -25.0, 35.0, -35.0), (0.51, -0.43, 0.752, -0.71)  # not of one line: errors show
    line, _ = steady_gains([(v, w, 0.01) for v, w in zip(duties, speeds, strict=True)])
    v1, v2, v3, v4 = duties
    w1, w2, w3, w4 = speeds
    q = ((v3 - v4) - (v1 - v2)) / ((w3 - w4) - (w1 - w2))
    assert 1.0 / line[0] == pytest.approx(q, rel=1e-12)
    assert line[1] * q == pytest.approx(-0.5 * ((q * w1 - v1) + (q * w3 - v3)), rel=1e-12)
    assert line[2] * q == pytest.approx(0.5 * ((q * w2 - v2) + (q * w4 - v4)), rel=1e-12)


def test_more_duties_and_weights_do_better_than_four() -> None:
    rng = np.random.default_rng(3)
    errors: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(300):
        for many in (True, False):
            duties = [v * s for v in ((15.0, 25.0, 35.0, 60.0) if many else (25.0, 35.0)) for s in (1.0, -1.0)]
            error = [0.02 if v > 30.0 else 0.002 for v in duties]
            steady = [
                (v, (v - 5.0 * np.sign(v)) / 40.0 + e * rng.standard_normal(), e)
                for v, e in zip(duties, error, strict=True)
            ]
            errors[many].append(1.0 / float(steady_gains(steady)[0][0]) - 40.0)
    assert np.std(errors[True]) < 0.5 * np.std(errors[False])


def test_the_covariance_of_the_line_is_its_scatter() -> None:
    rng = np.random.default_rng(5)
    duties, error = np.array([20.0, 30.0, 50.0, -20.0, -30.0, -50.0]), 0.01
    truth = (duties - np.where(duties > 0.0, 5.0, -7.0)) / 40.0
    found, claimed = [], []
    for _ in range(2000):
        speeds = truth + error * rng.standard_normal(len(duties))
        line, spread = steady_gains([(v, w, error) for v, w in zip(duties, speeds, strict=True)])
        found.append(line)
        claimed.append(np.diag(spread))
    # Errors are never claimed below what was given, so their mean is a little above the scatter.
    assert np.sqrt(np.mean(claimed, axis=0)) == pytest.approx(np.std(found, axis=0), rel=0.25)


@pytest.mark.parametrize(
    ("speed", "count", "known", "unknown"),
    [(0.12, 140, 0.026, 2.1), (0.76, 140, 0.004, 0.34), (0.12, 1500, 1e-4, 1e-3)],
)
def test_bound_of_a_piece_is_that_of_the_method_page(speed: float, count: int, known: float, unknown: float) -> None:
    time, noise = np.arange(count) * STEP, COUNT / math.sqrt(12.0)
    assert cramer_rao_bound(time, 0.52, -2.0 * speed, noise) == pytest.approx(known, rel=0.3)
    assert cramer_rao_bound(time, 0.52, -2.0 * speed, noise, known=False) == pytest.approx(unknown, rel=0.3)


def test_scatter_of_the_pieces_is_their_bound() -> None:
    axis, pieces = Axis(q=40.0), [*PAPER[:4], *wave(30.0, 0.8, 40)]
    time, duty, x, _ = play(axis, pieces)
    rng = np.random.default_rng(1)
    noisy = x + 3e-4 * rng.standard_normal(len(x))
    found = two_stage([Recording("test", time, duty, noisy, "%", "rad")])
    waves = [p for p in found.pieces if p.held_since > 48.5 and p.used]
    scores = np.array([(p.b - axis.b) / p.b_std for p in waves])
    assert len(waves) > 35
    assert 0.75 < np.std(scores) < 1.3  # three standard errors of a scatter of 39


def test_standard_errors_are_the_scatter_over_many_recordings() -> None:
    axis = Axis(b=2.0, q=20.0)
    time, duty, x, _ = play(axis, [(4.0, 25.0), (4.0, -25.0), (4.0, 35.0), (4.0, -35.0), *wave(30.0, 0.8, 12)])
    rng = np.random.default_rng(2)
    scores = []
    for _ in range(16):
        noisy = x + 1e-3 * rng.standard_normal(len(x))
        found = two_stage([Recording("test", time, duty, noisy, "%", "rad")])
        truth = (axis.q, axis.forward, axis.reverse, axis.b, axis.b / axis.q)
        scores.append([(getattr(found, n) - t) / found.std(n) for n, t in zip(NAMES, truth, strict=True)])
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all(spread < 1.6) and np.all(spread > 0.4), dict(zip(NAMES, spread, strict=True))


def test_what_the_gap_touches_is_thrown_away_and_nothing_else() -> None:
    axis = Axis(dead_time=0.2)
    found = two_stage([record(axis)])
    reversals = {round(p.held_since, 3): p.start - p.held_since for p in found.pieces if p.held_since > 1.0}
    assert len(reversals) == 15
    assert all(0.2 <= skipped < 0.5 for skipped in reversals.values()), reversals
    untouched = two_stage([record(Axis(dead_time=0.0))])
    assert untouched.skipped == ()
    assert all(p.held_since < p.start < p.end for p in found.pieces if p.start > p.held_since)
    for p in found.pieces:
        assert len(p.time) == len(p.measured) == len(p.fitted)
        assert np.max(np.abs(p.fitted - p.measured)) < 2.0 * COUNT


def test_speed_recordings_are_fitted_as_speeds_and_it_says_so() -> None:
    found = two_stage([record(Axis(dead_time=0.1), speed=True)], "positions")
    assert found.ok and found.form == "speeds" and "speeds" in found.says
    assert found.b == pytest.approx(0.52, rel=1e-4)


def test_gaps_in_the_readings_and_uneven_time_do_no_harm() -> None:
    axis = Axis(dead_time=0.1)
    whole = record(axis)
    rng = np.random.default_rng(4)
    output = whole.output.copy()
    output[rng.random(len(output)) < 0.1] = np.nan
    output[5000:5600] = np.nan
    keep = rng.random(len(output)) > 0.2
    uneven = replace(whole, time=whole.time[keep], input=whole.input[keep], output=output[keep])
    for form in ("speeds", "positions"):
        assert two_stage([uneven], form).b == pytest.approx(axis.b, rel=0.03)


def test_several_recordings_count_as_one() -> None:
    axis = Axis(dead_time=0.1)
    steps, square = record(axis, PAPER[:4]), record(axis, wave(30.0, 1.5, 12))
    found = two_stage([steps, square])
    assert found.b == pytest.approx(axis.b, rel=0.005)
    assert {p.recording for p in found.pieces} == {0, 1}
    heavy = replace(square, known={"payload_mass": 1.0, "arm_length": 0.3})
    assert "payload" in two_stage([steps, heavy]).says


def sine() -> Recording:
    time = np.arange(5000) * STEP
    return Recording("test", time, 40.0 * np.sin(time), np.sin(time), "%", "rad", COUNT)


@pytest.mark.parametrize(
    ("recording", "word"),
    [
        (sine(), "constant"),
        (record(Axis(), wave(30.0, 0.4, 40)), "steady state"),
        (record(Axis(), [(12.0, 25.0), (12.0, 35.0)]), "backwards"),
        (record(Axis(), [(12.0, -25.0), (12.0, -35.0)]), "forwards"),
        (record(Axis(), [(12.0, 25.0), (12.0, -25.0)]), "two"),
        (record(Axis(), [(12.0, 3.0), (12.0, -3.0)]), "steady state"),
        (record(Axis(), [(0.04, 30.0)]), "constant"),
    ],
    ids=["sine", "square wave only", "forwards only", "backwards only", "one duty", "no motion", "too short"],
)
@pytest.mark.parametrize("form", ["speeds", "positions"])
def test_a_recording_that_lacks_something_gets_a_sentence(recording: Recording, word: str, form: str) -> None:
    found = two_stage([recording], form)
    assert not found.ok and word in found.says and "\n" not in found.says
    assert math.isnan(found.b) and math.isnan(found.std("b"))
    with pytest.raises(ValueError, match=word):
        to_model(found, [recording])


def test_noise_alone_gives_no_estimate() -> None:
    time, duty, _, _ = play(Axis(), PAPER)
    noise = np.random.default_rng(6).standard_normal(len(time)) * 1e-3
    assert not two_stage([Recording("test", time, duty, noise, "%", "rad")]).ok


def test_the_model_says_what_the_method_does_not_know() -> None:
    recording = record(Axis(dead_time=0.1))
    found = two_stage([recording])
    model = loads(dumps(to_model(found, [recording])))
    assert model.structure.ids == BASE
    assert model.values["input_gain"] == pytest.approx(found.c)
    assert model.std("viscous_friction") == pytest.approx(found.std("b"))
    assert model.values["backlash_gap"] == 0.0 and math.isnan(model.std("backlash_gap"))
    assert "not estimated" in model.notes["backlash_gap"] and "friction" in model.notes["dead_band_forward"]
