"""The shape of the code: imports go one way, rooms are few and no halls, importing has no side effects."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import stickslip_jax as ss
from stickslip_jax import design, nonlinear, plot

PACKAGE = "stickslip_jax"
ROOT = Path(__file__).parents[2] / PACKAGE
TESTS = Path(__file__).parents[1]

# From the ground up: a module imports only from its own folder and from entries before its own.
ROWS = (
    "_starting",
    "_compiler",
    "_foundation",
    "_numerics",
    "_uncertainty",
    "_excitation",
    "_systems",
    "_dynamics",
    "_statistics",
    "_ensemble",
    "_sensitivity",
    "_calibration",
    "_sweep",
    "nonlinear",
    "plot",
    "design",
    "papers",
    "study",
    "_explore",
    "_cli",
    "__init__",
    "__main__",
)
CIRCLES: set[tuple[str, ...]] = set()
"""Known circles of files that name each other in annotations. None may be added; one undone leaves the list."""

# A file holds one topic, usually in 200 to 800 lines; a function reads from top to bottom.
FILE_LINES, FUNCTION_LINES = 800, 200
FILES_AT_MOST = 151  # of the package
FLOORS, ARROWS = 12, 108  # at most, of the imports between folders; one that is undone lowers them

MODULES = {path.relative_to(ROOT).with_suffix("").parts: path for path in sorted(ROOT.rglob("*.py"))}


def name_of(parts) -> str:
    return "/".join(parts)


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(), filename=str(path))


def imports_of(tree: ast.Module, *, with_types: bool = False):
    """All import statements, in functions too; those for type checkers only with `with_types`."""
    hidden = set()
    for node in () if with_types else ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            hidden.update(id(inner) for part in node.body for inner in ast.walk(part))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in hidden]


def modules_named(target: tuple[str, ...], names: list[str]) -> set[tuple[str, ...]]:
    """The package's modules behind ``from target import names``."""
    found = set()
    for name in names:
        if (*target, name) in MODULES:
            found.add((*target, name))
        elif (*target, name, "__init__") in MODULES:
            found.add((*target, name, "__init__"))
        elif target in MODULES:
            found.add(target)
        elif name != "__version__":  # plain text, which the package's __init__ holds for everybody
            found.add((*target, "__init__"))
    return found


def uses(parts: tuple[str, ...], *, with_types: bool = False) -> set[tuple[str, ...]]:
    """Which of the package's own modules the module `parts` imports."""
    found = set()
    for node in imports_of(tree_of(MODULES[parts]), with_types=with_types):
        if isinstance(node, ast.ImportFrom):
            module = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                target = parts[: len(parts) - node.level] + module
            elif module[:1] == (PACKAGE,):
                target = module[1:]
            else:
                continue
            found |= modules_named(target, [alias.name for alias in node.names])
        else:
            for alias in node.names:
                if alias.name.split(".")[0] == PACKAGE:
                    found |= modules_named(tuple(alias.name.split(".")[1:]), ["*"])
    return found


@pytest.mark.parametrize("parts", MODULES, ids=name_of)
def test_every_module_has_its_row(parts):
    assert parts[0] in ROWS


def test_all_but_the_public_modules_are_private():
    """And no public function or class hides a module of its name."""
    public = {parts for parts in MODULES if not any(part.startswith("_") and part != "__init__" for part in parts)}
    assert {name_of(parts) for parts in public} == {
        "__init__", "design", "nonlinear/__init__", "papers", "plot/__init__", "study/__init__",
    }  # fmt: skip
    modules = {part for parts in MODULES for part in parts[:1]}
    for namespace in (ss, plot, design, nonlinear):
        assert not {name for name in namespace.__all__ if name in modules}
        assert not [name for name in namespace.__all__ if isinstance(getattr(namespace, name), ModuleType)]


def test_the_stub_names_all_that_is_public():
    """Type checkers read it, and ``__init__`` finds the names of ``__all__`` by it."""
    imported = [node for node in tree_of(ROOT / "__init__.pyi").body if isinstance(node, ast.ImportFrom)]
    found = [alias.name for node in imported for alias in node.names]
    assert [name for name in found if getattr(ss, name) is None] == []
    assert all(alias.asname == alias.name for node in imported for alias in node.names)  # else it is private
    modules = {"design", "nonlinear", "papers", "plot", "study"}
    assert len(found) == len({*found})
    assert {*found} == {*ss.__all__} | modules
    assert dir(ss) == sorted({*ss.__all__, *modules, "__version__"})
    assert not hasattr(ss, "simulat")


