"""The structure of the packages: what may import what, and that everything public is documented."""

from __future__ import annotations

import ast
import graphlib
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("assets", "irm", "planners", "clutter_env")
GL = ("OpenGL", "OpenGL.GL", "mujoco.egl", "mujoco.osmesa")
LEARNING = ("torch", "stable_baselines3", "ray", "minari")
CHAINS = (
    (
        ("planners.goals", ("numba", "irm", "mujoco", "gymnasium", "matplotlib", *GL, *LEARNING)),
        ("assets", ("mujoco", "gymnasium", "numba", *LEARNING)),
        ("planners.scene", ("numba", "gymnasium", "matplotlib", *GL, *LEARNING)),
        ("planners.face", ("gymnasium", "matplotlib", *GL, *LEARNING)),
    ),
    (("irm", ("mujoco", "scipy.ndimage", "scipy.spatial", "mink", "gymnasium", "matplotlib", *GL, *LEARNING)),),
    (
        *(
            (module, ("numba", "planners", "irm", "mink", "scipy", *GL, *LEARNING))
            for module in ("clutter_env", "clutter_env.envs.retrieve", "clutter_env.envs.goal", "clutter_env.cli.main")
        ),
        ("clutter_env.envs.rearrange", ("numba", *GL, *LEARNING)),
    ),
)
"""Modules, and what has not been imported once they are; one process imports those of a chain, in this order."""
SOURCES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
ALL_SOURCES = [
    *SOURCES,
    *sorted(file for name in ("scripts", "tests", "examples") for file in (ROOT / name).rglob("*.py")),
]


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def test_imports_stay_small() -> None:
    code = """
import importlib, sys
for module, banned in {0!r}:
    importlib.import_module(module)
    assert not {{*banned}} & {{*sys.modules}}, (module, {{*banned}} & {{*sys.modules}})
"""
    # Where it names a library, MuJoCo opens that as soon as it is imported: the user has asked for it.
    without_gl = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code.format(chain)], stderr=subprocess.PIPE, text=True, cwd=ROOT, env=without_gl
        )
        for chain in CHAINS
    ]
    for process in processes:
        _, said = process.communicate()
        assert process.returncode == 0, said


def test_no_import_circle() -> None:
    """Imports inside functions, by name and for types alone count too; the methods that draw are the exceptions."""
    modules = {module_name(file): file for file in SOURCES}
    graph = {name: imported(name, tree(file), set(modules)) for name, file in modules.items()}
    for name, other in drawing_methods():
        graph[name].remove(other)
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as circle:
        pytest.fail(" <- ".join(circle.args[1]))


def test_nothing_but_the_methods_that_draw_imports_the_drawing() -> None:
    """In planners; each of these methods has one import, and no other module goes up."""
    allowed = set(drawing_methods())
    assert {name for name, _ in allowed} == {"planners.tamp.solution", "planners.expert.expert"}
    assert all(other.startswith("planners.drawing.") and "*" not in other for _, other in allowed)
    modules = {module_name(file): file for file in SOURCES}
    below = {name: file for name, file in modules.items() if name.startswith("planners.") and ".drawing" not in name}
    found = {
        (name, other)
        for name, file in below.items()
        for other in imported(name, tree(file), set(modules))
        if other.startswith("planners.drawing")
    }
    assert found == allowed
    for name in {name for name, _ in allowed}:
        methods = [node for node in ast.walk(tree(modules[name])) if isinstance(node, ast.FunctionDef)]
        counts = {node.name: sum(isinstance(one, ast.ImportFrom) for one in ast.walk(node)) for node in methods}
        assert max(counts.values()) == 1, counts


def drawing_methods() -> list[tuple[str, str]]:
    """The exceptions to the layers of planners in pyproject.toml: which module imports which."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract for contract in contracts if contract.get("containers") == ["planners"])
    return [tuple(line.split(" -> ")) for line in layers["ignore_imports"]]


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
            names = {a.asname or a.name for n in tree(file).body if isinstance(n, ast.ImportFrom) for a in n.names}
            shadowed += [f"{module_name(file)}.{name}" for name in submodules & names]
    assert not shadowed


def test_everything_public_has_a_docstring() -> None:
    bare = [f"{file.relative_to(ROOT)}: {name}" for file in SOURCES for name in undocumented(tree(file))]
    assert not bare


def undocumented(tree: ast.Module, prefix: str = "") -> Iterator[str]:
    """Public functions, classes and methods without a docstring, and the module itself.

    What a protocol only names (its body is "...") is described by the protocol's own docstring.
    """
    if ast.get_docstring(tree) is None:
        yield prefix or "module"
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            if ast.get_docstring(node) is None:
                yield prefix + node.name
            if isinstance(node, ast.ClassDef):
                is_protocol = "Protocol" in [ast.unparse(base) for base in node.bases]
                written = [entry for entry in node.body if isinstance(entry, ast.FunctionDef)]
                named = [one for one in written if is_protocol and ast.unparse(one.body[-1]) == "..."]
                methods = ast.Module([one for one in written if one not in named], [])
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
