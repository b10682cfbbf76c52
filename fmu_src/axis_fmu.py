"""The slave: how an axis behaves as an FMU, whatever its physics.

Standard library and pythonfmu only. The packer appends the generated functions `step` and `sensor` to this
text and gives the file a name of its own: two FMUs in one process must not share a module that differs.
What it must know of the model stands in resources/interface.json, the start values in resources/parameters.txt.
Errors come out as a logged sentence and a status, never as an exception, which would bring the host down.
"""

import atexit
import ctypes
import json
import os
import sys
from pathlib import Path

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status


def finite(number):
    return number - number == 0.0


_released = set()


def release_at_exit(library):
    """Let pythonfmu's library drop its state while Python ends.

    On Linux it is never unloaded and drops the state twice when the process ends: the second time it writes to
    freed memory, which brings some processes down. Once dropped, there is nothing left to drop.
    """
    if not sys.platform.startswith("linux") or library in _released or not os.path.exists(library):  # noqa: PTH110
        return
    try:
        drop = ctypes.CDLL(library, mode=os.RTLD_NOLOAD | os.RTLD_NOW).finalizePythonInterpreter
    except (OSError, AttributeError):
        return  # not the library that runs us: nothing to mend
    _released.add(library)
    atexit.register(drop)


def advance(x, p, k, command, h, count):
    """Move the states by `count` internal steps of h."""
    for _ in range(count):
        step(x, p, k, command, h)  # noqa: F821


def stepper(library, sizes):
    """What advances the axis, and what holds its numbers (`sizes` of them in x, p, k): the compiled text and arrays,
    or the Python text and lists.

    The library is compiled from what stands below in Python, for one platform: elsewhere it does not load.
    """
    try:
        # A call of a microsecond does not stop to let other threads in.
        compiled = ctypes.PyDLL(library).advance
    except OSError:
        return advance, list
    # Arrays of a known length pass twice as fast as pointers.
    compiled.argtypes = [ctypes.c_double * size for size in sizes] + [ctypes.c_double] * 2 + [ctypes.c_long]
    compiled.restype = None
    return compiled, lambda values: (ctypes.c_double * len(values))(*values)


