"""`twin export` and `twin update`: a model, or a controller, as an FMU."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from twin.cli.command import Command, add_out, check_outputs
from twin.cli.output import answer_user, show_progress
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.control.controller import Controller
    from twin.model.fitted_model import Model


def _export(args: argparse.Namespace) -> int:
    check_outputs(args, args.out, args.ssv, args.ssp, args.modelica)
    if args.controller is not None and args.ssp is None:
        raise BadInput("--controller goes into a system: add --ssp FILE, or export the CONTROLLER.toml by itself")
    if args.target == "python" and args.fmi == 3:
        raise BadInput("--target python writes FMI 2 only, through pythonfmu: add --target native for FMI 3")
    from twin.io import toml

    text = toml.load(args.model, "model", "MODEL.toml", "twin identify")
    from twin.codegen import modelica
    from twin.control import controller
    from twin.fmi import ssp
    from twin.io.files import put
    from twin.model import fitted_model

    answer = {"format": "twin-export/1", "fmu": str(args.out), "target": args.target, "fmi": args.fmi}
    if toml.format_of(text) == controller.FORMAT:
        for option in ("ssv", "ssp", "modelica"):
            if getattr(args, option) is not None:
                raise BadInput(f"--{option} needs the MODEL.toml of the axis, {args.model} is a controller")
        made = controller.loads(text, str(args.model))
        _export_controller(args, made, args.out)
        answer_user(args, [f"{args.out}: FMI {args.fmi} co-simulation ({args.target}) of the {made.summary}."], answer)
        return 0
    found = fitted_model.loads(text, str(args.model))
    designed = None if args.controller is None else controller.read(args.controller)
    offers = _export_axis(args, found)
    said = [f"{args.out}: FMI {args.fmi} ({args.target}) of {found.structure}, for {offers}."]
    if args.ssv is not None:
        ssp.write_ssv(found, args.ssv, args.force)
        said.append(f"{args.ssv}: the parameters as an SSP set.")
    if args.ssp is not None:
        with tempfile.TemporaryDirectory() as folder:
            packed = None if designed is None else Path(folder) / "controller.fmu"
            if designed is not None and packed is not None:
                _export_controller(args, designed, packed)
            ssp.write_ssp(args.ssp, args.out, packed, found, args.force)
        said.append(f"{args.ssp}: the system with its parameters.")
    if args.modelica is not None:
        put(args.modelica, modelica.write(found))
        said.append(f"{args.modelica}: the same equations in Modelica.")
    answer_user(args, said, answer)
    return 0


def _export_axis(args: argparse.Namespace, found: Model) -> str:
    """Write the FMU; what it offers."""
    from twin.fmi import native_fmu, python_fmu

    with show_progress(args) as tell:
        tell("compiling the FMU", 0.0)
        if args.target == "native":
            native_fmu.export_native(found, args.out, args.fmi, args.force)
            return native_fmu.offers(found.structure)
        python_fmu.export(found, args.out, args.force)
        return "co-simulation"


def _export_controller(args: argparse.Namespace, made: Controller, out: Path) -> None:
    from twin.control import controller_fmu

    if args.target == "native":
        with show_progress(args) as tell:
            tell("compiling the controller", 0.0)
            controller_fmu.export_native(made, out, args.fmi, args.force)
    else:
        controller_fmu.export_controller(made, out, args.force)


def _update(args: argparse.Namespace) -> int:
    check_outputs(args, None if args.out is None or args.out == args.fmu else args.out)
    from twin.fmi import python_fmu
    from twin.model import fitted_model

    old, new = python_fmu.read_model(args.fmu), fitted_model.read(args.model)
    out = python_fmu.update(args.fmu, new, args.out)
    changed = {n: [old.values[n], v] for n, v in new.values.items() if n in old.values and old.values[n] != v}
    said = [f"{out}: {len(changed)} of {len(new.values)} parameters changed."]
    answer_user(args, said, {"format": "twin-update/1", "fmu": str(out), "changed": changed})
    return 0


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml", help="a model, or a CONTROLLER.toml")
    add_out(parser, "ARM.fmu")
    parser.add_argument(
        "--target", choices=("python", "native"), default="python",
        help="python: through pythonfmu (default); native: compiled, needs no Python in the host",
    )  # fmt: skip
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version; 3 with --target native only")
    parser.add_argument("--ssv", type=Path, metavar="FILE", help="also write the parameters as an SSP parameter set")
    parser.add_argument("--ssp", type=Path, metavar="FILE", help="also pack FMU and parameters as an SSP system")
    parser.add_argument(
        "--controller", type=Path, metavar="CONTROLLER.toml", help="goes into --ssp, as an FMU of the same kind"
    )
    parser.add_argument("--modelica", type=Path, metavar="FILE", help="also write the model as a Modelica package")


def _add_update_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    parser.add_argument("--from", dest="model", type=Path, required=True, metavar="MODEL.toml")
    add_out(parser, "NEW.fmu", required=False, text="leave ARM.fmu as it is and write this one")


EXPORT = Command("export", "a model, or a controller, as an FMU", _add_export_arguments, _export)

UPDATE = Command(
    "update", "write parameters into an existing FMU, in place or as --out", _add_update_arguments, _update
)
