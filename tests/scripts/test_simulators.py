"""What holds of every simulator of rigs: the effects that it knows, their sizes, its seeds, its rigs' own numbers."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from concealed import Concealed, Trip, visibility
from excitations import EXCITATIONS, FREE
from simulators import SIMULATORS

from twin.effects.catalogue import CANDIDATES

DURATION = 12.0
#: Each simulator with each of its effects; the worn rigs have those of another.
EACH = [
    (name, effect)
    for name, module in SIMULATORS.items()
    for effect in (*module.VOCABULARY, *module.OUTSIDE)
    if name != "worn"
]
#: The simulators whose runs are quick enough for longer ones, of which more is asked.
QUICK = ("gearmotor", "textbook")
every = pytest.mark.parametrize("module", SIMULATORS.values(), ids=SIMULATORS)


def recorded(module: Any, effects: Sequence[Concealed], seed: int | None = 5) -> Any:
    """A run of the rig that seed 4 draws."""
    rng = np.random.default_rng(4)
    rig = module.draw_rig(rng)
    return module.simulate(rig, effects, *EXCITATIONS["rich"](DURATION, rng, FREE), seed)


@cache
def plain_run(name: str) -> Any:
    """That rig's motion with nothing concealed."""
    return recorded(SIMULATORS[name], [])


@every
def test_ids(module: Any) -> None:
    assert list(module.VOCABULARY) == sorted(CANDIDATES)
    assert module.OUTSIDE and all(i.startswith("other_") for i in module.OUTSIDE)


@every
def test_unknown_and_doubled(module: Any) -> None:
    rng = np.random.default_rng(0)
    rig = module.draw_rig(rng)
    unknown = rf"no effect 'magic'; there are constant_offset.*{module.OUTSIDE[-1]}"
    with pytest.raises(ValueError, match=unknown):
        module.draw_effect(rng, "magic", rig, 0.1)
    with pytest.raises(ValueError, match=unknown):
        recorded(module, [Concealed("magic", {})])
    twice = module.draw_effect(rng, "gravity", rig, 0.1)
    with pytest.raises(ValueError, match="gravity is there twice"):
        recorded(module, [twice, twice])


@pytest.mark.parametrize(("name", "effect"), [(n, e) for n, e in EACH if n not in QUICK])
def test_size(name: str, effect: str) -> None:
    """None at 0; plain to see at 0.3, of three draws, as a stop may lie where the axis does not go."""
    module = SIMULATORS[name]
    rng = np.random.default_rng(4)
    rig = module.draw_rig(rng)
    time, duty = EXCITATIONS["rich"](DURATION, rng, FREE)

    def drawn(size: float, seed: int) -> Any:
        one, same = (module.draw_effect(np.random.default_rng(seed), effect, rig, size, DURATION) for _ in range(2))
        assert one == same
        return one

    def played(*effects: Concealed) -> Any:
        return module.simulate(rig, effects, time, duty, 5)

    none = drawn(0.0, 8)
    plain, with_none = played(none.carrier) if none.carrier else plain_run(name), played(none)
    apart = with_none.position - plain.position
    # Where gravity acts a rig may begin by hanging, and rounds other numbers on its way.
    allowed = 1e-9 if apart[0] == 0.0 else 2.0 * np.pi / rig.counts_per_revolution
    assert np.abs(apart - apart[0]).max() < allowed

    def seen(changed: Any) -> bool:
        assert np.all(np.isfinite(changed.position))
        assert np.abs(changed.velocity).max() < 3.0 * np.abs(plain.velocity).max()
        return bool(np.ptp(changed.counts - with_none.counts) > 10)

    assert any(seen(played(drawn(0.3, seed))) for seed in (8, 9, 10))


@pytest.mark.parametrize(("name", "effect"), [(n, e) for n, e in EACH if n in QUICK])
def test_size_where_a_run_is_quick(name: str, effect: str) -> None:
    """Nothing at all at 0, and three times what noise changes at 0.3, the first time that one is drawn."""
    module = SIMULATORS[name]
    rng = np.random.default_rng(4)
    rig = module.draw_rig(rng)
    time, duty = EXCITATIONS["rich"](20.0, rng, FREE)
    none, large = (module.draw_effect(np.random.default_rng(8), effect, rig, size, 20.0) for size in (0.0, 0.3))
    plain, with_none, changed = (module.simulate(rig, e, time, duty, 5) for e in ([], [none], [large]))
    assert np.array_equal(plain.position, with_none.position) and np.array_equal(plain.counts, with_none.counts)
    assert visibility(Trip(module.simulate, time, duty, 5), rig, [large]) > 3.0
    assert np.all(np.isfinite(changed.position))
    assert np.abs(changed.velocity).max() < 3.0 * np.abs(plain.velocity).max()


@every
def test_seed_draws_the_noise_and_nothing_else(module: Any) -> None:
    one, again, other = (recorded(module, [], seed) for seed in (1, 1, 2))
    assert np.array_equal(one.counts, again.counts) and not np.array_equal(one.counts, other.counts)
    quiet, silent = (recorded(module, [], None) for _ in range(2))
    assert np.array_equal(quiet.position, silent.position) and not np.array_equal(quiet.counts, one.counts)


@every
def test_own_numbers_can_be_changed(module: Any) -> None:
    rig = module.draw_rig(np.random.default_rng(4))
    moved = rig.with_(**{name: 0.9 * value for name, (value, _) in rig.own.items()})
    assert all(getattr(moved, name) == pytest.approx(0.9 * value) for name, (value, _) in rig.own.items())
    assert all(value < most for value, most in rig.own.values())
    assert moved.model_values().keys() == rig.model_values().keys()


def test_without_the_extra_the_rigs_in_mujoco_say_its_name(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "mujoco_rig")
    with pytest.raises(SystemExit, match="need the extra mujoco"):
        importlib.import_module("mujoco_rig")


def test_worn_rigs_have_three_small_departures_that_move_them() -> None:
    """Without them they are rigs of the simulator that they come from."""
    module, plain = SIMULATORS["worn"], SIMULATORS["gearmotor"]
    rng = np.random.default_rng(4)
    rig = module.draw_rig(rng)
    sizes = [size for name, size in rig.truths().items() if name.startswith(module.DEPARTS)]
    assert len(sizes) == 3 and all(0.02 <= size <= 0.05 for size in sizes)
    time, duty = EXCITATIONS["rich"](8.0, rng, FREE)
    worn, without = module.simulate(rig, [], time, duty, 5), plain.simulate(rig, [], time, duty, 5)
    assert np.array_equal(module.simulate(rig.with_(departures=()), [], time, duty, 5).counts, without.counts)
    assert np.ptp(worn.counts - without.counts) > 10


def test_a_departure_of_the_kind_of_a_concealed_effect_leaves_its_place() -> None:
    module = SIMULATORS["worn"]
    rng = np.random.default_rng(4)
    rig = module.draw_rig(rng)
    time, duty = EXCITATIONS["rich"](4.0, rng, FREE)
    same = module.draw_effect(rng, rig.departures[0].effect.id, rig, 0.1)
    others = rig.with_(departures=rig.departures[1:])
    one, other = (module.simulate(r, [same], time, duty, 5) for r in (rig, others))
    assert np.array_equal(one.counts, other.counts)
