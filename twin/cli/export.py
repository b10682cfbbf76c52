"""`twin export` and `twin update`: a model, or a controller, as an FMU."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.cli.command import Command, add_out, check_outputs, load
from twin.cli.output import answer_user, show_progress
from twin.errors import BadInput, install

if TYPE_CHECKING:
    from twin.control.controller import Controller
    from twin.io.recording import Recording
    from twin.model.fitted_model import Model

#: Options that say nothing of a controller.
_OF_THE_AXIS = (
    "ssv", "ssp", "controller", "modelica", "held-input", "evidence", "rig", "report", "author", "model-version",
    "license",
)  # fmt: skip

#: A compiler for other platforms builds their C libraries first, for minutes, and keeps them.
_COMPILING = "compiling for each platform, minutes the first time"


def _export(args: argparse.Namespace) -> int:
    check_outputs(args, args.out, args.ssv, args.ssp, args.modelica)
    if args.controller is not None and args.ssp is None:
        raise BadInput("--controller goes into a system: add --ssp FILE, or export the CONTROLLER.toml by itself")
    if args.target == "python" and args.fmi == 3:
        raise BadInput("--target python writes FMI 2 only, through pythonfmu: add --target native for FMI 3")
    if args.held_input and args.target == "python":
        raise BadInput("--held-input is for solvers of the importer, model exchange: add --target native")
    from twin.io import toml

    text = toml.load(args.model, "model", "MODEL.toml", "twin identify")
    from twin.codegen import modelica
    from twin.control import controller
    from twin.fmi import ssp
    from twin.io.files import put
    from twin.model import fitted_model

    answer: dict[str, Any] = {"format": "twin-export/1", "fmu": str(args.out), "target": args.target, "fmi": args.fmi}
    if toml.format_of(text) == controller.FORMAT:
        for option in _OF_THE_AXIS:
            if getattr(args, "log" if option == "evidence" else option.replace("-", "_")):
                raise BadInput(f"--{option} needs the MODEL.toml of the axis, {args.model} is a controller")
        made = controller.loads(text, str(args.model))
        _export_controller(args, made, args.out)
        answer["platforms"] = _platforms(args)
        made_of = f"{args.out}: FMI {args.fmi} co-simulation ({args.target}) of the {made.summary}."
        answer_user(args, [made_of, _runs_on(args)], answer)
        return 0
    found = fitted_model.loads(text, str(args.model))
    designed = None if args.controller is None else controller.read(args.controller)
    recordings = _evidence(args)
    offers, result = _export_axis(args, found, recordings)
    said = [f"{args.out}: FMI {args.fmi} ({args.target}) of {found.structure}, for {offers}.", _runs_on(args)]
    answer["platforms"] = _platforms(args)
    if result is not None:
        answer["evidence"] = result
        said.append(_carries(args.out, result))
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


def _platforms(args: argparse.Namespace) -> list[str]:
    from twin.fmi import native_fmu, python_fmu

    return list(native_fmu.platforms() if args.target == "native" else python_fmu.PLATFORMS)


def _runs_on(args: argparse.Namespace) -> str:
    from twin.display.numbers import listed

    where = f"It runs on {listed(_platforms(args))}"
    if args.target == "python":
        return f"{where}, in hosts that run Python; --target native needs none."
    from twin.fmi.compilers import has_zig

    return f"{where}." if has_zig() else f"{where} alone. For all platforms: {install('native', 'ziglang')}."


def _carries(fmu: Path, result: Mapping[str, Any]) -> str:
    names = [str(run["recording"]) for run in result["runs"]]
    which = names[0] if len(names) == 1 else f"{len(names)} recordings"
    return f"{fmu} carries {which} and how well it fits: twin check {fmu} runs it again."


def _evidence(args: argparse.Namespace) -> list[Recording]:
    """The recordings that the FMU is to carry: those held out where there are any. Raises BadInput."""
    if not args.log:
        for option in ("report", "rig"):
            if getattr(args, option, None) is not None:
                raise BadInput(f"--{option} goes with --evidence LOG: add it")
        return []
    with show_progress(args) as tell:
        recordings, _ = load(args, tell)
    return [r for r in recordings if r.role == "holdout"] or recordings


def _page(report: Path) -> str:
    try:
        return report.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"{report} cannot be read as a page of text: give the report.html of a run") from None


def _origin(args: argparse.Namespace) -> dict[str, str]:
    given = {"author": args.author, "version": args.model_version, "license": args.license}
    return {name: value for name, value in given.items() if value is not None}


def _export_axis(
    args: argparse.Namespace, found: Model, recordings: Sequence[Recording]
) -> tuple[str, dict[str, Any] | None]:
    """Write the FMU; what it offers, and how well it fits the recordings that it carries."""
    from twin.fmi import evidence, native_fmu, python_fmu
    from twin.io.files import check_free, put
    from twin.io.recording import check_units

    for r in recordings:
        check_units(r, str(args.model), found.input_unit, found.axis_unit)
    report = "" if args.report is None else _page(args.report)
    check_free(args.out, args.force)
    offers, result = "co-simulation", None
    with show_progress(args) as tell, tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / args.out.name
        tell(_COMPILING if args.target == "native" else "writing the FMU", 0.0)
        if args.target == "native":
            native_fmu.export_native(found, draft, args.fmi)
            offers = native_fmu.offers(found.structure)
        else:
            python_fmu.export(found, draft)
        if args.held_input:
            python_fmu.hold_input(draft)
        if origin := _origin(args):
            python_fmu.set_origin(draft, origin)
        if recordings:
            tell("replaying the recordings", 0.5)
            result = evidence.attach(draft, [evidence.Trial(r) for r in recordings], report=report)
        put(args.out, draft.read_bytes())
    return offers, result


def _export_controller(args: argparse.Namespace, made: Controller, out: Path) -> None:
    from twin.control import controller_fmu

    if args.target == "native":
        with show_progress(args) as tell:
            tell(_COMPILING, 0.0)
            controller_fmu.export_native(made, out, args.fmi, args.force)
    else:
        controller_fmu.export_controller(made, out, args.force)


def _update(args: argparse.Namespace) -> int:
    check_outputs(args, None if args.out is None or args.out == args.fmu else args.out)
    from twin.fmi import evidence, python_fmu
    from twin.io.files import put
    from twin.model import fitted_model

    old, new = python_fmu.read_model(args.fmu), fitted_model.read(args.model)
    recordings, out = _evidence(args), args.out or args.fmu
    changed = {n: [old.values[n], v] for n, v in new.values.items() if n in old.values and old.values[n] != v}
    said = [f"{out}: {len(changed)} of {len(new.values)} parameters changed."]
    answer: dict[str, Any] = {"format": "twin-update/1", "fmu": str(out), "changed": changed}
    with tempfile.TemporaryDirectory() as folder:
        draft = python_fmu.update(args.fmu, new, Path(folder) / "new.fmu")
        if recordings:
            answer["evidence"] = evidence.attach(draft, [evidence.Trial(r) for r in recordings])
            said.append(_carries(out, answer["evidence"]))
        put(out, draft.read_bytes())
    if changed and not recordings and (old_evidence := evidence.of_old_parameters(out)):
        said.append(old_evidence)
    answer_user(args, said, answer)
    return 0


def _add_evidence_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--evidence", dest="log", nargs="+", type=Path, default=[], metavar="LOG",
        help="recordings for the FMU to carry, with how well it fits them: twin check ARM.fmu then needs none",
    )  # fmt: skip
    parser.add_argument("--rig", type=Path, help="what the columns of LOG are; default: rig.toml beside LOG")


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml", help="a model, or a CONTROLLER.toml")
    add_out(parser, "ARM.fmu")
    parser.add_argument(
        "--target", choices=("python", "native"), default="python",
        help="python: through pythonfmu (default); native: compiled, needs no Python in the host",
    )  # fmt: skip
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version; 3 with --target native only")
    parser.add_argument(
        "--held-input", action="store_true",
        help="with --target native, for model exchange: importers hold the command between the rows of a table",
    )  # fmt: skip
    parser.add_argument("--ssv", type=Path, metavar="FILE", help="also write the parameters as an SSP parameter set")
    parser.add_argument("--ssp", type=Path, metavar="FILE", help="also pack FMU and parameters as an SSP system")
    parser.add_argument(
        "--controller", type=Path, metavar="CONTROLLER.toml", help="goes into --ssp, as an FMU of the same kind"
    )
    _add_evidence_arguments(parser)
    parser.add_argument("--report", type=Path, metavar="HTML", help="a report for the FMU to carry, with --evidence")
    parser.add_argument("--author", help="of the model, for the FMU's description")
    parser.add_argument("--model-version", metavar="VERSION", help="of the model, for the FMU's description")
    parser.add_argument("--license", help="of the model, for the FMU's description; default: MIT")
    parser.add_argument("--modelica", type=Path, metavar="FILE", help="also write the model as a Modelica package")


def _add_update_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    parser.add_argument("--from", dest="model", type=Path, required=True, metavar="MODEL.toml")
    add_out(parser, "NEW.fmu", required=False, text="leave ARM.fmu as it is and write this one")
    _add_evidence_arguments(parser)


EXPORT = Command("export", "a model, or a controller, as an FMU", _add_export_arguments, _export)

UPDATE = Command(
    "update", "write parameters into an existing FMU, in place or as --out", _add_update_arguments, _update
)
