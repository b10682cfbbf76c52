"""Checks of a project that keeps a twin under test: does it still fit, does the loop still hold?

Each fails with the figures and the name of a plot.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import matplotlib.figure
import numpy as np
import pytest
from numpy.typing import NDArray

from twin.control import controller as controllers
from twin.control.controller import Controller
from twin.control.cosimulation import Tracking, run
from twin.control.reference import KINDS, Reference, make_reference, read_reference
from twin.fmi.fmu_archive import Fmu, open_fmu
from twin.fmi.misfit import misfit
from twin.fmi.python_fmu import Replay, replay
from twin.io import recording as recordings
from twin.report.misfit_plot import worst_second

FloatArray = NDArray[np.floating]
#: Each recording of a log, and what an FMU made of its input.
Replays = list[tuple[recordings.Recording, Replay]]


@dataclass(frozen=True)
class Checks:
    """What the `twin` fixture offers. Plots of failed checks go to `plots`, under the test's name."""

    plots: Path
    test: str

    def load(self, fmu: str | Path) -> Fmu:
        """The FMU, opened and checked. Raises BadInput."""
        return open_fmu(Path(fmu))

    def replay(self, fmu: str | Path, log: str | Path, rig: str | Path | None = None) -> Replays:
        """The recorded input of every recording in the log through the FMU. Raises BadInput."""
        loaded, _ = recordings.load([Path(log)], Path(rig) if rig else None)
        return [(r, replay(Path(fmu), r)) for r in loaded]

    def assert_nrmse(
        self, fmu: str | Path, log: str | Path, max_percent: float, rig: str | Path | None = None,
        ahead: float | None = None,
    ) -> float:  # fmt: skip
        """The worst error of the FMU over the log's range, percent; fails beyond `max_percent`.

        With `ahead` it is the error of the prediction so many seconds ahead, over the range of the change in that time.
        """
        return self._assert_fit(fmu, self.replay(fmu, log, rig), ahead, "nrmse_percent", max_percent)

    def assert_rmse(
        self, fmu: str | Path, log: str | Path, max_error: float, rig: str | Path | None = None,
        ahead: float | None = None,
    ) -> float:  # fmt: skip
        """As `assert_nrmse`, for the root mean square error in the unit of the output."""
        return self._assert_fit(fmu, self.replay(fmu, log, rig), ahead, "rmse", max_error)

    def assert_peak(
        self, fmu: str | Path, log: str | Path, max_error: float, rig: str | Path | None = None,
        ahead: float | None = None,
    ) -> float:  # fmt: skip
        """As `assert_nrmse`, for the largest error in the unit of the output."""
        return self._assert_fit(fmu, self.replay(fmu, log, rig), ahead, "peak", max_error)

    def _assert_fit(self, fmu: str | Path, replays: Replays, ahead: float | None, figure: str, limit: float) -> float:
        worst = 0.0
        for recording, replayed in replays:
            found = misfit(recording, replayed, ahead)
            value = float(getattr(found, figure))
            worst = max(worst, value)
            if not value <= limit:
                name, unit = ("NRMSE", "%") if figure == "nrmse_percent" else (figure.upper(), recording.output_unit)
                far = "" if ahead is None else f" {ahead:g} s ahead"
                begin, end = found.worst()
                at = int(np.nanargmax(np.abs(found.error)))
                plot = self._plot_file()
                plot.write_bytes(worst_second(recording, replayed, found, self.test))
                pytest.fail(
                    f"{fmu} no longer fits {recording.name}{far}: {name} {value:.3g} {unit} > {limit:g} {unit}\n"
                    f"  RMSE {found.rmse:.4g} {recording.output_unit}; furthest off at {found.time[at]:.3f} s, by "
                    f"{found.error[at]:.4g} {recording.output_unit}\n"
                    f"  plot: {plot} (from {begin:.3f} to {end:.3f} s)",
                    pytrace=False,
                )
        return worst

    def track(
        self, fmu: str | Path, controller: str | Path | Controller, reference: Reference | str | Path | None = None
    ) -> Tracking:
        """The closed loop in FMPy, over a CSV with time and position, or `minimum-jerk`, `sine`, `step`.

        Raises BadInput.
        """
        made = controller if isinstance(controller, Controller) else controllers.read(Path(controller))
        if isinstance(reference, str | Path):
            kind = str(reference)
            reference = make_reference(kind, made) if kind in KINDS else read_reference(Path(kind), made)
        return run(Path(fmu), made, reference)

    def assert_tracking(
        self,
        fmu: str | Path,
        controller: str | Path | Controller,
        max_peak: float,
        reference: Reference | str | Path | None = None,
    ) -> Tracking:
        """The closed loop; fails where the peak error exceeds `max_peak`, in the axis' unit."""
        tracking = self.track(fmu, controller, reference)
        if not tracking.peak <= max_peak:
            at = int(np.argmax(np.abs(tracking.error)))
            self._fail(
                tracking,
                f"{fmu}: tracking error {tracking.peak:.4g} > {max_peak:g} at {tracking.time[at]:.3f} s: wanted "
                f"{tracking.reference[at]:.5g}, is {tracking.position[at]:.5g} (RMS {tracking.rms:.4g})",
            )
        return tracking

    def assert_no_limit_cycle(
        self, fmu: str | Path, controller: str | Path | Controller, reference: Reference | str | Path | None = None
    ) -> Tracking:
        """The closed loop; fails where it hunts at rest."""
        tracking = self.track(fmu, controller, reference)
        if cycle := tracking.limit_cycle:
            self._fail(
                tracking,
                f"{fmu}: the loop hunts at rest, amplitude {cycle.amplitude:.4g} at {cycle.frequency:.3g} Hz",
            )
        return tracking

    def _fail(self, tracking: Tracking, sentence: str) -> None:
        plot = self._plot(tracking.time, tracking.reference, tracking.position, ("reference", "position"), "")
        said = "\n".join(f"  {s}" for s in tracking.says)
        pytest.fail(f"{sentence}\n{said}\n  plot: {plot}", pytrace=False)

    def _plot(self, time: FloatArray, wanted: FloatArray, got: FloatArray, names: tuple[str, str], unit: str) -> Path:
        """Both curves and their difference, as a file named after the test."""
        figure = matplotlib.figure.Figure(figsize=(9, 6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(time, wanted, label=names[0])
        above.plot(time, got, label=names[1])
        above.legend()
        below.plot(time, got - wanted)
        for axes, label in ((above, unit), (below, f"difference {unit}")):
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
        below.set_xlabel("time, s")
        path = self._plot_file()
        figure.savefig(path)
        return path

    def _plot_file(self) -> Path:
        self.plots.mkdir(parents=True, exist_ok=True)
        return self.plots / f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', self.test)}.png"