def test_only_systems_ask_which_class_a_system_is():
    asks = re.compile(r"isinstance\(.*\b(MassSpring|MotorCart|SwitchedSystem)\b")
    assert [
        name_of(parts) for parts in MODULES if parts[0] != "_systems" and asks.search(MODULES[parts].read_text())
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("parts", MODULES, ids=name_of)
def test_imports_go_one_way(parts):
    row = ROWS.index(parts[0])
    wrong = [name_of(other) for other in uses(parts) if other[0] != parts[0] and ROWS.index(other[0]) >= row]
    assert wrong == []


@pytest.mark.slow
def test_no_circle_of_imports():
    graph = {parts: uses(parts) - {parts} for parts in MODULES}
    while leaves := [parts for parts, others in graph.items() if not others & graph.keys()]:
        for parts in leaves:
            del graph[parts]
    assert [name_of(parts) for parts in graph] == []


def test_no_new_circle_of_files_and_subfolders():
    """A subfolder counts as one, its files together; what only type checkers import counts too."""
    graph: dict[tuple[str, ...], set[tuple[str, ...]]] = {}
    for parts in MODULES:
        graph.setdefault(parts[:2], set()).update(other[:2] for other in uses(parts, with_types=True))

    def reached(start):
        found, further = set(), {start}
        while further:
            further = {other for parts in further for other in graph[parts]} - found
            found |= further
        return found

    behind = {parts: reached(parts) for parts in graph}
    circles = {tuple(sorted(name_of(other) for other in behind[parts] if parts in behind[other])) for parts in graph}
    assert {circle for circle in circles if len(circle) > 1} == CIRCLES


@pytest.mark.slow
@pytest.mark.parametrize("parts", MODULES, ids=name_of)
def test_imports_are_named_and_public(parts):
    """No star imports, nothing private of JAX, and matplotlib only where figures are drawn."""
    for node in imports_of(tree_of(MODULES[parts])):
        names = [alias.name for alias in node.names]
        modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else names
        assert "*" not in names
        for module in modules:
            full = [module, *(f"{module}.{name}" for name in names)]
            assert not any(item.startswith("jax._src") for item in full), ast.unparse(node)
            assert module.split(".")[0] != "matplotlib" or parts[0] in ("plot", "study"), ast.unparse(node)
    assert "jax._src" not in MODULES[parts].read_text()


@pytest.mark.slow
def test_whatever_is_imported_is_declared():
    """By the package or by the extras that its users may install."""
    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needs = [*project["dependencies"], *extras["study"], *extras["cluster"], *extras["tables"], *extras["explore"]]
    declared = {re.split("[^A-Za-z0-9_]", need)[0] for need in needs}
    declared = {{"pillow": "PIL"}.get(name, name) for name in declared}  # imported under another name
    imported = set()
    for path in MODULES.values():
        for node in imports_of(tree_of(path)):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif node.level == 0 and node.module:
                imported.add(node.module.split(".")[0])
    assert imported - set(sys.stdlib_module_names) - {PACKAGE} <= declared


def test_there_are_few_rooms():
    assert len(MODULES) <= FILES_AT_MOST


def test_there_are_few_floors_and_arrows():
    """Floors of the folders (the files beside them only begin things), arrows of both; `ROWS` knows no circle."""
    arrows = {(parts[0], other[0]) for parts in MODULES for other in uses(parts, with_types=True)}
    arrows = {(one, other) for one, other in arrows if one != other and "__init__" not in (one, other)}
    floor: dict[str, int] = {}
    for row in ROWS:
        floor[row] = 1 + max((floor[other] for one, other in arrows if one == row), default=0)
    assert max(floor[row] for row in ROWS if (ROOT / row).is_dir()) <= FLOORS
    assert len(arrows) <= ARROWS


OTHERS = [path for name in ("tests", "benchmarks", "tools") for path in sorted((ROOT.parent / name).rglob("*.py"))]
FILES = [*MODULES.values(), *OTHERS]


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(TESTS.parent)))
def test_files_and_functions_are_no_halls(path):
    text = path.read_text()
    assert len(text.splitlines()) <= FILE_LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno - node.lineno + 1 <= FUNCTION_LINES, node.name


IMPORT_QUIETLY = """
import json, os, sys, warnings
import jax, diffrax, equinox, jaxtyping, numpy
before, seen = dict(os.environ), dict(jax.config.values)
errors, filters = numpy.geterr(), list(warnings.filters)
import stickslip_jax
changed = {name: value for name, value in jax.config.values.items() if seen.get(name) != value}
found = {
    "environment": dict(os.environ) != before,
    "flags": {name: repr(value) for name, value in changed.items()},
    "numpy": numpy.geterr() != errors,
    "warnings": list(warnings.filters) != filters,
    "matplotlib": "matplotlib.pyplot" in sys.modules,
    "numba": "numba" in sys.modules,
}
jax.config.update("jax_num_cpu_devices", 2)  # raises RuntimeError if JAX has started
print(json.dumps(found | {"devices": len(jax.devices("cpu")), "float64": str(jax.numpy.ones(1).dtype)}))
"""


@pytest.fixture(scope="module")
def imported():
    """What a process finds that imports the package after all that it needs."""
    command = [sys.executable, "-c", IMPORT_QUIETLY]
    return json.loads(subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout)


@pytest.mark.slow
def test_importing_changes_nothing(imported):
    """No flag of JAX, no environment variable, no warning filter; float64 stays the user's choice."""
    assert {name: value for name, value in imported.items() if name != "devices"} == {
        "environment": False,
        "flags": {},
        "numpy": False,
        "warnings": False,
        "float64": "float32",
        "matplotlib": False,
        "numba": False,
    }


@pytest.mark.slow
def test_importing_does_not_start_jax(imported):
    """What must be set before JAX starts, such as the number of devices, can still be set after the import."""
    assert imported["devices"] == 2
