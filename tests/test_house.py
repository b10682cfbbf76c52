"""The rules of the house that a machine can check."""

from __future__ import annotations

import ast
import re
import subprocess
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: A package of `twin` imports only from those that stand before it.
ORDER = """errors parallel display effects io model codegen simulation fmi estimation control diagnosis report pipeline
    batch web testing cli __main__"""
TOP = {
    "pyproject.toml", "fmu_src", "twin", "tests", "models", "scripts", "README.md", "LICENSE", "CONTRIBUTING.md",
    "docs", "mkdocs.yml", ".ci", ".gitignore",
}  # fmt: skip


def tracked() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in listed.stdout.decode().split("\0") if name and (ROOT / name).exists()]


def imported_names(path: Path) -> set[str]:
    """Dotted names that a file imports: modules, and what is taken from them."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{a.name}" for a in node.names}
    return found


def imports(path: Path) -> set[str]:
    """First names under `twin` that a file imports; "" for the root itself, "fmu_src" for that."""
    split = [name.split(".") for name in imported_names(path)]
    inside = {name[1] if len(name) > 1 else "" for name in split if name[0] == "twin"}
    return inside | {"fmu_src" for name in split if name[0] == "fmu_src"}


def modules() -> list[Path]:
    return [p for p in sorted((ROOT / "twin").rglob("*.py")) if p.parent != ROOT / "twin" or p.name != "__init__.py"]


def sources() -> list[Path]:
    """The package's files, and those of the studies."""
    return modules() + sorted((ROOT / "scripts").glob("*.py"))


@pytest.mark.parametrize("path", modules(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_run_one_way(path):
    own = path.relative_to(ROOT / "twin").parts[0].removesuffix(".py")
    order = ORDER.split()
    assert own in order, f"give {own} its place in the order"
    allowed = {*order[: order.index(own)], own}
    allowed |= {"fmu_src"} if own in {"fmi", "control"} else set()  # these two pack
    assert imports(path) <= allowed


def test_no_two_files_import_each_other():
    names = {p: ".".join(p.relative_to(ROOT).with_suffix("").parts) for p in modules()}
    graph = {
        own: {name for name in set(names.values()) - {own} if any(f"{i}.".startswith(f"{name}.") for i in imported)}
        for own, imported in ((names[path], imported_names(path)) for path in modules())
    }
    assert tuple(TopologicalSorter(graph).static_order())


def test_the_root_holds_packages_and_at_most_six_files():
    assert len([p for p in tracked() if p.parent == ROOT / "twin"]) <= 6


def test_every_package_says_what_it_is_for():
    for path in (ROOT / "twin").glob("*/__init__.py"):
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path


def functions(path: Path) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function, its docstring apart."""
    first = function.body[1 if ast.get_docstring(function) and len(function.body) > 1 else 0]
    return (function.end_lineno or 0) - first.lineno + 1


def test_no_function_is_longer_than_sixty_lines():
    long = {(path.name, f.name): length(f) for path in sources() for f in functions(path) if length(f) > 60}
    assert not long, "split them into stages with names; a text of the stepper's language into sections"


def test_no_function_takes_more_than_six_parameters():
    """The stepper's own language has no objects: what is translated from it is another matter."""
    for path in sources():
        for function in functions(path):
            if path.parent.name == "codegen" or path.name == "stations.py":
                continue
            given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
            assert len(given) <= 6, f"{path.name}, {function.name}: make one object of what belongs together"


def test_the_root_only_maps_names_to_modules():
    root = ast.parse((ROOT / "twin" / "__init__.py").read_text(encoding="utf-8"))
    for node in root.body:
        if isinstance(node, ast.If):  # the imports that only a type checker reads
            assert ast.unparse(node.test) == "TYPE_CHECKING"
        elif isinstance(node, ast.FunctionDef):
            assert node.name in {"__getattr__", "__dir__"}
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None and not node.module.startswith("twin")
        else:
            assert isinstance(node, ast.Expr | ast.Assign)


def test_no_module_of_the_package_imports_its_root():
    for path in modules():
        assert "" not in imports(path), path
    assert not imports(ROOT / "fmu_src" / "axis_fmu.py") - {"fmu_src"}


def test_top_level_is_what_it_should_be():
    assert {p.relative_to(ROOT).parts[0] for p in tracked()} <= TOP


def test_no_addresses_of_registries_and_no_machine_paths():
    hosts = ["py" + "pi.org", "python" + "hosted", "github" + "usercontent", "con" + "da.io", "npm" + "js"]
    folders = [rf"/{name}/\w" for name in ("ho" + "me", "ro" + "ot", "wo" + "rk", "tm" + "p")]
    pattern = re.compile("|".join([*map(re.escape, hosts), *folders]))
    texts = {".py", ".md", ".toml", ".txt", ".c", ".h", ".xml", ".cfg", ".yml", ".sh"}
    for path in tracked():
        if path.suffix in texts or path.parent.name == ".ci":
            found = pattern.search(path.read_text(encoding="utf-8"))
            assert found is None, f"{path.relative_to(ROOT)}: {found and found.group()}"
