"""Models as FMUs: export, update, read back, and replay of a recording through one in FMPy."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import re
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from fmu_src import pack
from twin.codegen import c, python
from twin.errors import BadInput
from twin.fmi import compilers, model_description, related_files
from twin.fmi.fmu_archive import Fmu, open_fmu, rewritten
from twin.fmi.fmu_instance import running
from twin.io.files import check_free, put
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, as_told, check_units, command_of, driven, known_quantities
from twin.model import sensor
from twin.model.fitted_model import INPUT_NAMES, Model, dumps, loads
from twin.model.stepper import KNOWN
from twin.model.variables import OUTPUTS, ROUND, delay_capacity, parameters_text, variables

FloatArray = NDArray[np.float64]

#: What pythonfmu brings a library for.
PLATFORMS = ("Linux x86_64", "Windows x86_64")
_MODEL = "resources/model.toml"
_VALUES = "resources/parameters.txt"
_DESCRIPTION = "modelDescription.xml"


def interface(model: Model) -> dict[str, Any]:
    """What the slave must know of the model, its numbers apart."""
    shown = variables(model)
    return {
        "variables": [{k: getattr(v, k) for k in ("name", "reference", "causality", "min", "max")} for v in shown],
        "known": list(KNOWN),
        "parameters": [p.name for p in model.structure.parameters],
        "delay_capacity": delay_capacity(model),
        "longest_step": model.longest_step,
        "round": ROUND,
    }


def _slave_text(model: Model) -> str:
    """The slave's module: its behaviour, and the physics of the structure below it."""
    return pack.SLAVE.read_text(encoding="utf-8") + python.write(model.structure)


def identity(model: Model) -> model_description.Identity:
    """Names hashed from all that the FMU is, numbers apart: an update must not change them."""
    listed = [asdict(v) | {"start": None} for v in variables(model)]
    said = [interface(model), listed, model.sample_time, importlib.metadata.version("pythonfmu")]
    text = json.dumps(said) + _slave_text(model) + c.library(model.structure)
    digest = hashlib.sha256(text.encode()).hexdigest()
    return model_description.of_axis(model, f"axis_{digest[:12]}", f"{{{uuid.UUID(digest[:32])}}}")


def described(model: Model) -> bytes:
    """modelDescription.xml of the FMU that needs Python."""
    written = model_description.fmi2(identity(model), variables(model), (), model_description.NO_SOLVER)
    return model_description.through_python(written)


def export(model: Model, out: Path, force: bool = False) -> Path:
    """Write the model's FMU (FMI 2.0 co-simulation, through pythonfmu). Raises BadInput.

    Where a C compiler is at hand, the compiled stepper for Linux x86_64 is inside as well. It takes a microsecond for a
    step that takes tens of them in Python. Where that does not load, the same text runs in Python.
    """
    check_free(out, force)
    resources: dict[str, str | bytes] = {
        "interface.json": json.dumps(interface(model), indent=1) + "\n",
        "parameters.txt": parameters_text(model),
        "model.toml": dumps(model),
    }
    who = identity(model).identifier
    stepper = f"{who}_stepper"
    library = compilers.for_linux(c.library(model.structure), stepper)
    if library is not None:
        resources[f"{stepper}.so"] = library
    put(out, pack.pack(_slave_text(model), who, resources, described(model)))
    return out


def read_model(fmu: Path) -> Model:
    """The model inside an FMU of ours. Raises BadInput."""
    opened = open_fmu(fmu)
    if "resources/controller.toml" in opened.members:
        raise BadInput(f"{fmu} is a controller: give the FMU of the axis; a controller is exported anew")
    try:
        text = opened.read(_MODEL).decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput(f"{fmu}: {_MODEL} is not UTF-8 text: export the FMU again") from None
    return loads(text, f"{fmu}: {_MODEL}")


# ---- update ----


def _differences(old: Model, new: Model) -> str:
    parts = []
    gone = [i for i in old.structure.ids if i not in new.structure]
    more = [i for i in new.structure.ids if i not in old.structure]
    if gone:
        parts.append(f"the FMU has {', '.join(gone)}, which the model lacks")
    if more:
        parts.append(f"the model has {', '.join(more)}, which the FMU lacks")
    if old.axis_unit != new.axis_unit:
        parts.append(f"the FMU's axis is in {old.axis_unit}, the model's in {new.axis_unit}")
    if old.input_unit != new.input_unit:
        parts.append(f"the FMU's input is in {old.input_unit}, the model's in {new.input_unit}")
    return "; ".join(parts)


