"""The program as syntax trees: its modules, and what each of them imports."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("disk", "processes", "scenegen", "itof", "render", "model", "commandline", "cli", "night_nlos")


@dataclass(frozen=True)
class Import:
    """One import of one module.

    Attributes
    ----------
    module : imported module; the submodule where ``from package import submodule`` names one of ours.
    when_loaded : whether it happens when the importing module is loaded, not later in a function.
    """

    module: str
    when_loaded: bool


@cache
def files() -> tuple[str, ...]:
    """Each file of the program, as its path from the root."""
    found = [ROOT / f"{room}.py" for room in ROOMS if (ROOT / f"{room}.py").is_file()]
    found += [file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    return tuple(str(file.relative_to(ROOT)) for file in found)


@cache
def sources() -> dict[str, ast.Module]:
    """Syntax tree of each file of the program; to be called in tests, as it takes a second."""
    return {file: ast.parse((ROOT / file).read_text()) for file in files()}


def module_of(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@cache
def imports() -> dict[str, list[Import]]:
    """What each module of the program imports, from anywhere."""
    return {module_of(file): imports_in(tree) for file, tree in sources().items()}


def imports_in(tree: ast.Module) -> list[Import]:
    """What the code of a syntax tree imports."""
    return list(_imports(tree, {module_of(file) for file in files()}))


def _imports(node: ast.AST, ours: set[str], when_loaded: bool = True) -> Iterator[Import]:
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, when_loaded) for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "imports are absolute"
        for alias in node.names:
            submodule = f"{node.module}.{alias.name}"
            yield Import(submodule if submodule in ours else str(node.module), when_loaded)
    is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    for_types = node.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) else []
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):  # expressions import nothing
            yield from _imports(child, ours, when_loaded and not is_function and child not in for_types)


def needed_by(module: str) -> set[str]:
    """Our modules that a module imports, directly or through others, when it is loaded or later."""
    needed, waiting = set(), [module]
    while waiting:
        found = {each.module for each in imports()[waiting.pop()] if each.module in imports()} - needed
        needed |= found
        waiting += found
    return needed
