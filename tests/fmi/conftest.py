"""Native FMUs that several files try: each is compiled once in a run of the tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from native_axis import model_of, without_zig

from twin.fmi.native_fmu import export_native
from twin.model.stepper import Structure


@pytest.fixture(scope="session")
def native_fmu_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Structure, int], Path]:
    """The FMU of an axis with these effects for FMI 2 or 3, for this machine only; it is to be read, not changed."""
    folder = tmp_path_factory.mktemp("native")
    made: dict[tuple[Structure, int], Path] = {}

    def fmu_of(structure: Structure, fmi: int) -> Path:
        if (structure, fmi) not in made:
            with without_zig():
                fmu = export_native(model_of(structure), folder / f"axis{len(made)}.fmu", fmi)
            made[structure, fmi] = fmu
        return made[structure, fmi]

    return fmu_of
