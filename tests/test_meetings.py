"""Meetings of motor and link whose moment noise decides: held against the moments under other noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin import kernel, likelihood, meetings, ready
from twin.axis import Structure
from twin.effects.catalogue import BASE
from twin.likelihood import Case, Point
from twin.recording import Recording

STRUCTURE = Structure.of(BASE)
VALUES = {
    "input_gain": 0.1, "viscous_friction": 1.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.05, "motor_share": 0.3, "friction_share": 0.85,
}  # fmt: skip
COUNT = 2.0 * np.pi / 4096.0
STEP = 0.002
SECONDS = 24.0


def slow() -> np.ndarray:
    """Up and down by turns, on ramps along which the motor only just keeps up with the link."""
    time = STEP * np.arange(round(SECONDS / STEP))
    return 30.0 * np.interp(time % 8.0, [0.0, 1.0, 4.0, 5.0, 8.0], [0.0, 1.0, 0.0, -1.0, 0.0])


def quick() -> np.ndarray:
    """The same, without the ramps."""
    return 20.0 * np.sign(slow())


def shaken(duty: np.ndarray, seed: int, size: float = 1.0) -> tuple[Case, np.ndarray]:
    """A recording under a noisy drive that nobody knows of, and the moments at which motor and link met."""
    unknown = size * np.random.default_rng(seed).standard_normal(len(duty))
    time = STEP * np.arange(len(duty))
    blank = Recording("made", time, duty + unknown, np.zeros(len(duty)), "%", "rad", COUNT)
    run = kernel.predict(
        likelihood.prepare(blank, STRUCTURE).drive, kernel.vector(STRUCTURE, VALUES),
        kernel.start_state(0.0, 0.0, 0.0), keep_states=True,
    )  # fmt: skip
    touching = np.abs(run.states[:, 2]) >= 0.5 * VALUES["backlash_gap"] * (1.0 - 1e-9)
    read = COUNT * np.round(run.reading / COUNT)
    met = time[1:][touching[1:] & ~touching[:-1]]
    return likelihood.prepare(replace(blank, input=duty, output=read), STRUCTURE), met


def at_truth(case: Case) -> Point:
    density = likelihood.best_density([case], STRUCTURE, VALUES)
    return likelihood.evaluate([case], STRUCTURE, VALUES, density, ready.free_parameters(STRUCTURE))


def test_where_noise_decides_the_moment_nothing_is_judged():
    case, _ = shaken(slow(), 0)
    (judged,) = meetings.foreseeable([case], at_truth(case))
    assert judged.unforeseen is not None and 0.01 < judged.unforeseen.mean() < meetings.MOST
    spread = [shaken(slow(), seed)[1] for seed in range(1, 30)]
    # On the second half of each ramp down the motor lets go; it meets the other flank at about its end.
    for begin, end in ((2.6, 4.0), (6.6, 8.0)):
        first = np.array([m[(m > begin) & (m < end)][0] for m in spread if np.any((m > begin) & (m < end))])
        assert len(first) > 20 and np.std(first) > 3.0 * STEP, "noise does decide them"
        hidden = judged.unforeseen[(first / STEP).astype(int)]
        assert hidden.mean() > 0.8


def test_quick_reversals_are_all_judged():
    case, met = shaken(quick(), 0)
    (judged,) = meetings.foreseeable([case], at_truth(case))
    assert len(met) > 4
    assert judged.unforeseen is None or not judged.unforeseen[(met / STEP).astype(int)].any()


def test_without_a_gap_nothing_is_hidden():
    case, _ = shaken(slow(), 0)
    rigid = STRUCTURE.without("backlash")
    point = replace(at_truth(case), structure=rigid)
    marked = replace(case, unforeseen=np.ones(len(case.drive.time), dtype=bool))
    assert meetings.foreseeable([marked], point)[0].unforeseen is None


def test_the_truth_is_as_likely_as_it_should_be_where_only_what_can_be_foreseen_is_judged():
    """Judged throughout, crossings that noise decides speak against the truth by many units; left out, they do not."""
    behind = []
    for seed in range(4):
        case, _ = shaken(slow(), seed)
        point = at_truth(case)
        for cases in ([case], meetings.foreseeable([case], point)):
            here = likelihood.evaluate(cases, STRUCTURE, VALUES, point.density, point.free)
            best = likelihood.climb(cases, STRUCTURE, VALUES, point.density, point.free)
            behind.append(here.deviance - best.deviance)
    # Of so many parameters it is chi-squared: less than three for each in all but one of a thousand.
    assert max(behind[1::2]) < 3.0 * len(VALUES)
    assert max(behind[0::2]) > 5.0 * len(VALUES)
