"""The structure of the packages: what may import what, and the limits that CONTRIBUTING.md states."""

from __future__ import annotations

import ast
import graphlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("assets", "irm", "planners", "clutter_env")
GL = ("OpenGL", "OpenGL.GL", "mujoco.egl", "mujoco.osmesa")
LEARNING = ("torch", "stable_baselines3", "ray", "minari")
CASES = [
    ("assets", ("mujoco", "gymnasium", "numba", *LEARNING)),
    ("irm", ("gymnasium", "matplotlib", *GL, *LEARNING)),
    ("planners", ("gymnasium", "matplotlib", *GL, *LEARNING)),
    ("clutter_env", ("numba", "planners", "irm", *GL, *LEARNING)),
    ("clutter_env.envs.retrieve", ("numba", "planners", "irm", *GL, *LEARNING)),
    ("clutter_env.envs.goal", ("numba", "planners", "irm", *GL, *LEARNING)),
    ("clutter_env.cli.main", ("numba", "planners", "irm", *GL, *LEARNING)),
]
MOST_FILES, MOST_LINES, MOST_PARAMETERS, MOST_KERNEL_PARAMETERS = 16, 300, 8, 12
SOURCES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
ALL_SOURCES = [
    *SOURCES,
    *sorted(file for name in ("scripts", "tests", "examples") for file in (ROOT / name).rglob("*.py")),
]
TREES = {file: ast.parse(file.read_text()) for file in ALL_SOURCES}


@pytest.mark.parametrize(("package", "banned"), CASES, ids=[case[0] for case in CASES])
def test_imports_stay_small(package: str, banned: tuple[str, ...]) -> None:
    code = f"import sys, {package}; print(sorted(set({banned!r}) & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_import_contracts_hold() -> None:
    pytest.importorskip("importlinter")
    command = [sys.executable, "-c", "import sys; from importlinter.cli import lint_imports_command as run; run()"]
    result = subprocess.run([*command, "--no-cache"], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


def test_no_import_circle() -> None:
    """Imports inside functions, for types alone and by name are counted too."""
    modules = {module_name(file): file for file in SOURCES}
    graph = {name: imported(name, TREES[file], set(modules)) for name, file in modules.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as circle:
        pytest.fail(" <- ".join(circle.args[1]))


def module_name(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(name: str, tree: ast.Module, modules: set[str]) -> set[str]:
    """The modules of ours that a module names in its import statements, or as a string to import one from."""
    found = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    found &= modules - set(PACKAGES)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = {f"{node.module}.{alias.name}" for alias in node.names} & modules
            found |= inside or {node.module}
    return (found & modules) - {name}


def test_no_module_is_shadowed_by_a_name_of_its_package() -> None:
    shadowed = []
    for file in SOURCES:
        if file.name == "__init__.py":
            submodules = {other.stem for other in file.parent.glob("*.py")} | {
                d.name for d in file.parent.iterdir() if d.is_dir()
            }
            names = {
                a.asname or a.name for n in ast.walk(TREES[file]) if isinstance(n, ast.ImportFrom) for a in n.names
            }
            shadowed += [f"{module_name(file)}.{name}" for name in submodules & names]
    assert not shadowed


def test_folders_stay_small() -> None:
    folders = {file.parent for file in ALL_SOURCES} | {ROOT / "docs", ROOT / "docs" / "images", ROOT / "scripts"}
    count = {folder: sum(entry.is_file() for entry in folder.iterdir()) for folder in folders}
    assert not {str(folder): n for folder, n in count.items() if n > MOST_FILES}


def test_files_stay_short() -> None:
    lengths = {str(file.relative_to(ROOT)): len(file.read_text().splitlines()) for file in ALL_SOURCES}
    assert not {name: length for name, length in lengths.items() if length > MOST_LINES}


def test_functions_have_few_parameters() -> None:
    too_many = {}
    for file, node in functions(ALL_SOURCES):
        arguments = node.args
        names = [a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        count = len(names) - (names[:1] in (["self"], ["cls"]))
        is_kernel = any("njit" in ast.unparse(d) or "kernel" in ast.unparse(d) for d in node.decorator_list)
        if count > (MOST_KERNEL_PARAMETERS if is_kernel else MOST_PARAMETERS):
            too_many[f"{file.relative_to(ROOT)}:{node.name}"] = count
    assert not too_many


def functions(files: list[Path]) -> Iterator[tuple[Path, ast.FunctionDef]]:
    for file in files:
        yield from ((file, node) for node in ast.walk(TREES[file]) if isinstance(node, ast.FunctionDef))


def test_everything_public_has_a_docstring() -> None:
    bare = [f"{file.relative_to(ROOT)}: {name}" for file in SOURCES for name in undocumented(TREES[file])]
    assert not bare


def undocumented(tree: ast.Module, prefix: str = "") -> Iterator[str]:
    """Public functions, classes and methods without a docstring, and the module itself."""
    if ast.get_docstring(tree) is None:
        yield prefix or "module"
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            if ast.get_docstring(node) is None:
                yield prefix + node.name
            if isinstance(node, ast.ClassDef):
                methods = ast.Module([entry for entry in node.body if isinstance(entry, ast.FunctionDef)], [])
                yield from (name for name in undocumented(methods, f"{node.name}.") if name != f"{node.name}.")


def test_every_ignored_type_error_names_its_code_and_its_reason() -> None:
    bare = [
        f"{file.relative_to(ROOT)}:{number}"
        for file in ALL_SOURCES
        if file != Path(__file__).resolve()
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if "type: ignore" in line and not re.search(r"# type: ignore\[[\w, -]+\]\s+# \w+", line)
    ]
    assert not bare
