"""Damage files of every kind that the tool reads, and see what becomes of them.

    python scripts/fuzz.py [--mutations N] [--seed S] [--kinds csv,mat,...]

A file of each kind is written, damaged in a few places at random (bytes flipped, cut out, repeated or put in, numbers
replaced by extreme ones, the end cut off) and read. It must be read or refused by BadInput in one line; anything else
is a finding, printed with the seed that makes it again. Exit code 1 where there are findings.
"""

import argparse
import gzip
import json
import random
import sqlite3
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import scipy.io

from twin.control import controller
from twin.control.design import design
from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.io.recording import load
from twin.io.rig_file import read_rig
from twin.model import fitted_model
from twin.model.stepper import Structure

TIME = np.arange(120) * 0.01
DUTY = np.where(TIME % 0.5 < 0.25, 40.0, -20.0)
ANGLE = np.round(np.sin(3 * TIME) + 0.2 * TIME, 4)
COLUMNS = {"t": TIME, "duty": DUTY, "pos": ANGLE}
RIG = """[time]
column = "t"
[input]
column = "duty"
unit = "%"
[output]
column = "pos"
unit = "rad"
location = "link"
[known]
inertia = 0.01
[structure]
effects = ["gravity"]
"""
CLOCKED = RIG.replace('[time]\ncolumn = "t"\n', "")
TOKENS = [
    b"\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"nan", b"-inf", b"1e308", b"1e-320", b"9" * 400, b'"', b";", b",",
    b"\n", b"\r", b"\t", b"[", b"]", b"{", b"}", b"=", b"\x1b[31m", b"\xe2\x80\xae", b"../", b"#", b"'''", b"0x", b"-",
]  # fmt: skip


def _csv(mark: str, comma: bool) -> bytes:
    rows = [mark.join(COLUMNS), *(mark.join(f"{v:g}" for v in row) for row in zip(*COLUMNS.values(), strict=True))]
    text = "\n".join(rows) + "\n"
    return (text.replace(".", ",") if comma else text).encode()


def _sysid() -> bytes:
    rows = np.column_stack([TIME, DUTY, ANGLE, ANGLE]).tolist()
    document = {"slow-forward": rows, "sysid": True, "test": "Simple", "units": "Radians", "unitsPerRotation": 6.28}
    return json.dumps(document).encode()


def _wpilog() -> bytes:
    def record(entry: int, stamp: int, payload: bytes) -> bytes:
        return bytes([0x70, entry, len(payload)]) + stamp.to_bytes(8, "little") + payload

    log = b"WPILOG\x00\x01" + bytes(4)
    for entry, name in ((1, "duty"), (2, "pos")):
        texts = b"".join(struct.pack("<I", len(t)) + t.encode() for t in (name, "double", ""))
        log += record(0, 0, b"\0" + struct.pack("<I", entry) + texts)
    for t, u, y in zip(TIME, DUTY, ANGLE, strict=True):
        log += record(1, round(1e6 * t), struct.pack("<d", u)) + record(2, round(1e6 * t), struct.pack("<d", y))
    return log


def _made(folder: Path, name: str, write: Callable[[Path], object]) -> bytes:
    write(folder / name)
    return (folder / name).read_bytes()


def _parquet(path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(COLUMNS), path)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in COLUMNS.items():
            file.create_dataset(f"log/{name}", data=values, compression="gzip")


def _mdf4(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(v, TIME, name=n, unit="") for n, v in COLUMNS.items() if n != "t"])
        file.save(path)


def _mcap(path: Path) -> None:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        plain = writer.register_channel("/state", "json", 0)
        packed = writer.register_channel("/duty", "cdr", schema)
        for t, u, y in zip(TIME, DUTY, ANGLE, strict=True):
            stamp = round(1e9 * t)
            writer.add_message(plain, stamp, json.dumps({"pos": y}).encode(), stamp)
            writer.add_message(packed, stamp, b"\0\1\0\0" + struct.pack("<d", u), stamp)
        writer.finish()


def _db3(path: Path) -> None:
    base = sqlite3.connect(path)
    with base:
        base.execute("create table topics (id integer, name text, type text, serialization_format text)")
        base.execute("create table messages (id integer, topic_id integer, timestamp integer, data blob)")
        for k, (topic, values) in enumerate({"/duty": DUTY, "/pos": ANGLE}.items()):
            base.execute("insert into topics values (?, ?, 'std_msgs/msg/Float64', 'cdr')", (k, topic))
            rows = [(k, round(1e9 * t), b"\0\1\0\0" + struct.pack("<d", v)) for t, v in zip(TIME, values, strict=True)]
            base.executemany("insert into messages values (1, ?, ?, ?)", rows)
    base.close()


def _model() -> fitted_model.Model:
    structure = Structure.of([*BASE, "gravity"])
    values = {p.name: p.start for p in structure.parameters} | {"input_gain": 0.3, "viscous_friction": 1.5}
    return fitted_model.Model(structure, values, resolution=1e-3, torque_density=1e-4)


