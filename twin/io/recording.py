"""A recording of one axis, measured or simulated alike, and how to load it from what lies on disk."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.display.table import DisplayTable, Tabular
from twin.errors import BadInput
from twin.io import thinning
from twin.io.cleaning import Raw, clean_optional, clean_output, hold
from twin.io.clock import (
    CONVERTER_STEP,
    LONGEST_STEP,
    bridge_jumps,
    check_unit,
    count_from_first,
    spread_bursts,
    undo_counter_wraps,
)
from twin.io.edges import counted
from twin.io.faults import Fault, find_gaps
from twin.io.joined import join_files
from twin.io.manifest import Entry, entries_of, expand
from twin.io.preflight.checks import at_its_limit, coarse, examine, reversed_alone, slow_sensor, thinned
from twin.io.preflight.finding import Finding, Severity
from twin.io.preflight.response import Signals
from twin.io.preflight.standing import Columns, contradicted
from twin.io.rig_file import Clock, Column, Direction, LoopRig, Rig, guess_time, read_rig
from twin.io.rig_guess import Guess, guess
from twin.io.supply import without_reading_noise
from twin.io.tables.formats import open_tables
from twin.io.tables.table import Table, listing

__all__ = [
    "Fault", "FloatArray", "Loop", "Recording", "Rig", "command_of", "driven", "known_quantities", "load", "read_rig",
]  # fmt: skip

FloatArray = npt.NDArray[np.float64]

_LEAST_SAMPLES = 50
#: A converted reading or input beyond this is no number of an axis, but the mark of a fault or an overflow.
_LARGEST = 1e12
#: A duty, %, and a pause, s, beyond which a unit is wrong or a cell is bad.
_FULL, _PAUSE = 1e4, 1e5
#: So many bytes of files tell what their columns are.
_GUESSED_FROM = 2**26
#: So many recordings that move tell which column is a speed.
_WITNESSES = 3
_NOMINAL = "supply_nominal"
#: What a radian at the gears makes of each unit of the output: the radius of a usual pinion, m, and an encoder of 4096.
_LEVERS = {"rad": 1.0, "m": 0.02, "kcount": 4.096 / (2 * math.pi)}
_NO_HEADER = " (the file has no header: a column is named by its number, from 1)"
#: Known quantities that mean something to twin; others may be there for the gains of a loop.
MEANT = ("inertia", "mass", _NOMINAL, "payload_mass", "arm_length", "arm_mass", "payload_inertia", "payload_moment")
_INPUT_WORDS = {"%": "duty", "V": "voltage", "A": "current", "N*m": "torque", "N": "force"}


@dataclass(frozen=True)
class Loop:
    """The rig's own position loop, in the units of the recording.

    "P": input = gain * (reference - output). "P-P": input = kv * (kp * (reference - output) - velocity).
    """

    law: str  # "P" | "P-P"
    gain: float | None = None  # input_unit per output_unit
    kp: float | None = None  # 1/s
    kv: float | None = None  # input_unit per (output_unit/s)
    limit: float | None = None  # input_unit
    reference_rate_limit: float | None = None  # output_unit/s
    minimum: float | None = None  # input_unit; the smallest input that the loop gives other than 0


@dataclass(frozen=True, eq=False)
class Recording(Tabular):
    """One recording: input held from stamp to stamp, output as it was read. All arrays have shape (N,).

    `output` is NaN where a reading is left out (`faults` says why); `input` is finite everywhere. `resolution` is the
    size of one encoder count in `output_unit`, 0.0 when the output is not quantised. `optional` holds those that the
    recording has of these: motor_position (rad or m, NaN where left out), speed, current (A), supply (V), temperature
    (K) and, with a loop, reference (output_unit).

    `load` examines and mends what it reads. A recording that is made from arrays is taken as it is: bad readings are
    yours to leave out, and a coarse counter is read at each row, not where its count changes. Its file, read by `load`,
    has all of that.
    """

    name: str
    time: FloatArray  # s, strictly increasing, from 0
    input: FloatArray
    output: FloatArray
    input_unit: str  # "%", "V", "A", "N*m", "N"
    output_unit: str  # "rad", "m", "kcount", "rad/s", "m/s", "kcount/s"
    resolution: float = 0.0
    role: str = "train"  # "train" | "holdout"
    known: Mapping[str, float] = field(default_factory=dict)
    optional: Mapping[str, FloatArray] = field(default_factory=dict)
    loop: Loop | None = None
    faults: tuple[Fault, ...] = ()
    location: str = "link"  # "link" | "motor": the side of gear, gap and elasticity that the sensor sits on
    refresh: float | None = None  # s, how often the sensor is read anew; None: not known
    edge_rounding: float | None = None  # output_unit, of readings where the count changed; None: it is read at each row
    rig: Rig | None = None  # what the columns of the file were
    file: Path | None = None  # that it was read from
    preflight: tuple[Finding, ...] = ()  # what was found before any fit

    def __repr__(self) -> str:
        quantity = "speed" if self.is_speed else "position"
        step = f"{1e3 * float(np.median(np.diff(self.time))):.3g} ms" if self.time.size > 1 else "one sample"
        count = f" ({self.resolution:.3g} per count)" if self.resolution else ""
        left = int(np.count_nonzero(np.isnan(self.output)))
        readings = "no readings" if left == 0 else "1 reading" if left == 1 else f"{left} readings"
        return (
            f"{self.time[-1] if self.time.size else 0.0:.1f} s at {step}, "
            f"{_INPUT_WORDS.get(self.input_unit, 'input')} in {self.input_unit}, "
            f"{quantity} in {self.output_unit}{count}, {readings} left out"
        )

    def __str__(self) -> str:
        return str(self.table())

    def table(self) -> DisplayTable:
        """What was recorded, and what of it was left out."""
        rows = [
            ("input", f"{self.input_unit}, from {np.min(self.input):.3g} to {np.max(self.input):.3g}"),
            ("output", f"{self.output_unit}, from {np.nanmin(self.output):.3g} to {np.nanmax(self.output):.3g}"),
            ("samples", f"{self.time.size} in {self.time[-1]:.3g} s"),
            ("role", self.role),
            *((name, f"{value:.6g} (known)") for name, value in self.known.items()),
        ]
        assumed = self.rig.assumed if self.rig else ()
        notes = [*(f"left out: {f.says}" for f in self.faults), *(f"assumed: {a}" for a in assumed)]
        return DisplayTable(f"recording {self.name}", ("", ""), rows, notes)

    @property
    def is_speed(self) -> bool:
        """True when the output is a speed, not a position."""
        return self.output_unit.endswith("/s")

    @property
    def is_angle(self) -> bool:
        """True when the output is an angle or its rate: only then can a law repeat with each turn."""
        return self.output_unit.startswith("rad")

    @property
    def lever(self) -> float:
        """About what a radian at the gears makes at the output: where fits begin to look for a gap."""
        return _LEVERS[self.output_unit.removesuffix("/s")]

    def part(self, start: float, end: float) -> "Recording":
        """The samples from `start` to `end` (s, both included), with time from 0 again.

        Raises BadInput when fewer than two samples lie in the window.
        """
        keep = (self.time >= start) & (self.time <= end)
        if np.count_nonzero(keep) < 2:
            raise BadInput(
                f"{self.name}: no samples from {start:g} to {end:g} s; the recording lasts {self.time[-1]:g} s"
            )
        origin, last = self.time[keep][0], self.time[keep][-1]
        return replace(
            self,
            name=f"{self.name} ({start:g} to {end:g} s)",
            time=self.time[keep] - origin,
            input=self.input[keep],
            output=self.output[keep],
            optional={key: values[keep] for key, values in self.optional.items()},
            faults=tuple(
                replace(f, start=max(f.start, origin) - origin, end=min(f.end, last) - origin)
                for f in self.faults
                if f.end >= origin and f.start <= last
            ),
        )

    def without(self, start: float, end: float) -> "Recording":
        """The recording without its readings from `start` to `end` (s, both included), up to the last that is left.

        Raises BadInput when none is left.
        """
        left_out = (self.time >= start) & (self.time <= end)
        kept = np.flatnonzero(~left_out & np.isfinite(self.output))
        if len(kept) == 0:
            raise BadInput(f"{self.name}: no readings but from {start:g} to {end:g} s")
        shorter = replace(self, output=np.where(left_out, np.nan, self.output)).part(0.0, float(self.time[kept[-1]]))
        return replace(shorter, name=f"{self.name} (without {start:.3g} to {end:.3g} s)")


def known_quantities(recording: Recording) -> dict[str, float]:
    """Inertia and first moment of the payload about the axis, from what the user knows of it."""
    known = recording.known
    mass, arm = known.get("payload_mass", 0.0), known.get("arm_length", 0.0)
    rod = known.get("arm_mass", 0.0)
    return {
        "payload": known.get("payload_inertia", mass * arm**2 + rod * arm**2 / 3.0),
        "moment": known.get("payload_moment", mass * arm + rod * arm / 2.0),
    }


def told_of(recording: Recording) -> dict[str, float]:
    """What a model keeps of what is known: the axis' inertia (kg m^2), or the mass (kg) of a linear axis, and the
    supply (V) to which the input gain refers.
    """
    names = {"inertia": "mass" if recording.output_unit.startswith("m") else "inertia", _NOMINAL: _NOMINAL}
    return {ours: recording.known[theirs] for ours, theirs in names.items() if theirs in recording.known}


def command_of(recording: Recording) -> FloatArray:
    """The input as it acts: a duty drives in proportion to the supply where that is logged."""
    supply = recording.optional.get("supply")
    if supply is None or recording.input_unit != "%":
        return recording.input
    nominal = recording.known.get(_NOMINAL, float(np.nanmedian(supply)))
    return recording.input * np.where(np.isfinite(supply), supply, nominal) / nominal


def as_told(recording: Recording, known: Mapping[str, float]) -> Recording:
    """The recording as a model sees it that knows these: with its own nominal supply, where it has one."""
    if _NOMINAL not in known:
        return recording
    return replace(recording, known={**recording.known, _NOMINAL: known[_NOMINAL]})


def _share_supply(recordings: list[Recording]) -> list[Recording]:
    """One axis has one supply to which the input gain refers. With one for each recording, a battery that runs down
    would be another gain in each. The noise of its readings would be noise of the command.
    """
    recordings = [
        replace(r, optional={**r.optional, "supply": without_reading_noise(r.optional["supply"])})
        if "supply" in r.optional
        else r
        for r in recordings
    ]
    logged = [float(np.nanmedian(r.optional["supply"])) for r in recordings if "supply" in r.optional]
    if not logged:
        return recordings
    return [replace(r, known={_NOMINAL: float(np.median(logged)), **r.known}) for r in recordings]


def driven(recording: Recording) -> Recording:
    """The recording as an FMU of its axis is driven: the command as it acts, and what the laws know of the payload."""
    return replace(recording, input=command_of(recording), known={**known_quantities(recording), **recording.known})


def check_units(recording: Recording, where: str, input_unit: str, axis_unit: str) -> None:
    """Raises BadInput where a model or an FMU is in other units than the recording; an empty unit is not known."""
    pairs = ((input_unit, recording.input_unit, "input"), (axis_unit, recording.output_unit.removesuffix("/s"), "axis"))
    for theirs, ours, what in pairs:
        if theirs and theirs != ours:
            raise BadInput(
                f"{where} has its {what} in {theirs}, {recording.name} in {ours}: give a recording of the same rig, or "
                "the rig file that says what its columns are"
            )


def to_fit(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings that may be fitted. Raises BadInput where there are none, or where nothing could be concluded."""
    train = [r for r in recordings if r.role == "train"]
    if not train:
        raise BadInput("every recording has the role holdout: give at least one to fit")
    for recording in recordings:
        step = float(np.median(np.diff(recording.time))) if recording.time.size > 1 else LONGEST_STEP
        if not CONVERTER_STEP <= step <= LONGEST_STEP:
            raise BadInput(
                f"{recording.name}: time makes {step:.3g} s from sample to sample, at which no axis is seen to move: "
                "give it in s"
            )
    for recording in recordings:
        for finding in recording.preflight:
            if finding.severity is Severity.BLOCKS:
                raise BadInput(f"{recording.name}: {finding.says}")
    return train


