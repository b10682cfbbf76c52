"""`twin check`: gates that a good twin passes and one that lacks a lag does not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from example_diagnosis import excitation, model_of, simulated

from twin.cli.main import main
from twin.fmi import python_fmu
from twin.fmi.fmu_archive import open_fmu
from twin.model import fitted_model

LAGGED = model_of("motor_lag").with_values({"lag_time": 0.02, "viscous_friction": 6.0})
PLAIN = model_of().with_values({"viscous_friction": 6.0})


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of an axis with a lag, its FMU, and the same without the lag."""
    folder = tmp_path_factory.mktemp("shelf")
    time, command = excitation(6.0)
    rows = zip(time, command, simulated(LAGGED, time, command), strict=True)
    (folder / "log.csv").write_text("t,duty,q\n" + "".join(f"{t:.4f},{u:g},{y:.8f}\n" for t, u, y in rows))
    python_fmu.export(LAGGED, folder / "good.fmu")
    python_fmu.export(PLAIN, folder / "without.fmu")
    return folder


@pytest.fixture
def bench(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path in shelf.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def check(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(["check", *arguments])
    return code, *capsys.readouterr()


AHEAD = ["--ahead", "0.1", "--max-nrmse", "0.5"]


def test_the_recommended_gate_sees_a_lag_that_the_free_run_does_not(capsys, bench: Path) -> None:
    for gate in (["--max-nrmse", "5"], AHEAD):
        assert check(capsys, "good.fmu", "--log", "log.csv", *gate)[0] == 0
    assert not (bench / "twin-plots").exists()
    assert check(capsys, "without.fmu", "--log", "log.csv", "--max-nrmse", "5")[0] == 0
    code, out, _ = check(capsys, "without.fmu", "--log", "log.csv", *AHEAD)
    assert code == 1 and "0.1 s ahead: RMSE" in out and "beyond --max-nrmse 0.5" in out
    picture = bench / "twin-plots" / "without-log.csv.png"
    assert str(picture.relative_to(bench)) in out
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and picture.stat().st_size > 10_000


def test_each_gate_judges_its_own_figure(capsys, bench: Path) -> None:
    code, out, _ = check(
        capsys, "without.fmu", "--log", "log.csv", "--max-peak", "1e3", "--json", "-", "--ahead", "0.1"
    )
    assert code == 0
    answer = json.loads(out)
    (fit,) = answer["fit"]
    for gate, figure in (("--max-rmse", "rmse"), ("--max-peak", "peak"), ("--max-nrmse", "nrmse_percent")):
        for far, figures, factor in ((["--ahead", "0.1"], fit["ahead"], 0.999), ([], fit, 1.001)):
            limit = repr(factor * figures[figure])
            given = ["without.fmu", "--log", "log.csv", gate, limit, *far, "--plots", "p"]
            assert check(capsys, *given)[0] == (factor < 1.0)
    assert answer["limits"] == {"peak": 1e3} and answer["holds"] and answer["plots"] == []
    assert 0 < fit["ahead"]["rmse"] < fit["ahead"]["peak"] < fit["peak"]


def test_a_picture_that_cannot_be_written_costs_only_itself(capsys, bench: Path) -> None:
    (bench / "file").write_text("")
    code, out, _ = check(capsys, "without.fmu", "--log", "log.csv", "--max-peak", "1e-9", "--plots", "file")
    assert code == 1 and "name another folder with --plots" in out


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([], "give --max-nrmse"),
        (["--max-peak", "0"], "--max-peak is 0"),
        (["--max-rmse", "nan"], "--max-rmse is nan"),
        (["--max-rmse", "1", "--ahead", "60"], "--ahead is 60 s and log.csv lasts"),
    ],
)
def test_gates_that_hold_nothing_are_refused(capsys, bench: Path, given: list[str], says: str) -> None:
    code, out, err = check(capsys, "good.fmu", "--log", "log.csv", *given)
    assert (code, out) == (2, "") and says in err and err.count("\n") == 1


def test_an_fmu_that_carries_a_recording_is_checked_without_one(capsys, bench: Path) -> None:
    (bench / "lagged.toml").write_text(fitted_model.dumps(LAGGED))
    (bench / "slow.toml").write_text(fitted_model.dumps(LAGGED.with_values({"lag_time": 0.04})))
    given = ["lagged.toml", "--out", "arm.fmu", "--evidence", "log.csv", "--author", "me", "--license", "CC0-1.0"]
    assert main(["export", *given]) == 0
    assert open_fmu(bench / "arm.fmu").description.get("author") == "me"
    assert check(capsys, "arm.fmu")[0] == 0
    assert check(capsys, "arm.fmu", *AHEAD)[0] == 0
    assert main(["update", "arm.fmu", "--from", "slow.toml", "--out", "slow.fmu"]) == 0
    code, out, _ = check(capsys, "slow.fmu")
    assert code == 1 and "beyond the figures that it carries" in out
    assert main(["update", "arm.fmu", "--from", "slow.toml", "--evidence", "log.csv"]) == 0
    assert check(capsys, "arm.fmu")[0] == 0
    code, _, err = check(capsys, "good.fmu")
    assert code == 2 and "carries no recording: give one as --log" in err
    assert check(capsys, "arm.fmu", "--ahead", "0.1")[0] == 2
    assert main(["export", *given[:-4], "--report", "none.html", "--force"]) == 2
