"""The kernel's text: written once."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

from twin import kernel
from twin.axis import Structure


def test_threads_that_need_a_kernel_at_once_wait_for_the_first(monkeypatch, tmp_path):
    at_once = threading.Barrier(4)
    writing = []

    def text(offered):
        writing.append(threading.get_ident())
        time.sleep(0.2)  # long enough for the others to come by
        return f"said = {len(writing)}\n"

    monkeypatch.setenv("TWIN_CACHE", str(tmp_path))
    monkeypatch.setattr(kernel, "kernel_text", text)

    def ask(_):
        at_once.wait()
        return kernel.compiled(Structure.of(("inertia", "gravity")))

    with ThreadPoolExecutor(4) as pool:
        loaded = list(pool.map(ask, range(4)))
    assert len(writing) == 1
    assert all(module is loaded[0] for module in loaded) and loaded[0].said == 1
