"""Input signals that a rig can play: duty in percent, one value per sample.

Each takes the duration, a random generator and the limits, and returns time (n,) and duty (n,).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Signal = tuple[Array, Array]


@dataclass(frozen=True)
class Limits:
    """What the rig may be given."""

    duty: float = 100.0  # percent, either sign
    sample_time: float = 0.002


FREE = Limits()


def _finish(time: Array, duty: Array, limits: Limits) -> Signal:
    # A drive's duty register holds hundredths of a percent at best.
    return time, np.round(np.clip(duty, -limits.duty, limits.duty), 2)


def _clock(duration: float, limits: Limits) -> Array:
    # Stamps are whole multiples, rounded as they will be written.
    return np.round(np.arange(round(duration / limits.sample_time)) * limits.sample_time, 9)


def _pieces(pieces: Sequence[tuple[float, float, float]], duration: float, limits: Limits) -> Signal:
    """Pieces (length, duty at its start, duty at its end), stretched together to fill the duration."""
    lengths = np.array([p[0] for p in pieces])
    ends = np.cumsum(lengths) * duration / lengths.sum()
    starts = np.concatenate([[0.0], ends[:-1]])
    time = _clock(duration, limits)
    index = np.minimum(np.searchsorted(ends, time + 1e-9, side="right"), len(pieces) - 1)
    share = (time - starts[index]) / (ends - starts)[index]
    first, last = np.array([p[1] for p in pieces]), np.array([p[2] for p in pieces])
    return _finish(time, first[index] + share * (last - first)[index], limits)


def _hold(length: float, duty: float) -> tuple[float, float, float]:
    return length, duty, duty


def paper(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """The paper's protocol: 25, -25, 35, -35 % to steady state over half the time, then a square wave."""
    half = [_hold(duration / 8.0, duty) for duty in (25.0, -25.0, 35.0, -35.0)]
    flips = max(round(duration / 2.0 / rng.uniform(0.5, 1.5)), 2)
    level = rng.uniform(25.0, 35.0)
    square_wave = [_hold(duration / 2.0 / flips, level * (-1.0) ** k) for k in range(flips)]
    return _pieces(half + square_wave, duration, limits)


def square(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """A square wave, its amplitude and half-period drawn anew every few periods."""
    pieces: list[tuple[float, float, float]] = []
    while sum(p[0] for p in pieces) < duration:
        level, length = rng.uniform(15.0, 70.0), rng.uniform(0.3, 2.0)
        pieces += [_hold(length, level), _hold(length, -level)] * int(rng.integers(1, 4))
    return _pieces(pieces, duration, limits)


def rich(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """The protocol that separates what others mix up, 60 s by design.

    A block of reversals; slow ramps through zero; coast-downs from three speeds; plugging at three
    amplitudes; steps at four duties both ways; full turns both ways; the first block again.
    """

    def near(duty: float) -> float:
        return duty * float(rng.uniform(0.9, 1.1))

    side = float(rng.choice([-1.0, 1.0]))
    a, b = side * near(40.0), side * near(25.0)
    block = [_hold(1.2, a), _hold(1.0, -a), _hold(0.7, b), _hold(0.7, -b), _hold(0.6, 0.0)]
    top = side * near(25.0)
    ramps = [(2.4, 0.0, top), (4.8, top, -top), (2.4, -top, 0.0)]
    coasts = []
    for duty, sign in zip((30.0, 55.0, 85.0), (side, -side, side), strict=True):
        coasts += [_hold(1.6, sign * near(duty)), _hold(1.8, 0.0)]
    plugs = []
    for duty, sign in zip((25.0, 45.0, 75.0), (-side, side, -side), strict=True):
        plugs += [_hold(1.2, sign * near(duty)), _hold(0.8, -sign * near(0.7 * duty)), _hold(0.4, 0.0)]
    stairs = [_hold(1.0, sign * near(duty)) for sign in (side, -side) for duty in (20.0, 35.0, 55.0, 80.0)]
    turns = [_hold(4.5, side * near(65.0)), _hold(4.5, -side * near(65.0))]
    return _pieces(block + ramps + coasts + plugs + stairs + turns + block, duration, limits)


def random_steps(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """Steps to random duties of either sign, a sixth of them to exactly zero, held 0.1 to 2 s."""
    pieces: list[tuple[float, float, float]] = []
    while sum(p[0] for p in pieces) < duration:
        duty = 0.0 if rng.uniform() < 1.0 / 6.0 else float(rng.uniform(10.0, 80.0) * rng.choice([-1.0, 1.0]))
        pieces.append(_hold(float(rng.uniform(0.1, 2.0)), duty))
    return _pieces(pieces, duration, limits)


def multisine(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """Some twenty sines between 0.1 and 10 Hz, weaker the faster, phases random, peak drawn."""
    time = _clock(duration, limits)
    lines = np.geomspace(0.1, 10.0, 20) * rng.uniform(0.95, 1.05, 20)
    phases = rng.uniform(0.0, 2.0 * np.pi, 20)
    duty = sum(np.sin(2.0 * np.pi * f * time + p) / np.sqrt(f) for f, p in zip(lines, phases, strict=True))
    return _finish(time, duty * (rng.uniform(50.0, 90.0) / np.abs(duty).max()), limits)


def chirp(duration: float, rng: np.random.Generator, limits: Limits = FREE) -> Signal:
    """A sine that rises from 0.1 to some 10 Hz in equal time per octave, and back."""
    time = _clock(duration, limits)
    top, half = rng.uniform(6.0, 12.0), duration / 2.0
    octaves = np.log(top / 0.1) * (1.0 - np.abs(time / half - 1.0))
    phase = 2.0 * np.pi * limits.sample_time * np.cumsum(0.1 * np.exp(octaves))
    return _finish(time, rng.uniform(35.0, 80.0) * np.sin(phase), limits)


EXCITATIONS: dict[str, Callable[[float, np.random.Generator, Limits], Signal]] = {
    "paper": paper,
    "square": square,
    "rich": rich,
    "random_steps": random_steps,
    "multisine": multisine,
    "chirp": chirp,
}