def _encoding(text: bytes) -> str:
    """The encoding of an XML document: by its byte order mark, else by what it declares, else UTF-8."""
    marks = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
    declared = re.match(rb"<\?xml[^>]*?encoding=[\"']([A-Za-z][\w.-]*)[\"']", text)
    return marks.get(text[:2]) or (declared.group(1).decode("ascii") if declared else "utf-8")


def _with_starts(fmu: Fmu, text: bytes, model: Model) -> bytes:
    """The description with other start values; every other byte stays. Raises BadInput."""
    encoding = _encoding(text)
    try:
        described = text.decode(encoding)
    except (UnicodeDecodeError, LookupError):
        raise BadInput(f"{fmu.path}: {_DESCRIPTION} is no {encoding} text: export the FMU again") from None
    for variable in variables(model):
        if variable.causality != "parameter":
            continue
        element = re.compile(
            rf"<(ScalarVariable|Float64)\b[^<]*?\bname={re.escape(quoteattr(variable.name))}[^<]*(?:<Real\b[^<]*)?"
        )
        found = element.search(described)
        start = found and re.search(r'\bstart="[^"]*"', found.group())
        if found is None or not start:
            raise BadInput(f"{fmu.path} has no parameter {variable.name}: export it again with this version")
        first = found.start() + start.start()
        described = described[:first] + f'start="{variable.start!r}"' + described[found.start() + start.end() :]
    return described.encode(encoding)


def update(fmu: Path, model: Model, out: Path | None = None) -> Path:
    """Write the model's parameters into an FMU of ours, of either kind.

    The old ones become part of the archive's history (`twin.fmi.related_files`); every other byte stays as it is.
    Without `out` the FMU itself is replaced, whole or not at all. Raises BadInput.
    """
    opened, old = open_fmu(fmu), read_model(fmu)
    different = _differences(old, model)
    if different:
        raise BadInput(f"{fmu} has another structure: {different}; make a new FMU with twin export")
    fresh = {_MODEL: dumps(model).encode(), _VALUES: parameters_text(model).encode()}
    fresh[_DESCRIPTION] = _with_starts(opened, opened.read(_DESCRIPTION), model)
    if fresh[_VALUES] != opened.read(_VALUES):
        fresh |= related_files.files(opened, related_files.past(opened, old))
    put(out or fmu, rewritten(opened, fresh))
    return out or fmu


def set_origin(fmu: Path, origin: Mapping[str, str]) -> None:
    """Write who made an FMU into its description: `author`, `version`, `license`, `copyright`. Raises BadInput."""
    opened = open_fmu(fmu)
    described = model_description.with_origin(opened.read(_DESCRIPTION), origin)
    put(fmu, rewritten(opened, {_DESCRIPTION: described}))


def hold_input(fmu: Path) -> None:
    """Declare the input of an FMU as discrete, as the command of a sampled drive is.

    An importer that solves the axis itself then holds the command from one row of its table to the next, where it draws
    a line for a continuous input, and enters an event at each change. Nothing else of the FMU differs. Raises BadInput.
    """
    opened = open_fmu(fmu)
    put(fmu, rewritten(opened, {_DESCRIPTION: model_description.with_held_input(opened.read(_DESCRIPTION))}))


# ---- replay ----

_READS, _MOVES = OUTPUTS.index("position_measured"), OUTPUTS.index("velocity")


@dataclass(frozen=True, eq=False)
class Replay:
    """What the FMU did at the recording's stamps; all arrays have shape (N,)."""

    time: FloatArray  # s
    input: FloatArray  # that drove the FMU from here on
    position: FloatArray
    velocity: FloatArray
    position_measured: FloatArray

    def output(self, recording: Recording) -> FloatArray:
        """What stands against the recording's output (N,)."""
        return self.velocity if recording.is_speed else self.position_measured

    def rmse(self, recording: Recording) -> float:
        """Root mean square error over the readings that are there, in the output's unit."""
        error = self.output(recording) - recording.output
        return float(np.sqrt(np.nanmean(error**2)))

    def nrmse_percent(self, recording: Recording) -> float:
        """rmse over the range of the recorded output, percent."""
        span = float(np.nanmax(recording.output) - np.nanmin(recording.output))
        return 100.0 * self.rmse(recording) / span if span > 0.0 else math.inf


