"""The simulators of rigs by name. None shares anything with the model in `twin/`, nor with the
others, but for `worn_rig`, which has rigs of `gearmotor_rig` that depart from every law a little.

Each module has `draw_rig`, `draw_effect`, `simulate`, the effects it knows as `VOCABULARY`, those that the tool has no
name for as `OUTSIDE`, and rigs with `truths()` and `model_values()`.
"""

from __future__ import annotations

from typing import Any

import circuit_rig
import gearmotor_rig
import mujoco_rig
import textbook_rig
import worn_rig

SIMULATORS: dict[str, Any] = {
    "mujoco": mujoco_rig,
    "circuit": circuit_rig,
    "gearmotor": gearmotor_rig,
    "textbook": textbook_rig,
    "worn": worn_rig,
}
