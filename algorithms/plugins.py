"""The plugin table: every technique and projection, found by scanning folders, entry points and named files."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

from algorithms.modules import ROOT, defined_in, files_in, import_file, import_own, installed
from algorithms.projections import table as projections
from algorithms.technique import ALL_LIGHTS, Technique
from wkernels.errors import InputError, nearest

FAMILIES = (
    "hard",
    "filtering",
    "occluder_search",
    "backprojection",
    "light_sampling",
    "volumes",
    "wedges",
    "outer_penumbrae",
    "temporal",
    "reference",
)


def load_all(files: Sequence[Path] = ()) -> dict[str, type[Technique]]:
    """Every technique by name, sorted; parts of projections in ``files`` join ``algorithms.projections.table``.

    Args:
        files: Further plugin files, as given by ``--plugin``.

    Raises:
        InputError: A file fails to import, holds no plugin or several, is named unlike its plugin, declares something
            wrong, or takes a name that exists already. The message names the file.
    """
    table: dict[str, type[Technique]] = {}
    origin: dict[str, Path] = {}
    for module, path in _modules(files):
        technique = _technique_of(module, path)
        if technique.name in table:
            raise InputError(f"technique '{technique.name}' exists already, in {origin[technique.name]}", file=path)
        table[technique.name], origin[technique.name] = technique, path
    return dict(sorted(table.items()))


def find(name: str, files: Sequence[Path] = ()) -> type[Technique]:
    """One technique; loads only its file where the name is one of ours.

    Raises:
        InputError: Unknown name.
    """
    if not files:
        for path in _own_files():
            if path.stem == name:
                return _technique_of(import_own(path), path)
    table = load_all(files)
    if name not in table:
        raise InputError(f"unknown technique '{name}'.{nearest(name, table)}")
    return table[name]


def file_of(technique: type[Technique]) -> Path:
    """The file that a technique lives in."""
    return Path(inspect.getfile(technique))


def _own_files() -> list[Path]:
    return [path for family in FAMILIES for path in files_in(ROOT / family)]


def _modules(files: Sequence[Path]) -> Iterator[tuple[ModuleType, Path]]:
    """Modules that hold a technique, and their files."""
    for path in _own_files():
        yield import_own(path), path
    yield from ((module, path) for module, path in installed() if not projections.holds_part(module))
    brought = [(import_file(path), path) for path in map(Path, files)]
    projections.add([entry for entry in brought if projections.holds_part(entry[0])])
    yield from (entry for entry in brought if not projections.holds_part(entry[0]))


def _technique_of(module: ModuleType, path: Path) -> type[Technique]:
    found: list[type[Technique]] = defined_in(module, Technique)
    if len(found) != 1:
        names = ", ".join(cls.__name__ for cls in found) or "none"
        raise InputError(f"a plugin file holds exactly one Technique, this one holds {len(found)} ({names})", file=path)
    technique = found[0]
    _check_declarations(technique, path)
    return technique


def _check_declarations(technique: type[Technique], path: Path) -> None:
    line = _line_of_class(path, technique.__name__)

    def wrong(message: str) -> InputError:
        return InputError(f"{technique.__name__}: {message}", file=path, line=line)

    for attribute in ("name", "family", "paper", "bias_sign"):
        if not hasattr(technique, attribute):
            raise wrong(f"declares no `{attribute}`")
    if technique.name != path.stem:
        raise wrong(f"is named '{technique.name}' but its file is {path.name}; both must be the same")
    camel = "".join(part.capitalize() for part in technique.name.split("_"))
    if technique.__name__ != camel or not re.fullmatch(r"[a-z][a-z0-9_]*", technique.name):
        raise wrong(f"the class of '{technique.name}' must be called {camel}")
    if technique.family not in FAMILIES:
        raise wrong(f"unknown family '{technique.family}'.{nearest(technique.family, FAMILIES)}")
    if isinstance(technique.paper, str) or not all(isinstance(key, str) for key in technique.paper):
        raise wrong("`paper` is a tuple of keys of references.bib")
    if technique.bias_sign not in ("darker", "lighter", "none"):
        raise wrong(f"`bias_sign` is 'darker', 'lighter' or 'none', not {technique.bias_sign!r}")
    if technique.bias_turns and technique.bias_sign == "none":
        raise wrong("`bias_turns` says where `bias_sign` is the opposite one, which 'none' does not have")
    if unknown := technique.needs.lights - ALL_LIGHTS:
        raise wrong(f"needs an unknown light kind '{min(unknown)}'.{nearest(min(unknown), ALL_LIGHTS)}")
    for name, item in technique.Params.model_fields.items():
        if not item.description or not isinstance(item.json_schema_extra, dict) or "unit" not in item.json_schema_extra:
            raise wrong(f"parameter '{name}' must be made with `setting(default, text, unit=...)`")
        if item.is_required():
            raise wrong(f"parameter '{name}' has no default")
    if not technique.documentation():
        raise wrong("its file has no docstring")
    if inspect.isabstract(technique):
        raise wrong("does not implement `render`")


def _line_of_class(path: Path, name: str) -> int | None:
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError, UnicodeDecodeError):
        return None
    return next((node.lineno for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name), None)
