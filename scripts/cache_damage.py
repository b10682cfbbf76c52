"""Flip bits in the kernel cache: does any of them reach the user?

    python scripts/cache_damage.py [--flips 200] [--seed 0]

A small function is compiled into a cache of its own. Each time one bit of one of its files is another. Then the
function is loaded again and called. Counted are wrong numbers, errors, and damaged files that were taken.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

TEXT = """from numba import njit
from twin.simulation.compile_cache import kept

@kept
@njit
def sums(x):
    total = 0.0
    for value in x:
        total += value * value
    return total
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flips", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, values = np.random.default_rng(args.seed), np.arange(10.0)
    wrong = errors = taken = 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TWIN_CACHE"] = folder
        from twin.simulation.compile_cache import module_of

        def call() -> tuple[float, bool]:
            module = module_of("damaged", lambda: TEXT)
            return module.sums(values), bool(module.sums.stats.cache_hits)

        expected, _ = call()
        for _ in range(args.flips):
            path = rng.choice(sorted(p for p in Path(folder).rglob("damaged.*")))
            whole = bytearray(path.read_bytes())
            whole[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
            path.write_bytes(whole)
            try:
                got, read = call()
            except Exception as error:
                errors += 1
                print(f"{path.name}: {error}")
                continue
            wrong += got != expected
            taken += read and path.suffix == ".nbc"
    print(f"{args.flips} flipped bits: {wrong} wrong numbers, {errors} errors, {taken} damaged files taken")
    return 1 if wrong or errors or taken else 0


if __name__ == "__main__":
    sys.exit(main())