@dataclass(frozen=True)
class Start:
    """Position and velocity at the first stamp, and the standard error of that velocity; zero where it is taken as
    rest."""

    position: float
    velocity: float
    velocity_error: float


#: Ways an axis may begin to move, as powers of time: rest, setting off from rest, steady speed, changing speed.
_BEGINNINGS = ((0,), (0, 2), (0, 1), (0, 1, 2))
#: Chi-square that each term of motion has to earn at the start: three standard errors.
_EARNED = 9.0
#: The readings of so many s tell the state at the start, and at least so many.
_WINDOW, _FIRST = 0.02, 5
#: Gauss-Newton steps to that velocity.
_LOOKS = 5


def start_state(recording: Recording, window: float = _WINDOW) -> Start:
    """State at the first stamp from the readings of the first `window` s, with the fewest terms that describe them.

    A line through an axis that starts from rest would give it too high a speed. The position error would then be that
    speed times the time constant, for the rest of the run. So rest, acceleration from rest, a steady speed and a
    changing speed compete by their squared error over the noise plus a price for each term. A recording of speed begins
    at position zero. Raises BadInput where nothing was read.
    """
    seen = np.flatnonzero(np.isfinite(recording.output))
    if seen.size == 0:
        raise BadInput(f"{recording.name}: no reading is left, so there is nothing to compare with")
    near = seen[recording.time[seen] <= max(recording.time[seen[0]] + window, recording.time[seen[:_FIRST][-1]])]
    time, output = recording.time[near] - recording.time[0], recording.output[near]
    if recording.is_speed:
        return Start(0.0, float(np.mean(output)), float(np.std(output)) / math.sqrt(len(near)))
    if len(near) < 3:
        return Start(float(output[0]), 0.0, 0.0)
    fits = []
    for powers in _BEGINNINGS:
        columns = time[:, None] ** np.array(powers)
        found, _, rank, _ = np.linalg.lstsq(columns, output, rcond=None)
        spare = len(near) - len(powers)
        if rank == len(powers) and spare >= 2 * len(powers) - 3:
            fits.append((powers, columns, found, float(np.sum((output - columns @ found) ** 2)), spare))
    _, _, _, rest, spare = fits[-1]
    noise = max(rest / spare, recording.resolution**2 / 12.0, 1e-300)
    powers, columns, found, _, _ = min(fits, key=lambda f: f[3] / noise + _EARNED * (len(f[0]) - 1))
    if 1 not in powers:
        return Start(float(found[0]), 0.0, 0.0)
    at = powers.index(1)
    return Start(float(found[0]), float(found[at]), math.sqrt(noise * np.linalg.inv(columns.T @ columns)[at, at]))


def start_of(recording: Recording, model: Model | None = None) -> tuple[float, float]:
    """Position and velocity at the first stamp (`start_state`).

    Between readings that are far apart an axis moves as no power of time does. There the model says at what velocity it
    began, and rest has to be wrong by as much as any other beginning.
    """
    start = start_state(recording)
    read = np.flatnonzero(np.isfinite(recording.output))[:_FIRST]
    if model is None or recording.time[read[-1]] - recording.time[read[0]] <= _WINDOW:
        return start.position, start.velocity
    first = float(recording.output[read[0]])
    return (0.0 if recording.is_speed else first), _velocity_by_model(recording, model, read)


def _velocity_by_model(recording: Recording, model: Model, read: NDArray[np.intp]) -> float:
    """The velocity at the first stamp from which a free run of the model meets these readings best."""
    from twin.simulation import kernel  # most uses of an FMU need no compiled kernel, whose import takes seconds

    upto = slice(0, int(read[-1]) + 1)
    drive = kernel.Drive(
        recording.time[upto], command_of(recording)[upto], np.full(upto.stop, np.nan), recording.is_speed,
        kernel.known_vector(known_quantities(recording)), np.zeros(5), model.longest_step,
    )  # fmt: skip
    parameters = kernel.vector(model.structure, dict(model.values))
    place = 0.0 if recording.is_speed else float(recording.output[read[0]])

    def error(velocity: float) -> FloatArray:
        run = kernel.predict(drive, parameters, kernel.start_state(place, velocity, 0.0))
        return np.asarray(recording.output[read] - run.reading[read])

    scale = (
        float(np.max(np.abs(recording.output[read])))
        if recording.is_speed
        else float(np.max(np.abs(np.diff(recording.output[read]) / np.diff(recording.time[read]))))
    )
    rest = error(0.0)
    if scale == 0.0 or not np.isfinite(rest).all():
        return 0.0
    velocity, moving = 0.0, rest
    for _ in range(_LOOKS):  # dry friction and a gap are not linear in it
        slope = (error(velocity + 0.01 * scale) - moving) / (0.01 * scale)
        velocity -= float(np.dot(slope, moving)) / max(float(np.dot(slope, slope)), 1e-300)
        moving = error(velocity)
    spare = len(read) - 1
    noise = max(float(np.sum(moving**2)) / spare, recording.resolution**2 / 12.0, 1e-300)
    gain = (float(np.sum(rest**2)) - float(np.sum(moving**2))) / noise
    return velocity if gain > _EARNED else 0.0


