"""A sensor that is read anew more slowly than it is logged.

It has no law: what a model reads at the moments of new readings is right without one, and other rows are left out of
every fit. How late a reading is cannot be told from a dead time, which `input_delay` names.
"""

from __future__ import annotations

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="sensor_hold",
    title="sensor that is read more slowly than the log",
    station="sensor",
    slot="structure",
    parameters=(
        Parameter("refresh", "s", "from one new reading to the next", None, 1e-6, start=0.02, estimated=False),
    ),
    law=None,
    depends_on=("time",),
    promises=frozenset({"odd"}),
    sentence="The sensor is read anew only every {refresh}: the rows between are repeats and not fitted.",
    reference="Franklin, Powell, Workman, Digital Control of Dynamic Systems, 1998, ch. 3 (sample and hold)",
    confused_with={
        "input_delay": "log the sensor on its own bus with its own stamps: a hold repeats readings, a delay does not",
        "encoder_eccentricity": "move slowly: a hold makes steps of several counts, an eccentric encoder none",
    },
    equation=r"y_k = y(t_0 + T_s \lfloor (t_k - t_0) / T_s \rfloor)",
)
