"""The verdict is a function of figures and findings alone, and claims nothing that these contradict."""

from __future__ import annotations

import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from twin.diagnosis import verdict
from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun, TorqueFigures, to_json, unchanged
from twin.diagnosis.coverage import Beyond
from twin.diagnosis.result import Estimate, Finding
from twin.model.stepper import Structure

VERDICTS = {"inconclusive", "explained", "nothing_missing", "partly_explained", "unexplained"}
POSITIVE = st.floats(1e-6, 1e3)
RUNS = st.builds(
    lambda rmse, expected, chance, times: FreeRun(rmse, expected, chance, times * expected),
    POSITIVE, POSITIVE, st.floats(0.0, 1.0), st.floats(1.0, 3.0),
)  # fmt: skip
COMPARISONS = st.builds(Comparison, RUNS, RUNS, POSITIVE)
TORQUES = st.builds(
    TorqueFigures, POSITIVE, POSITIVE, POSITIVE, st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.just("rad/s^2")
)
BEYOND = st.lists(st.just(Beyond("input", (-34.0, 34.0), (-70.0, 60.0))), max_size=1)
FIGURES = st.builds(
    lambda train, held, torque, beyond: Adequacy({"train": train, "holdout": held}, (), torque, tuple(beyond)),
    COMPARISONS, COMPARISONS, TORQUES, BEYOND,
)  # fmt: skip


def finding(value: float, std: float) -> Finding:
    size = {"gravity_gain": Estimate(value, std, "rad/s^2")}
    return Finding("gravity", "load", 0.9, "Gravity.", "", size)


FINDINGS = st.lists(st.builds(finding, st.floats(-10.0, 10.0), st.floats(1e-3, 10.0)), max_size=2)


WITHIN_NOISE = FreeRun(0.01, 0.012, 0.6, 0.024)


def sound(after: FreeRun = WITHIN_NOISE) -> Adequacy:
    compared = Comparison(FreeRun(0.1, 0.012, 0.0, 0.024), after, 3.0)
    torque = TorqueFigures(3.0, 0.1, 0.05, 0.03, 0.005)
    return Adequacy({"train": compared, "holdout": compared}, (), torque)


@given(FIGURES, FINDINGS, st.booleans(), st.booleans())
def test_no_claim_stands_beside_figures_that_contradict_it(
    figures: Adequacy, findings: list[Finding], left: bool, drawn: bool
) -> None:
    claim = verdict.decide(figures, findings, left, drawn)
    assert claim.verdict in VERDICTS
    assert claim.says.endswith(".") and "\n" not in claim.says
    if claim.verdict not in ("explained", "nothing_missing"):
        return
    assert not left and not drawn
    for compared in figures.free_run.values():
        before, after = compared.before, compared.after
        far = after.rmse > verdict.SEVERAL * after.expected and after.rmse > verdict.SHOWS * compared.span
        assert not (far and after.p_value < verdict.CHANCE)
        chance = min(before.largest, after.largest)
        assert after.rmse <= verdict.LARGER * before.rmse or after.rmse <= chance
    torque = figures.missing_torque
    assert torque.of_drive <= verdict.TOO_MUCH
    if findings:
        assert torque.share_left <= verdict.MUCH_LEFT or torque.of_drive <= verdict.OF_DRIVE
        sizes = [f.parameters["gravity_gain"] for f in findings]
        assert all(abs(e.value) >= verdict.SURE * e.std for e in sizes)
    assert (claim.verdict == "explained") == bool(findings)


def test_each_verdict_has_its_figures() -> None:
    sure, off = finding(3.0, 0.1), FreeRun(0.9, 0.01, 1e-9, 0.02)
    assert verdict.decide(sound(), [sure], False, False).verdict == "explained"
    assert verdict.decide(sound(), [], False, False).verdict == "nothing_missing"
    assert verdict.decide(sound(), [sure], True, False).verdict == "partly_explained"
    assert verdict.decide(sound(), [finding(0.05, 0.1)], False, False).verdict == "partly_explained"
    assert verdict.decide(unchanged(sound()), [], False, False).verdict == "unexplained"
    assert verdict.decide(sound(off), [], False, False).verdict == "unexplained"


