"""What a fit is made on: recordings made ready, the parameters that are held, and the process noise of the filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from twin.estimation.prepared_recording import PreparedRecording
from twin.model.stepper import Structure


def free_parameters(structure: Structure) -> tuple[str, ...]:
    """Names of the parameters that are estimated unless they are held."""
    return tuple(p.name for p in structure.parameters if p.estimated)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Recordings, masks, held parameters and process noise: all that structures are fitted and compared on.

    Parameters
    ----------
    recordings
        The recordings made ready, each with its masks.
    held
        Parameters that keep their value in every fit, by name.
    process_noise
        Density of the torque noise over the variance of a reading, 1/s^3 (positions) or 1/s (speeds). Zero stands for a
        free run.
    """

    recordings: Sequence[PreparedRecording]
    held: Mapping[str, float] = field(default_factory=dict)
    process_noise: float = 0.0
    _by_step: dict[int, tuple[PreparedRecording, ...]] = field(default_factory=dict, repr=False)

    @property
    def longest(self) -> PreparedRecording:
        """The longest of the recordings."""
        return max(self.recordings, key=lambda r: float(r.drive.time[-1]))

    def at(self, process_noise: float) -> FitProblem:
        """The same with another process noise."""
        return self if process_noise == self.process_noise else replace(self, process_noise=process_noise)

    def holding(self, held: Mapping[str, float]) -> FitProblem:
        """The same with other parameters held."""
        return replace(self, held=held)

    def on(self, recordings: Sequence[PreparedRecording]) -> FitProblem:
        """The same on other recordings, or with other masks."""
        return replace(self, recordings=recordings, _by_step={})

    def free(self, structure: Structure) -> tuple[str, ...]:
        """Names of the structure's parameters that are estimated and not held."""
        return tuple(n for n in free_parameters(structure) if n not in self.held)

    def stepped(self, structure: Structure) -> tuple[PreparedRecording, ...]:
        """The recordings with the longest internal step that the structure allows."""
        if structure.substeps not in self._by_step:
            self._by_step[structure.substeps] = tuple(r.stepped(structure) for r in self.recordings)
        return self._by_step[structure.substeps]
