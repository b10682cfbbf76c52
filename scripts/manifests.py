"""Write manifests of the four real data sets: what trains, what is held out, what is known of each.

    python scripts/manifests.py DATA_DIR OUT_DIR

The splits are those of the README beside each data set.
"""

import argparse
import csv
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

Row = Mapping[str, object]


def jga25(folder: Path) -> list[Row]:
    """Sorted by the commanded PWM, every second file is held out."""

    def command(path: Path) -> float:
        with path.open(encoding="utf-8") as stream:
            values = [float(row["Commanded_PWM"]) - 1 for row in csv.DictReader(stream)]
        return max(values, key=abs)

    paths = sorted((folder / "runs").glob("*.csv"), key=command)
    return [{"file": path, "role": "holdout" if k % 2 else "train"} for k, path in enumerate(paths)]


def _switched_off(path: Path) -> str:
    """The moment from which on the drive is off and the log says nothing of what acts on the motor, or nothing."""
    with path.open(encoding="utf-8") as stream:
        return next((row["t_s"] for row in csv.DictReader(stream) if float(row["torque_enable"]) == 0.0), "")


def sts3215(folder: Path, brutal: bool) -> list[Row]:
    """Other repetitions, masses and gains are held out than train; `brutal` runs are a set of their own.

    A run ends where the drive is switched off: with open terminals the motor no longer brakes itself, which no duty
    describes.
    """
    splits = {
        ("1", "0.535", "1.168"): ("train", {4, 8, 16, 32}),
        ("2", "0.741", "0.969"): ("holdout", {12, 24}),
    }
    rows: list[Row] = []
    with (folder / "manifest.csv").open(encoding="utf-8") as stream:
        for run in csv.DictReader(stream):
            for (rep, *masses), (role, gains) in splits.items():
                mass = f"{float(run['mass_kg']):.3f}"
                chosen = run["rep"] == rep and mass in masses and int(run["kp"]) in gains
                if chosen and (run["trajectory"] == "brutal") == brutal:
                    rows.append(
                        {
                            "file": folder / "runs" / run["file"],
                            "role": role,
                            "end": _switched_off(folder / "runs" / run["file"]),
                            "payload_mass": run["mass_kg"],
                            "arm_length": run["length_m"],
                            "arm_mass": run["arm_mass_kg"],
                            "kp": run["kp"],
                            "trajectory": run["trajectory"],
                        }
                    )
    return rows


def emps(folder: Path) -> list[Row]:
    """The estimation set trains, the one with force pulses is held out."""
    return [
        {"file": folder / "DATA_EMPS.mat", "role": "train"},
        {"file": folder / "DATA_EMPS_PULSES.mat", "role": "holdout"},
    ]


def ak80(folder: Path) -> list[Row]:
    """Windows before the disturbances by hand that the log does not hold."""
    windows = [
        ("ddp", "train", 0.0, 3.0),
        ("ddp", "train", 3.0, 6.0),
        ("ilqr", "train", 0.0, 3.0),
        ("sac", "train", 0.0, 3.0),
        ("direct_collocation", "holdout", 0.0, 3.5),
        ("energy_shaping", "holdout", 0.0, 3.0),
    ]
    return [
        {"file": folder / f"{name}_measured.csv", "role": role, "start": start, "end": end}
        for name, role, start, end in windows
    ]


def write(path: Path, rows: Iterable[Row]) -> None:
    """One manifest; paths are written relative to it."""
    rows = list(rows)
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        for row in rows:
            writer.writerow({**row, "file": os.path.relpath(str(row["file"]), path.parent)})


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder that holds jga25_pwm_steps, sts3215_pendulum, ...")
    parser.add_argument("out", type=Path, help="folder for the manifests")
    given = parser.parse_args()
    data = given.data.resolve()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    manifests = {
        "jga25": jga25(data / "jga25_pwm_steps"),
        "sts3215": sts3215(data / "sts3215_pendulum", brutal=False),
        "sts3215_brutal": sts3215(data / "sts3215_pendulum", brutal=True),
        "emps": emps(data / "emps"),
        "ak80": ak80(data / "ak80_pendulum"),
    }
    for name, rows in manifests.items():
        write(out / f"{name}.csv", rows)
        print(f"{out / name}.csv: {len(rows)} recordings")


if __name__ == "__main__":
    main()
