"""Work on many items: the outcomes of a cluster are those of this machine, and a worker that dies costs its item."""

from __future__ import annotations

import signal
import time

import pytest
from batch_work import dies_at_two, fails_at_two, slow_square, square

from twin.batch.execution import WorkerDied, run_local, run_on_cluster
from twin.errors import BadInput


def test_every_item_has_its_own_outcome():
    assert dict(run_local(square, range(7), 2)) == {i: i * i for i in range(7)}


def test_an_item_that_fails_leaves_the_others():
    found = dict(run_local(fails_at_two, range(4), 2))
    assert isinstance(found.pop(2), ValueError) and found == {0: 0, 1: 1, 3: 3}


def test_a_process_that_dies_costs_its_item_only():
    found = dict(run_local(dies_at_two, range(5), 2))
    assert isinstance(found.pop(2), WorkerDied) and found == {i: i for i in (0, 1, 3, 4)}


def test_processes_end_where_their_caller_stops_early():
    began = time.monotonic()
    outcomes = run_local(slow_square, range(400), 2)
    next(outcomes)
    outcomes.close()
    assert time.monotonic() - began < 50.0


def test_a_cluster_whose_worker_dies_gives_what_this_machine_gives(cluster):
    items = list(range(12))
    found = {}
    for i, outcome in run_on_cluster(slow_square, items, cluster.address):
        found[i] = outcome
        if len(found) == 2:
            cluster.workers[0].send_signal(signal.SIGKILL)
    assert found == dict(run_local(slow_square, items, 2))


def test_a_scheduler_that_is_not_there_is_said_in_one_line():
    pytest.importorskip("distributed")
    with pytest.raises(BadInput, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9 .*correct the address"):
        list(run_on_cluster(square, [1], "tcp://127.0.0.1:9"))
