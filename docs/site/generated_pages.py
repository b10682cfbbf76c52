"""The pages of the documentation that no file holds: one of each effect, and the gallery.

MkDocs calls `on_files` before it builds the site. All that a page says stands on the effect's own page in
`twin/effects`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from twin.codegen import latex
from twin.effects.catalogue import BASE, EFFECTS, UNKNOWN
from twin.effects.effect import Effect
from twin.model.stepper import Structure
from twin.report import figures
from twin.report.style import AFTER, BEFORE
from twin.simulation import kernel

#: The axis of the pictures, in percent and rad: it moves through a turn, and the drive makes about 15 rad/s^2.
AXIS = {"input_gain": 0.3, "viscous_friction": 3.0, "backlash_gap": 0.0}
#: Sizes at which an effect shows. A torque that is not listed is as large as `TORQUE`.
TORQUE = 3.0
SIZES: dict[str, float] = {
    "coulomb_friction": 2.0, "dead_band_forward": 10.0, "dead_band_reverse": 6.0, "delay": 0.03, "detent_angle": 0.5,
    "disturbance_frequency": 0.7, "eccentricity": 0.05, "fade": 0.4, "fade_reference": 30.0, "fade_time": 4.0,
    "friction_asymmetry": 0.5, "friction_variation": 1.0, "joint_frequency": 4.0, "lag_time": 0.05, "load_added": 0.6,
    "load_friction": 0.3, "load_time": 6.0, "own_inertia": 0.01, "pulse_start": 6.0, "pulse_length": 1.5,
    "pulse_edge": 0.1, "presliding_travel": 0.3, "flexible_load_share": 0.5, "quadratic_drag": 0.5,
    "ripple_order": 6.0, "run_in_friction": 2.5, "run_in_time": 3.0, "sag_reference": 60.0,
    "saturation_limit": 35.0, "sector_friction": 3.0, "sector_width": 0.5, "sector_angle": 0.5, "spring_stiffness": 2.0,
    "stop_lower": -1.2, "stop_upper": 1.2, "stop_stiffness": 400.0, "stop_damping": 10.0,
    "stribeck_friction": 2.0, "stribeck_velocity": 0.8, "supply_sag": 0.006, "viscous_asymmetry": 0.4,
}  # fmt: skip
#: What the second panel is drawn over, by the first word of `depends_on` that stands here.
OVER = {"position": "position, rad", "velocity": "velocity, rad/s", "direction": "velocity, rad/s", "input": "input, %",
        "load": "input, %", "acceleration": "acceleration, rad/s²"}  # fmt: skip
NAMESPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
HEAD = """# {title}

`{id}` acts at the {station}. What it leaves in a recording goes with {depends}.

