"""Other people's readers may print, raise or crash: the process survives, and one line says so."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from twin.errors import BadInput
from twin.io.tables.library import call_in_child, call_library

LOG = Path("log.mf4")


def noisy_failure() -> None:
    print("a traceback of its own")
    print("and another", file=sys.stderr)
    raise KeyError("block at 0x12")


@pytest.mark.parametrize("call", [call_library, call_in_child])
def test_what_a_reader_raises_is_one_line_and_what_it_prints_is_none(call, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BadInput, match=r"^log\.mf4: cannot be read as MDF4 .*block at 0x12"):
        call(LOG, "MDF4", noisy_failure)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked here")
def test_a_reader_that_crashes_ends_only_its_own_process(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BadInput, match="breaks down"):
        call_in_child(LOG, "MDF4", os.abort)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("call", [call_library, call_in_child])
def test_what_a_reader_returns_comes_back(call) -> None:
    values = np.arange(100_000.0)
    np.testing.assert_array_equal(call(LOG, "MDF4", lambda: {"x": values})["x"], values)
