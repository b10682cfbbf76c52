"""`twin track`: fits that were made before are read, the answer stands in three places, a wrong limit is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_diagnosis import model_of

from twin.cli.main import main
from twin.model.fitted_model import dumps
from twin.report.origin import file_digest


@pytest.fixture
def history(tmp_path: Path) -> Path:
    """A model and five logs with their fits, of which the last two are of an axis with more friction."""
    rng = np.random.default_rng(21)
    model = replace(model_of(), notes={})
    (tmp_path / "model.toml").write_text(dumps(model))
    (tmp_path / "logs").mkdir()
    (tmp_path / "out" / "fits").mkdir(parents=True)
    for i in range(5):
        log = tmp_path / "logs" / f"day{i}.csv"
        log.write_text(f"t,duty,counts\n0,0,{i}\n")
        truth = [model.values[n] * (1.4 if n == "viscous_friction" and i > 2 else 1.0) for n in model.fitted]
        drawn = rng.multivariate_normal(truth, model.covariance)
        bounds = [model.parameter(n) for n in model.fitted]
        values = np.clip(drawn, [p.lower for p in bounds], [p.upper for p in bounds]).tolist()
        fit = model.with_values(dict(zip(model.fitted, values, strict=True)))
        (tmp_path / "out" / "fits" / f"{file_digest(log)}.toml").write_text(dumps(fit))
    return tmp_path


def test_a_folder_of_logs_is_followed_with_the_fits_that_are_there(history: Path, capsys) -> None:
    arguments = ["track", str(history / "model.toml"), str(history / "logs"), "--out", str(history / "out")]
    assert main([*arguments, "--quiet", "--json", str(history / "answer.json")]) == 0
    answer = json.loads((history / "answer.json").read_text())
    (alarm,) = answer["alarms"]
    assert alarm["since"] == "day3.csv"
    assert [c["parameter"] for c in alarm["changes"]] == ["viscous_friction"]
    assert json.loads((history / "out" / "track.json").read_text()) == answer
    assert "Viscous friction" in (history / "out" / "track.html").read_text()
    assert main(arguments) == 0
    assert "the viscous friction grew" in capsys.readouterr().out.lower()


@pytest.mark.parametrize("limit", ["viscous_friction", "viscous_friction=much", "friction=2"])
def test_a_limit_that_names_nothing_is_refused(history: Path, capsys, limit: str) -> None:
    assert main(["track", str(history / "model.toml"), str(history / "logs"), "--limit", limit]) == 2
    assert f"--limit {limit}" in capsys.readouterr().err


def test_a_recording_that_is_not_there_is_refused(history: Path, capsys) -> None:
    assert main(["track", str(history / "model.toml"), str(history / "none.csv")]) == 2
    assert "none.csv" in capsys.readouterr().err
