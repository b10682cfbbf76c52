"""The finding that a sensor is read more slowly than it is logged, made when the recording was read."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from twin.diagnosis import thresholds
from twin.diagnosis.result import Estimate, Finding
from twin.effects.catalogue import EFFECTS
from twin.io.recording import Recording


def finding(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """The finding, or none where each row may be a new reading or the rig file gives `refresh`.

    Parameters
    ----------
    recordings
        As they were read, with what was found before any fit.
    """
    held = [r.refresh for r in recordings if r.refresh and any(f.kind == "refresh" for f in r.preflight)]
    if not held:
        return ()
    page, refresh = EFFECTS["sensor_hold"], statistics.median_high(held)
    says = page.sentence.format(refresh=f"{1e3 * refresh:.3g} ms")
    estimate = Estimate(refresh, math.nan, "s")
    certain = 1.0 - thresholds.PROB_NONE_OF_THESE
    return (Finding(page.id, page.station, certain, says, page.equation or "", {"refresh": estimate}),)
