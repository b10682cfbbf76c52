"""Faults of a recording, as opposed to things that the axis really did.

Each rule asks for something that no axis can do, not just for something unusual. A false fault costs more than a missed
one: a standstill from dry friction or an impact in the backlash carries the information that we want.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Fault:
    """Something in the recording that is no motion of the axis. `start`, `end` in s."""

    kind: str  # freeze, outlier, gap, clock, wrap, restart, saturation, missing
    start: float
    end: float
    says: str
    signal: str = "output"


#: How a fault that comes often is called.
_PLURALS = {
    "freeze": "freezes", "outlier": "outliers", "gap": "gaps", "clock": "faults of the clock", "wrap": "wraps",
    "restart": "restarts", "saturation": "saturations", "missing": "stretches without a number",
}  # fmt: skip
#: Up to so many faults of one kind are said one by one.
_FEW = 2


def summarise(faults: Sequence[Fault]) -> list[str]:
    """What was found, in a line for each kind of fault and signal.

    Parameters
    ----------
    faults
        In the order of time.

    Returns
    -------
    list of str
        One or two faults of a kind as they are; of more, their number, the stretch and the first of them.
    """
    said = []
    for kind, signal in dict.fromkeys((f.kind, f.signal) for f in faults):
        alike = [f for f in faults if (f.kind, f.signal) == (kind, signal)]
        if len(alike) <= _FEW:
            said += [f.says for f in alike]
            continue
        said.append(
            f"{len(alike)} {_PLURALS.get(kind, kind)} of the {signal} from {alike[0].start:.3f} s to "
            f"{max(f.end for f in alike):.3f} s; the first: {alike[0].says}"
        )
    return said


def find_resolution(values: FloatArray) -> float:
    """Size of one step of a quantised signal, in its own unit; 0.0 when it is not quantised.

    The values of a quantised signal differ by whole numbers of steps. A tenth of a step is allowed for
    decimals that the logger rounded away, and a few in a hundred may differ (read errors).
    """
    finite = values[np.isfinite(values)]
    levels = np.unique(finite)
    if levels.size < 3 or levels.size > 0.9 * finite.size:
        return 0.0
    spacing = np.diff(levels)
    spacing = np.sort(spacing[spacing > 1e-9 * np.ptp(levels)])
    if spacing.size < 2:
        return 0.0
    alike = np.searchsorted(spacing, 1.1 * spacing, side="right") - np.searchsorted(spacing, 0.9 * spacing)
    common = float(np.mean(spacing[np.abs(spacing / spacing[np.argmax(alike)] - 1) < 0.1]))
    for divisor in (1, 2, 3) if spacing.size >= 8 else (1,):
        step = common / divisor
        ratio = spacing[spacing < 20 * step] / step  # a longer one adds up the rounding errors of many
        if ratio.size >= 2 and np.mean(np.abs(ratio - np.round(ratio)) < 0.1) > 0.97:
            return _refined(levels, step)
    return 0.0


def _refined(levels: FloatArray, step: float) -> float:
    """The step from the whole range: far more digits than a single spacing has when decimals were rounded."""
    counts = np.concatenate(([0.0], np.cumsum(np.round(np.diff(levels) / step))))
    return float(np.ptp(levels) / counts[-1]) if counts[-1] > 0 else step


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First and last index of each stretch where `mask` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def find_missing(time: FloatArray, values: FloatArray, what: str) -> list[Fault]:
    """Stretches without a reading."""
    faults = []
    for first, last in runs(np.isnan(values)):
        count = last - first + 1
        readings = "1 reading" if count == 1 else f"{count} readings"
        faults.append(
            Fault(
                "missing",
                time[first],
                time[last],
                f"{readings} of the {what} missing at {time[first]:.3f} s.",
                what,
            )
        )
    return faults


def find_gaps(time: FloatArray) -> list[Fault]:
    """Holes in the time axis: steps over 5 times the usual one and over 20 ms."""
    step = np.diff(time)
    holes = np.flatnonzero((step > 5 * np.median(step)) & (step > 0.02))
    return [
        Fault("gap", time[k], time[k + 1], f"No samples for {step[k]:.3f} s from {time[k]:.3f} s on.", "clock")
        for k in holes
    ]


def find_outliers(values: FloatArray, resolution: float) -> BoolArray:
    """Single readings (or two in a row) that jump away and come back.

    A reading is an outlier when its distance from the median of its neighbourhood passes three limits. They are 10
    counts, 5 times any step around it, and a quarter of the fastest step of the whole recording.
    """
    found = np.zeros(values.size, dtype=bool)
    good = np.flatnonzero(np.isfinite(values))
    if good.size < 11:
        return found
    from scipy.ndimage import median_filter  # slow to import, as above

    y = values[good]
    smooth = median_filter(y, size=5, mode="nearest")
    off = np.abs(y - smooth)
    least = max(10 * resolution, 1e-6 * float(np.ptp(smooth)))
    suspects = np.flatnonzero((off > least) & (off > 0.25 * np.max(np.abs(np.diff(smooth)))))
    step = np.abs(np.diff(y))
    for k in suspects:
        # the fifth largest step: two single outliers side by side make four large ones
        around = np.sort(step[max(0, k - 12) : k + 12])
        usual = around[-5] if around.size >= 5 else np.inf
        if off[k] > 5 * usual and 0 < k < y.size - 1:
            found[good[k]] = True
    return found


def find_held(time: FloatArray, values: FloatArray, resolution: float) -> tuple[list[Fault], BoolArray]:
    """Freezes of a position: it stands exactly still as no axis at rest does.

    An axis that really stood still starts from rest: its first step is no larger than the ones that follow.
    Returns the faults and the samples to leave out.
    """
    out = np.zeros(values.size, dtype=bool)
    faults: list[Fault] = []
    good = np.flatnonzero(np.isfinite(values))
    if good.size < 20:
        return faults, out
    t, y = time[good], values[good]
    step = np.diff(y)
    if resolution == 0:
        resolution = 1e-4 * float(np.ptp(y))  # nothing is known of the grain: what we would not call motion
    still = [(a, b + 1) for a, b in runs(step == 0) if b - a + 1 >= 10 and b + 1 < y.size - 1]
    if not still:
        return faults, out
    exits = np.zeros(step.size, dtype=bool)
    exits[[b for _, b in still]] = True
    fastest = float(np.max(np.abs(step[~exits] / np.diff(t)[~exits]), initial=0.0))
    for a, b in still:
        if not _is_freeze(t, y, a, b, fastest, resolution):
            continue
        says = f"The reading froze at {t[a]:.3f} s for {t[b] - t[a]:.3f} s while the axis moved on."
        faults.append(Fault("freeze", float(t[a]), float(t[b]), says))
        out[good[a] + 1 : good[b] + 1] = True
    return faults, out


def _is_freeze(t: FloatArray, y: FloatArray, a: int, b: int, fastest: float, resolution: float) -> bool:
    """Whether the axis went on during the standstill y[a] = ... = y[b].

    True in each of three cases. The jump at its end is faster than the axis ever moves. Or the axis was moving as it
    began, and the jump is far larger than any step around. Or, away from the ends of the range, it neither braked
    before nor started after. An impact in the backlash can start a link at once, but only an end stop can halt it at
    once.
    """
    jump = abs(y[b + 1] - y[b])
    before = np.abs(np.diff(y[max(0, a - 5) : a + 1]))
    after = np.abs(np.diff(y[b + 1 : b + 7]))
    if jump <= 10 * resolution or before.size < 3 or after.size < 3:
        return False
    if jump / (t[b + 1] - t[b]) > 1.5 * fastest and jump > 3 * np.max(after):
        return True
    if before[-1] >= 3 * resolution and jump > 4 * max(float(np.max(before)), float(np.max(after))):
        return True
    braked = before[-1] < max(10 * resolution, 0.7 * float(np.max(before[-3:])))
    started = min(jump, float(np.min(after[:3]))) < max(10 * resolution, 0.7 * float(np.max(after[:3])))
    margin = 0.05 * float(np.ptp(y))
    return not braked and not started and np.min(y) + margin < y[a] < np.max(y) - margin


def find_contradicted(
    time: FloatArray, values: FloatArray, speed: FloatArray, resolution: float
) -> tuple[list[Fault], BoolArray]:
    """Freezes that a reported speed gives away: it stands at one value other than zero while the position
    does not move."""
    out = np.zeros(values.size, dtype=bool)
    faults = []
    same = (np.diff(values) == 0) & (np.diff(speed) == 0)
    # the last digit of a speed may stay lit at rest
    least = max(3 * find_resolution(speed), 0.02 * float(np.max(np.abs(speed))))
    for a, last in runs(same & (np.abs(speed[1:]) > least)):
        b = last + 1
        missed = abs(speed[b]) * (time[b] - time[a])
        if last - a + 1 >= 10 and missed > 20 * resolution:
            lasts = time[b] - time[a]
            says = f"The reading froze at {time[a]:.3f} s for {lasts:.3f} s while the speed read {speed[b]:.3g}."
            faults.append(Fault("freeze", time[a], time[b], says))
            out[a + 1 : b + 1] = True
    return faults, out