{law}
"""


def command(time: Any) -> Any:
    """A command that rests, steps and swings, so that most effects show."""
    levels = np.array([0, 45, 45, -45, -45, 0, 25, -25, 60, 0, -60, 0, 30, 55, -55, -30])
    held = levels[np.minimum((time / 0.5).astype(int), len(levels) - 1)].astype(float)
    return np.where(time < 8.0, held, 50.0 * np.sin(2.0 * np.pi * (0.3 + 0.08 * (time - 8.0)) * (time - 8.0)))


def moved(structure: Structure, values: dict[str, float], time: Any, duty: Any) -> tuple[Any, Any]:
    """What the sensor reads, and the states, of an axis that starts at rest."""
    drive = kernel.Drive(
        time, duty, np.full(len(time), np.nan), False,
        kernel.known_vector({"payload": 0.01, "moment": 0.05}), np.zeros(5), 0.002,
    )  # fmt: skip
    ran = kernel.predict(drive, kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0), keep_states=True)
    return ran.reading, ran.states


def sized(effect: Effect) -> dict[str, float]:
    structure = Structure.of([*BASE, *effect.includes, effect.id])
    return {
        p.name: AXIS.get(p.name, SIZES.get(p.name, p.start if p.start or p.neutral is None else TORQUE))
        if p.name in AXIS or p in effect.parameters or p.name == "coulomb_friction"
        else p.start
        for p in structure.parameters
    }


def picture(effect: Effect) -> str:
    """The torque that a model without the effect lacks, over time and over what it goes with."""
    time = np.arange(0.0, 16.0, 0.002)
    duty = command(time)
    values = sized(effect)
    reading, states = moved(Structure.of([*BASE, *effect.includes, effect.id]), values, time, duty)
    position, velocity = states[:, 0], states[:, 1]
    acceleration = np.gradient(velocity, time)
    lacking = acceleration - AXIS["input_gain"] * duty + AXIS["viscous_friction"] * velocity
    says = "torque that the model lacks, rad/s²"
    if effect.slot == "sensor":
        lacking, says = reading - position, "reading minus position, rad"
    over = next((OVER[d] for d in effect.depends_on if d in OVER), None)
    variable = {"position, rad": position, "velocity, rad/s": velocity, "input, %": duty,
                "acceleration, rad/s²": acceleration}  # fmt: skip
    # Where the command jumps, a difference of two speeds is no acceleration.
    jumps = np.flatnonzero(np.abs(np.diff(duty)) > 5.0)
    lacking[(jumps[:, None] + np.arange(-1, 3)).ravel()] = np.nan
    limit = 1.3 * float(np.nanquantile(np.abs(lacking), 0.995)) or 1.0
    lacking = np.clip(lacking, -limit, limit)

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, 2 if over else 1, squeeze=False)[0]
        axes[0].plot(time[::3], lacking[::3], color=AFTER, linewidth=0.9)
        axes[0].set_xlabel("time, s")
        axes[0].set_ylabel(says)
        if over:
            back = velocity < 0.0
            for way, color in ((~back, AFTER), (back, BEFORE)):
                shown = np.flatnonzero(way)[::3]
                axes[1].plot(variable[over][shown], lacking[shown], ".", color=color, markersize=2)
            axes[1].set_xlabel(f"{over} (blue forwards, orange backwards)")
        for axis in axes:
            axis.set_ylim(-limit, limit)

    drawn = figures.draw_svg(draw, 9.0, 3.0, f"{effect.title}: {says}, over time{f' and {over}' if over else ''}")
    # In a file of its own a drawing has to say what it is, and in which letters.
    return drawn.replace("<svg ", f'<svg {NAMESPACES} font-family="sans-serif" ', 1)


def page(effect: Effect) -> str:
    """One page, in Markdown."""
    law = f'<p class="law">{figures.math_svg(latex.equation(effect.id))}</p>'
    said = [HEAD.format(
        title=effect.title[0].upper() + effect.title[1:], id=effect.id, station=effect.station,
        depends=" and ".join(effect.depends_on) or "nothing: it is always there", law=law,
    )]  # fmt: skip
    if effect.id in BASE:
        said.append("Every model has it from the start.\n")
    if effect.parameters:
        said.append("| parameter | symbol | unit | meaning |\n|---|---|---|---|")
        said += [
            f"| `{p.name}` | {figures.math_svg(latex.symbol(p.name))} | {p.unit_for('rad', '%')} | {p.meaning} |"
            for p in effect.parameters
        ]
    if effect.parameters and effect.id not in BASE:
        sizes = sized(effect)
        shown = ", ".join(f"`{p.name}` {sizes[p.name]:g}" for p in effect.parameters)
        said.append(f"\n## What it leaves\n\n![{effect.title}: the torque that the model lacks]({effect.id}.svg)")
        said.append(f"\nOn a simulated axis with {shown}.")
    if effect.confused_with:
        said.append("\n## What it is confused with\n\n| rival | the experiment that tells them apart |\n|---|---|")
        said += [
            f"| [{EFFECTS[other].title}]({other}.md) | {experiment} |"
            for other, experiment in effect.confused_with.items()
            if other not in UNKNOWN
        ]
    said.append(f"\nSource: {effect.reference}.")
    return "\n".join(said)


def overview(shown: list[Effect]) -> str:
    rows = "\n".join(f"| [{e.title}]({e.id}.md) | `{e.id}` | {e.station} |" for e in shown)
    return (
        "# Effects\n\nWhat twin can name. Each page shows the law, what the effect leaves in a recording, and the "
        "experiment that tells it from its rivals. `twin effects ID` prints the same in a terminal.\n\n"
        f"| effect | id | acts at |\n|---|---|---|\n{rows}\n"
    )


GALLERY = """# Gallery

Six reports on simulated axes, one of each kind of answer. `python scripts/gallery.py` makes the recordings and asks
twin. Each report lies beside its recording.

| report | what was done to the axis |
|---|---|
"""
REPORTS = {
    "explained": ("Explained", "gravity was concealed"),
    "nothing": ("Nothing is missing", "nothing was concealed"),
    "cannot-tell": (
        "Two effects that do the same",
        "a dead time was concealed, which a lag between command and torque imitates",
    ),
    "unknown": (
        "Something without a name",
        "a drag with the cube of the speed was concealed, which no effect describes",
    ),
    "faults": ("A log with faults", "dry friction was concealed; readings froze, jumped and went missing"),
    "speed-only": ("Only the speed was logged", "drag was concealed; the output is a tachometer in rpm"),
}


def gallery(folder: Path) -> str:
    """The list of the reports; those that were made are linked."""
    rows = []
    for name, (title, done) in REPORTS.items():
        there = (folder / "gallery" / name / "report.html").exists()
        rows.append(f"| {f'[{title}](gallery/{name}/report.html)' if there else title} | {done} |")
    return GALLERY + "\n".join(rows)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs' event: add the pages that no file holds."""
    files.append(File.generated(config, "gallery.md", content=gallery(Path(config.docs_dir))))
    shown = [e for i, e in EFFECTS.items() if i not in UNKNOWN]
    files.append(File.generated(config, "effects/index.md", content=overview(shown)))
    for effect in shown:
        files.append(File.generated(config, f"effects/{effect.id}.md", content=page(effect)))
        if effect.parameters and effect.id not in BASE:
            files.append(File.generated(config, f"effects/{effect.id}.svg", content=picture(effect)))
    return files
