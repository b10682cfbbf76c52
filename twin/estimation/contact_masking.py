"""Contacts of motor and link after a gap crossing, and whether a model can predict their time.

Where the command falls slowly, the motor separates from the link by very little. It crosses the gap at a few hundredths
of a radian per second. Noise then decides when it touches the other flank. The filter runs on its mean, which has one
time of contact. The jolt that it predicts and the jolt that occurs are two errors. Each is far larger than the filter's
variance allows. An estimate would bend gap, dead-band and shares until the two coincide, and three such crossings in a
minute outweigh all other readings. So the filter follows the readings around a contact whose time is visibly uncertain,
but they are not judged.

The motor's place in its gap at the start is unknown. So the first contact is not judged where others follow.

Contacts between reversals of the command that follow each other faster than the gears come to rest are not judged
either. These are known before any model is, so that all models are judged on the same readings.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation import filter_memory, likelihood
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem

#: Standard deviations of a contact's time, before and after it, in which nothing is judged.
_CONTACT_DEVIATIONS = 2.0
#: Where more than this share of a recording would not be judged, all of it is: its motor rattles without end.
MAX_MASKED_SHARE = 0.25
#: A command that reverses again after less than this time, s, keeps a motor rattling. Below this share of the largest
#: command, a reversal does not count. At least this share of a recording is judged, or all of it.
_RATTLE_INTERVAL, _IDLE_COMMAND, _MIN_JUDGED_SHARE = 0.25, 0.1, 0.3
#: Least number of pushes for the first not to be judged. Standard deviations of a reading that show that it has moved
#: the link.
_MIN_PUSHES, _MOVED_DEVIATIONS = 4, 5.0


def _unforeseeable_contacts(case: PreparedRecording, point: Fit) -> NDArray[np.bool_]:
    """The stamps (N,) at which the model cannot know whether motor and link have met."""
    time = case.drive.time
    hidden = np.zeros(len(time), dtype=bool)
    run = likelihood.filtered_states(case, point.structure, point.values, point.process_noise)
    half = 0.5 * point.values["backlash_gap"]
    touching = np.abs(run.states[:, 2]) >= half * (1.0 - 1e-6)
    speed = np.abs(run.states[:, 3] - run.states[:, 1])
    left = np.flatnonzero(touching[:-1] & ~touching[1:])
    met = np.flatnonzero(~touching[:-1] & touching[1:])
    left = left[left < (met[-1] if len(met) else 0)]
    last = met[np.searchsorted(met, left, "right")]
    share = point.values["motor_share"]
    variance = case.reading_variance * point.scale
    process_noise = point.process_noise * variance * (0.5 / share**2 + 1.0)
    alone = time[last + 1] - time[left]
    spread = np.sqrt(process_noise * alone**3 / 3.0)
    unsure = np.minimum(spread / np.maximum(speed[last], 1e-9), alone)
    error = share * (speed[last] if case.drive.speed else spread)
    seen = (error > np.sqrt(variance)) & (unsure > case.step)
    moment, reach = time[last + 1][seen], _CONTACT_DEVIATIONS * unsure[seen]
    begin = np.searchsorted(time, moment - reach)
    end = np.searchsorted(time, moment + reach + filter_memory.memory_of(case, point.process_noise))
    for i, j in zip(begin.tolist(), end.tolist(), strict=True):
        hidden[i:j] = True
    return hidden


def find_rattling(case: PreparedRecording) -> NDArray[np.bool_] | None:
    """The stamps (N,) between turns of the command that follow each other so soon that motor and link come to no rest
    against each other; None where there are none, or hardly anything else.

    Each bounce depends on the one before, and so does its error. After a few bounces the likelihood of any model, also
    of the true one, is a matter of chance. Its local optima lie a percent apart and say nothing of the parameters.
    """
    time, command = case.drive.time, case.drive.command
    if case.drive.closed:
        return None
    pushed = np.flatnonzero(np.abs(command) > _IDLE_COMMAND * np.abs(command).max())
    sign = np.sign(command[pushed])
    turns = pushed[1:][sign[1:] != sign[:-1]]
    hidden = np.zeros(len(time), dtype=bool)
    for i, j in itertools.pairwise(turns.tolist()):
        hidden[i:j] = time[j] - time[i] < _RATTLE_INTERVAL
    return hidden if 0.0 < hidden.mean() <= 1.0 - _MIN_JUDGED_SHARE else None


def find_first_contact(case: PreparedRecording) -> NDArray[np.bool_] | None:
    """The stamps (N,) until the first push has brought motor and link together and to rest against each other; None
    where few pushes follow, of which the first may say the most.

    Half a gap more or less on the way there makes a jolt that any effect is welcome to explain.
    """
    time, command, measured = case.drive.time, case.drive.command, case.drive.measured
    sign = np.sign(command) * (np.abs(command) > _IDLE_COMMAND * np.abs(command).max())
    pushes = np.flatnonzero((sign != 0.0) & (np.diff(sign, prepend=0.0) != 0.0))
    still = case.start[1] if case.drive.speed else case.start[0]
    moved = np.flatnonzero(np.abs(measured - still) > _MOVED_DEVIATIONS * np.sqrt(case.reading_variance))
    if case.drive.closed or len(pushes) < _MIN_PUSHES or len(moved) == 0:
        return None
    return np.asarray(time < time[max(pushes[0], moved[0])] + _RATTLE_INTERVAL)


def without_contact_mask(problem: FitProblem) -> FitProblem:
    """The problem with every reading judged where the motor does not rattle."""
    return problem.on([replace(c, contact_mask=None) for c in problem.recordings])


def with_contact_mask(problem: FitProblem, point: Fit) -> FitProblem:
    """The problem, judged only where the model at this point can predict whether motor and link touch."""
    if not point.structure.toothed:
        return without_contact_mask(problem)
    out = []
    for case in problem.stepped(point.structure):
        hidden = _unforeseeable_contacts(case, point)
        out.append(replace(case, contact_mask=hidden if 0.0 < hidden.mean() <= MAX_MASKED_SHARE else None))
    return problem.on(out)