def start_values(recording: Recording, model: Model | None) -> tuple[float, float]:
    """Position and velocity at the first stamp at which the model's sensor reads what was read there."""
    position, velocity = start_of(recording, model)
    return (sensor.position(model.structure, model.values, position) if model else position), velocity


def _is_own(model: Model, recording: Recording) -> bool:
    """Whether the model was fitted to the recording, so that what happened in it happens in its replay."""
    own = model.provenance.get("recordings", "").split(", ")
    return recording.name in {name.partition(" (without ")[0] for name in own}


def replay(fmu: Path, recording: Recording, start: tuple[float, float] | None = None, closed: bool = False) -> Replay:
    """Drive the recorded input through the FMU in FMPy, one communication step from stamp to stamp.

    `closed` simulates the rig's own loop around the FMU instead. The input is then the command of that loop, from the
    recorded reference and the reading of the FMU's sensor. The steps are as short as the loop's. `start` is position
    and velocity at the first stamp. By default the sensor of the FMU's model gives the first reading there. Known
    quantities of the recording are set. A duty drives in proportion to the supply where that is logged, by the nominal
    one that the FMU's model knows. Raises BadInput where the FMU refuses or its results are NaN.
    """
    opened = open_fmu(fmu)
    model = read_model(fmu) if _MODEL in opened.members else None
    recording = driven(as_told(recording, model.known if model and "supply" in recording.optional else {}))
    shown = opened.description.findall("ModelVariables/*")
    names = {node.get("name") for node in shown}
    inputs = [node.get("name", "") for node in shown if node.get("causality") == "input"]
    if len(inputs) != 1:
        raise BadInput(f"{fmu} has {len(inputs)} inputs, not one: give the FMU of an axis, as twin export writes it")
    units = {name: unit for unit, name in INPUT_NAMES.items()}
    check_units(recording, str(fmu), units.get(inputs[0], ""), opened.unit("position"))
    position, velocity = start_values(recording, model) if start is None else start
    values = {"position_start": float(position), "velocity_start": float(velocity)}
    if "time_start" in names and model is not None and _is_own(model, recording):
        values["time_start"] = 0.0
    values |= {name: float(value) for name, value in recording.known.items() if name in KNOWN and name in names}
    loop = own_loop(recording) if closed else None
    if loop is None:
        time, command = recording.time.tolist(), recording.input.tolist()
    else:
        time, command = loop.time.tolist(), [0.0] * len(loop.time)
    seen = np.empty((len(time), len(OUTPUTS)))
    with running(opened, inputs, OUTPUTS) as instance:
        instance.start(values, time[0])
        seen[0] = instance.read()
        for i in range(len(time) - 1):
            if loop is not None:
                command[i] = loop.command(i, seen[i, _READS], seen[i, _MOVES])
            seen[i + 1] = instance.step(time[i], time[i + 1] - time[i], command[i : i + 1])
    if not np.isfinite(seen).all():
        at = time[int(np.argmin(np.isfinite(seen).all(axis=1)))]
        raise BadInput(f"{fmu}: the simulation is no longer a number at {at:g} s: check the parameters")
    commanded = np.array(command)
    if loop is not None:
        commanded[-1] = loop.command(len(time) - 1, seen[-1, _READS], seen[-1, _MOVES])
        seen, commanded = seen[loop.stamps], commanded[loop.stamps]
    return Replay(recording.time, commanded, *(np.ascontiguousarray(column) for column in seen.T))
