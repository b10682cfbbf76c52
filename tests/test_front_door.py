"""`import twin`: what a script or a notebook is offered."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from example_diagnosis import example, model_of, recording_of

import twin
from twin.cli.main import with_flags
from twin.fmi import python_fmu

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "models" / "shipped" / "recording.csv"


def program(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False, cwd=ROOT, encoding="utf-8"
    )


def test_every_name_is_there_and_says_what_it_is_for():
    for name in set(dir(twin)) - {"EFFECTS", "__version__"}:
        offered = getattr(twin, name)
        assert offered.__name__ == name and offered.__doc__
    assert twin.EFFECTS["gravity"].station == "load" and re.fullmatch(r"[0-9.]+", twin.__version__)
    with pytest.raises(AttributeError, match="identfy"):
        getattr(twin, "identfy")  # noqa: B009


def test_every_function_says_what_it_takes_gives_and_refuses():
    for name in dir(twin):
        if name.islower() and not name.startswith("_"):
            text = getattr(twin, name).__doc__
            assert "BadInput" in text or "of `export_fmu`" in text, name


def test_the_import_costs_nothing():
    said = program("-X", "importtime", "-c", "import twin, sys; print(*sorted(m for m in sys.modules if 'twin' in m))")
    own = next(line for line in said.stderr.splitlines() if line.split("|")[-1].strip() == "twin")
    assert int(own.split("|")[0].split(":")[1]) < 50_000  # us
    assert "twin.cli" not in said.stdout and "numpy" not in said.stderr


def test_a_recording_may_be_made_from_arrays():
    time = np.arange(100) * 0.01
    made = twin.Recording("mine", time, np.sin(time), np.cumsum(np.sin(time)), "V", "rad")
    assert "100 in 0.99 s" in str(made) and "voltage in V" in repr(made)
    assert twin.first_structure(made, ["gravity"], ["backlash"]).named == ("gravity",)


def test_a_simulation_is_what_the_fmu_makes_of_the_recording(tmp_path):
    model = model_of("gravity")
    recording = recording_of(model)
    ran = twin.simulate(model, recording)
    fmu = python_fmu.replay(twin.export_fmu(model, tmp_path / "arm.fmu"), recording)
    np.testing.assert_allclose(ran.output, fmu.position_measured, atol=1e-9)
    np.testing.assert_allclose(ran.velocity, fmu.velocity, atol=1e-8)
    assert ran.rmse == pytest.approx(fmu.rmse(recording), rel=1e-6)
    assert ran.residual.shape == recording.time.shape and "RMSE" in str(ran)


def test_a_model_goes_through_its_file(tmp_path):
    model = model_of("gravity")
    again = twin.Model.read(model.write(tmp_path / "m.toml"))
    assert again.values == model.values
    with pytest.raises(twin.BadInput, match="`force=True`"):
        model.write(tmp_path / "m.toml")
    made = twin.design_controller(model, bandwidth=2.0)
    assert twin.Controller.read(made.write(tmp_path / "c.toml")).bandwidth == 2.0
    assert twin.cosimulate(model, made, twin.make_reference("step", made, amplitude=0.1)).peak < 0.2


def test_objects_print_as_tables():
    model, found = model_of("gravity"), example()
    made = twin.design_controller(model, bandwidth=2.0)
    for shown, word in ((model, "gravity_gain"), (found, "explained"), (made, "phase margin"),
                        (recording_of(model), "samples"), (twin.EFFECTS["spring"], "spring_stiffness")):  # fmt: skip
        assert word in str(shown) and len(str(shown).splitlines()) > 2
        page = shown._repr_html_()
        assert word in page and page.count("<tr>") == page.count("</tr>") > 1
    assert found.model is found.after


def test_a_report_is_one_file(tmp_path):
    out = twin.write_report(example(), tmp_path / "report.html")
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(twin.BadInput):
        twin.write_report(example(), out)


USER = """
import twin

recordings = twin.load("recording.csv", rig="rig.toml")
model: twin.Model = twin.identify(recordings, method="joint", horizon=None)
diagnosis = twin.diagnose(recordings, first=model)
verdict: str = diagnosis.verdict
error: float = twin.simulate(diagnosis.model, recordings[0]).rmse
fmu = twin.export_fmu(model, "arm.fmu", target="native", fmi=2)
controller: twin.Controller = twin.design_controller(model, bandwidth=2.0)
print(twin.cosimulate(fmu, controller, reference="step").rms + error, twin.EFFECTS["gravity"].title)
twin.run(recordings, out="out")
"""


def test_a_users_script_passes_a_strict_type_check(tmp_path):
    pytest.importorskip("mypy")
    script = tmp_path / "user.py"
    script.write_text(USER)
    check = ["-m", "mypy", "--strict", "--follow-imports=silent", "--config-file", "pyproject.toml"]
    said = program(*check, str(script))
    assert said.returncode == 0, said.stdout
    script.write_text(USER.replace("bandwidth=2.0", "bandwith=2.0"))
    assert "bandwith" in program(*check, str(script)).stdout


def test_messages_name_arguments_and_the_command_line_turns_them_into_options():
    assert with_flags("overwrite it with `force=True`") == "overwrite it with --force"
    assert with_flags('use `target="native"`, or `method="joint"`') == "use --target native, or --method joint"
    assert with_flags("leave `closed_loop` out, `include` and `effects`") == "leave --closed out, --with and `effects`"


def test_no_message_of_the_library_speaks_of_an_option():
    for path in (ROOT / "twin").rglob("*.py"):
        if path.parts[-2] not in {"cli", "testing"}:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Raise):
                    assert not re.search(r"(?<![\w-])--\w", ast.unparse(node)), (path, node.lineno)
