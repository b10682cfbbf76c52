"""A supply that is read with noise: its level is estimated, and what it does in truth stays."""

from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, duty_levels

from twin.io.recording import command_of, load
from twin.io.supply import without_reading_noise

N = 2000


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_a_constant_supply_becomes_constant(seed: int, noise: float) -> None:
    level = without_reading_noise(12.0 + noise * np.random.default_rng(seed).standard_normal(N))
    assert np.std(level) < 0.3 * noise
    assert np.mean(level) == pytest.approx(12.0, abs=0.1 * noise)


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_a_supply_that_sags_with_the_load_is_followed(noise: float) -> None:
    rng = np.random.default_rng(3)
    true = 12.0 - np.repeat(rng.choice([0.0, 0.6, 1.2], N // 100), 100)
    read = true + noise * rng.standard_normal(N)
    assert np.std(without_reading_noise(read) - true) < np.std(read - true)


def test_readings_without_noise_stay() -> None:
    wandering = 12.0 + 0.01 * np.cumsum(np.random.default_rng(5).standard_normal(N))
    assert np.std(without_reading_noise(wandering) - wandering) < 0.003


def test_the_level_is_the_most_likely_one() -> None:
    """Of all levels x the one with the least sum of (y - x)^2 and of squared steps of x, weighed by r / q."""
    rng = np.random.default_rng(7)
    read = 12.0 + np.cumsum(0.05 * rng.standard_normal(N)) + 0.1 * rng.standard_normal(N)
    step = np.diff(read)
    noise = -np.mean(step[1:] * step[:-1])
    weight = noise / (np.mean(step**2) - 2.0 * noise)
    steps = np.diff(np.eye(N), axis=0)
    likeliest = np.linalg.solve(np.eye(N) + weight * steps.T @ steps, read)
    middle = slice(100, -100)
    np.testing.assert_allclose(without_reading_noise(read)[middle], likeliest[middle], atol=1e-6)


def test_what_was_not_read_stays_unknown() -> None:
    read = 12.0 + 0.1 * np.random.default_rng(1).standard_normal(N)
    read[[0, 5, 6, N - 1]] = np.nan
    level = without_reading_noise(read)
    np.testing.assert_array_equal(np.isnan(level), np.isnan(read))
    assert np.nanstd(level) < 0.03


def test_a_noisy_supply_does_not_shake_the_command(tmp_path: Path) -> None:
    step = 0.005
    duty = duty_levels(2, N, step)
    supply = 12.0 + 0.3 * np.random.default_rng(2).standard_normal(N)
    rows = zip(step * np.arange(N), duty, axis_position(duty, step), supply, strict=True)
    (tmp_path / "log.csv").write_text(
        "\n".join(["t,duty,angle,supply", *(",".join(f"{x:.9g}" for x in r) for r in rows)])
    )
    (recording,), _ = load([tmp_path / "log.csv"])
    assert "supply" in recording.optional
    driven = duty != 0.0
    shaken = command_of(recording)[driven] / duty[driven]
    assert np.std(shaken) < 0.3 * 0.3 / 12.0