class Axis(Fmi2Slave):
    """One axis. `v` holds every variable by value reference, `x` the states as the stepper wants them."""

    hold = list
    most = 1e6  # length of a step, s

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        resources = Path(self.resources)
        face = json.loads((resources / "interface.json").read_text(encoding="utf-8"))
        self.modelName = __name__  # pythonfmu names the binaries by it
        release_at_exit(str(resources.parent / "binaries" / "linux64" / f"{__name__}.so"))
        lines = (resources / "parameters.txt").read_text(encoding="utf-8").splitlines()
        pairs = (line.split() for line in lines if line and not line.startswith("#"))
        values = {name: float(value) for name, value in pairs}
        self.variables = face["variables"]
        references = {variable["name"]: variable["reference"] for variable in self.variables}
        self.v = [values.get(variable["name"], 0.0) for variable in self.variables]
        first, second, last = references["position"], references["gap"], references["time_since_start"]
        self.outer = slice(first, first + 2)  # position and velocity
        self.hidden = slice(second, last + 1)  # the other states, in the stepper's order
        self.known = [references.get(name) for name in face["known"]]
        self.parameters = [references[name] for name in face["parameters"]]
        self.starts = [references["position_start"], references["velocity_start"]]
        self.origin = references.get("time_start")
        self.settable = {v["reference"] for v in self.variables if v["causality"] == "parameter"}
        self.measured = references["position_measured"]
        self.capacity = face["delay_capacity"]
        if self.capacity:
            self.delay = references["delay"]
            self.acting = references["acting_command"]
            self.count = references["delay_count"]
            self.times = references["delay_time[1]"]
            self.values = references["delay_value[1]"]
        self.longest = face["longest_step"]
        self.round = face["round"]
        states = 2 + last + 1 - second
        sizes = (states, len(self.parameters), len(self.known))
        self.advance, self.hold = stepper(str(resources / f"{__name__}_stepper.so"), sizes)
        self.x = self.hold([0.0] * states)
        self.p = self.hold([0.0] * len(self.parameters))
        self.k = self.hold([0.0] * len(self.known))
        self.ready = False
        self.clock = None  # where the last step ended, in the importer's time
        self.changed = True
        self.begin()

    # Life of an instance

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        self.clock = start_time

    def enter_initialization_mode(self):
        self.begin()

    def exit_initialization_mode(self):
        self.begin()
        self.ready = True

    def terminate(self):
        self.ready = False

    def begin(self):
        """Put the axis where the start values say, at rest inside, nothing on its way."""
        position, velocity = (self.v[i] for i in self.starts)
        rest = [0.0] * (len(self.x) - 5)
        time = 0.0 if self.origin is None else self.v[self.origin]
        self.x[:] = [position, velocity, 0.0, velocity, *rest, time]
        if self.capacity:
            self.v[self.acting] = self.v[self.count] = 0.0
        self.take()
        self.show()

    def take(self):
        """Hand parameters to the stepper; a sentence where one cannot be used."""
        v = self.v
        for i in self.settable:
            variable = self.variables[i]
            low, high = variable["min"], variable["max"]
            if not finite(v[i]) or (low is not None and v[i] < low) or (high is not None and v[i] > high):
                span = f"[{'-inf' if low is None else low}, {'inf' if high is None else high}]"
                return f"parameter {variable['name']} is {v[i]}, not a finite number in {span}: set one"
        self.p = self.hold([v[i] for i in self.parameters])
        self.k = self.hold([0.0 if i is None else v[i] for i in self.known])
        self.changed = False
        return ""

    def show(self):
        """Write the states where the importer reads them."""
        v, x = self.v, self.x
        v[self.outer] = x[:2]
        v[self.hidden] = x[2:]
        v[self.measured] = x[0] + sensor(x[0], x[2], self.p)  # noqa: F821

    # Steps

    def do_step(self, current_time, step_size):
        try:
            problem = self.problem(current_time, step_size)
            if not problem:
                if step_size > 0.0:
                    self.move(step_size)
                    self.show()
                self.clock = current_time + step_size
                if finite(sum(self.x)):
                    return True
                problem = "the motion has become infinite or NaN: check the parameters"
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        self.log(f"doStep from {current_time} by {step_size} s: {problem}", Fmi2Status.error)
        return False

    def problem(self, time, length):
        """Why this step cannot be taken, or nothing."""
        if not self.ready:
            return "the axis is not initialised: end the initialisation mode first"
        if not finite(self.v[0]):
            return f"input {self.variables[0]['name']} is {self.v[0]}: set a finite number"
        if not (finite(time) and 0.0 <= length <= self.most):
            return f"a step of {length} s at {time} s is negative, not finite or too long: give one up to {self.most} s"
        if self.clock is not None and abs(time - self.clock) > 0.01 * length + 1e-9:
            if time < self.clock:
                return f"time goes back, the last step ended at {self.clock} s: go on there or restore a state"
            return f"time jumps ahead, the last step ended at {self.clock} s: go on there"
        return self.take() if self.changed else ""

    def move(self, length):
        if not self.capacity:
            self.run(length, self.v[0])
            return
        v = self.v
        self.give(v[0])
        now = self.x[-1]
        end = now + length
        delay = v[self.delay]
        slack = (1.0 - self.round) * self.longest  # no pieces that exist by rounding only
        while now < end:
            while v[self.count] and v[self.times] + delay <= now + slack:
                v[self.acting] = v[self.values]
                self.drop(0)
            until = end
            if v[self.count] and v[self.times] + delay < end - slack:
                until = v[self.times] + delay
            self.run(until - now, v[self.acting])
            now = until

    def run(self, length, command):
        pieces = int(length / self.longest + self.round) or 1
        self.advance(self.x, self.p, self.k, command, length / pieces, pieces)

    # The commands on their way

    def give(self, command):
        """The command of this step joins the line."""
        v, times, values = self.v, self.times, self.values
        now = self.x[-1]
        count = int(v[self.count])
        if count and v[times + count - 1] == now:
            count -= 1
        if count == self.capacity:
            ends = [*v[times + 1 : times + count], now]
            lasted = [ends[i + 1] - v[times + i] for i in range(count - 1)]
            i = lasted.index(min(lasted))
            share = (ends[i] - v[times + i]) / lasted[i]
            v[values + i + 1] = share * v[values + i] + (1.0 - share) * v[values + i + 1]
            v[times + i + 1] = v[times + i]
            self.drop(i)
            count -= 1
        v[times + count] = now
        v[values + count] = command
        v[self.count] = count + 1.0

    def drop(self, place):
        v = self.v
        last = int(v[self.count]) - 1
        for first in (self.times, self.values):
            v[first + place : first + last] = v[first + place + 1 : first + last + 1]
        v[self.count] = float(last)

    # What the importer reads and sets

    def get_real(self, vrs):
        v = self.v
        try:
            return [v[i] for i in vrs]
        except IndexError:
            self.log(f"getReal: there is no variable with one of the references {vrs}", Fmi2Status.error)
            return [float("nan")] * len(vrs)

    def set_real(self, vrs, values):
        if vrs == [0]:  # the input, at every step
            self.v[0] = values[0]
            return
        for i, value in zip(vrs, values):  # noqa: B905
            if i == 0:
                self.v[0] = value
            elif i not in self.settable or (self.ready and i in self.starts):
                name = self.variables[i]["name"] if i < len(self.v) else f"with reference {i}"
                self.log(f"setReal: variable {name} cannot be set now; it keeps its value", Fmi2Status.error)
            else:
                self.v[i] = value
                self.changed = True
        if not self.ready and self.changed:
            self.begin()

    def other(self, vrs, nothing):
        self.log("this FMU has variables of type Real only", Fmi2Status.error)
        return [nothing] * len(vrs)

    def get_integer(self, vrs):
        return self.other(vrs, 0)

    def get_boolean(self, vrs):
        return self.other(vrs, False)

    def get_string(self, vrs):
        return self.other(vrs, "")

    def set_integer(self, vrs, values):
        self.other(vrs, None)

    def set_boolean(self, vrs, values):
        self.other(vrs, None)

    def set_string(self, vrs, values):
        self.other(vrs, None)

    def _get_fmu_state(self):
        return {"v": list(self.v), "ready": self.ready, "clock": self.clock}

    def _set_fmu_state(self, state):
        self.v[:] = state["v"]
        self.ready = state["ready"]
        self.clock = state["clock"]
        self.x[:] = self.v[self.outer] + self.v[self.hidden]
        self.changed = True
