"""A plain axis under random duty levels, exactly integrated: what the tests of recordings plant faults in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.signal import lfilter


def duty_levels(seed: int, samples: int, step: float, most: float = 60.0) -> np.ndarray:
    """Duty (N,) in percent: levels of either sign, some of them 0, each held for 0.3 to 1.2 s."""
    rng = np.random.default_rng(seed)
    duty = np.zeros(samples)
    start = 0
    while start < samples:
        held = int(rng.uniform(0.3, 1.2) / step) + 1
        duty[start : start + held] = rng.choice([-1.0, 1.0, 1.0, -1.0, 0.0]) * rng.uniform(0.3 * most, most)
        start += held
    return duty


def square_wave(rng: np.random.Generator, samples: int) -> np.ndarray:
    """Duty levels of either sign, at times zero or inside the dead band, each held for 0.2 to 1.5 s at 2
    ms."""
    duty = np.zeros(samples)
    start = 200
    while start < samples:
        held = int(rng.integers(100, 750))
        duty[start : start + held] = rng.choice([-1, 1, 1, 0]) * rng.choice([8.0, 20.0, 35.0, 60.0])
        start += held
    return duty


def dry_axis(
    duty: np.ndarray, dt: float = 0.002, gap: float = 0.0, stop: float = math.inf, inner: int = 10
) -> np.ndarray:
    """Link angle (rad) of an axis with dry friction, dead band, a gap and a hard stop; true stick, plastic
    impacts.

    The link is carried along without mass of its own: it starts at full speed when the motor has crossed
    the gap, which is the hardest case for anyone who takes sudden starts for faults.
    """
    motor = speed = link = 0.0
    angles = []
    for u in duty:
        angles.append(link)
        for _ in range(inner):
            h = dt / inner
            drive = 12.0 * math.copysign(max(abs(u) - 6.0, 0.0), u)
            free = speed + h * (drive - 8.0 * speed)
            slow = h * 60.0
            speed = math.copysign(max(abs(free) - slow, 0.0), free)
            motor += h * speed
            link = min(max(link, motor - gap / 2), motor + gap / 2)
            if abs(link) >= stop:
                link = math.copysign(stop, link)
                if abs(motor) > stop + gap / 2:
                    motor, speed = math.copysign(stop + gap / 2, motor), 0.0
    return np.array(angles)


def axis_speed(duty: np.ndarray, step: float, gain: float = 6.0, friction: float = 5.0) -> np.ndarray:
    """Speed (N,) in rad/s of dv/dt = gain duty - friction v, with the duty held between stamps."""
    decay = np.exp(-friction * step)
    speed = lfilter([0.0, gain / friction * (1.0 - decay)], [1.0, -decay], duty)
    return np.asarray(speed)


def axis_position(duty: np.ndarray, step: float, gain: float = 6.0, friction: float = 5.0) -> np.ndarray:
    """Position (N,) in rad of the same axis, from 0."""
    speed = axis_speed(duty, step, gain, friction)
    moved = gain / friction * duty * step - np.diff(speed, append=speed[-1]) / friction
    return np.concatenate(([0.0], np.cumsum(moved)[:-1]))


def write_log(folder: Path, columns: dict[str, np.ndarray], rig: str, name: str = "log.csv") -> Path:
    """A CSV with the columns, and the rig file beside it."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{x:.10g}" for x in row) for row in rows)]
    (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "rig.toml").write_text(rig)
    return folder / name


def rig_text(output: str, drive: str = 'unit = "%"', time: str = "") -> str:
    """A rig file for columns t, duty and y; `output` holds the keys of [output] beside the column."""
    return f'[time]\ncolumn = "t"\n{time}\n[input]\ncolumn = "duty"\n{drive}\n[output]\ncolumn = "y"\n{output}\n'