def preflight_of(recordings: Sequence[Recording]) -> list[dict[str, str]]:
    """What the checks before any fit found, as JSON of every command says it."""
    return [
        {"recording": f.about or r.name, "kind": f.kind, "severity": f.severity.value, "says": f.says}
        for r in recordings
        for f in r.preflight
    ]


def faults_of(recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """What is wrong with the recordings, as JSON of every command says it."""
    return [{"recording": r.name, **vars(f)} for r in recordings for f in r.faults]


def load(paths: Sequence[Path], rig: Path | None = None) -> tuple[list[Recording], Rig]:
    """Load recordings and manifests, all with the same rig.

    `paths`: recordings or manifests. A manifest is a CSV with a column `file`, relative to the manifest. Its optional
    columns are `role`, and `start` and `end` in s to cut a window. Its numeric columns are known quantities of that
    recording. `rig`: the rig file; without one, the rig.toml beside the first path, else a guess from the column names.

    Raises BadInput for anything that cannot be used, also when input or output never changes in any of the
    recordings. In a set, single recordings may stand still: that is how a dead band shows.
    """
    if not paths:
        raise BadInput("no recording given; name at least one file")
    entries = [entry for path in paths for entry in entries_of(Path(path))]
    chosen = _choose_rig([Path(paths[0]), entries[0].path], rig)
    if rig is None:
        _check_one_rig([Path(p) for p in paths])
    return _load(entries, chosen)


def load_entries(entries: Sequence[Entry], rig: Path | None = None) -> tuple[list[Recording], Rig]:
    """Load recordings of one axis that a list has told of, as `load` does; an entry may be a manifest itself.

    Raises BadInput.
    """
    told = expand(entries)
    for e in told:
        if not e.path.exists():
            raise BadInput(f"{e.path} does not exist: correct the name, or copy the file there")
    chosen = _choose_rig([entries[0].path, told[0].path], rig)
    if rig is None:
        _check_one_rig([e.path for e in told])
    return _load(told, chosen)


def guess_of(entries: Sequence[Entry]) -> Guess:
    """What the columns of these recordings are, by their names and values. Raises BadInput where none can be told."""
    tables: list[Table] = []
    taken = 0
    for path in dict.fromkeys(e.path for e in entries):
        taken += path.stat().st_size if path.exists() else 0
        if tables and taken > _GUESSED_FROM:
            break
        tables += open_tables(path)
    return guess(*tables)


def load_guessed(entries: Sequence[Entry], guessed: Guess) -> tuple[list[Recording], Rig]:
    """The recordings as the guess says, which is corrected by what the checks before a fit find. Raises BadInput."""
    while True:
        rig = guessed.rig(str(entries[0].path))
        try:
            recordings, rig = _load(entries, rig)
        except BadInput as error:
            if not guessed.mend_refusal(error):
                raise
            continue
        if not guessed.mend([f for r in recordings for f in r.preflight]):
            return recordings, rig


def _load(entries: Sequence[Entry], chosen: Rig | None) -> tuple[list[Recording], Rig]:
    """The recordings of these entries, read with one rig file, or with a guess where there is none."""
    if chosen is None:
        return load_guessed(entries, guess_of(entries))
    opened: dict[Path, list[Table]] = {}
    held, sources = _Held(), []
    for entry in entries:
        tables = opened.get(entry.path) or open_tables(entry.path)
        opened = {entry.path: tables}  # windows of one file stand together in a manifest
        for table in _tests(tables, entry):
            joined = join_files(table, chosen, entry.path, _clock(table, chosen.time))
            held.add(_recording(*joined, entry))
            sources.append((entry.path, table.test))
    recordings = _without_standing(held.recordings, sources, chosen)
    _check_moves(recordings)
    recordings = _share_supply(_share_resolution(recordings, chosen.output.resolution))
    recordings = _read_at_edges(_examined(recordings, chosen))
    recordings[0] = replace(recordings[0], preflight=(*recordings[0].preflight, *held.findings))
    return recordings, chosen


class _Held:
    """Recordings as they are read, cut where they are more than memory holds (see `twin.io.thinning`)."""

    def __init__(self) -> None:
        self._windows: list[_Window] = []
        self._cuts = 0
        self._lasted = 0.0  # of all that was read, s

    def add(self, recording: Recording) -> None:
        """Hold one more, cut as often as those before it."""
        self._lasted += float(recording.time[-1])
        window = _Window(recording)
        for _ in range(self._cuts):
            window = window.half()
        self._windows.append(window)
        before = math.inf
        while thinning.MOST < (stamps := sum(w.recording.time.size for w in self._windows)) < before:
            self._windows = [w.half() for w in self._windows]
            self._cuts, before = self._cuts + 1, stamps

    @property
    def recordings(self) -> list[Recording]:
        """What is held, by name and window."""
        return [w.recording if w.begin is None else replace(w.recording, name=w.name) for w in self._windows]

    @property
    def findings(self) -> list[Finding]:
        """What the user is told of it."""
        if all(w.begin is None for w in self._windows):
            return []
        return [thinned(sum(float(w.recording.time[-1]) for w in self._windows), self._lasted)]


@dataclass(frozen=True, eq=False)
class _Window:
    """What is held of a recording, and where in it that begins, s; None: all of it is held."""

    recording: Recording
    begin: float | None = None

    @property
    def name(self) -> str:
        begin = self.begin or 0.0
        return f"{self.recording.name} ({begin:.6g} to {begin + self.recording.time[-1]:.6g} s)"

    def half(self) -> "_Window":
        """The half that moves most; the whole where it is short."""
        recording = self.recording
        ends = thinning.busiest_half(recording.time, recording.output)
        if ends is None:
            return self
        return _Window(replace(recording.part(*ends), name=recording.name), (self.begin or 0.0) + ends[0])


def _without_standing(recordings: list[Recording], sources: Sequence[tuple[Path, str]], rig: Rig) -> list[Recording]:
    """The recordings without those whose output stands still while another column says that the axis moves."""
    still = [k for k, r in enumerate(recordings) if np.ptp(r.output[np.isfinite(r.output)]) == 0]
    moving = [k for k in range(len(recordings)) if k not in still]
    if not still or not moving:
        return recordings
    looked_at = [*moving[:_WITNESSES], *still]
    found = contradicted([_columns(recordings[k], *sources[k], rig) for k in looked_at])
    out = {looked_at[k]: name for k, name in found.items()}
    first = moving[0]
    findings = tuple(
        Finding(
            "standing",
            f"the recording {recordings[k].name} is left out: its output stands still throughout while column '{name}' "
            "says that the axis moves",
            Severity.WARNS,
            recordings[k].name,
        )
        for k, name in out.items()
    )
    recordings[first] = replace(recordings[first], preflight=findings)
    return [r for k, r in enumerate(recordings) if k not in out]


def _columns(recording: Recording, path: Path, test: str, rig: Rig) -> Columns:
    """The output of a recording and the columns of its file that nothing else uses, on the same rows."""
    (table,) = [t for t in open_tables(path) if t.test == test]
    used = {rig.input.name, rig.output.name, rig.time.column}
    others = {}
    for name in table.names:
        if name in used:
            continue
        try:
            (values,) = table.columns([name])
        except BadInput:  # a column of text
            continue
        if values.size == recording.time.size and np.isfinite(values).any():
            others[name] = values
    return Columns(recording.time, recording.output, recording.is_speed, others)


def _examined(recordings: list[Recording], rig: Rig) -> list[Recording]:
    """The recordings with what the checks before any fit find in each of them, or in all of them together."""
    factor, offset = rig.input.scale * rig.input.factor, rig.input.offset
    signals = [
        Signals(
            r.name, r.time, command_of(r), r.output, r.is_speed, r.resolution,
            np.round(r.input / factor + offset, 9), r.input_unit,
        )
        for r in recordings
    ]  # fmt: skip
    together = examine(signals)
    found = [list(r.preflight) for r in recordings]
    found[0] += together
    for own, r, s in zip(found, recordings, signals, strict=True):
        if r.refresh is not None and rig.refresh is None:
            own.append(slow_sensor(s, r.refresh))
        own += at_its_limit(s, _share_at_limit(r))
        if len(recordings) > 1 and not any(f.severity is Severity.BLOCKS for f in together):
            own += reversed_alone(s, signals)
    return [replace(r, preflight=tuple(own)) for r, own in zip(recordings, found, strict=True)]


def _share_at_limit(recording: Recording) -> float:
    """The share of the time for which the output is at the limit of its sensor."""
    spent = sum(f.end - f.start for f in recording.faults if f.kind == "saturation" and f.signal == "output")
    return spent / float(recording.time[-1])


def _tests(tables: Sequence[Table], entry: Entry) -> list[Table]:
    """The tests of a file that an entry stands for: all, or the one that the manifest names."""
    chosen = [table for table in tables if entry.test in ("", table.test)]
    if not chosen:
        tests = ", ".join(table.test for table in tables if table.test) or "none"
        raise BadInput(f"{entry.path}: no test '{entry.test}', which the manifest names; there are: {tests}")
    return chosen


def _choose_rig(beside: Sequence[Path], rig: Path | None) -> Rig | None:
    if rig is not None:
        return read_rig(rig)
    for path in beside:
        if (path.parent / "rig.toml").is_file():
            return read_rig(path.parent / "rig.toml")
    return None


def _check_one_rig(paths: Sequence[Path]) -> None:
    """Raises BadInput where rig files beside the recordings say different things."""
    files = [f for f in dict.fromkeys(path.parent / "rig.toml" for path in paths) if f.is_file()]
    for other in files[1:]:
        if other.read_bytes() != files[0].read_bytes():
            raise BadInput(f"{files[0]} and {other} differ: name the one that holds for all recordings with `rig`")


def _recording(table: Table, rig: Rig, entry: Entry) -> Recording:
    clock = _clock(table, rig.time)
    wanted = _wanted(table, rig, clock)
    raw = dict(zip(wanted, table.columns(wanted), strict=True))
    time, rows, faults = _time(table, clock, raw, rig)
    raw = {name: values[rows] for name, values in raw.items()}
    drive, held = hold(time, _convert(raw[rig.input.name], rig.input), "input", table.name)
    faults += held
    if rig.direction is not None:
        drive = drive * _sense(time, raw[rig.direction.name], rig.direction, table.name)
    reading = _convert(raw[rig.output.name], rig.output)
    _check_reachable(table, rig, rows, raw[rig.output.name], reading)
    _check_sense(table, rig, clock, time, rows, _Drive(drive, raw[rig.input.name]))
    optional: dict[str, FloatArray] = {}
    for key, column in rig.optional.items():
        column_read = Raw(
            raw[column.name], _convert(raw[column.name], column), column, f"{table.name}: column '{column.name}'"
        )
        optional[key], found = clean_optional(time, key, column_read, table.name, drive)
        faults += found
    where = f"{table.name}: column '{rig.output.name}'"
    cleaned = clean_output(
        time, Raw(raw[rig.output.name], reading, rig.output, where), drive, optional.get("speed"), rig.refresh
    )
    faults += [*cleaned.faults, *find_gaps(time)]
    known = _known(rig, table, entry)
    if rig.loop is not None:
        optional["reference"], found = hold(
            time, _convert(raw[rig.loop.reference], rig.output), "reference", table.name
        )
        faults += found
    recording = Recording(
        name=Path(table.name).name,
        time=time,
        input=drive,
        output=cleaned.values,
        input_unit=rig.input.unit,
        output_unit=rig.output.unit,
        resolution=cleaned.resolution,
        role=entry.role,
        known=known,
        optional=optional,
        loop=None if rig.loop is None else _loop(rig.loop, rig, table, entry),
        faults=tuple(
            replace(f, start=float(f.start), end=float(f.end)) for f in sorted(faults, key=lambda f: (f.start, f.kind))
        ),
        location=rig.location,
        refresh=cleaned.refresh,
        rig=rig,
        file=entry.path,
    )
    if entry.start is not None or entry.end is not None:
        recording = recording.part(entry.start or 0.0, math.inf if entry.end is None else entry.end)
    if recording.time.size < _LEAST_SAMPLES:
        raise BadInput(
            f"{table.name}: only {recording.time.size} samples; "
            f"at least {_LEAST_SAMPLES} are needed to say anything, record for longer"
        )
    return recording


@dataclass(frozen=True, eq=False)
class _Drive:
    """The input of a recording. Arrays have shape (N,)."""

    values: FloatArray
    logged: FloatArray  # as the file holds it


def _check_reachable(
    table: Table, rig: Rig, rows: npt.NDArray[np.intp], logged: FloatArray, reading: FloatArray
) -> None:
    """Raises BadInput where the output holds no numbers, or mostly such as no axis reaches."""
    there = np.isfinite(logged)
    if not there.any():
        raise BadInput(f"{table.name}: column '{rig.output.name}' holds no number; name the column of the reading")
    beyond = np.flatnonzero(there & ~np.isfinite(reading))
    if 2 * beyond.size > np.count_nonzero(there):
        row, value = int(rows[beyond[0]]), float(logged[beyond[0]])
        raise BadInput(
            f"{table.name}: {table.where(row)}, column '{rig.output.name}': {value:.6g} and most others are beyond "
            "what an axis reaches; name the right column, or correct its unit in the rig file"
        )


def _check_sense(
    table: Table, rig: Rig, clock: Clock, time: FloatArray, rows: npt.NDArray[np.intp], taken: _Drive
) -> None:
    """Raises BadInput for numbers that no axis makes, which a wrong unit or a bad cell does."""
    drive, logged = taken.values, taken.logged
    steps = np.diff(time)
    said = f"column '{clock.column}'" if clock.column is not None else "sample_time"
    check_unit(time, clock.factor, f"{table.name}: {said}", "a rig.toml" if rig.assumed else rig.name)
    if steps.max(initial=0.0) > _PAUSE:
        row = int(rows[int(np.argmax(steps)) + 1])
        raise BadInput(
            f"{table.name}: {table.where(row)}, column '{clock.column}': {steps.max():.6g} s after the sample before; "
            "correct that stamp, or split the recording"
        )
    beyond = np.flatnonzero(np.abs(drive) > _FULL)
    if rig.input.unit == "%" and beyond.size:
        raise BadInput(
            f"{table.name}: {table.where(int(rows[beyond[0]]))}, column '{rig.input.name}': {drive[beyond[0]]:.6g} % "
            f"is far beyond full drive; {_cure_of_duty(logged)}"
        )


def _cure_of_duty(logged: FloatArray) -> str:
    """What to do about numbers that are far beyond full drive."""
    whole = logged[np.isfinite(logged)]
    if whole.min() >= 0 and 2.0**15 <= whole.max() < 2.0**16 and np.array_equal(whole, np.round(whole)):
        return "if the column holds signed numbers that were read without their sign, say signed_bits = 16 in [input]"
    return "correct or empty it, or give [input] full_scale in the rig file"


def _clock(table: Table, clock: Clock) -> Clock:
    """The clock with its column settled: as the rig file says, else the format's own stamps, else by name."""
    if clock.column is not None or clock.sample_time is not None:
        return clock
    found = Clock(table.clock) if table.clock is not None else guess_time(table.names, table.units)
    if found is None:
        raise BadInput(
            f"{table.name}: no time column is named; give [time] column or sample_time in the rig file; "
            f"columns are: {listing(table.names)}"
        )
    return found


def _wanted(table: Table, rig: Rig, clock: Clock) -> list[str]:
    """Names of the columns to read, the output first (its clock is the clock of the recording). Raises BadInput where
    one is missing.
    """
    named = {"output": rig.output.name, "input": rig.input.name}
    named |= {f"optional.{key}": column.name for key, column in rig.optional.items()}
    named |= {"input.direction": rig.direction.name} if rig.direction is not None else {}
    named |= {"loop": rig.loop.reference} if rig.loop is not None else {}
    named |= {"time": clock.column} if clock.column is not None else {}
    for role, name in named.items():
        if name not in table.names and name != table.clock:
            near = get_close_matches(name, table.names[:1000], 1) or [
                n for n in table.names if n.lower() == name.lower()
            ]
            meant = f"; did you mean '{near[0]}'?" if near else ""
            says = f"which {rig.name} says is its [{role}]" if not rig.assumed else f"taken for the {role} by its name"
            raise BadInput(
                f"{table.name}: no column '{name}', {says}{meant}; columns are: {listing(table.names)}"
                f"{_NO_HEADER if table.names[0] == '1' else ''}; correct the rig file, or give one as `rig`"
            )
    return list(dict.fromkeys(named.values()))


def _time(
    table: Table, clock: Clock, raw: Mapping[str, FloatArray], rig: Rig
) -> tuple[FloatArray, npt.NDArray[np.intp], list[Fault]]:
    """Seconds from 0, strictly increasing, the rows that they belong to, and faults of the clock."""
    column = clock.column
    if column is None:
        rows = np.arange(len(raw[rig.output.name]))
        return rows.astype(np.float64) * (clock.sample_time or 1.0), rows, []
    stamps = raw[column]
    rows = np.flatnonzero(np.isfinite(stamps))
    if rows.size < 2:
        raise BadInput(f"{table.name}: column '{column}' holds fewer than two time stamps")
    with np.errstate(over="ignore", invalid="ignore"):
        unwrapped, wraps = undo_counter_wraps(stamps[rows])
        time: FloatArray = np.asarray(count_from_first(unwrapped) * clock.factor, dtype=np.float64)
    if not np.isfinite(time).all():
        row = int(rows[int(np.argmin(np.isfinite(time)))])
        raise BadInput(
            f"{table.name}: {table.where(row)}, column '{column}': {stamps[row]:g} is no time stamp; correct it"
        )
    time, jumps = bridge_jumps(time, raw[rig.output.name][rows])
    step = np.diff(time)
    back = np.flatnonzero(step < 0)
    if back.size:
        row = int(rows[back[0] + 1])
        raise BadInput(
            f"{table.name}: {table.where(row)}: time goes backwards to {stamps[row]:.9g} from "
            f"{stamps[rows[back[0]]]:.9g} in column '{column}'; sort the rows or split the recording"
        )
    same = np.flatnonzero(step == 0)
    if same.size > 0.05 * step.size:
        raise BadInput(
            f"{table.name}: {table.where(int(rows[same[0] + 1]))}: {same.size} time stamps in column "
            f"'{column}' come twice; its resolution is too coarse, give [time] sample_time instead"
        )
    faults = [
        Fault("clock", time[k], time[k], f"The stamp {time[k]:.4f} s comes twice; one sample is dropped.", "clock")
        for k in same
    ]
    faults += [_clock_fault(time, k, "passes the largest number of its counter; it is continued") for k in wraps]
    faults += [_clock_fault(time, k, "jumps while the axis moves on; the jump is taken out") for k in jumps]
    keep = np.concatenate(([True], step > 0))
    spread = spread_bursts(time[keep])
    faults += spread.faults
    if rows.size < stamps.size:
        count = stamps.size - rows.size
        faults.append(Fault("missing", 0.0, time[-1], f"{count} samples without a time stamp are dropped.", "clock"))
    return spread.time, rows[keep], faults


def _clock_fault(time: FloatArray, k: int, says: str) -> Fault:
    return Fault("clock", float(time[k]), float(time[k + 1]), f"The clock {says} at {time[k + 1]:.3f} s.", "clock")


def _sense(time: FloatArray, raw: FloatArray, direction: Direction, name: str) -> FloatArray:
    """1 where the input drives forward, -1 where it drives in reverse, 0 where it does neither.

    Raises BadInput for a column that holds neither signs nor 0 and 1 while the rig file gives no values.
    """
    values, _ = hold(time, raw, "direction of the input", name)
    if direction.forward is not None:
        forward = values == direction.forward
        reverse = ~forward if direction.reverse is None else values == direction.reverse
        if not forward.any() and not reverse.any():
            raise BadInput(
                f"{name}: column '{direction.name}' is nowhere {direction.forward:g} or {direction.reverse:g}; "
                "give the values that it holds as forward and reverse in [input.direction]"
            )
        return np.asarray(forward.astype(np.float64) - reverse, dtype=np.float64)
    if values.min() < 0:
        return np.asarray(np.sign(values), dtype=np.float64)
    odd = values[(values != 0) & (values != 1)]
    if odd.size:
        raise BadInput(
            f"{name}: column '{direction.name}' holds {odd[0]:g}, neither a sign nor 0 or 1; "
            "say what it means with forward and reverse in [input.direction] of rig.toml"
        )
    return np.asarray(2 * values - 1, dtype=np.float64)


def _convert(raw: FloatArray, column: Column) -> FloatArray:
    if column.signed_bits:
        raw = np.where(raw >= 2.0 ** (column.signed_bits - 1), raw - 2.0**column.signed_bits, raw)
    with np.errstate(over="ignore", invalid="ignore"):
        values = (raw - column.offset) * (column.scale * column.factor) + column.zero
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def _known(rig: Rig, table: Table, entry: Entry) -> dict[str, float]:
    where = f"{rig.name} [known]"
    known = {key: _lookup(value, table, entry, f"{where} {key}") for key, value in rig.known.items()}
    known = {**known, **entry.known}
    for key, value in known.items():
        said = where if key in rig.known else f"{table.name}: manifest"
        near = [] if key in MEANT else get_close_matches(key, MEANT, 1, 0.85)
        if near:
            raise BadInput(f"{said}: unknown quantity '{key}'; did you mean '{near[0]}'?")
        if key in MEANT and key != _NOMINAL and rig.output.unit.startswith("kcount"):
            raise BadInput(
                f"{said}: {key} says nothing of an axis in counts; give counts_per_revolution in [output] of the rig "
                "file"
            )
        if value < 0.0 and key in MEANT and key != "payload_moment":
            raise BadInput(f"{said}: {key} = {value:g} must not be negative")
    return known


def _lookup(value: float | str, table: Table, entry: Entry, where: str) -> float:
    """A number, or the manifest column or scalar of the file that a name stands for."""
    if not isinstance(value, str):
        return value
    if value in entry.known:
        return entry.known[value]
    if value in table.scalars:
        return table.scalars[value]
    names = ", ".join([*entry.known, *table.scalars]) or "none"
    raise BadInput(
        f"{where} = '{value}' is neither a column of the manifest nor a scalar in {table.name}; there are: {names}"
    )


def _loop(loop: LoopRig, rig: Rig, table: Table, entry: Entry) -> Loop:
    into = abs(rig.input.factor)
    outof = abs(rig.output.factor)

    def value(given: float | str | None, key: str) -> float | None:
        return None if given is None else _lookup(given, table, entry, f"{rig.name} [loop] {key}")

    def times(number: float | None, factor: float) -> float | None:
        return None if number is None else number * factor

    return Loop(
        law=loop.law,
        gain=times(value(loop.gain, "gain"), loop.gain_scale * into / outof),
        kp=value(loop.kp, "kp"),
        kv=times(value(loop.kv, "kv"), into / outof),
        limit=times(loop.limit, into),
        reference_rate_limit=times(loop.reference_rate_limit, outof),
        minimum=times(loop.minimum, into),
    )


def _share_resolution(recordings: list[Recording], given: float | None) -> list[Recording]:
    """One encoder, one resolution: the median of what each recording shows, where they agree."""
    found = np.array([recording.resolution for recording in recordings if recording.resolution > 0])
    if given is not None or not found.size or np.ptp(found) > 0.1 * np.median(found):
        return recordings
    return [replace(recording, resolution=float(np.median(found))) for recording in recordings]


def _read_at_edges(recordings: list[Recording]) -> list[Recording]:
    """The recordings of a coarse counter, read where its count changes (see `twin.io.edges`).

    One sensor read them all: where most readings of all of them together are new, they stay as they are.
    """
    if any(r.is_speed or any(f.severity is Severity.BLOCKS for f in r.preflight) for r in recordings):
        return recordings
    seen = [counted(r.time, r.output, r.resolution) for r in recordings]
    repeats = [s.repeats for s in seen if s is not None]
    repeated, moving = (sum(n) for n in zip(*repeats, strict=True)) if repeats else (0, 0)
    if 2 * repeated <= moving:
        return recordings
    found = [None if s is None else s.edges() for s in seen]
    shares = np.concatenate([f[1] for f in found if f is not None])
    rounding = float(np.sqrt(np.mean(shares**2)))
    read = []
    for r, f in zip(recordings, found, strict=True):
        known = np.full(r.time.size, np.nan)
        known[np.isfinite(r.output)] = np.nan if f is None else f[0]
        if f is None:
            known[np.flatnonzero(np.isfinite(r.output))[0]] = r.output[np.isfinite(r.output)][0]
        read.append(replace(r, output=known, edge_rounding=rounding * r.resolution))
    rows = moving / max(moving - repeated, 1)
    return [replace(read[0], preflight=(*read[0].preflight, coarse(rows))), *read[1:]]


def _check_moves(recordings: Sequence[Recording]) -> None:
    for what in ("input", "output"):
        values = np.concatenate([getattr(recording, what) for recording in recordings])
        values = values[np.isfinite(values)]
        if values.size < 2 or np.ptp(values) == 0:
            said = f"{values[0]:g}" if values.size else "nothing"
            raise BadInput(
                f"{recordings[0].name}: the {what} is {said} all the time; record the axis moving under a changing "
                "input, or give recordings at several levels together"
            )
