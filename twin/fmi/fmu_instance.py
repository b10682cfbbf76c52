"""A running FMU of FMI 2 or 3 behind the same few calls, made for tight loops in FMPy."""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import fmpy.fmi3
import fmpy.logging

from twin.errors import BadInput
from twin.fmi.fmu_archive import Fmu

Outputs = ctypes.Array[ctypes.c_double]


@cache
def _silent() -> Any:
    """A logger that says nothing, kept for as long as the process lives."""
    return fmpy.fmi2.fmi2CallbackLoggerTYPE(lambda *a: None)


@cache
def release_at_exit(library: str) -> None:
    """Let the library of a pythonfmu FMU drop its state while Python ends, once for each file.

    On Linux such a library is never unloaded. When the process ends it drops a shared pointer twice: the second time it
    counts down in freed memory, which brings some processes down. Once dropped, there is nothing left to drop. Our
    own slaves do this themselves, for hosts that do not; twice is as good as once.
    """
    if not sys.platform.startswith("linux"):
        return
    loaded = ctypes.CDLL(library, mode=os.RTLD_NOLOAD | os.RTLD_NOW)
    drop = getattr(loaded, "finalizePythonInterpreter", None)
    if drop is not None:
        atexit.register(drop)


def _let_go_of_the_logger() -> None:
    """FMPy keeps the last logger for the whole process: the next FMU must not call one that has gone.

    The callbacks are new each time, because FMPy puts its own proxy in the place of their logger.
    """
    callbacks = fmpy.fmi2.fmi2CallbackFunctions()
    callbacks.logger = _silent()
    fmpy.logging.addLoggerProxy(ctypes.byref(callbacks))


class Running:
    """One instance. `inputs` and `outputs` are the names that `step` takes and gives, in order.

    What the FMU logs is kept in `said`. Methods raise BadInput, with what it said, where it refuses.
    """

    def __init__(self, fmu: Fmu, folder: Path, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self.path = fmu.path
        self.said: list[str] = []
        self._references = fmu.references()
        absent = [name for name in (*inputs, *outputs) if name not in self._references]
        if absent:
            raise BadInput(f"{fmu.path} has no variable {', '.join(absent)}: give an FMU that twin export wrote")
        self._in = (ctypes.c_uint * len(inputs))(*(self._references[name] for name in inputs))
        self._out = (ctypes.c_uint * len(outputs))(*(self._references[name] for name in outputs))
        self._given = (ctypes.c_double * len(inputs))()
        self._got = (ctypes.c_double * len(outputs))()
        kind = fmpy.fmi2.FMU2Slave if fmu.version == 2 else fmpy.fmi3.FMU3Slave
        self._two = fmu.version == 2
        self._slave = kind(
            guid=fmu.token, unzipDirectory=str(folder), modelIdentifier=fmu.identifier, instanceName="axis"
        )
        if self._two:
            self._callbacks = fmpy.fmi2.fmi2CallbackFunctions()
            self._callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(lambda *a: self._hear(a[2], a[4]))
            self._callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
            self._callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
            fmpy.logging.addLoggerProxy(ctypes.byref(self._callbacks))
            self._slave.instantiate(callbacks=self._callbacks, loggingOn=True)
            release_at_exit(self._slave.dll._name)
        else:
            self._slave.instantiate(loggingOn=True, logMessage=lambda *a: self._hear(a[1], a[3]))

    def _hear(self, status: int, message: bytes | None) -> None:
        if status > 0 and message:
            self.said.append(message.decode("utf-8", "replace"))

    def _refusal(self, doing: str, error: Exception) -> BadInput:
        why = self.said[-1] if self.said else str(error)
        return BadInput(f"{self.path} refused {doing}: {why}")

    def start(self, values: Mapping[str, float], time: float = 0.0) -> None:
        """Set start values and parameters, and initialise."""
        try:
            if self._two:
                self._slave.setupExperiment(startTime=time)
                self._set(values)
                self._slave.enterInitializationMode()
            else:
                self._set(values)
                self._slave.enterInitializationMode(startTime=time)
            self._slave.exitInitializationMode()
        except Exception as error:
            raise self._refusal("to initialise", error) from None

    def _set(self, values: Mapping[str, float]) -> None:
        absent = [name for name in values if name not in self._references]
        if absent:
            raise BadInput(f"{self.path} has no variable {', '.join(absent)}: give an FMU that twin export wrote")
        references = [self._references[name] for name in values]
        setter = self._slave.setReal if self._two else self._slave.setFloat64
        if references:
            setter(references, list(values.values()))

    def step(self, time: float, length: float, given: Sequence[float]) -> Outputs:
        """Set the inputs and go from `time` on by `length`; the outputs, in an array that is used again."""
        slave, component = self._slave, self._slave.component
        for i, value in enumerate(given):
            self._given[i] = value
        try:
            if self._two:
                slave.fmi2SetReal(component, self._in, len(self._in), self._given)
                slave.fmi2DoStep(component, time, length, 1)
            else:
                slave.fmi3SetFloat64(component, self._in, len(self._in), self._given, len(self._given))
                slave.doStep(time, length)
        except Exception as error:
            raise self._refusal(f"the step from {time:g} s by {length:g} s", error) from None
        return self.read()

    def read(self) -> Outputs:
        """The outputs as they stand, in an array that is used again."""
        slave, component = self._slave, self._slave.component
        if self._two:
            slave.fmi2GetReal(component, self._out, len(self._out), self._got)
        else:
            slave.fmi3GetFloat64(component, self._out, len(self._out), self._got, len(self._got))
        return self._got

    def close(self) -> None:
        # After a refused step some FMUs refuse to end, too; what matters is the first refusal.
        with suppress(Exception):
            self._slave.terminate()
        self._slave.freeInstance()
        if self._two:
            _let_go_of_the_logger()


@contextmanager
def running(fmu: Fmu, inputs: Sequence[str], outputs: Sequence[str]) -> Iterator[Running]:
    """Unpack and load an FMU; freed and removed at the end. Raises BadInput where it cannot be loaded."""
    with fmu.unpacked() as folder:
        noise = StringIO()
        try:
            with redirect_stdout(noise), redirect_stderr(noise):
                instance = Running(fmu, folder, inputs, outputs)
        except BadInput:
            raise
        except Exception as error:
            raise BadInput(
                f"{fmu.path} cannot be loaded ({error}): is there a binary for this machine in it?"
            ) from None
        try:
            yield instance
        finally:
            instance.close()