def test_where_nothing_was_fitted_there_an_error_condemns_nothing() -> None:
    good, off = FreeRun(0.01, 0.012, 0.6, 0.024), FreeRun(0.9, 0.01, 1e-9, 0.02)
    runs = {"train": Comparison(good, good, 3.0), "holdout": Comparison(off, off, 3.0)}
    torque = TorqueFigures(0.1, 0.1, 0.05, 1.0, 0.005)
    outside = Adequacy(runs, (), torque, (Beyond("input", (-34.0, 34.0), (-70.0, 60.0)),))
    claim = verdict.decide(outside, [], False, False)
    assert claim.verdict == "inconclusive" and "input beyond -34 to 34" in claim.says


def test_a_last_model_that_errs_more_is_not_handed_out() -> None:
    worse = Comparison(FreeRun(0.1, 0.1, 0.5, 0.2), FreeRun(0.3, 0.1, 1e-4, 0.2), 3.0)
    figures = Adequacy({"holdout": worse}, (), TorqueFigures())
    assert verdict.vetoed(figures) and not verdict.vetoed(unchanged(figures))
    within_noise = Comparison(FreeRun(0.05, 0.4, 0.9, 0.8), FreeRun(0.3, 0.4, 0.6, 0.8), 3.0)
    assert not verdict.vetoed(Adequacy({"holdout": within_noise}, (), TorqueFigures()))
    assert not verdict.vetoed(Adequacy({"train": worse, "holdout": within_noise}, (), TorqueFigures()))
    first = Structure.of(("inertia",))
    assert "gravity" in verdict.veto_sentence(figures, first.with_("gravity"), first)
    assert [n.id for n in verdict.vetoed_names(figures, first.with_("gravity"), first)] == ["gravity"]


def test_figures_that_could_not_be_told_are_null() -> None:
    written = to_json(
        Adequacy({"train": Comparison(FreeRun(0.1, 0.1, 0.5, 0.2), FreeRun(0.1, math.nan, 0.5, math.nan), 1.0)})
    )
    assert written["missing_torque"]["of_drive"] is None  # type: ignore[index]
    assert "expected" not in written["free_run"]["train"]  # type: ignore[index]


def test_a_torque_that_reading_noise_hides_is_not_said_to_be_small() -> None:
    hidden = replace(sound(), missing_torque=TorqueFigures(110.0, 108.0, 110.0, math.nan, 0.0, "rad/s^2", 800.0))
    claim = verdict.decide(hidden, [], False, False)
    assert "hidden by the noise of the readings, which makes 14 %" in claim.says
    assert "under 0.1 %" not in claim.says


def test_a_later_time_is_told_where_something_is_off() -> None:
    off = FreeRun(0.4, 0.012, 0.0, 0.024)
    later = (Beyond("time", (0.0, 42.0), (42.0, 60.0)),)
    assert "time beyond" not in verdict.decide(replace(sound(), beyond_training=later), [], False, False).says
    claim = verdict.decide(replace(sound(off), beyond_training=later), [], False, False)
    assert claim.verdict == "unexplained" and "time beyond 0 to 42" in claim.says


def test_good_figures_are_not_said_to_show_that_something_is_missing() -> None:
    claim = verdict.decide(sound(), [], False, True)
    assert claim.verdict == "unexplained" and not claim.objections
    assert claim.says.startswith("The figures are good, but")


def test_names_that_leave_the_fitted_data_unexplained_are_not_called_the_cause() -> None:
    half = Comparison(FreeRun(0.8, 0.012, 0.0, 0.024), FreeRun(0.4, 0.012, 0.0, 0.024), 3.0)
    figures = replace(sound(), free_run={"train": half, "holdout": sound().free_run["holdout"]})
    claim = verdict.decide(figures, [finding(3.0, 0.1)], False, False)
    assert claim.verdict == "partly_explained"
    assert "not show that what is named is the cause" in claim.says and "errs 50 % as much" in claim.says
    same = Comparison(half.before, replace(half.before, rmse=0.79), 3.0)
    claim = verdict.decide(
        replace(figures, free_run={**figures.free_run, "train": same}), [finding(3.0, 0.1)], False, False
    )
    assert "not show that what is named is the cause: " in claim.says and "although" not in claim.says
