"""Commands killed at random moments: what they write is whole or absent, and the next run leaves nothing behind.

    python scripts/kill_study.py --kills 200

Each command runs twice to its end, which says how long it takes and what it writes. Then it is killed again and again,
at a moment drawn over the second half of that time and more often near its end, where it publishes. Every second kill
finds the result of a whole run there, every other one nothing. After it the result is whole, with the bytes in which
both whole runs agree, or it is absent. Of a fleet and a track, which go on later, that holds for each file. At the end
the command runs once more, and the folder holds what one run writes and nothing else.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "models" / "shipped"
#: Seconds of the recording: a whole run has to be short.
LENGTH = 6.0


@dataclass(frozen=True)
class Command:
    """A command, and the name of the file or folder that it writes; some go on where they were stopped."""

    name: str
    arguments: Sequence[str]
    writes: str
    goes_on: bool = False


COMMANDS = (
    Command("identify", ("identify", "log.csv", "--out", "m.toml", "--force"), "m.toml"),
    Command("export", ("export", "model.toml", "--out", "arm.fmu", "--force"), "arm.fmu"),
    Command("update", ("update", "old.fmu", "--from", "model.toml"), "old.fmu"),
    Command("track", ("track", "model.toml", "log.csv", "--out", "history", "--force"), "history", goes_on=True),
    Command("fleet", ("fleet", "fleet.csv", "--out", "all", "--force"), "all", goes_on=True),
    Command("run", ("run", "log.csv", "--out", "out", "--force"), "out"),
)


def prepare(folder: Path) -> None:
    """The inputs of all commands."""
    shutil.copy(SHIPPED / "rig.toml", folder / "rig.toml")
    lines = (SHIPPED / "recording.csv").read_text(encoding="utf-8").splitlines()
    (folder / "log.csv").write_text("\n".join(lines[: 1 + int(LENGTH / 0.002)]) + "\n", encoding="utf-8")
    (folder / "fleet.csv").write_text("axis,file\na,log.csv\n", encoding="utf-8")
    finish(folder, ("identify", "log.csv", "--out", "model.toml"))
    finish(folder, ("export", "model.toml", "--out", "old.fmu"))


def begin(folder: Path, arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """A command, begun in a process group of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "SOURCE_DATE_EPOCH": "0"}
    return subprocess.Popen(
        [sys.executable, "-m", "twin", *arguments, "--quiet"], cwd=folder, env=environment, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def finish(folder: Path, arguments: Sequence[str]) -> None:
    """Run a command to its end. Raises RuntimeError where it fails."""
    process = begin(folder, arguments)
    _, said = process.communicate()
    if process.returncode:
        raise RuntimeError(f"twin {' '.join(arguments)} ended with {process.returncode}: {said.decode()}")


def contents(path: Path) -> Mapping[str, bytes]:
    """What a file or folder holds, by name: an archive by its members."""
    if path.is_dir():
        return {f"{p.relative_to(path)}/{n}": b for p in sorted(path.iterdir()) for n, b in contents(p).items()}
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return {n: archive.read(n) for n in archive.namelist()}
    return {"": path.read_bytes()} if path.exists() else {}


def remove(path: Path) -> None:
    """Take away a result."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def study(command: Command, folder: Path, kills: int, rng: random.Random) -> tuple[int, int, list[str]]:
    """Results that were neither whole nor absent, kills that met the command at work, and what was left behind."""
    finish(folder, command.arguments)
    once = contents(folder / command.writes)
    start = time.perf_counter()
    finish(folder, command.arguments)
    lasts = time.perf_counter() - start
    whole = contents(folder / command.writes)
    same = {n for n in whole if whole[n] == once.get(n)}
    usual, out = {p.name for p in folder.iterdir()}, folder / command.writes
    broken = met = 0
    for i in range(kills):
        # What an update is asked to change has to be there.
        if i % 2 and command.name != "update":
            remove(out)
        process = begin(folder, command.arguments)
        time.sleep(lasts * (1.0 - 0.5 * rng.random() ** 2))
        met += process.poll() is None
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        found = contents(out)
        missing = set() if command.goes_on else set(whole) - set(found)
        wrong = {n for n in found if n not in whole or (n in same and found[n] != whole[n])}
        broken += out.exists() and bool(missing or wrong)
    finish(folder, command.arguments)
    left = sorted({p.name for p in folder.iterdir()} - usual)
    return broken, met, left


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="of all commands together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", default=",".join(c.name for c in COMMANDS))
    given = parser.parse_args()
    chosen = [c for c in COMMANDS if c.name in given.commands.split(",")]
    rng, failed = random.Random(given.seed), False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for command in chosen:
            kills = -(-given.kills // len(chosen))
            broken, met, left = study(command, folder, kills, rng)
            failed |= bool(broken or left)
            print(
                f"{command.name}: {kills} begun, {met} killed at work, {broken} results neither whole nor absent, "
                f"left behind: {', '.join(left) or 'nothing'}",
                flush=True,
            )
    sys.exit(failed)


if __name__ == "__main__":
    main()
