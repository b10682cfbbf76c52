"""The checks before any fit. Each is a statement that holds for every sound recording, with its reason.

They share one statistic (`twin.io.preflight.response`): the share of the change of speed that the command explains
beyond the axis' own motion. On a sound recording it exceeds what the same command explains moved in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from twin.io.preflight.finding import Finding, Severity
from twin.io.preflight.response import (
    Response,
    Signals,
    regression,
    response,
    size_of_change_response,
    speed_response,
)

#: A command has to explain this share, or more than each of the same commands moved in time.
_MIN_SHARE = 0.1
#: Three coefficients explain 3 % of so many rows by chance.
_MIN_ROWS = 100
#: A coefficient is negative for sure that is so many standard deviations below 0.
_SURE = 5.0
#: Another reading of a column has to leave at most this part of what the column as it is leaves unexplained.
_BETTER = 0.8
#: Counts within which an axis that only shakes in its dead-band stays.
_SHAKING_COUNTS = 2.0
#: Share of the readings at an end of the range, from which on they say why nothing answers.
_AT_ENDS = 0.3
#: For how long, s, the speed of an axis goes on the way that the command had.
_MEMORIES = (0.01, 0.03, 0.1, 0.3, 1.0)
#: Of the largest speed: slower is no motion the other way. Share of the rows that have to show motion each way.
_SLOW, _EACH_WAY = 0.1, 0.05


def examine(recordings: Sequence[Signals]) -> list[Finding]:
    """All findings on recordings of one rig, the ones that block first.

    Parameters
    ----------
    recordings
        What is to be fitted, in the order that it was given.
    """
    twice = same_twice(recordings)
    still = stays_in_dead_band(recordings)
    found = [*twice, *still, *duty_scale(recordings)]
    seen = None if still else response(recordings)
    if seen is not None:
        said = lost_sign(recordings, seen) or unsigned_command(recordings, seen) or opposed(seen)
        if not said and (nothing := unrelated(seen)):
            said = clipped(recordings) or nothing
        found = [*said, *found]
    return sorted(found, key=lambda f: f.severity is not Severity.BLOCKS)


def same_twice(recordings: Sequence[Signals]) -> list[Finding]:
    """The same readings stand in the list twice: standard errors would come out too small by the root of two.

    Two recordings of a rig never agree in each stamp and each reading: noise alone would have to repeat.
    """
    seen: dict[bytes, str] = {}
    found = []
    for r in recordings:
        key = r.time.tobytes() + r.command.tobytes() + r.output.tobytes()
        if key in seen:
            found.append(
                Finding(
                    "duplicate",
                    f"{r.name} holds the same readings as {seen[key]}: take one of them out of the list",
                    Severity.BLOCKS,
                )
            )
        seen.setdefault(key, r.name)
    return found


def stays_in_dead_band(recordings: Sequence[Signals]) -> list[Finding]:
    """The output never leaves two counts: a reading at rest between two counts does the same."""
    spans = [float(np.ptp(r.output[np.isfinite(r.output)])) for r in recordings]
    counts = [span / r.resolution if r.resolution > 0 else np.inf for span, r in zip(spans, recordings, strict=True)]
    if max(counts) > _SHAKING_COUNTS:
        return []
    peak = max(float(np.max(np.abs(r.command))) for r in recordings)
    return [
        Finding(
            "dead_band",
            f"the output stays within {max(counts):.0f} counts while the input goes to {peak:.3g} "
            f"{recordings[0].input_unit}: the axis never leaves its dead-band; drive it harder",
            Severity.BLOCKS,
        )
    ]


def duty_scale(recordings: Sequence[Signals]) -> list[Finding]:
    """A duty in percent that never exceeds 1, or goes beyond 100.

    No gear motor moves at a hundredth of its drive, and no drive gives more than all of it. Such numbers are a
    fraction, or the ticks of a timer.
    """
    if recordings[0].input_unit != "%":
        return []
    peak = max(float(np.max(np.abs(r.command))) for r in recordings)
    if peak <= 1.0:
        return [
            Finding(
                "duty_scale",
                f'the duty stays within {peak:.3g} %: if 1 is full drive, say unit = "1" in [input]',
                Severity.WARNS,
            )
        ]
    if peak <= 110.0:
        return []
    logged = max(float(np.nanmax(np.abs(r.logged_command))) for r in recordings)
    full = next(
        (f for f in (100, 255, 256, 1000, 1023, 1024, 4095, 4096, 10_000, 32_767, 65_535) if f >= logged), logged
    )
    cure = (
        'say unit = "%" in [input]' if full == 100 else f"say full_scale = {full:g} in [input], if that is full drive"
    )
    return [Finding("duty_scale", f"the duty reaches {peak:.4g} %, more than full drive: {cure}", Severity.WARNS)]


def _is_better(other: Response | None, seen: Response) -> bool:
    """Whether another reading of the command explains far more than the command as it is, and is no chance."""
    if other is None or other.rank < 1.0 or other.share < _MIN_SHARE:
        return False
    return 1.0 - other.share < _BETTER * (1.0 - seen.share)


def _drives_size_alone(seen: Response) -> bool:
    """Whether the command explains the size of the speed or of its change, not the two themselves, or nothing."""
    of_change, change_rank = size_of_change_response(seen)
    if change_rank == 1.0 and of_change > max(seen.share, _MIN_SHARE):
        return True
    share, rank = speed_response(seen, np.abs)
    signed, _ = speed_response(seen, np.asarray)
    size_alone = rank == 1.0 and share > 2.0 * max(signed, _MIN_SHARE)
    return seen.share < 2.0 * _MIN_SHARE and (size_alone or bool(unrelated(seen)))


def _with_sign(recordings: Sequence[Signals]) -> Iterator[list[Signals]]:
    """The recordings, each with the sign that its command had in the mean lately, for several meanings of that."""
    for memory in _MEMORIES:
        signed = []
        for one in recordings:
            total = np.concatenate(([0.0], np.cumsum(one.command[:-1] * np.diff(one.time))))
            lately = total - np.interp(one.time - memory, one.time, total)
            signed.append(replace(one, output=np.sign(lately) * np.abs(one.output)))
        yield signed


def lost_sign(recordings: Sequence[Signals], seen: Response) -> list[Finding]:
    """A command or a speed that is a magnitude: its sign was lost.

    A command that is never negative drives one way. The axis runs both ways, and the command explains hardly any change
    of speed but the size of the speed. Then it drives each motion in its own direction, and its sign is in another
    column. A load that falls back is braked by the command, which then explains the change of speed. A speed that is
    never negative has lost its own sign where a command of both signs explains it far better with the sign that the
    command had shortly before.
    """
    least = min(float(np.min(r.command)) for r in recordings)
    speed = seen.rows.motion[:, 0]
    fastest = float(np.max(np.abs(speed)))
    both_ways = min(np.mean(speed > _SLOW * fastest), np.mean(speed < -_SLOW * fastest)) > _EACH_WAY
    if least >= 0.0 and both_ways and _drives_size_alone(seen):
        return [
            Finding(
                "direction",
                "the input is never negative, yet it drives the axis both ways: its sign is in another column; name it "
                'with [input.direction] column = "..."',
                Severity.BLOCKS,
            )
        ]
    # Noise around standstill is a little below zero.
    backwards = min(float(np.nanmin(r.output)) for r in recordings) < -_SLOW * fastest
    unsigned = all(r.is_speed for r in recordings) and not backwards
    if least < 0.0 and unsigned and any(_is_better(response(r), seen) for r in _with_sign(recordings)):
        return [
            Finding(
                "unsigned_output",
                "the output is never negative though the input is, and follows the input far better with the input's "
                "sign: a speed without its direction; log it with its sign, or give a recording that drives one way",
                Severity.BLOCKS,
            )
        ]
    return []


def unsigned_command(recordings: Sequence[Signals], seen: Response) -> list[Finding]:
    """Signed whole numbers that were logged without their sign: -1 stands as 255 or 65535.

    All numbers are whole, none is negative, and some lie in the upper half of a byte or word. Read as signed, they
    explain far more.
    """
    logged = np.concatenate([r.logged_command[np.isfinite(r.logged_command)] for r in recordings])
    if logged.min() < 0.0 or not np.array_equal(logged, np.round(logged)):
        return []
    for bits in (8, 16, 32):
        top, half = 2.0**bits, 2.0 ** (bits - 1)
        if not half <= logged.max() < top:
            continue
        scale = [float(np.nanmax(np.abs(r.command))) / float(np.nanmax(r.logged_command)) for r in recordings]
        signed = [_signed(r, half, top, s) for r, s in zip(recordings, scale, strict=True)]
        if _is_better(response(signed), seen):
            return [
                Finding(
                    "unsigned_input",
                    f"the input reaches {logged.max():.0f}, is never negative, and explains the motion far better as a "
                    f" signed number of {bits} bits: say signed_bits = {bits} in [input]",
                    Severity.BLOCKS,
                )
            ]
    return []


def _signed(signals: Signals, half: float, top: float, scale: float) -> Signals:
    """The same with the command read as a signed number."""
    raw = np.where(np.isfinite(signals.logged_command), signals.logged_command, 0.0)
    return replace(signals, command=scale * np.where(raw >= half, raw - top, raw))


def opposed(seen: Response) -> list[Finding]:
    """A positive command slows the axis down in all of the recording: the sensor or the motor is reversed.

    A drive pushes the way that it is told. The sum of the command's coefficients is negative by over five times its
    standard deviation under commands moved in time.
    """
    if seen.score > -_SURE or seen.rank < 1.0 or seen.share < _MIN_SHARE:
        return []
    return [
        Finding(
            "sign",
            "the output moves against the input: a positive input drives it down; if the sensor is reversed, say "
            "scale = -1 in [output]",
            Severity.BLOCKS,
        )
    ]


def unrelated(seen: Response) -> list[Finding]:
    """The command explains under a tenth of the change of speed, and no more of it or of the speed than moved in time.

    Under the hypothesis that the two have nothing to do with each other, all moved commands are as good as the true
    one, whatever their spectrum. A command that repeats is as good when moved by its period, but explains more than a
    tenth.
    """
    few = seen.rows.change.size < _MIN_ROWS
    if few or seen.share >= _MIN_SHARE or seen.rank == 1.0 or speed_response(seen, np.asarray)[1] == 1.0:
        return []
    return [
        Finding(
            "unrelated",
            f"the input explains {100 * max(seen.share, 0.0):.2g} % of how the speed changes, no more than the same "
            "input moved in time: the two columns have nothing to do with each other, or the axis never leaves its "
            "dead-band; name the right columns, or drive the axis harder",
            Severity.BLOCKS,
        )
    ]


def clipped(recordings: Sequence[Signals]) -> list[Finding]:
    """An output that stands at an end of its range for much of the time: why it does not answer to the input."""
    shares = []
    for r in recordings:
        y = r.output[np.isfinite(r.output)]
        shares.append(float(np.mean((y == y.min()) | (y == y.max()))))
    if max(shares) < _AT_ENDS:
        return []
    return [
        Finding(
            "clipped",
            f"the output stands at its smallest or its largest reading for {100 * max(shares):.0f} % of the time, "
            "whatever the input: the sensor or the log clips it, or the axis stands at a stop; record within the range",
            Severity.BLOCKS,
        )
    ]


def at_its_limit(signals: Signals, share: float) -> list[Finding]:
    """A sensor that is at its limit for much of the time while the axis goes on (see `twin.io.limits`).

    Parameters
    ----------
    signals
        The recording.
    share
        Of its time, for which the sensor is at its limit.
    """
    if share < _AT_ENDS:
        return []
    return [
        Finding(
            "clipped",
            f"{signals.name} is at the limit of its sensor for {100 * share:.0f} % of the time, while the axis goes on "
            "beyond; these readings are left out; move within the range of the sensor to have them",
            Severity.WARNS,
        )
    ]


def reversed_alone(signals: Signals, recordings: Sequence[Signals]) -> list[Finding]:
    """One recording of several, in which the axis moves against the input (see `opposed`).

    A short recording holds one change of the command or two. Its own coefficients then say little, and those of the
    other recordings judge it: they have to tell its motion better with its command turned round.

    Parameters
    ----------
    signals
        The recording.
    recordings
        All of the rig, this one among them.
    """
    seen = response([signals])
    found = [] if seen is None else opposed(seen)
    if seen is None or not found:
        return []
    others = regression([s for s in recordings if s is not signals], seen.step)
    if others is None:
        return found
    of_all = np.column_stack([others.motion, others.command])
    size = np.maximum(np.sqrt(np.mean(of_all**2, axis=0)), 1e-300)
    weights = np.linalg.lstsq(of_all / size, others.change, rcond=1e-9)[0] / size
    own, driven = seen.rows.motion @ weights[:-3], seen.rows.command @ weights[-3:]
    as_it_is, turned = (float(np.sum((seen.rows.change - own - sign * driven) ** 2)) for sign in (1.0, -1.0))
    return found if turned < as_it_is else []


def coarse(rows: float) -> Finding:
    """A counter that takes many rows for one count (see `twin.io.edges`)."""
    return Finding(
        "coarse",
        f"the output moves by one count in {rows:.0f} rows: it is read where its count changes, and the rows between "
        "are left out; less than a count shows of nothing that lasts for less than this",
        Severity.WARNS,
    )


def thinned(kept: float, lasted: float) -> Finding:
    """Recordings of which only what moves most is held (see `twin.io.thinning`)."""
    return Finding(
        "thinned",
        f"{kept:.0f} s of {lasted:.0f} s are used, of each recording the part that moves most: all together would take "
        "too much memory; to choose the parts yourself, give fewer recordings, or start and end in a manifest",
        Severity.WARNS,
    )


def slow_sensor(signals: Signals, refresh: float) -> Finding:
    """A sensor that is read anew more slowly than it is logged (see `twin.io.refresh`)."""
    row = float(np.median(np.diff(signals.time)))
    return Finding(
        "refresh",
        f"the output holds a new reading every {1e3 * refresh:.3g} ms only, while a row is logged every "
        f"{1e3 * row:.3g} ms; the rows between are left out (refresh = {refresh:.3g} in [output] says the same)",
        Severity.WARNS,
    )
