"""FMUs of both kinds, loaded and freed by the hundred: the process that ran them ends as it should."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from example_diagnosis import model_of

from twin.fmi import native_fmu, python_fmu

ROOT = Path(__file__).resolve().parents[2]
CHECKER = "libc_malloc_debug.so.0"
#: Loads each FMU so often, steps and frees it.
SCRIPT = """
import sys; from pathlib import Path
import numpy as np
from twin.fmi.fmu_archive import open_fmu
from twin.fmi.fmu_instance import running
fmus = [open_fmu(Path(name)) for name in sys.argv[2:]]
for i in range(int(sys.argv[1])):
    for fmu in fmus:
        (drive,) = [n.get("name") for n in fmu.description.iter() if n.get("causality") == "input"]
        with running(fmu, [drive], ["position"]) as instance:
            instance.start({})
            assert np.isfinite([instance.step(0.01 * k, 0.01, [40.0])[0] for k in range(3)]).all()
"""
#: What C++ frees is filled with ones and never used again. A count of owners that lies there then reads one, so that
#: who counts down in freed memory frees what is not there.
POISON = """
#include <stddef.h>
void _ZdlPvm(void *block, size_t size) { for (size_t i = 0; i < size / 4; i++) ((int *)block)[i] = 1; }
"""

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the checkers are those of Linux")


def run(count: int, fmus: list[Path], **environment: str) -> subprocess.CompletedProcess[str]:
    told = [sys.executable, "-c", SCRIPT, str(count), *map(str, fmus)]
    more = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(told, env=more, capture_output=True, text=True, check=False)


def test_two_hundred_under_the_malloc_checker(tmp_path: Path, no_zig: None) -> None:
    model = model_of("gravity")
    kinds = [python_fmu.export(model, tmp_path / "python.fmu")]
    kinds += [native_fmu.export_native(model, tmp_path / f"native{fmi}.fmu", fmi) for fmi in (2, 3)]
    done = run(67, kinds, LD_PRELOAD=CHECKER, GLIBC_TUNABLES="glibc.malloc.check=3", MALLOC_PERTURB_="165")
    assert done.returncode == 0 and "cannot be preloaded" not in done.stderr, done.stderr


def test_a_foreign_slave_of_pythonfmu_drops_its_state_once(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    told = [sys.executable, "-m", "pythonfmu", "build", "-f", str(ROOT / "scripts" / "plain_motor.py")]
    subprocess.run(told, cwd=tmp_path, check=True, capture_output=True)
    (tmp_path / "poison.c").write_text(POISON)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "poison.so", "poison.c"], cwd=tmp_path, check=True)
    done = run(1, [tmp_path / "PlainMotor.fmu"], LD_PRELOAD=str(tmp_path / "poison.so"))
    assert done.returncode == 0, done.stderr