def sound_files(folder: Path) -> dict[str, tuple[str, bytes, str]]:
    """A sound file of each kind: its name, its bytes and the rig file beside it; the folder is one to write into."""
    text = _csv(",", False)
    several = {"log": COLUMNS, "gain": 3.0, "name": "x"}
    sysid_rig = RIG.replace('"t"', '"time"').replace('"duty"', '"voltage"').replace('"pos"', '"position"')

    def mat(name: str, content: Mapping[str, object], packed: bool) -> bytes:
        return _made(folder, name, lambda path: scipy.io.savemat(path, content, do_compression=packed))

    files = {
        "csv": ("log.csv", text, RIG),
        "csv;": ("log.csv", _csv(";", True), RIG),
        "utf16": ("log.csv", text.decode().encode("utf-16"), RIG),
        "gzip": ("log.csv.gz", gzip.compress(text), RIG),
        "sysid": ("log.json", _sysid(), sysid_rig),
        "wpilog": ("log.wpilog", _wpilog(), CLOCKED),
        "mat": ("log.mat", mat("a.mat", COLUMNS, False), RIG),
        "mat struct": ("log.mat", mat("b.mat", several, False), RIG),
        "mat packed": ("log.mat", mat("c.mat", several, True), RIG),
        "mat v7.3": ("log.mat", _made(folder, "d.mat", _hdf5), RIG),
        "parquet": ("log.parquet", _made(folder, "e.parquet", _parquet), RIG),
        "mdf4": ("log.mf4", _made(folder, "f.mf4", _mdf4), CLOCKED),
        "mcap": ("log.mcap", _made(folder, "g.mcap", _mcap), CLOCKED),
        "rosbag": ("log.db3", _made(folder, "h.db3", _db3), CLOCKED),
        "rig": ("rig.toml", RIG.encode(), ""),
        "manifest": ("m.csv", b"file,role,start,payload_mass [g]\nlog.csv,train,0,300\nlog.csv,holdout,0.1,\n", RIG),
        "model": ("model.toml", fitted_model.dumps(_model()).encode(), ""),
        "controller": ("controller.toml", controller.dumps(design(_model())).encode(), ""),
    }
    return files


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The bytes with one to four faults."""
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data) + 1)
        size = min(rng.choice((1, 1, 2, 4, 8, 64, 512)), len(data) - at)
        fault = rng.randrange(7)
        if fault == 0 and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
        elif fault == 1:
            data = data[:at] + data[at + size :]
        elif fault == 2:
            data = data[:at] + data[at : at + size] * rng.randint(2, 5) + data[at + size :]
        elif fault == 3:
            token = rng.choice(TOKENS)
            data = data[:at] + token + data[at + rng.choice((0, len(token))) :]
        elif fault == 4:
            number = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, rng.getrandbits(32)))
            data = data[:at] + number.to_bytes(8, rng.choice(("little", "big")))[: max(size, 1)] + data[at + size :]
        elif fault == 5:
            data = data[:at] + rng.randbytes(size) + data[at + size :]
        elif rng.random() < 0.3:
            data = data[:at]
    return data


def outcome(folder: Path, kind: str, name: str, data: bytes) -> str:
    """What becomes of a file in a folder with the rig file and `log.csv` beside it: "read", "refused", or a finding."""
    path = folder / name
    path.write_bytes(data)
    try:
        if kind == "rig":
            read_rig(path)
        elif kind == "model":
            fitted_model.read(path)
        elif kind == "controller":
            controller.read(path)
        else:
            for recording in load([path])[0]:
                if not (np.diff(recording.time) > 0).all() or not np.isfinite(recording.input).all():
                    return "time that does not increase, or an input that is not finite"
    except BadInput as error:
        return "refused" if str(error) and "\n" not in str(error) else f"a message of several lines: {error}"
    except BaseException as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"
    return "read"


def attempts(folder: Path, mutations: int, seed: int, kinds: tuple[str, ...] = ()) -> Iterator[tuple[str, int, str]]:
    """Kind, seed and outcome of each damaged file, kind after kind in turn; first of the sound files, with seed -1."""
    files = {k: v for k, v in sound_files(folder).items() if not kinds or k in kinds}
    places = {}
    for number, (kind, (_, _, rig)) in enumerate(files.items()):
        places[kind] = folder / f"{number}"
        places[kind].mkdir()
        (places[kind] / "log.csv").write_bytes(_csv(",", False))
        if rig:
            (places[kind] / "rig.toml").write_text(rig, encoding="utf-8")
    for kind, (name, data, _) in files.items():
        yield kind, -1, outcome(places[kind], kind, name, data)
    for number in range(mutations):
        kind = list(files)[number % len(files)]
        name, data, _ = files[kind]
        rng = random.Random(f"{kind} {seed + number}")
        yield kind, seed + number, outcome(places[kind], kind, name, damaged(data, rng))


def main() -> int:
    """Count the outcomes by kind, print the findings."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--mutations", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default="", help="such as csv,mat; all without")
    args = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    findings = 0
    with tempfile.TemporaryDirectory() as folder:
        kinds = tuple(filter(None, args.kinds.split(",")))
        for kind, seed, became in attempts(Path(folder), args.mutations, args.seed, kinds):
            counts[kind, became if became in ("read", "refused") else "finding"] += 1
            if became not in ("read", "refused"):
                findings += 1
                print(f"{kind}, seed {seed}: {became}", flush=True)
    for kind in dict.fromkeys(kind for kind, _ in counts):
        print(f"{kind:12s}", *(f"{counts[kind, what]:6d} {what}" for what in ("read", "refused", "finding")))
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
